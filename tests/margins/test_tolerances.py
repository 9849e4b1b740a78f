"""Tolerances of loops that are pushed, limited, or start from rest: does the loop do its work?"""

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.imperfections import LateSamples, Noise, Saturation, StepDisturbance
from deadtime.margins.tolerance import BOUNDED, KEPT, LOST, RobustnessRuns, noise_price
from deadtime.reports.robustness import plot_robustness
from deadtime.simulation.outcome import outcome_of

STEP = 0.005
LIMITS = Saturation(-12.0, 12.0)
FAR = (15, 16, 20, 40, 60, 100, 150)  # periods


def motor():
    """A motor with two inertias, 30 ms from its amplifier; states are speed and current."""
    R, L, k, b = 1.0, 5e-3, 0.05, 1e-4
    A = [[[-b / J, k / J], [-k / L, -R / L]] for J in (2e-4, 6e-4)]
    return dt.SwitchedSystem(A, [[[0.0], [1.0 / L]]] * 2, delay=0.030)


PLANT = motor()


def servo(reference=100.0):
    made = dt.Servo(PLANT, C=np.eye(2), tracked=[[1.0, 0.0]])
    gains = made.lqr(np.diag([1.0, 0.01, 100.0]), [[20.0]], step=STEP)
    law = dt.AveragedPredictor(made.plant, gains, allow_unstable=True)
    observer = dt.luenberger(made.model, made.C, poles=[-150.0, -200.0], step=STEP)
    return dt.OutputFeedback(law, observer, servo=made, reference=reference)


LAW = servo()


def signal(horizon):
    return dt.SwitchingSignal.random(2, horizon + 1.0, dwell_time=0.3, seed=1)


def setting(horizon, law=LAW, x0=(1.0, 0.0), imperfections=(LIMITS,)):
    start = np.array(x0)
    return RobustnessRuns(
        PLANT, law, signal(horizon), start, horizon, STEP, 1, 0, tuple(imperfections)
    )


def ends(of, periods):
    return [int(of.runs([LateSamples(n)], 1)[1][0]) for n in periods]


@pytest.mark.few(2)
@pytest.mark.parametrize("horizon", [2.0, 3.0, 8.0])
@pytest.mark.parametrize("x0", [(1.0, 0.0), (0.0, 0.0)])
def test_a_limit_cycle_around_the_reference_is_not_tolerated_over_any_horizon(horizon, x0):
    of = setting(horizon, x0=x0)
    assert of.works == "settles"
    assert ends(of, (1, 8)) == [KEPT] * 2
    assert KEPT not in ends(of, [n for n in FAR if 4 * n * STEP <= horizon])


def test_what_is_said_to_be_tolerated_settles_and_the_next_period_does_not():
    result = dt.robustness(
        PLANT, LAW, signal(3.0), [1.0, 0.0], 3.0, STEP, scenarios=1, imperfections=[LIMITS]
    )
    late = result.late
    assert late.failed == late.tolerated + 1.0 < 15.0
    assert late.bounded[late.values == late.failed].all()
    assert result.sentences[3] == (
        f"Every sample may be up to {late.tolerated:g} periods ({late.tolerated * STEP:.3g} s) "
        f"late over 3 s of this signal; with {late.failed:g} the loop no longer settles."
    )
    drops = result.sentences[2]
    assert drops.endswith("over 3 s of this signal settles (a higher share was not tried).")
    for periods, settled in ((late.tolerated, True), (late.failed, False)):
        run = dt.simulate(
            PLANT, LAW, signal(3.0), [1.0, 0.0], 3.0, STEP,
            imperfections=[LIMITS, LateSamples(int(periods))],
        )  # fmt: skip
        error = np.abs(run.states[0] - 100.0)
        assert (error[run.time >= 2.7].max() <= 0.02 * error.max()) == settled
    plot_robustness(result)


def test_a_loop_that_already_oscillates_is_said_not_to_settle():
    result = dt.robustness(
        PLANT, LAW, signal(3.0), [1.0, 0.0], 3.0, STEP, scenarios=1,
        imperfections=[LIMITS, LateSamples(14)],
    )  # fmt: skip
    assert result.late.tolerated is None
    assert result.late.message == "not every run settles as it is, with nothing added"
    plot_robustness(result)


def test_a_reference_that_never_rests_must_be_kept_up_with():
    of = setting(8.0, law=servo(lambda t: 60.0 * np.sin(3.0 * t)))
    assert of.works == "stays near the run without imperfections"
    assert ends(of, (1, 8)) == [KEPT] * 2
    assert KEPT not in ends(of, (15, 20, 60, 100, 400))


def test_a_limited_plain_loop_must_come_to_rest_at_zero():
    # x'' = u, |u| ≤ 1: |x| ends below its start, yet oscillates for ever.
    plant = dt.SwitchedSystem([[[0.0, 1.0], [0.0, 0.0]]], [[[0.0], [1.0]]], delay=0.1)
    law = dt.SingleModePredictor(plant, dt.place(plant, [-2.0, -3.0]), 0)
    limited = Saturation(-1.0, 1.0)
    always = dt.SwitchingSignal.constant(0)
    of = RobustnessRuns(plant, law, always, np.array([3.0, 0.0]), 40.0, 0.05, 1, 0, (limited,))
    late = [limited, LateSamples(10)]
    run = dt.simulate(plant, law, always, of.x0, 40.0, 0.05, imperfections=late)
    assert outcome_of(run, 40.0).kind == "falls"
    assert ends(of, (1, 4, 10, 20)) == [KEPT, KEPT, BOUNDED, LOST]


SCALAR = plants.scalar([0.4, 0.5])
HELD = dt.AveragedPredictor(SCALAR, dt.place(SCALAR, [-1.5]))
SWITCHED = dt.SwitchingSignal.periodic([0.7, 0.9], [0, 1], 30.0)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "moved",
    [{"imperfections": [StepDisturbance([0.5])]}, {"imperfections": [Noise(0.1)]}, {"u0": 0.3}],
)
def test_what_moves_from_rest_may_start_there(moved):
    result = dt.robustness(SCALAR, HELD, SWITCHED, [0.0], 8.0, 0.05, scenarios=1, **moved)
    assert result.late.tolerated >= 1.0


def test_a_force_that_comes_after_the_end_moves_nothing():
    late = [StepDisturbance([0.5], start=20.0)]
    with pytest.raises(dt.ArgumentError, match="x0 must not be 0, from where nothing moves"):
        dt.robustness(SCALAR, HELD, SWITCHED, [0.0], 8.0, 0.05, scenarios=1, imperfections=late)


@pytest.mark.parametrize("push", [Noise(0.05), StepDisturbance([1e-4])], ids=["noise", "force"])
@pytest.mark.parametrize("horizon", [200.0, 358.0, 700.0])
def test_late_samples_are_tolerated_where_the_run_ends_before_the_slow_loop_settles(horizon, push):
    """x' = −a x + b u with a gain so small that the loop is stable whatever the delay."""
    plant = dt.SwitchedSystem([[[-0.0083]]], [[[0.0067]]], 17.8)
    law = dt.AveragedPredictor(plant, [[[-0.35]]])
    always = dt.SwitchingSignal.constant(0)
    result = dt.robustness(
        plant, law, always, [8.0], horizon, 2.0, scenarios=1, imperfections=[push]
    )
    assert result.late.failed is None
    assert result.late.tolerated == horizon / 2.0 // 4
    assert not result.late.lost.any()
    assert result.late.message.endswith("and more was not tried")


def test_a_slow_loop_that_grows_when_samples_are_late_is_lost_all_the_same():
    plant = dt.SwitchedSystem([[[0.0]]], [[[1.0]]], 1.0)
    law = dt.AveragedPredictor(plant, [[[-0.5]]])
    always = dt.SwitchingSignal.constant(0)
    result = dt.robustness(
        plant, law, always, [8.0], 80.0, 0.5, scenarios=1, imperfections=[Noise(1e-3)]
    )
    assert result.late.failed is not None
    longer = RobustnessRuns(plant, law, always, np.array([8.0]), 400.0, 0.5, 1, 0, (Noise(1e-3),))
    assert ends(longer, (int(result.late.tolerated) - 1, int(result.late.failed) + 1)) == [
        KEPT,
        LOST,
    ]


DOUBLE = dt.SwitchedSystem([[[0.0, 1.0], [0.0, -0.5]]], [[[0.0], [1.0]]], delay=0.1)
SLOW = plants.scalar([-0.5, -0.3])
PRICED = {
    "linear": (SCALAR, HELD, SWITCHED, [1.0], []),
    "limited": (
        SLOW,
        dt.AveragedPredictor(SLOW, dt.place(SLOW, [-2.0])),
        SWITCHED,
        [1.0],
        [Saturation(-1.0, 1.0)],
    ),
    "limited integrator": (
        DOUBLE,
        dt.SingleModePredictor(DOUBLE, dt.place(DOUBLE, [-2.0, -3.0]), 0),
        dt.SwitchingSignal.constant(0),
        [3.0, 0.0],
        [Saturation(-3.0, 3.0)],
    ),
}


@pytest.mark.parametrize("case", PRICED)
def test_the_noise_that_is_said_to_double_the_cost_doubles_it_in_other_runs(case):
    plant, law, switching, x0, limits = PRICED[case]
    of = RobustnessRuns(plant, law, switching, np.array(x0), 10.0, 0.05, 20, 0, tuple(limits))
    price = noise_price(of, float(np.linalg.norm(x0)))
    assert price.cost[3].mean() == pytest.approx(2.0 * price.base, rel=0.02)
    other = [
        dt.simulate(
            plant, law, switching, x0, 10.0, 0.05,
            imperfections=[*limits, Noise(price.doubling)], seed=1000 + i,
        ).metrics()["cost"]
        for i in range(40)
    ]  # fmt: skip
    # Both means have an error: of 20 runs here, of 40 there.
    error = np.std(other) * np.sqrt(1.0 / 20.0 + 1.0 / 40.0)
    assert abs(np.mean(other) - 2.0 * price.base) <= 3.0 * error + 0.02 * price.base


def test_a_cost_that_levels_off_as_noise_grows_has_no_price():
    plant, law, switching, _, _ = PRICED["limited"]
    limits = (Saturation(-2.0, 2.0),)
    of = RobustnessRuns(plant, law, switching, np.array([10.0]), 10.0, 0.05, 4, 0, limits)
    price = noise_price(of, 10.0)
    assert np.isnan(price.doubling)
    assert "the price of measurement noise could not be computed" in price.message
