"""Certificates, searches and runs where samples are lost, at most so many in a row."""

import importlib.util
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import certificate_corpus as corpus
import deadtime as dt
import observer_reference as reference
from deadtime.base.errors import ArgumentError
from deadtime.certificates.proof import load_evidence
from deadtime.certificates.proof.transitions import SwitchGraph
from deadtime.certificates.worst_case.witness import LostAt
from deadtime.certificates.worst_case.worst_cycle import _allowed
from deadtime.cli.application import main
from shares import mostly_long

STEP = 0.1
VERIFY = Path(__file__).parents[2] / "verifier/verify.py"
A = np.array([
    [[0.1, 0.3], [-0.3, -0.2]], [[0.12, 0.25], [-0.32, -0.15]], [[0.08, 0.3], [-0.3, -0.3]]
])  # fmt: skip
B = np.array([[[1.0, 0.0], [0.2, 1.0]], [[1.05, 0.0], [0.2, 0.95]], [[0.95, 0.1], [0.2, 1.0]]])
THREE = dt.SwitchedSystem(A, B, [[0.17, 0.05], [0.12, 0.05], [0.17, 0.08]])
NEAR = dt.SwitchedSystem(1.03 * A, 0.97 * B, [[0.18, 0.05], [0.12, 0.06], [0.17, 0.09]])
SEEN = np.array([[[1.0, 0.3]], [[1.0, 0.25]], [[0.9, 0.3]]])  # one output, of each mode its own


GAINS = dt.lqr(THREE, np.eye(2), np.eye(2), step=STEP)


def on_outputs(plant, C, poles=(-2.0, -3.0), dwell_time=None):
    gains = dt.lqr(plant, np.eye(2), np.eye(plant.inputs), step=STEP)
    law = dt.AveragedPredictor(plant, gains, None, dwell_time)
    return dt.OutputFeedback(law, dt.luenberger(plant, C, poles, STEP))


def aged(true=1.0):
    plant = dt.SwitchedSystem(A[:2], B[:2], 0.17)
    other = dt.SwitchedSystem(true * A[:2], B[:2], 0.18)
    return other, on_outputs(plant, [[1.0, 0.0]], dwell_time=0.35)


# (the true plant and the law, samples lost in a row)
LOOPS = {
    "three modes, own delays, C per mode": (lambda: (NEAR, on_outputs(THREE, SEEN)), 2),
    "rows by age": (lambda: aged(1.02), 1),
    "sums and a disturbance": (lambda: corpus.tracking([[1.0]]), 2),
    "the state, held": (lambda: (NEAR, dt.AveragedPredictor(THREE, GAINS)), 2),
    "the state, rows by mode": (lambda: (corpus.MILD, corpus.DELAYED), 4),
}


def drawn(rng, modes, dwell_time, periods, most):
    """A signal with switches off the grid, and losses, at most so many in a row."""
    times, path = [0.0], [int(rng.integers(modes))]
    while times[-1] < periods * STEP:
        times.append(times[-1] + dwell_time + rng.exponential(0.3) * rng.integers(2))
        path.append(int(rng.choice([i for i in range(modes) if i != path[-1]])))
    lost, run = np.zeros(periods, bool), 0
    for k in range(1, periods):  # the first sample tells a mode
        lost[k] = run < most and rng.random() < 0.75
        run = run + 1 if lost[k] else 0
    return np.array(times), path, lost


def followed(times, path, lost):
    """At every sample: mode, age, losses just before it, and the mode and age that are told."""
    modes = [path[np.flatnonzero(times <= k * STEP + 1e-12)[-1]] for k in range(len(lost))]
    age, told_age, before, told, nodes = 0, 0, 0, modes[0], []
    for k, mode in enumerate(modes):
        age = age + 1 if k and mode == modes[k - 1] else 0
        told_age = told_age + 1 if k and (lost[k] or mode == told) else 0
        told = told if lost[k] else mode
        nodes.append((mode, age, before, told, told_age))
        before = before + 1 if lost[k] else 0
    return nodes


def spans(times, path, k):
    """(mode, start, stop) of the parts of a period, seconds after its sample."""
    marks = [0.0, *(t - k * STEP for t in times if 1e-12 < t - k * STEP < STEP - 1e-12), STEP]
    middles = [0.5 * (a + b) + k * STEP for a, b in pairwise(marks)]
    modes = [path[np.flatnonzero(times <= t)[-1]] for t in middles]
    return [(mode, a, b) for mode, (a, b) in zip(modes, pairwise(marks), strict=True)]


def stepped(plant, law, signal, rng, past):
    """ξ at every sample by the equations, period by period."""
    times, path, lost = signal
    inside = law.law if isinstance(law, dt.OutputFeedback) else law
    table, n, m = inside.digital(STEP), plant.states, plant.inputs
    memory = 0 if inside is law else law.observer.plant.states
    sums = 0 if inside is law or law.servo is None else law.servo.sums
    x, w = rng.normal(size=n), np.zeros(memory + sums)
    if sums:  # a run begins its sums at the first sample
        w[memory:] = -0.5 * STEP * law.servo.tracked @ law.outputs[path[0]] @ x
    sent = list(rng.normal(size=(past, m)))
    for k, (*_, told, told_age) in enumerate(followed(*signal)):
        yield np.concatenate((x, w, *sent[len(sent) - past :][::-1]))
        row = 0 if table.context == "none" else told * table.ages + min(told_age, table.ages - 1)
        parts = spans(times, path, k)
        if memory:
            state = x, w, sent
            x, w, sent = reference.period(plant, law, table, state, (told, row), parts, lost[k])
            continue
        taps = sum(tap @ u for tap, u in zip(table.input_gain[row], sent[::-1], strict=False))
        u = sent[-1] if lost[k] else table.state_gain[row] @ x + taps
        sent = [*sent, u]
        x = reference.Line(sent, STEP).carry(plant, plant.delays, x, parts)


@pytest.mark.parametrize("name", mostly_long(LOOPS, "sums and a disturbance"))
def test_V_falls_along_runs_with_losses_at_the_certified_rate(name, tmp_path):
    (plant, law), most = LOOPS[name][0](), LOOPS[name][1]
    options = {"decay_rate": 0.05, "search_signals": False}
    found = dt.certify(plant, law, 0.35, STEP, lost_samples=most, **options)
    assert found.proven, found.message
    path = found.save(tmp_path / "c")
    assert dt.verify(path, plant, law, dwell_time=0.35, lost_samples=most).proven
    assert "(offsets) and noise. " in f"{found.statement[0]} "
    setting, rho = found.evidence.setting, found.evidence.rho
    for seed in range(3):
        rng = np.random.default_rng(seed)
        signal = drawn(rng, plant.modes, 0.35, 60, most)
        run = stepped(plant, law, signal, rng, setting.past)
        values = []
        for (mode, age, lost, *_), xi in zip(followed(*signal), run, strict=True):
            values.append(float(xi @ found.lyapunov(mode, age, lost) @ xi))
        assert min(values) > 0.0
        assert all(b <= rho**2 * a * (1.0 + 1e-9) for a, b in pairwise(values))


@pytest.mark.few(1)
@pytest.mark.parametrize("name", LOOPS)
def test_runs_and_controllers_that_lose_samples_follow_the_same_equations(name):
    (plant, law), most = LOOPS[name][0](), LOOPS[name][1]
    signal = drawn(np.random.default_rng(3), plant.modes, 0.35, 40, most)
    times, path, lost = signal
    past = int(np.ceil(max(plant.longest_delay, law.plant.longest_delay) / STEP))
    states = list(stepped(plant, law, signal, np.random.default_rng(7), past))
    xi, n, m = states[0], plant.states, plant.inputs
    u0 = xi[len(xi) - past * m :].reshape(past, m)[::-1].T
    switching = dt.SwitchingSignal(times, path, 40 * STEP + 1.0)
    started = law.beginning_at(xi[n : len(xi) - past * m]) if law.observer is not None else law
    at = LostAt(tuple(np.flatnonzero(lost).tolist()), len(lost))
    run = dt.simulate(plant, started, switching, xi[:n], 3.9, STEP, u0, imperfections=[at])
    expected = np.array([one[:n] for one in states])[:40]
    assert np.abs(run.states[:, :40].T - expected).max() < 1e-9 * np.abs(expected).max()
    if law.observer is None:
        return
    controller = dt.Controller(started, STEP, u0=u0)
    for k, (mode, *_, told, _) in enumerate(followed(*signal)[:39]):
        y = law.outputs[mode] @ states[k][:n]
        u = controller.update(np.full_like(y, np.nan) if lost[k] else y, told)
        sent = states[k + 1][len(xi) - past * m :][:m]
        assert np.abs(u - sent).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("context", "ages", "most", "chatter"),
    [("mode", 1, 1, 1), ("mode", 1, 7, 1), ("mode_age", 5, 2, 1), ("mode_age", 6, 5, 1),
     ("none", 1, 3, 1), ("mode_age", 3, 2, 2), ("mode", 1, 2, 3)],
)  # fmt: skip
def test_every_row_that_acts_in_a_run_is_in_the_graph(context, ages, most, chatter):
    ways = [[0, 1, 1], [0, 0, 1], [1, 1, 0]]
    signals = dt.SignalClass(0.35, transitions=ways, lost_samples=most, chatter=chatter)
    graph = SwitchGraph.of(3, signals, STEP, context, ages)
    if chatter > 1:
        told = {(i, lost, row, then) for i in range(3) for row, lost, then in graph._reported(i, 1)}
    else:
        told = {
            (i, a, lost, row, then)
            for i in range(3)
            for a in range(graph.last + 1)
            for row, lost, then in graph._reported(i, a)
        }
    rng = np.random.default_rng(1)
    for _ in range(20):
        times, _, lost = drawn(rng, 3, 0.35, 80, most)
        path = [0]
        while len(path) < len(times):
            path.append(int(rng.choice(graph.following[path[-1]])))
        for k, (mode, age, before, tells, counted) in enumerate(followed(times, path, lost)):
            if k < most + ages:
                continue
            row = 0 if context == "none" else tells * ages + min(counted, ages - 1)
            row, then = (row + graph.measured, before + 1) if lost[k] else (row, 0)
            place = (mode, min(age, graph.clocks[mode].last)) if chatter == 1 else (mode,)
            assert (*place, before, row, then) in told


def test_both_verifiers_have_the_same_rows_at_every_node():
    spec = importlib.util.spec_from_file_location("verify", VERIFY)
    verify = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(verify)
    for path in sorted(corpus.CORPUS.glob("lost-*.json")):
        loop = verify.Loop(verify.certificate(verify.parsed(path)[0]), float("inf"))
        graph = load_evidence(path).evidence.setting.transitions
        assert [clock.last for clock in graph.clocks] == loop.last
        for i in range(graph.modes):
            for a in range(loop.last[i] + 1):
                assert set(graph._reported(i, a)) == set(loop.told(i, a)), (path.name, i, a)


def unstable():
    plant = dt.problems.paper().plant.apart(0.1)
    return plant, on_outputs(plant, [[1.0, 0.0]], (-4.0, -5.0))


@pytest.mark.long
def test_a_loop_that_is_certified_without_losses_is_refuted_with_six_and_its_witness_grows():
    plant, law = unstable()
    assert dt.certify(plant, law, 0.35, STEP, decay_rate=0.0, search_signals=False).proven
    worst = dt.falsify(plant, law, 0.35, STEP, lost_samples=6, budget=2000)
    assert 0.5 < worst.proof.rate <= worst.growth_rate
    periods = round(worst.length / STEP)
    assert _allowed(worst.lost, periods, 6)
    assert not _allowed(worst.lost, periods, 5)
    run = worst.simulate(40)
    size = np.abs(run.states[:, : 40 * periods]).reshape(2, 40, periods).max(axis=(0, 2))
    slope = np.polyfit(np.arange(20) * worst.length, np.log(size[20:]), 1)[0]
    assert abs(slope - worst.growth_rate) < 1e-9


@pytest.mark.long
def test_certify_refutes_losses_that_are_too_many_and_proves_fewer():
    plant, law = unstable()
    refuted = dt.certify(plant, law, 0.35, STEP, lost_samples=6)
    assert refuted.stable is False
    assert refuted.witness.proven
    assert refuted.witness.lost
    assert dt.certify(plant, law, 0.35, STEP, lost_samples=1, decay_rate=0.0).proven


@pytest.mark.long
def test_the_growth_along_a_pattern_is_the_radius_of_the_products_of_the_equations():
    plant, law = corpus.MILD, corpus.DELAYED
    worst = dt.falsify(plant, law, 0.3, STEP, lost_samples=3, budget=4000)
    cycle = worst.cycle
    instants = np.cumsum([cycle.offset, *cycle.gaps[:-1]]) * STEP
    rounds = np.concatenate([instants + r * worst.length for r in range(3)])
    times, path = np.append(0.0, rounds), [cycle.modes[-1], *cycle.modes * 3]
    lost = np.isin(np.arange(3 * cycle.periods) % cycle.periods, worst.lost)
    past, columns = 4, []

    class Unit:
        def __init__(self, at):
            self.at = at

        def normal(self, size):
            whole = np.zeros(2 + past)
            whole[self.at] = 1.0
            return whole[:2] if size == 2 else whole[2:].reshape(size)

    for at in range(2 + past):
        run = list(stepped(plant, law, (times, path, lost), Unit(at), past))
        columns.append((run[cycle.periods], run[2 * cycle.periods]))
    first, second = (np.array(part).T for part in zip(*columns, strict=True))
    M = second @ np.linalg.pinv(first)
    rate = np.log(np.abs(np.linalg.eigvals(M)).max()) / worst.length
    assert rate == pytest.approx(worst.growth_rate, abs=1e-6)


def test_no_losses_are_no_other_certificate_and_what_does_not_fit_is_refused(tmp_path):
    plant, law = corpus.tracking()
    plain, none = (dt.certify(plant, law, 0.5, STEP, **o) for o in ({}, {"lost_samples": 0}))
    paths = [plain.save(tmp_path / "a"), none.save(tmp_path / "b")]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert "lost_samples" not in json.loads(paths[0].read_text())["law"]
    asked = dt.verify(paths[0], plant, law, lost_samples=1)
    assert "at most 0 samples in a row are lost, not 1" in asked.message
    for options, words in (
        ({"lost_samples": -1}, "lost_samples"),
        ({"lost_samples": 101}, "at most 100 in a row"),
        ({"lost_samples": 1, "mode_lag": 1}, "exclude each other"),
    ):
        for ask in (dt.certify, dt.falsify):
            with pytest.raises(ArgumentError, match=words):
                ask(plant, law, 0.5, STEP, **options)
    found = dt.certify(plant, law, 0.5, STEP, lost_samples=1, search_signals=False)
    with pytest.raises(ArgumentError, match="lost must be at most 1"):
        found.lyapunov(0, 0, 2)
    ruled = dt.StateDependentPredictor(
        corpus.MILD, corpus.WEAK, dt.HalfSpace([1.0, 0.0]), allow_unstable=True
    )
    with pytest.raises(ArgumentError, match="lost_samples needs a law that is a table"):
        dt.falsify(corpus.MILD, ruled, 0.5, STEP, lost_samples=1)
    never = corpus.free(corpus.ellipses(2.0, 0.5))
    assert dt.certify(*never, 0.25, STEP, lost_samples=2).evidence.setting.signals.lost_samples == 0


@pytest.mark.long
def test_the_command_line_certifies_and_verifies_losses(tmp_path, capsys):
    file, out = tmp_path / "mine.toml", str(tmp_path / "c.json")
    file.write_text(reference.PROBLEM)
    for command, code in (
        (["certify", str(file), "--law", "averaged", "--lost-samples", "1", "--out", out], 0),
        (["verify", out, "--problem", str(file), "--lost-samples", "1"], 0),
        (["verify", out, "--lost-samples", "2"], 1),
    ):
        with pytest.raises(SystemExit, match=f"^{code}$"):
            main(command)
    said = " ".join(capsys.readouterr().out.split())
    assert "up to 1 sample in a row may be lost" in said
    assert "every loss of samples with at most 1 in a row" in said
    assert "at most 1 samples in a row are lost, not 2" in said


def test_the_program_of_many_nodes_takes_room_for_what_is_not_0_alone(monkeypatch):
    """Each step has the S of two nodes: with all others, 0, it was gigabytes at twenty ages."""
    seen = []
    monkeypatch.setattr(
        "deadtime.certificates.dwell.program.maximise",
        lambda A, *_, **__: seen.append((A.nnz, np.prod(A.shape))),  # no answer
    )
    A = [[[-1.2, 2.0], [0.0, -4.0]], [[-0.6, 1.1], [0.0, -4.0]], [[-0.3, 0.6], [0.0, -4.0]]]
    B = [[[0.0, -1.5], [4.0, 0.0]], [[0.0, -0.8], [4.0, 0.0]], [[0.0, -0.4], [4.0, 0.0]]]
    plant = dt.SwitchedSystem(A, B, [0.17, 0.083])
    law = dt.AveragedPredictor(plant, dt.lqr(plant, np.eye(2), np.eye(2), step=0.05))
    found = dt.certify(plant, law, 0.25, step=0.05, lost_samples=2, search_signals=False)
    assert found.stable is None
    assert max(size for _, size in seen) > 10 * max(full for full, _ in seen)
