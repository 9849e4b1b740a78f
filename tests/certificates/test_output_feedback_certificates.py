"""Certificates and worst cases of loops with an observer, a disturbance's estimate and sums."""

from itertools import pairwise

import numpy as np
import pytest

import deadtime as dt
import observer_reference as reference
from deadtime.certificates.dwell.centre import loop_matrix
from deadtime.certificates.dwell.leaps import plant_rows
from deadtime.certificates.proof.delays import Delays
from deadtime.certificates.proof.evidence import Setting
from deadtime.certificates.proof.transitions import Transition
from deadtime.cli.application import main
from deadtime.feedback.recurrence import recurrence_of
from deadtime.plant.plant_set import Polytope
from exponential_products import ellipses

STEP = 0.1
PAPER = dt.problems.paper().plant
A = np.array([
    [[0.1, 0.3], [-0.3, -0.2]], [[0.12, 0.25], [-0.32, -0.15]], [[0.08, 0.3], [-0.3, -0.3]]
])  # fmt: skip
B = np.array([[[1.0, 0.0], [0.2, 1.0]], [[1.05, 0.0], [0.2, 0.95]], [[0.95, 0.1], [0.2, 1.0]]])
OWN = [[0.17, 0.05], [0.12, 0.05], [0.17, 0.08]]  # of every mode and input, no multiples of STEP
THREE = dt.SwitchedSystem(A, B, OWN)  # three modes, two inputs
NEAR = dt.SwitchedSystem(1.03 * A, 0.97 * B, [[0.18, 0.05], [0.12, 0.06], [0.17, 0.09]])
SEEN = np.array([[[1.0, 0.3]], [[1.0, 0.25]], [[0.9, 0.3]]])  # one output, of each mode its own


def observed(plant, C, poles=(-2.0, -3.0), **options):
    law = dt.AveragedPredictor(plant, dt.lqr(plant, np.eye(2), np.eye(plant.inputs), step=STEP))
    return dt.OutputFeedback(law, dt.luenberger(plant, C, poles, STEP, **options))


def servo(disturbance=None, integral=True):
    """One state and input: sums of errors, and, if asked for, a disturbance that is estimated."""
    plant = dt.SwitchedSystem([[[0.0]], [[0.2]]], [[[1.0]], [[1.1]]], delay=0.17)
    whole = dt.Servo(plant, [[1.0]], disturbance=disturbance, integral=integral)
    gains = whole.place([-1.0, -1.5][: 1 + whole.sums], STEP)
    law = dt.AveragedPredictor(whole.plant, gains, allow_unstable=True)
    poles = [-3.0, -4.0][: whole.model.states]
    observer = dt.luenberger(whole.model, whole.C, poles, STEP)
    return plant, dt.OutputFeedback(law, observer, servo=whole, reference=1.0)


LOOPS = {
    "paper": lambda: (PAPER.apart(0.1), observed(PAPER.apart(0.1), [[1.0, 0.0]], (-4.0, -5.0))),
    "own delays, true ones others": lambda: (NEAR, observed(THREE, SEEN)),
    "sums": servo,
    "sums and a disturbance": lambda: servo([[1.0]]),
    "a disturbance alone": lambda: servo([[1.0]], integral=False),
    "rows by age": lambda: aged(),
}


def aged():
    plant = dt.SwitchedSystem(A[:2], B[:2], 0.17)
    law = dt.AveragedPredictor(plant, dt.lqr(plant, np.eye(2), np.eye(2)), None, 0.35)
    return plant, dt.OutputFeedback(law, dt.luenberger(plant, [[1.0, 0.0]], [-2.0, -3.0], STEP))


def setting_of(plant, law, dwell_time=0.35):
    table = recurrence_of(law, STEP)
    delays = Delays.of(None, plant, STEP)
    return Setting(
        Polytope.of([plant]), delays, table.state_gain, table.input_gain, table.context,
        table.ages, STEP, dt.SignalClass(dwell_time), table.memory,
    )  # fmt: skip


@pytest.mark.parametrize("name", LOOPS)
def test_the_period_of_a_proof_is_that_of_the_equations(name):
    plant, law = LOOPS[name]()
    setting, inside = setting_of(plant, law), law.law.digital(STEP)
    m, q, n, rng = plant.inputs, setting.memory, plant.states, np.random.default_rng(1)
    assert setting.order == n + q + setting.past * m
    for i, j in ((0, 0), (0, 1), (plant.modes - 1, 0)):
        instant = 1.0 if i == j else 0.37
        for row in {setting.transitions.row(i, 0), setting.transitions.row(i, 9)}:
            step = Transition(i, 9, row, j, 0, (instant, instant))
            M = loop_matrix(setting, plant_rows(setting, step, (instant,))[0], row)
            xi = rng.normal(size=setting.order)
            past = list(xi[n + q :].reshape(-1, m)[::-1])
            cut = instant * STEP
            spans = [(i, 0.0, cut), (j, cut, STEP)] if i != j else [(i, 0.0, STEP)]
            told = i, 0 if inside.context == "none" else row
            x, w, sent = reference.period(
                plant, law, inside, (xi[:n], xi[n : n + q], past), told, spans
            )
            expected = np.concatenate((x, w, *sent[::-1]))
            assert np.abs(M @ xi - expected).max() <= 1e-12 * np.abs(expected).max()


def put_back(certificate, plant, law, signal, periods=40):
    """V at the samples of a run of `simulate`, its memory recomputed from its estimates."""
    rng, n, m = np.random.default_rng(5), plant.states, plant.inputs
    setting = certificate.evidence.setting
    u0 = rng.normal(size=(m, setting.past))
    run = dt.simulate(plant, law, signal, rng.normal(size=n), periods * STEP, STEP, u0)
    model = law.observer.plant
    sent = [*u0.T, *run.inputs.T]
    modes = [int(signal(k * STEP)) for k in range(periods + 1)]
    age, n_o = 0, model.states
    for k in range(1, periods):
        mode, before = modes[k], modes[k - 1]
        age = age + 1 if mode == before else 0
        line = reference.Line(sent[: setting.past + k], STEP)
        z = run.estimates[:, k - 1]
        x_bar = line.carry(model, model.delays, z[:n_o], [(before, 0.0, STEP)])
        sums = setting.memory - n_o
        value = law.servo.tracked @ (law.outputs[before] @ run.states[:, k - 1]) if sums else 0.0
        s = z[n_o : n_o + sums] + 0.5 * STEP * value if sums else []
        xi = np.concatenate((run.states[:, k], x_bar, s, *sent[k : setting.past + k][::-1]))
        yield k, mode, age, xi


LOWEST = {"own delays, true ones others": 0.8, "sums": 0.5, "sums and a disturbance": 0.8}


@pytest.mark.few(1)
@pytest.mark.parametrize("name", LOWEST)
def test_V_falls_along_runs_at_the_certified_rate(name, tmp_path):
    plant, law = LOOPS[name]()
    dwell_time = LOWEST[name]
    certificate = dt.certify(plant, law, dwell_time, STEP, search_signals=False)
    assert certificate.proven, certificate.message
    assert dt.verify(certificate.save(tmp_path / "c"), plant, law, dwell_time=dwell_time).proven
    if law.servo is not None:  # what is certified is the loop at rest at 0
        law = dt.OutputFeedback(law.law, law.observer, servo=law.servo)
    rho = certificate.evidence.rho
    for seed in range(2):
        signal = dt.SwitchingSignal.random(plant.modes, 4.0, dwell_time=dwell_time, seed=seed)
        nodes = []
        for k, mode, age, xi in put_back(certificate, plant, law, signal):
            knots = certificate.evidence.knots
            if age in knots or (age > knots[-1]):
                P = certificate.lyapunov(mode, min(age, knots[-1]))
                nodes.append((k, float(xi @ P @ xi)))
        assert len(nodes) >= 8
        for (k, V), (then, after) in pairwise(nodes):
            assert 0.0 < after <= rho ** (2 * (then - k)) * V * (1.0 + 1e-9)


def unstable():
    """A plant that decays by itself, and a gain of the observer that does not."""
    plant = dt.SwitchedSystem(ellipses(2.0, 0.5), np.ones((2, 2, 1)), 0.12)
    gain = np.array([[[0.1], [2.4]], [[2.2], [0.1]]])
    law = dt.DelayedStateFeedback(plant, np.full((2, 1, 2), -0.01))
    observer = dt.Observer(plant, [[1.0, 0.5]], gain, STEP, allow_unstable=True)
    return plant, dt.OutputFeedback(law, observer)


def test_an_observer_that_grows_under_switching_is_refuted_and_the_witness_grows():
    plant, law = unstable()
    worst = dt.falsify(plant, law, 0.3, STEP, budget=4000)
    assert worst.proven
    assert worst.growth_rate > 0.1
    assert 0.0 < worst.proof.rate <= worst.growth_rate + 1e-9
    run = worst.simulate(30)
    size = np.log(np.linalg.norm(np.concatenate((run.states, run.estimates)), axis=0))
    periods = round(worst.length / STEP)
    slopes = (size[periods:] - size[:-periods]) / worst.length
    assert np.allclose(slopes[2 * periods :], worst.growth_rate, atol=1e-6)
    certificate = dt.certify(plant, law, 0.3, STEP)
    assert certificate.stable is False
    assert certificate.witness.proven


def test_no_law_inside_that_is_not_linear_and_no_mode_told_late_of_other_outputs_is_certified():
    two = dt.SwitchedSystem(A[:2], B[:2], 0.17)
    gains = dt.lqr(two, np.eye(2), np.eye(2))
    ruled = dt.StateDependentPredictor(two, gains, dt.HalfSpace([1.0, 0.0]))
    loop = dt.OutputFeedback(ruled, dt.luenberger(two, [[1.0, 0.0]], [-3.0, -4.0], STEP))
    refused = dt.certify(two, loop, 0.3, STEP)
    assert refused.stable is None
    assert "OutputFeedback has no linear update of its state" in refused.message
    late = dt.certify(THREE, observed(THREE, SEEN), 0.8, STEP, mode_lag=1)
    assert late.stable is None
    assert "certify with one C for all modes, or without mode_lag" in late.message


def test_bounds_of_growth_hold_what_the_eigenvalues_say():
    plant, law = servo()
    low, high = dt.growth_bounds(plant, law, 0, STEP)
    assert low <= dt.growth_rate(plant, law, 0, STEP) + 1e-9 <= high + 2e-9
    assert high - low < 1e-9


@pytest.mark.long
def test_margins_and_the_command_line_follow(tmp_path):
    plant, law = servo()
    alone = dt.delay_margin(plant, law, STEP, upto=0.3)
    proved = dt.delay_margin(plant, law, STEP, dwell_time=0.8, upto=0.3)
    assert proved.certified
    assert alone.lower <= proved.lower < 0.17 < proved.upper <= alone.upper
    file, out = tmp_path / "mine.toml", tmp_path / "cert.json"
    file.write_text(reference.PROBLEM)
    for command in (["certify", str(file), "--out", str(out)], ["verify", str(out)]):
        with pytest.raises(SystemExit, match=r"^0$"):
            main([*command, *(["--problem", str(file)] if command[0] == "verify" else [])])
