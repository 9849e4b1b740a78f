"""Laws on a belief from outputs: their definition, that no mode is read, observers, refusals."""

import numpy as np
import pytest

import deadtime as dt
import plants
from by_period import MODEL, PLANT, SIGNAL
from deadtime.imperfections import Dropout, ModeDelay, Noise, WhiteDisturbance, WrongMode
from shares import mostly_long

STEP, X0 = 0.1, [1.0, -1.0, 0.5]
C = [[1.0, 0.0, 0.2], [0.0, 1.0, 0.0]]
SEMI = dt.SemiMarkov([0.4, 0.7, 0.5])
LAWS = {
    "mode": dt.ExpectedPredictor(MODEL, plants.gains(MODEL), plants.markov(3)),
    "ages": dt.ExpectedPredictor(MODEL, plants.gains(MODEL), SEMI),
    "dwell": dt.AveragedPredictor(MODEL, plants.gains(MODEL), None, 0.31),
}


def made(model=None, **options):
    given = {"covariance": 0.1, "disturbance": 0.2, "noise": 0.05, "estimate": X0} | options
    return dt.OutputModeFilter(
        MODEL, plants.markov(3) if model is None else model, STEP, C, **given
    )


@pytest.mark.parametrize("model", [plants.markov(3), SEMI], ids=["markov", "semi-markov"])
@pytest.mark.parametrize("name", LAWS)
def test_inputs_are_the_rows_of_each_mode_on_its_estimate_weighed_by_the_belief(name, model):
    law, filt = LAWS[name], made(model)
    kinds = [Noise(0.05), Dropout(0.3), WhiteDisturbance(0.1)]
    args = SIGNAL, X0, 2.0, STEP
    run = dt.simulate(PLANT, dt.BeliefPredictor(law, filt), *args, imperfections=kinds)
    assert run.measured.shape == (2, 21)
    assert np.isnan(run.measured).any()
    table = law.digital(STEP)
    running = dt.estimation.RunningOutputFilter(filt.form(table.ages))
    past = np.zeros((table.taps + 30, 2))
    for k in range(21):
        plants.close(running.update(run.measured[:, k], past[-1]), run.belief[:, k], 1e-12)
        plants.close(running.estimate, run.estimates[:, k], 1e-12)
        u = 0.0
        for mode, age in np.ndindex(running.belief.shape):
            row = mode * table.ages + min(age, table.ages - 1)
            own = table.state_gain[row] @ running.estimates[mode]
            for j in range(table.taps):
                own = own + table.input_gain[row, j] @ past[-1 - j]
            u = u + running.belief[mode, age] * own
        plants.close(run.inputs[:, k], u, 1e-10)
        past = np.vstack((past[1:], run.inputs[:, k]))


def test_no_mode_is_read():
    law = dt.BeliefPredictor(LAWS["ages"], made(SEMI))
    args = PLANT, law, SIGNAL, X0, 2.0, STEP
    run = dt.simulate(*args)
    for kinds in ([ModeDelay(3)], [WrongMode(1.0)]):
        other = dt.simulate(*args, imperfections=kinds)
        assert (other.states == run.states).all()
        assert (other.belief == run.belief).all()
        assert (other.estimates == run.estimates).all()


def test_a_rule_may_decide_the_mode():
    plant, model = plants.paper(), plants.markov(2)
    law = dt.ExpectedPredictor(plant, plants.gains(plant), model)
    filt = dt.OutputModeFilter(plant, model, 0.02, np.eye(2), covariance=1.0)
    rule = dt.HalfSpace([1.0, 0.4], 0.0)
    run = dt.simulate(plant, dt.BeliefPredictor(law, filt), rule, [-1.0, 1.0], 4.0, 0.02)
    assert run.signal.switches > 0
    assert (run.belief.argmax(axis=0) == run.mode).mean() > 0.95


def test_a_bank_of_one_observer_is_output_feedback_on_it():
    plant = dt.SwitchedSystem(MODEL.A[:1], MODEL.B[:1], MODEL.delays[:1])
    law = dt.ExpectedPredictor(plant, plants.gains(plant), dt.Markov([[0.0]]))
    kinds = [Noise(0.05), Dropout(0.2), WhiteDisturbance(0.1)]
    for observer in (
        dt.luenberger(plant, C, [-3.0, -4.0, -5.0], STEP),
        dt.kalman(plant, C, 0.1 * np.eye(3), 0.01 * np.eye(2), STEP),
    ):
        options = {"covariance": 1.0, "noise": 0.1, "disturbance": 0.1}
        filt = dt.OutputModeFilter(plant, dt.Markov([[0.0]]), STEP, observer, **options)
        args = dt.SwitchingSignal.constant(0), X0, 3.0, STEP
        loops = dt.BeliefPredictor(law, filt), dt.OutputFeedback(law, observer)
        one, other = (dt.simulate(plant, each, *args, imperfections=kinds) for each in loops)
        plants.close(one.inputs, other.inputs, 1e-10)
        plants.close(one.estimates, other.estimates, 1e-10)


@pytest.mark.parametrize("i", range(3))
def test_a_bank_of_kalman_observers_has_their_covariance_where_a_mode_lasts(i):
    plant = dt.SwitchedSystem(MODEL.A[[i]], MODEL.B[[i]], MODEL.delays[[i]])
    observer = dt.kalman(plant, C, 0.1 * np.eye(3), 0.01 * np.eye(2), STEP)
    options = {"covariance": 1.0, "noise": 0.1, "disturbance": 0.1}
    for given in (observer, C):
        running = dt.OutputModeFilter(plant, dt.Markov([[0.0]]), STEP, given, **options).start()
        for _ in range(300):
            running.update([0.0, 0.0])
        plants.close(running.covariances, observer.covariance, 1e-9)


A = np.array([[[0.0, 1.0], [3.0, -0.2]], [[0.0, 1.0], [-2.0, -0.2]]])
CART = dt.SwitchedSystem(A, [[[0.0], [1.0]], [[0.0], [2.0]]], 0.25)


@pytest.mark.parametrize("count", mostly_long([8, 40], 8))
def test_modes_that_last_are_worth_more_than_their_average_where_only_one_state_is_measured(count):
    """Median costs: y and the mode measured, y alone, and the averaged law on a mean observer."""
    K, model, step, s = dt.place(CART, [-1.5, -2.0]), dt.Markov([[0, 0.5], [0.5, 0]]), 0.05, 0.01
    law, C1 = dt.ExpectedPredictor(CART, K, model), [[1.0, 0.0]]
    options = {"disturbance": s**2, "noise": s, "estimate": [1.0, 0.0], "covariance": 0.0}
    filt = dt.OutputModeFilter(CART, model, step, C1, **options)
    mean = CART.mean()
    alike = dt.SwitchedSystem(np.tile(mean.A, (2, 1, 1)), np.tile(mean.B, (2, 1, 1)), 0.25)
    told = dt.kalman(CART, C1, s**2 * np.eye(2), [[s**2]], step)
    blind = dt.kalman(alike, C1, (1.0 + s**2) * np.eye(2), [[s**2]], step)
    loops = [
        dt.OutputFeedback(law, told, estimate=[1.0, 0.0]),
        dt.BeliefPredictor(law, filt),
        dt.OutputFeedback(dt.AveragedPredictor(CART, K), blind, estimate=[1.0, 0.0]),
    ]
    cost = np.empty((3, count))
    for seed in range(count):
        kinds = [WhiteDisturbance(s**2), Noise(s)]
        args = model.sample(15.0, seed=seed), [1.0, 0.0], 15.0, step
        for i, loop in enumerate(loops):
            run = dt.simulate(CART, loop, *args, imperfections=kinds, seed=seed)
            cost[i, seed] = run.metrics()["cost"]
    measured, believed, averaged = np.median(cost, axis=1)
    assert believed < 2.0 * measured
    assert averaged > 3.0 * believed


HIDING = dt.SwitchedSystem(
    [[[-1.0, 0.0], [0.0, -2.0]], [[-1.0, 0.0], [0.0, -3.0]]], [[[1.0], [1.0]]] * 2, 0.25
)
GROWING = dt.SwitchedSystem(
    [[[-1.0, 0.0], [0.0, -2.0]], [[-1.0, 0.0], [0.0, 0.5]]], [[[1.0], [1.0]]] * 2, 0.25
)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"C": [[1.0]]}, r"C must have n = 2 columns"),
        ({"noise": [0.1, 0.1]}, r"noise must have shape \(p,\) = \(1,\), got \(2,\)"),
        ({"noise": -1.0}, "noise must be ≥ 0, a standard deviation"),
        ({"covariance": -1.0}, "covariance must be positive semidefinite, got -1 on its"),
        ({"covariance": np.nan}, "covariance.* must be finite"),
        ({"estimate": [1.0]}, r"estimate must have shape \(n,\) = \(2,\), got \(1,\)"),
        ({"model": plants.markov(3)}, "model must have the plant's 2 modes, got 3"),
        ({"disturbance": -1.0}, "disturbance must be positive semidefinite, got -1 on its"),
        (
            {"plant": HIDING},
            "modes 0 and 1 cannot be distinguished. The same state and inputs give",
        ),
        ({"plant": GROWING}, "mode 1 is not observable.* does not decay: measure more"),
        (
            {"C": dt.luenberger(CART, [[1.0, 0.0]], [-3.0, -4.0], 0.05)},
            "C must be an observer of the filter's plant and step = 0.1 s, got .* step = 0.05 s",
        ),
    ],
)
def test_a_filter_on_outputs_refuses(options, message):
    given = {"plant": CART, "model": plants.markov(2), "step": STEP, "C": [[1.0, 0.0]]}
    with pytest.raises(dt.ArgumentError, match=message):
        dt.OutputModeFilter(**(given | {"covariance": 1.0} | options))


def test_modes_with_the_same_outputs_are_accepted_where_asked_and_those_with_another_delay():
    allowed = {"covariance": 1.0, "noise": 0.1, "allow_alike": True}
    filt = dt.OutputModeFilter(HIDING, plants.markov(2), STEP, [[1.0, 0.0]], **allowed)
    running = filt.start()
    found = np.array([running.update([y]) for y in (1.0, 0.8, 0.9, 0.2)])
    assert np.isfinite(found).all()
    later = dt.SwitchedSystem(HIDING.A, HIDING.B, [[0.2], [0.3]])
    dt.OutputModeFilter(later, plants.markov(2), STEP, [[1.0, 0.0]], covariance=1.0)
    dt.OutputModeFilter(HIDING, plants.markov(2), STEP, [[0.0, 1.0]], covariance=1.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"y": [1.0, 2.0, 3.0]}, r"y must have shape \(p,\) = \(2,\), got \(3,\)"),
        ({"u": [1.0]}, r"u must have shape \(m,\) = \(2,\), got \(1,\)"),
        ({"belief": [0.5, 0.4, 0.0]}, "belief must be probabilities"),
    ],
)
def test_a_filter_that_runs_refuses_and_stays_as_it_was(options, message):
    running = made().start()
    running.update([1.0, 1.0])
    before, x = running.belief.copy(), running.estimate
    with pytest.raises(dt.ArgumentError, match=message):
        running.update(**({"y": [1.0, 1.0]} | options))
    assert (running.belief == before).all()
    assert (running.estimate == x).all()


def test_a_law_on_it_has_the_period_of_its_filter_and_no_table():
    law, signal = dt.BeliefPredictor(LAWS["mode"], made()), dt.SwitchingSignal.constant(0)
    assert law.outputs.shape == (3, 2, 3)
    with pytest.raises(dt.ArgumentError, match="BeliefPredictor has no table"):
        dt.growth_rate(PLANT, law, 0, STEP)
    with pytest.raises(dt.ArgumentError, match=r"step must be the filter's, 0\.1 s, got 0\.05"):
        dt.simulate(PLANT, law, signal, X0, 1.0, step=0.05)
    with pytest.raises(dt.ArgumentError, match="law must take the state"):
        dt.OutputFeedback(law, dt.luenberger(MODEL, C, [-3.0, -4.0, -5.0], STEP))
