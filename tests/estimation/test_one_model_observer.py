"""Observers of one model: they read no mode, and everything that runs or proves a loop knows it."""

import itertools
import re

import numpy as np
import pytest
from scipy.linalg import expm

import deadtime as dt
import plants
from deadtime.feedback.recurrence import recurrence_of

STEP, C, POLES = 0.05, plants.OUTPUTS, [-3.0, -4.0, -5.0]
PLANT = plants.near()
OWN = dt.SwitchedSystem(PLANT.A, PLANT.B, [[0.17, 0.05], [0.23, 0.11], [0.12, 0.2]])
SIGNAL = dt.SwitchingSignal([0.0, 0.42, 1.1, 1.63], [1, 0, 2, 1])
X0 = [1.0, -1.0, 0.5]
MODELS = ["mean", 0, 2]


def loop(model="mean", plant=PLANT, law="averaged"):
    observer = dt.luenberger(plant, C, POLES, STEP, model=model)
    return dt.OutputFeedback(plants.LAWS[law](plant), observer, estimate=[0.1, -0.2, 0.3])


def believed(plant, model):
    """Matrices and delays of the model, by their definition."""
    if model == "mean":
        return plant.A.mean(axis=0), plant.B.mean(axis=0), plant.delays.mean(axis=0)
    delays = np.broadcast_to(plant.delays, (plant.modes, plant.inputs))
    return plant.A[model], plant.B[model], delays[model]


def over_a_period(A, B, delays, x, u, k):
    """x after period k: what arrives when by the delays alone, SciPy's exponential."""
    n, m = B.shape
    cuts = sorted({0.0, STEP, *np.round(delays % STEP, 12).tolist()})
    for a, b in itertools.pairwise(cuts):
        sent = np.floor(k + (0.5 * (a + b) - delays) / STEP).astype(int)
        acting = [u[i][j] if i >= 0 else 0.0 for j, i in enumerate(sent)]
        Z = np.zeros((n + m, n + m))
        Z[:n] = np.hstack((A, B))
        x = (expm(Z * (b - a)) @ np.concatenate((x, acting)))[:n]
    return x


@pytest.mark.parametrize("plant", [PLANT, OWN], ids=["one delay", "own delays"])
@pytest.mark.parametrize("model", MODELS)
def test_the_estimate_is_that_of_the_one_model_whatever_the_mode(model, plant):
    law = loop(model, plant)
    run = dt.simulate(plant, law, SIGNAL, X0, 2.0, STEP)
    assert set(run.mode.tolist()) == {0, 1, 2}
    A, B, delays = believed(plant, model)
    L, x = law.observer.gain[0], np.array(law.estimate)
    for k, y in enumerate(run.measured.T):
        x = x + L @ (y - C @ x)
        plants.close(run.estimates[:, k], x, 1e-11)
        x = over_a_period(A, B, delays, x, run.inputs.T, k)


@pytest.mark.parametrize("model", MODELS)
def test_its_error_has_the_poles_asked_for_where_the_plant_is_the_model(model):
    observer = loop(model).observer
    A, _, _ = believed(PLANT, model)
    error = expm(A * STEP) @ (np.eye(3) - observer.gain[0] @ C)
    found = np.sort(np.log(np.linalg.eigvals(error)).real / STEP)
    np.testing.assert_allclose(found, np.sort(POLES), rtol=1e-8)
    np.testing.assert_allclose(observer.rates, max(POLES), rtol=1e-8)


def test_the_kalman_filter_of_the_mean_is_that_of_the_mean_alone():
    given = C, 0.1 * np.eye(3), 0.01 * np.eye(2), STEP
    one, alone = dt.kalman(PLANT, *given, model="mean"), dt.kalman(PLANT.mean(), *given)
    for name in ("gain", "covariance", "prior"):
        for mine in getattr(one, name):
            assert mine.tolist() == getattr(alone, name)[0].tolist()
    assert not one.reads_mode


@pytest.mark.parametrize("model", MODELS)
def test_nobody_has_to_tell_a_controller_the_mode(model):
    law = loop(model)
    run = dt.simulate(PLANT, law, SIGNAL, X0, 2.0, STEP)
    controller = dt.Controller(law, STEP)
    assert not controller.reads_mode
    found = np.array([controller.update(y) for y in run.measured.T]).T
    plants.close(found, run.inputs, 1e-12)
    with pytest.raises(dt.ArgumentError, match="mode must be given: the observer depends on it"):
        dt.Controller(loop("modes"), STEP).update([0.0, 0.0])
    message = "mode must be given: the rows of this law depend on it"
    with pytest.raises(dt.ArgumentError, match=message):
        dt.Controller(loop(model, law="expected"), STEP).update([0.0, 0.0])


@pytest.mark.parametrize("model", MODELS)
def test_a_mode_that_is_told_late_or_is_unknown_changes_nothing(model):
    late = dt.imperfections.ModeDelay(3)
    runs = [
        dt.simulate(PLANT, loop(model), SIGNAL, X0, 2.0, STEP, imperfections=kinds)
        for kinds in ([], [late])
    ]
    assert runs[0].inputs.tolist() == runs[1].inputs.tolist()
    told = dt.simulate(PLANT, loop("modes"), SIGNAL, X0, 2.0, STEP, imperfections=[late])
    heard = dt.simulate(PLANT, loop("modes"), SIGNAL, X0, 2.0, STEP)
    assert np.abs(told.inputs - heard.inputs).max() > 1e-3
    controllers = [dt.Controller(loop(model), STEP) for _ in range(2)]
    for y in runs[0].measured.T[:20]:
        ours = [one.update(y, mode) for one, mode in zip(controllers, (0, 7), strict=True)]
        assert ours[0].tolist() == ours[1].tolist()


def test_all_that_knows_of_modes_agrees_on_who_reads_them():
    for model, reads in (("modes", True), *((one, False) for one in MODELS)):
        law = loop(model)
        table = recurrence_of(law, STEP)
        memory = law.memory(STEP)
        assert (law.observer.reads_mode, memory.reads_mode) == (reads, reads)
        assert table.context == ("mode" if reads else "none")
        assert law.observer_alone_reads_mode == reads
        assert not loop(model, law="expected").observer_alone_reads_mode
    per_mode = C + 0.05 * np.arange(3)[:, None, None]
    same = PLANT.apart(0.0)
    assert not dt.luenberger(same, C, POLES, STEP).reads_mode
    assert dt.luenberger(same, per_mode, POLES, STEP).reads_mode
    assert dt.luenberger(same, C, [POLES, POLES, [-2.0, -3.0, -4.0]], STEP).reads_mode


def motor(model):
    A = [[[0.0, 1.0], [0.0, -10.0]], [[0.0, 1.0], [0.0, -4.0]]]
    plant = dt.SwitchedSystem(A, [[[0.0], [50.0]], [[0.0], [20.0]]], 0.03)
    law = dt.AveragedPredictor(plant, dt.place(plant, [-12.0, -15.0]))
    observer = dt.luenberger(plant, [[1.0, 0.0]], [-60.0, -70.0], 0.01, model=model)
    return plant, dt.OutputFeedback(law, observer)


@pytest.mark.parametrize("model", ["mean", 1])
def test_the_loop_is_certified_with_one_row_and_the_proof_holds_in_runs(model, tmp_path):
    plant, law = motor(model)
    found = dt.certify(plant, law, dwell_time=0.5, step=0.01)
    assert found.stable
    assert found.proven
    found.save(tmp_path / "c.json")
    assert dt.verify(tmp_path / "c.json", plant=plant, law=law).proven
    assert not dt.verify(tmp_path / "c.json", plant=plant, law=motor("modes")[1]).proven
    assert max(dt.growth_rate(plant, law, mode, 0.01) for mode in (0, 1)) <= -found.decay_rate
    for seed in range(3):
        signal = dt.SwitchingSignal.random(2, 4.0, dwell_time=0.5, mean_sojourn=0.6, seed=seed)
        run = dt.simulate(plant, law, signal, [1.0, 0.0], 4.0, 0.01)
        size = np.linalg.norm(run.states, axis=0)
        assert np.log(size[100] / size[300]) / 2.0 >= 0.9 * found.decay_rate


def test_a_loop_that_the_one_model_destroys_is_refuted():
    """On the paper's plant the modes differ too much for the mean: a mode held grows."""
    problem = dt.problems.paper()
    observer = dt.luenberger(problem.plant, [[1.0, 0.0]], [-4, -5], 0.05, model="mean")
    law = dt.OutputFeedback(dt.AveragedPredictor(problem.plant, problem.gains), observer)
    rate = dt.growth_rate(problem.plant, law, 1, 0.05)
    assert rate > 0.5
    run = dt.simulate(problem.plant, law, dt.SwitchingSignal.constant(1), [1.0, 0.0], 30.0, 0.05)
    size = np.linalg.norm(run.states, axis=0)
    assert np.log(size[-1] / size[300]) / 15.0 == pytest.approx(rate, rel=0.05)
    assert dt.falsify(problem.plant, law, 0.8, step=0.05).growth_rate > 0.5


@pytest.mark.long
def test_scenarios_in_batches_are_the_runs_one_by_one():
    signals = [dt.SwitchingSignal.random(3, 2.5, dwell_time=0.3, seed=k) for k in range(3)]
    data = dt.monte_carlo(PLANT, {"mean": loop()}, signals, X0, 2.0, STEP)
    for k, signal in enumerate(signals):
        run = dt.simulate(PLANT, loop(), signal, X0, 2.0, STEP)
        assert float(data.ise[0, k]) == pytest.approx(run.metrics()["ise"], rel=1e-10)


def test_outputs_follow_without_a_mode_and_without_an_offset():
    plant = plants.resting()
    servo = dt.Servo(plant, C)
    gains = servo.lqr(np.eye(3 + servo.sums), np.eye(2), step=STEP)
    observer = dt.luenberger(servo.model, servo.C, POLES, STEP, model="mean")
    law = dt.OutputFeedback(
        dt.AveragedPredictor(servo.plant, gains, allow_unstable=True),
        observer,
        servo=servo,
        reference=[1.0, -2.0],
    )
    assert not dt.Controller(law, STEP).reads_mode
    for mode in range(3):
        assert dt.growth_rate(plant, law, mode, STEP) < -0.03
        signal = dt.SwitchingSignal.constant(mode)
        run = dt.simulate(plant, law, signal, X0, 450.0, STEP)
        np.testing.assert_allclose(run.measured[:, -1], [1.0, -2.0], atol=1e-4)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: dt.luenberger(PLANT, np.stack([C, C, 2.0 * C]), POLES, STEP, model="mean"),
            "model = 'mean' needs one C for all modes: an observer that reads no mode cannot",
        ),
        (
            lambda: dt.luenberger(PLANT, C, POLES, STEP, model="median"),
            'model must be "modes", "mean" or the number of a mode, got \'median\'.',
        ),
        (
            lambda: dt.kalman(PLANT, C, np.eye(3), np.eye(2), STEP, model=3),
            "model must be in 0..2, got 3",
        ),
        (
            lambda: dt.luenberger(PLANT, C, [POLES] * 3, STEP, model=0),
            "poles must have shape (n,) = (3,) or (modes, n) = (1, 3), got (3, 3).",
        ),
        (
            lambda: dt.OutputFeedback(
                plants.LAWS["averaged"](PLANT),
                dt.luenberger(
                    dt.SwitchedSystem(PLANT.A, PLANT.B, 0.1), C, POLES, STEP, model="mean"
                ),
            ),
            "law must be made for the observer's plant, with delay = 0.1, got delay = 0.234.",
        ),
    ],
)
def test_what_cannot_be_is_refused_by_name(call, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        call()
