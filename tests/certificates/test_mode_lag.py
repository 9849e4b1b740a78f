"""Certificates and worst signals of laws that are told the mode some periods late.

What may be told is worked out here from whole histories of modes, the loops' matrices come from
`delayed_loops`, and runs from `simulate` with `imperfections.ModeDelay`.
"""

import itertools
import json
import math

import numpy as np
import pytest

import certificate_corpus as corpus
import deadtime as dt
import delayed_loops
from certificate_reference import rewritten
from deadtime.certificates.proof import StretchEvidence
from deadtime.certificates.proof.transitions import SwitchGraph
from deadtime.imperfections import ModeDelay

STEP = 0.1


def by_mode(plant, gains):
    return dt.DelayedStateFeedback(plant, gains, allow_unstable=True)


def a_loop(seed):
    """A plant and a law that reads the mode: two or three modes, one delay or one per input."""
    rng = np.random.default_rng(seed)
    modes, n, m = 2 + seed % 2, int(rng.integers(1, 3)), 1 + seed % 3 // 2
    A = rng.normal(size=(modes, n, n)) * rng.uniform(0.3, 3.0)
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.0, 1.0)) * np.eye(n)
    B = rng.normal(size=(modes, n, m))
    delay = float(rng.choice([0.1, 0.13, 0.2, 0.27]))
    plant = dt.SwitchedSystem(A, B, rng.choice([0.1, 0.13, 0.2, 0.27], m) if m > 1 else delay)
    gains = rng.normal(size=(modes, m, n)) * 0.3
    dwell = STEP * float(rng.choice([3, 4, 5.5]))
    aged = dt.AveragedPredictor(plant, gains, None, dwell, allow_unstable=True)
    law = aged if seed % 5 == 0 else by_mode(plant, gains)
    return rng, plant, law, round(dwell, 12), int(rng.integers(1, 7))


# -- what may be told --------------------------------------------------------------------------


def told_in_histories(modes, ages, shortest, lag):
    """(mode, its age) to the rows told, over all histories of sojourns of `shortest` samples up."""
    longest, found = max(shortest, lag) + ages + 1, {}
    count = 2 + -(-lag // shortest)
    for word in itertools.product(range(modes), repeat=count):
        if any(a == b for a, b in itertools.pairwise(word)):
            continue
        for lengths in itertools.product(range(shortest, longest), repeat=count - 1):
            seen = [i for i, k in zip(word, lengths, strict=False) for _ in range(k)]
            begun = [a for k in lengths for a in range(k)]
            for age in range(lag + ages):
                now = len(seen) + age
                history = seen + [word[-1]] * (age + 1)
                since = begun + list(range(age + 1))
                if now - lag >= lengths[0]:  # the first sojourn may have begun before
                    row = history[now - lag] * ages + min(since[now - lag], ages - 1)
                    found.setdefault((word[-1], age), set()).add(row)
    return found


@pytest.mark.parametrize(
    ("modes", "ages", "shortest", "lag"),
    [(2, 1, 2, 1), (2, 1, 2, 3), (2, 1, 3, 7), (3, 1, 2, 2), (3, 1, 2, 3), (2, 3, 2, 2),
     (2, 2, 3, 4), (3, 2, 2, 3)],
)  # fmt: skip
def test_the_rows_that_may_act_are_those_of_all_histories(modes, ages, shortest, lag):
    context = "mode" if ages == 1 else "mode_age"
    signals = dt.SignalClass((shortest + 1) * STEP, mode_lag=lag)
    graph = SwitchGraph.of(modes, signals, STEP, context, ages)
    assert graph.first + 1 == shortest
    found = told_in_histories(modes, ages, shortest, lag)
    assert len(found) == modes * (lag + ages)
    for (mode, age), rows in found.items():
        assert set(graph.rows(mode, age)) == rows, (mode, age)


# -- proofs ------------------------------------------------------------------------------------


def run_late(plant, law, signal, lag, past, samples, rng):
    """ξ_k and the sampled modes of a run of `simulate` with late modes."""
    x0, u0 = rng.normal(size=plant.states), rng.normal(size=(plant.inputs, past))
    late = [ModeDelay(lag)]
    run = dt.simulate(
        plant, law, signal, x0, samples * STEP, STEP, u0[:, -past:], imperfections=late
    )
    inputs = np.concatenate((u0, run.inputs), axis=1).T
    states = [
        np.concatenate((run.states[:, k], inputs[k : k + past][::-1].ravel()))
        for k in range(samples + 1)
    ]
    return states, signal(np.arange(samples + 1) * STEP + 1e-12).tolist()


def a_signal(rng, modes, dwell, horizon):
    """Random sojourns of the dwell time and a little more, switching off the grid."""
    times, here = [0.0], [int(rng.integers(modes))]
    while times[-1] < horizon:
        times.append(times[-1] + dwell + float(rng.choice([0.0, rng.exponential(0.3)])))
        here.append(int(rng.choice([i for i in range(modes) if i != here[-1]])))
    return dt.SwitchingSignal(times, here)


FEW = (0, 2, 3, 11)  # with ages, with two inputs, with three modes, with both


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "seed",
    [pytest.param(k, marks=() if k in FEW else pytest.mark.long) for k in range(12) if k != 7],
)
def test_v_falls_as_certified_along_runs_with_late_modes(seed):
    rng, plant, law, dwell, lag = a_loop(seed)
    found = dt.certify(plant, law, dwell, STEP, mode_lag=lag, search_signals=False)
    assert found.stable, found.message
    whole = not isinstance(found.evidence, StretchEvidence)  # along stretches V is known at nodes
    evidence, ages = found.evidence, law.digital(STEP).ages
    assert evidence.setting.signals.mode_lag == lag
    samples = 60
    signal = a_signal(rng, plant.modes, dwell, samples * STEP)
    states, modes = run_late(plant, law, signal, lag, evidence.setting.past, samples, rng)
    age, values, seen = 0, [], []
    for k, xi in enumerate(states):
        age = 0 if k and modes[k] != modes[k - 1] else age + (k > 0)
        if k >= lag + ages and (whole or age >= lag):
            values.append(xi @ found.lyapunov(modes[k], age) @ xi)
            seen.append(k)
    assert len(values) > 40
    assert min(values) > 0.0
    for (before, k), (after, now) in itertools.pairwise(zip(values, seen, strict=True)):
        assert after <= before * evidence.rho ** (2 * (now - k)) * (1.0 + 1e-9)


class Late(delayed_loops.Loop):
    """The second method's loop under rows that are told."""

    def under(self, row, mode, after, s):
        self.row = lambda *_: row
        return self.step(mode, 0, after, s)


def growth(loop, cycle, lag):
    """The factor per period along sojourns (mode, full periods, instant of the switch after)."""
    periods = []
    for (mode, full, s), (after, _, _) in itertools.pairwise([*cycle, cycle[0]]):
        periods += [(mode, age, None, 1) for age in range(full)] + [(mode, full, after, s)]
    product = np.eye(loop.order)
    for k, (mode, _, after, s) in enumerate(periods):
        told, age, *_ = periods[(k - lag) % len(periods)]
        ages = loop.table.ages
        row = told * ages + min(age, ages - 1)
        product = loop.under(row, mode, after, s) @ product
    return float(np.abs(np.linalg.eigvals(product)).max()) ** (1.0 / len(periods))


def worst_of_attack(rng, loop, modes, dwell, lag, tries=50):
    """The largest factor of random admissible cycles, the best three changed where that helps."""

    def admissible(cycle):
        before = [cycle[-1], *cycle[:-1]]
        lasts = [1.0 - b[2] + here[1] + here[2] for b, here in zip(before, cycle, strict=True)]
        return min(lasts) >= dwell / STEP * (1.0 - 1e-5)

    shortest, found = max(0, math.ceil(dwell / STEP) - 2), []
    for _ in range(tries):
        count = int(rng.choice([2, 2, 3, 4])) if modes > 2 else int(rng.choice([2, 4]))
        word = [k % modes for k in range(count)]
        if word[0] == word[-1]:
            word[-1] = next(i for i in range(modes) if i not in (word[0], word[-2]))
        full = (shortest + rng.integers(0, 6, count)).tolist()
        cycle = list(zip(word, full, rng.choice([0.0, 0.5, 1.0], count).tolist(), strict=True))
        if admissible(cycle):
            found.append((growth(loop, cycle, lag), cycle))
    best = max(found)[0]
    for rate, cycle in sorted(found, reverse=True)[:3]:
        for _ in range(20):
            k, moved = int(rng.integers(len(cycle))), [*cycle]
            mode, full, _ = cycle[k]
            moved[k] = mode, max(0, full + int(rng.integers(-1, 2))), float(rng.random())
            if admissible(moved) and growth(loop, moved, lag) > rate:
                rate, cycle = growth(loop, moved, lag), moved
        best = max(best, rate)
    return best


@pytest.mark.parametrize(
    "seed", [1, 2, *(pytest.param(k, marks=pytest.mark.long) for k in (5, 6, 9, 10))]
)
def test_no_certificate_is_violated_by_signals_searched_by_other_code(seed):
    rng, plant, law, dwell, lag = a_loop(seed)
    found = dt.certify(plant, law, dwell, STEP, mode_lag=lag, search_signals=False)
    loop = Late(plant, law.digital(STEP))
    assert worst_of_attack(rng, loop, plant.modes, dwell, lag) < found.evidence.rho


def paper_loop(alpha=0.5, delay=1.0):
    near = corpus.PAPER.apart(alpha)
    plant = dt.SwitchedSystem(near.A, near.B, delay)
    law = dt.ExpectedPredictor(plant, dt.place(plant, [-1.0, -2.0]), dt.Markov([[0, 1], [1, 0]]))
    return plant, law


@pytest.fixture(scope="module")
def reported_late():
    """A certificate of a loop that is told the mode two periods late."""
    found = dt.certify(*paper_loop(), 0.5, STEP, mode_lag=2, decay_rate=0.0, search_signals=False)
    assert found.proven
    return found


@pytest.mark.long
def test_without_a_lag_and_for_laws_that_do_not_read_the_mode_the_file_is_the_same(tmp_path):
    for name, lags in (("expected", (0,)), ("mean", (0, 7))):
        loop, dwell, step, options = corpus.CASES[name]
        options = {**options, "search_signals": False}
        plain = dt.certify(*loop(), dwell, step, **options).save(tmp_path / "plain.json")
        for lag in lags:
            found = dt.certify(*loop(), dwell, step, mode_lag=lag, **options)
            path = found.save(tmp_path / "late.json")
            assert path.read_bytes() == plain.read_bytes()
            assert "mode_lag" not in json.loads(path.read_text())["law"]


def test_a_file_says_how_late_and_is_about_that_loop_alone(reported_late, tmp_path):
    plant, law = paper_loop()
    path = reported_late.save(tmp_path / "late.json")
    assert json.loads(path.read_text())["law"]["mode_lag"] == 2
    told = dt.verify(path, plant, law, mode_lag=2)
    assert told.proven
    assert "the mode is reported 2 periods late" in told.statement[2]
    assert dt.verify(path).proven
    for asked in ({"law": law}, {"mode_lag": 3}, {"mode_lag": 0}):
        other = dt.verify(path, **asked)
        assert not other.proven
        assert "a mode that is reported 2 periods late, not" in other.message


@pytest.mark.parametrize("lag", [0, 1, 3, 6, 30])
def test_another_lag_written_into_a_file_proves_nothing(lag, reported_late, tmp_path):
    path = reported_late.save(tmp_path / "late.json")
    rewritten(path, "law", {"mode_lag": lag})
    if lag == 0:
        with pytest.raises(dt.DeadtimeError, match=r"law\.mode_lag 0 must be left out"):
            dt.verify(path)
    else:
        assert not dt.verify(path).proven


# -- signals that grow -------------------------------------------------------------------------


@pytest.mark.few(1)
@pytest.mark.parametrize(("alpha", "lag"), [(1.0, 3), (0.5, 11)])
def test_the_worst_signal_grows_as_said_in_a_run_with_late_modes(alpha, lag):
    plant, law = paper_loop(alpha)
    worst = dt.falsify(plant, law, 0.4, STEP, mode_lag=lag)
    assert worst.proven
    assert worst.signals.mode_lag == lag
    cycles = 40
    run = worst.simulate(cycles)
    ends = np.abs(run.states[:, :: worst.cycle.periods]).max(axis=0)
    slope = np.polyfit(np.arange(21) * worst.length, np.log(ends[-21:]), 1)[0]
    assert slope == pytest.approx(worst.growth_rate, rel=0.02)


def test_a_constant_mode_grows_the_same_however_late_it_is_told():
    plant, law = paper_loop(1.0)
    aware = dt.AveragedPredictor(plant, law.gains, None, 0.4)
    for one in (law, aware):
        rates = [dt.growth_rate(plant, one, 1, STEP, mode_lag=lag) for lag in (0, 5)]
        assert rates[0] == rates[1] == dt.growth_rate(plant, one, 1, STEP)
    with pytest.raises(dt.ArgumentError, match="mode_lag must be an integer of at least 0, got -1"):
        dt.growth_rate(plant, law, 1, STEP, mode_lag=-1)


@pytest.mark.long
def test_a_lag_that_is_refuted_is_not_certified():
    plant, law = paper_loop(1.0)
    certificate = dt.certify(plant, law, 0.4, STEP, mode_lag=3)
    assert certificate.stable is False
    assert certificate.witness.proven
    assert certificate.witness.signals.mode_lag == 3
