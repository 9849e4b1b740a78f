"""Laws on estimates: separation, lost samples, the controller, and what is refused."""

import math
import re

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.controller import Status
from deadtime.imperfections import Dropout, LateSamples, Noise, RateLimit, Saturation, WrongMode
from deadtime.plant import Window

MODEL, C, STEP = plants.near(), plants.OUTPUTS, 0.05
TRUTH = dt.SwitchedSystem(1.01 * MODEL.A, 0.99 * MODEL.B, 0.251)
X0, U0 = np.array([1.0, -1.0, 0.5]), np.random.default_rng(0).normal(size=(2, 5))
ON_GRID = dt.SwitchingSignal([0.0, 0.5, 1.1, 2.0, 3.0], [0, 1, 2, 0, 1])
OBSERVER = dt.luenberger(MODEL, C, [-3, -4, -5], STEP)
WORST = [Noise(0.05), Dropout(0.2), RateLimit(3.0), Saturation(-0.2, 0.25)]


def observed(name="averaged", observer=OBSERVER, **options):
    return dt.OutputFeedback(plants.LAWS[name](MODEL), observer, **options)


def run(law, plant=MODEL, signal=ON_GRID, horizon=6.0, u0=U0, **options):
    return dt.simulate(plant, law, signal, X0, horizon, STEP, u0, **options)


@pytest.mark.parametrize("name", plants.LAWS)
def test_with_a_right_estimate_the_loop_is_that_of_state_feedback(name):
    plain, loop = run(plants.LAWS[name](MODEL)), run(observed(name, estimate=X0))
    plants.close(loop.states, plain.states, 1e-11)
    plants.close(loop.inputs, plain.inputs, 1e-11)
    plants.close(loop.estimates, loop.states, 1e-11)
    plants.close(loop.measured, C @ loop.states, 1e-14)
    assert (loop.mismatch is None) == (plain.mismatch is None)
    assert (loop.commanded == loop.inputs).all()


@pytest.mark.parametrize("pole", [-1.5, -3.0])
def test_a_wrong_estimate_is_forgotten_at_the_observer_s_rate(pole):
    """The error decays at its own rate, whatever the loop does, switches on samples included."""
    observer = dt.luenberger(MODEL, C, [pole, pole - 1.0, pole - 2.0], STEP)
    loop = run(observed(observer=observer), horizon=10.0)
    error = np.linalg.norm(loop.estimates - loop.states, axis=0)
    after = slice(80, 140)  # the last switch is at 3 s
    slope = np.polyfit(loop.time[after], np.log(error[after]), 1)[0]
    assert slope == pytest.approx(pole, abs=0.15)


def test_observer_loops_converge_to_the_state_feedback_loop_once_both_have_decayed():
    """The difference of states and the states themselves decay: by separation, as each other."""
    law = dt.SingleModePredictor(MODEL, dt.place(MODEL, [-1, -1.5, -2], STEP), 0)
    signal = dt.SwitchingSignal.constant(0)
    observer = dt.luenberger(MODEL, C, [-3, -4, -5], STEP)
    plain = run(law, signal=signal, horizon=20.0)
    loop = run(dt.OutputFeedback(law, observer), signal=signal, horizon=20.0)
    gap = np.linalg.norm(loop.states - plain.states, axis=0)
    assert gap.max() > 0.1
    assert gap[-1] <= 1e-6 * gap.max()
    slope = np.polyfit(loop.time[200:], np.log(gap[200:]), 1)[0]
    assert slope == pytest.approx(-1.0, abs=0.02)


def test_a_switch_between_samples_costs_an_error_that_decays():
    loop = run(observed(estimate=X0), signal=plants.off_grid(), horizon=8.0)
    error = np.linalg.norm(loop.estimates - loop.states, axis=0) / np.abs(loop.states).max()
    assert error[:4].max() <= 1e-13  # the first switch is at 0.1718 s
    assert error.max() > 1e-4
    assert error[-1] < 1e-6


@pytest.mark.parametrize("name", ["averaged", "averaged, dwell-aware", "expected"])
def test_the_joint_loop_grows_at_the_larger_of_both_rates(name):
    for poles in ([-3, -4, -5], [-0.3, -0.4, -0.5]):
        observer = dt.luenberger(MODEL, C, poles, STEP)
        law = plants.LAWS[name](MODEL)
        for mode in range(3):
            joint = dt.growth_rate(MODEL, dt.OutputFeedback(law, observer), mode, STEP)
            apart = dt.growth_rate(MODEL, law, mode, STEP), observer.rates[mode]
            assert joint == pytest.approx(max(apart), abs=1e-8)


@pytest.mark.parametrize("delay", [0.251, 0.234, 0.08, 0.33, 0.52])
def test_the_joint_growth_rate_is_that_of_runs_on_a_plant_that_is_not_the_model(delay):
    """Another delay, with as many, fewer and more inputs on their way than the model has."""
    truth = dt.SwitchedSystem(1.03 * MODEL.A, 0.98 * MODEL.B, delay)
    law = observed()
    rate = dt.growth_rate(truth, law, 1, STEP)
    loop = dt.simulate(truth, law, dt.SwitchingSignal.constant(1), X0, 120.0, STEP)
    # The distance of states a period apart, weighed at equal phases of a slow oscillation.
    size = np.log(np.linalg.norm(np.vstack((loop.states, loop.estimates)), axis=0))
    slope = np.polyfit(loop.time[400:], size[400:], 1)[0]
    assert slope == pytest.approx(rate, abs=0.02)


def alone(mode, observer_poles):
    """One mode of `generic` with an unstable plant, under its own law."""
    generic = plants.generic()
    plant = dt.SwitchedSystem(generic.A[mode : mode + 1], generic.B[mode : mode + 1], 0.234)
    law = dt.SingleModePredictor(plant, dt.place(plant, [-1, -1.5, -2], STEP), 0)
    observer = dt.luenberger(plant, C, observer_poles, STEP)
    return plant, law, dt.OutputFeedback(law, observer)


@pytest.mark.parametrize("mode", [1, 2])
@pytest.mark.parametrize("poles", [[-3, -4, -5], [-1, -8, -9]])
def test_margins_of_delay_and_gain_are_where_the_joint_loop_neither_grows_nor_decays(mode, poles):
    plant, law, loop = alone(mode, poles)
    delay, gain = dt.delay_margin(plant, loop, STEP), dt.gain_margin(plant, loop, STEP)

    def rate(D=plant.delay, k=1.0):
        return dt.growth_rate(dt.SwitchedSystem(plant.A, k * plant.B, D), loop, 0, STEP)

    limits = [D for D in (delay.lower, delay.upper) if 0.0 < D < 10.0 * plant.delay]
    assert limits
    assert max(abs(rate(D)) for D in limits) < 1e-9
    assert max(abs(rate(k=k)) for k in (gain.lower, gain.upper)) < 1e-9
    inside = np.linspace(max(delay.lower, 0.01), delay.upper, 14)[1:-1]
    assert max(rate(D) for D in inside) < 0.0
    assert max(rate(k=k) for k in np.linspace(gain.lower, gain.upper, 14)[1:-1]) < 0.0
    assert rate(1.01 * delay.upper) > 0.0
    assert rate(k=1.01 * gain.upper) > 0.0
    # An observer changes how much error a loop stands, in either direction.
    assert abs(delay.upper / dt.delay_margin(plant, law, STEP).upper - 1.0) > 0.01


def test_lost_samples_are_predicted_over_and_not_held():
    plain = run(observed(estimate=X0))
    lossy = run(observed(estimate=X0), imperfections=[Dropout(0.4)], seed=2)
    lost = np.isnan(lossy.measured).any(axis=0)
    assert 30 < lost.sum() < 70
    # A lost sample loses the mode too; until the switch nothing is missed at all.
    before = plain.time < 0.5
    assert lost[before].sum() > 2
    plants.close(lossy.inputs[:, before], plain.inputs[:, before], 1e-12)
    assert (np.diff(lossy.inputs[:, lost[:-1].nonzero()[0][0] :]) != 0.0).any()


def test_with_no_measurement_at_all_the_observer_runs_open_loop():
    loop = run(observed(estimate=[1.0, 2.0, 3.0]), imperfections=[Dropout(1.0)])
    assert np.isnan(loop.measured).all()
    assert np.isfinite(loop.inputs).all()
    assert not loop.diverged
    # As the plant would move in mode 0, the first mode that is assumed, under the same inputs.
    held = dt.simulate(
        MODEL, observed(estimate=[1.0, 2.0, 3.0]), dt.SwitchingSignal.constant(0),
        [1.0, 2.0, 3.0], 6.0, STEP, U0,
    )  # fmt: skip
    plants.close(loop.estimates, held.states, 1e-10)


@pytest.mark.parametrize("predict", ["applied", "commanded"])
def test_it_predicts_with_the_inputs_it_is_told(predict):
    """Against a loop of its own in NumPy, on a plant that is not the model."""
    loop = run(observed(), TRUTH, imperfections=WORST, seed=1, predict=predict, u0=None)
    told = loop.inputs if predict == "applied" else loop.commanded
    window = Window.of(OBSERVER.plant.delay, OBSERVER.step)
    N, phase = window.count, window.phase
    u = np.concatenate((np.zeros((N, 2)), told.T))
    bar, mode, table = np.zeros(3), 0, plants.LAWS["averaged"](MODEL).digital(STEP)
    estimates = []
    for k in range(loop.time.size):
        y = loop.measured[:, k]
        if np.isfinite(y).all():
            mode = loop.mode[k]
            bar = bar + OBSERVER.gain[mode] @ (y - C @ bar)
        estimates.append(bar)
        A, B = MODEL.A[mode], MODEL.B[mode]
        (E, early), (L, late) = plants.held(A, B, phase), plants.held(A, B, STEP - phase)
        bar = L @ (E @ bar + early @ u[k]) + late @ u[k + 1]
    estimates = np.array(estimates)
    plants.close(loop.estimates, estimates.T, 1e-11)
    asked, scale = plants.expected_inputs(table, estimates, loop.mode, told.T)
    assert (np.abs(loop.commanded.T - asked) <= 1e-11 * scale).all()
    assert (loop.commanded != loop.inputs).any()


KALMAN = dt.kalman(MODEL, C, np.eye(3), 0.01 * np.eye(2), STEP)


@pytest.mark.parametrize("name", [name for name in plants.LAWS if name != "exact"])
def test_a_controller_gives_the_inputs_of_simulate(name):
    """Fed what the run was told: noise, losses, limits, another plant, switches off the grid."""
    law = observed(name, KALMAN)
    kinds = [Noise(0.05), Dropout(0.2), Saturation(-0.2, 0.25)]
    loop = run(law, TRUTH, plants.off_grid(), imperfections=kinds, seed=5, u0=None)
    controller = dt.Controller(law, STEP, limits=(-0.2, 0.25))
    scale = _terms(law, loop)
    mode, lost, last = -1, 0, np.zeros(2)
    for k in range(loop.time.size):
        y = loop.measured[:, k]
        gone = not np.isfinite(y).all()
        mode, lost = (mode if gone else int(loop.mode[k])), lost + gone
        u = controller.update(y, mode)
        assert (np.abs(u - loop.inputs[:, k]) <= 1e-12 * scale[: k + 1].max()).all()
        assert (controller.status == Status.BAD_STATE) == gone
        last = u
    assert lost > 10
    assert controller.refused == lost
    assert (last == controller.state["input"]).all()


def test_a_controller_loses_no_digits_over_thousands_of_periods():
    law = observed("averaged, dwell-aware", KALMAN)
    signal = dt.SwitchingSignal.random(3, 151.0, dwell_time=0.3, seed=2)
    kinds = [Noise(0.05), dt.imperfections.StepDisturbance([0.3, 0.1, 0.2])]
    loop = run(law, TRUTH, signal, 150.0, None, imperfections=kinds, seed=3)
    controller, scale = dt.Controller(law, STEP), _terms(law, loop).max()
    for k in range(loop.time.size):
        u = controller.update(loop.measured[:, k], int(loop.mode[k]))
        assert (np.abs(u - loop.inputs[:, k]) <= 1e-12 * scale).all()


def test_robustness_takes_it_and_speaks_of_outputs():
    result = dt.robustness(MODEL, observed(), ON_GRID, X0, 3.0, STEP, scenarios=2)
    assert result.delay.relative > 1.0
    assert result.drops.tolerated > 0.1
    assert "in every output" in result.noise.message


def _terms(law, loop):
    """Σ|terms| of every input."""
    table = law.law.digital(STEP)
    told = loop.estimates.T
    return plants.expected_inputs(table, told, loop.mode, loop.inputs.T)[1]


def test_a_warm_restart_covers_the_observer_to_the_last_bit():
    law = observed("averaged, dwell-aware", KALMAN)
    rng = np.random.default_rng(0)
    y, modes = rng.normal(size=(300, 2)), np.repeat(rng.integers(0, 3, 60), 5).tolist()
    y[rng.random(300) < 0.1] = math.nan
    whole, first, second = (dt.Controller(law, STEP) for _ in range(3))
    expected = [whole.update(y[k], modes[k]).tolist() for k in range(300)]
    for k in range(137):
        first.update(y[k], modes[k])
    second.restore(first.state)
    assert [second.update(y[k], modes[k]).tolist() for k in range(137, 300)] == expected[137:]
    second.reset()
    assert [second.update(y[k], modes[k]).tolist() for k in range(300)] == expected
    kept = first.state
    first.update(y[137], modes[137])
    assert (kept["observer_z"] != first.state["observer_z"]).any()
    with pytest.raises(dt.ArgumentError, match=r"state\['observer_z'\] must have shape"):
        first.restore(kept | {"observer_z": 0.0})


def test_a_controller_goes_on_through_what_is_unusable():
    law = observed("averaged", KALMAN, estimate=X0)
    controller = dt.Controller(law, STEP)
    seen, y = [], C @ X0
    for fed, mode, applied, status in (
        (y, 0, None, Status.OK),
        ([math.nan, 0.0], 0, None, Status.BAD_STATE),
        (y, 7, None, Status.BAD_MODE),
        (y, 1, [math.inf, 0.0], Status.BAD_APPLIED),
        (y, 1, None, Status.OK),
    ):
        seen.append(controller.update(fed, mode, applied))
        assert controller.status == status, status
    assert (seen[1] != seen[0]).all()  # predicted
    assert (seen[2] == seen[1]).all()  # held
    assert (seen[3] == seen[2]).all()  # held
    assert controller.refused == 3
    assert np.isfinite(controller.state["observer_z"]).all()


def test_a_measurement_that_would_overflow_the_estimate_is_left_out():
    observer = dt.luenberger(MODEL, 1e-3 * C, [-3, -4, -5], STEP)
    controller = dt.Controller(observed(observer=observer), STEP)
    assert (controller.update([1.7e308, -1.7e308], 0) == 0.0).all()
    assert (controller.status, controller.refused) == (Status.BAD_STATE, 1)


def test_an_answer_that_overflows_is_held():
    law = dt.AveragedPredictor(MODEL, dt.place(MODEL, [-20, -30, -40]))
    controller = dt.Controller(dt.OutputFeedback(law, KALMAN), STEP)
    before = controller.update([1.0, 2.0], 0)
    assert (controller.update([1e307, 1e307], 0) == before).all()
    assert controller.status == Status.OVERFLOW


def test_a_controller_of_one_mode_needs_no_mode():
    plant = dt.SwitchedSystem(MODEL.A[:1], MODEL.B[:1], MODEL.delay)
    law = dt.AveragedPredictor(plant, plants.gains(plant))
    observer = dt.luenberger(plant, C, [-3, -4, -5], STEP)
    controller = dt.Controller(dt.OutputFeedback(law, observer), STEP)
    assert np.isfinite(controller.update([1.0, 2.0])).all()
    with pytest.raises(dt.ArgumentError, match="mode must be given"):
        dt.Controller(observed(), STEP).update([1.0, 2.0])


def test_monte_carlo_takes_it_and_pairs_it_with_others():
    laws = {"state": plants.LAWS["averaged"](MODEL), "observed": observed(estimate=X0)}
    model, options = dt.SemiMarkov([0.35, 0.4, 0.3]), {"horizon": 2.0, "step": STEP, "scenarios": 3}
    data = dt.monte_carlo(MODEL, laws, model, X0, **options)
    # Every switch falls on a sample, so that nothing is lost by observing.
    np.testing.assert_allclose(data.cost.sel(law="observed"), data.cost.sel(law="state"), rtol=1e-9)


def test_other_imperfections_act_on_the_outputs():
    loop = run(observed(), imperfections=[LateSamples(3), WrongMode(0.1), Noise([0.1, 0.0])])
    assert loop.measured.shape == (2, loop.time.size)
    assert np.isnan(loop.measured[:, :3]).sum() == 3 * 2
    plants.close(loop.measured[1, 3:], (C @ loop.states)[1, :-3], 1e-13)


def test_a_law_that_reads_the_state_runs_on_estimates_too():
    problem, rule = dt.problems.paper(), dt.HalfSpace([1.0, 1.0], 0.5)
    law = dt.StateDependentPredictor(problem.plant, problem.gains, rule)
    observer = dt.luenberger(problem.plant, [[1.0, 0.0]], [-4, -5], STEP)
    options = {"x0": [-1.0, 1.0], "horizon": 1.0, "step": STEP}
    plain = dt.simulate(problem.plant, law, rule, **options)
    loop = dt.OutputFeedback(law, observer, estimate=[-1.0, 1.0])
    seen = dt.simulate(problem.plant, loop, rule, **options)
    plants.close(seen.states[:, :10], plain.states[:, :10], 1e-12)


OTHER = dt.SwitchedSystem(MODEL.A, MODEL.B, 0.3)
SMALL = plants.paper()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: dt.OutputFeedback(plants.LAWS["averaged"](OTHER), OBSERVER),
            "law must be made for the observer's plant, with delay = 0.234, got delay = 0.3.",
        ),
        (
            lambda: dt.OutputFeedback(
                dt.AveragedPredictor(SMALL, dt.place(SMALL, [-1, -2])), OBSERVER
            ),
            "law must be made for the observer's plant, with modes = 3, got modes = 2.",
        ),
        (lambda: dt.OutputFeedback(observed(), OBSERVER), "law must take the state"),
        (lambda: observed(estimate=[1.0]), "estimate must have shape (n,) = (3,), got (1,)"),
        (lambda: observed(reference=1.0), "reference needs a servo"),
        (lambda: run(observed(), horizon=1.0, signal=ON_GRID, plant=SMALL), "law must be made for"),
        (
            lambda: dt.simulate(MODEL, observed(), ON_GRID, X0, 1.0, 0.1),
            "step must be the observer's, 0.05 s, got 0.1",
        ),
        (lambda: dt.Controller(observed(), 0.1), "step must be the observer's, 0.05 s, got 0.1"),
        (
            lambda: dt.growth_rate(MODEL, observed(), 0, 0.1),
            "step must be the observer's, 0.05 s, got 0.1",
        ),
        (
            lambda: dt.simulate(MODEL, observed(), ON_GRID, X0, 1.0, None),
            "step must be given for OutputFeedback: its observer runs at samples, every 0.05 s.",
        ),
        (lambda: observed().digital(STEP), "OutputFeedback has no table: it keeps an estimate"),
        (
            lambda: dt.delay_margin(MODEL, observed(), 0.1),
            "step must be the observer's, 0.05 s, got 0.1",
        ),
        (
            lambda: dt.delay_margin(MODEL, observed(), None),
            "step must be given for OutputFeedback",
        ),
        (
            lambda: dt.Controller(observed("exact"), STEP),
            "law must be a table that a controller can run; ExactPredictor needs a preview",
        ),
        (
            lambda: dt.Controller(observed(), STEP).update([1.0, 2.0, 3.0], 0),
            "y must have shape (2,), got (3,)",
        ),
        (
            lambda: dt.Controller(observed(), STEP).update([1.0, 2.0], 0, reference=[1.0]),
            "reference needs a law with a servo; this one tracks nothing.",
        ),
        (
            lambda: dt.Controller(plants.LAWS["averaged"](MODEL), STEP).update(X0, reference=[1.0]),
            "reference needs a law with a servo; this one tracks nothing.",
        ),
    ],
)
def test_what_does_not_belong_together_is_refused_by_name(call, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        call()
