"""Tracking: no offset under constant disturbances, references followed through switches."""

import math
import re

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.controller import Status
from deadtime.imperfections import Dropout, Noise, Saturation, StepDisturbance

MODEL, C, STEP = plants.generic().apart(0.03), plants.OUTPUTS, 0.05
TRUTH = dt.SwitchedSystem(1.01 * MODEL.A, 0.99 * MODEL.B, 0.241)
PER_MODE = np.stack([C, 1.1 * C, C[::-1]])
E, POLES = np.array([[1.0], [0.5], [0.0]]), [-0.9, -1.1, -1.3, -1.5, -1.8]
SERVO = dt.Servo(MODEL, C)
TARGET = np.array([1.0, -2.0])
SWITCHES = dt.SwitchingSignal([0.0, 0.52, 1.13, 2.0, 3.07], [0, 1, 2, 1, 0])
LAWS = {
    "averaged": lambda servo, K: dt.AveragedPredictor(servo.plant, K, allow_unstable=True),
    "dwell-aware": lambda servo, K: dt.AveragedPredictor(
        servo.plant, K, None, 0.31, allow_unstable=True
    ),
    "expected": lambda servo, K: dt.ExpectedPredictor(
        servo.plant, K, plants.markov(servo.plant.modes), allow_unstable=True
    ),
    "wrong mode": lambda servo, K: dt.SingleModePredictor(servo.plant, K, 2, allow_unstable=True),
    "right mode": lambda servo, K: dt.SingleModePredictor(servo.plant, K, 0, allow_unstable=True),
    "exact": lambda servo, K: dt.ExactPredictor(servo.plant, K, allow_unstable=True),
}


def tracking(servo=SERVO, law="averaged", reference=TARGET, step=STEP, gains=None):
    n = servo.base.states + servo.sums
    K = servo.place(POLES[:n], step) if gains is None else gains
    poles = -3.0 - 0.5 * np.arange(servo.model.states)
    observer = dt.luenberger(servo.model, servo.C, poles, step)
    return dt.OutputFeedback(LAWS[law](servo, K), observer, servo=servo, reference=reference)


def run(law, plant=MODEL, signal=SWITCHES, horizon=80.0, step=STEP, **options):
    return dt.simulate(plant, law, signal, np.zeros(3), horizon, step, **options)


@pytest.mark.parametrize("step", [STEP, None])
@pytest.mark.parametrize("outputs", [C, PER_MODE], ids=["one C", "per mode"])
def test_gains_hold_the_reference_against_the_disturbance_in_every_mode(outputs, step):
    """Without a sum, so that nothing else could: the equilibrium of x under u = K z, solved for."""
    servo = dt.Servo(MODEL, outputs, integral=False, disturbance=E)
    K, d, r = servo.place(POLES[:3], step), np.array([0.7]), np.array([1.0, -2.0])
    assert K.shape == (3, 2, 3 + 1 + 2)
    for i in range(3):
        A, B = MODEL.A[i], MODEL.B[i]
        onward = K[i][:, 3:] @ np.concatenate((d, r))
        x = -np.linalg.solve(A + B @ K[i][:, :3], B @ onward + E @ d)
        plants.close(servo.C[i][:, :3] @ x, r, 1e-10)


def test_with_more_inputs_than_tracked_outputs_one_of_them_may_be_tracked():
    servo = dt.Servo(MODEL, C, tracked=[[0.5, 1.0]])
    assert repr(servo) == "Servo(tracked=1, sums=1, disturbances=0)"
    loop = run(tracking(servo, reference=[0.8]))
    assert abs(np.array([0.5, 1.0]) @ loop.measured[:, -1] - 0.8) < 1e-9


def test_gains_on_state_and_sum_are_those_of_the_plant_with_the_sum():
    A, B = np.zeros((3, 5, 5)), np.zeros((3, 5, 2))
    A[:, :3, :3], A[:, 3:, :3], B[:, :3] = MODEL.A, C, MODEL.B
    driven = dt.SwitchedSystem(A, B, MODEL.delay)
    for K, plain in (
        (SERVO.place(POLES, STEP), dt.place(driven, POLES, STEP)),
        (SERVO.lqr(np.eye(5), np.eye(2)), dt.lqr(driven, np.eye(5), np.eye(2))),
    ):
        plants.close(K[:, :, :5], plain, 1e-12)
    # Where the integrals follow the reference: q' = C x − r.
    assert (SERVO.plant.A[:, 3:5, 5:] == -np.eye(2)).all()


def test_the_loop_with_its_sum_decays_as_placed_with_order_two():
    """The sum is a trapezoid where the model has an integral: all that is not exact."""
    steps, errors = [0.05, 0.025, 0.0125], []
    for h in steps:
        law = tracking(law="right mode", step=h)
        errors.append(abs(dt.growth_rate(MODEL, law, 0, h) + 0.9))
    assert errors[0] < 0.02
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize("disturbance", [None, E], ids=["sum", "sum and estimate"])
def test_the_growth_rate_of_a_tracking_loop_is_that_of_its_runs(disturbance):
    servo = dt.Servo(MODEL, C, disturbance=disturbance)
    law = tracking(servo, "wrong mode", [0.0, 0.0])
    for truth in (TRUTH, dt.SwitchedSystem(MODEL.A, MODEL.B, 0.27)):
        rate = dt.growth_rate(truth, law, 1, STEP)
        loop = dt.simulate(truth, law, dt.SwitchingSignal.constant(1), [1, -1, 0.5], 30.0, STEP)
        size = np.log(np.linalg.norm(np.vstack((loop.states, loop.estimates)), axis=0))
        assert np.polyfit(loop.time[200:500], size[200:500], 1)[0] == pytest.approx(rate, abs=0.05)


@pytest.mark.parametrize("disturbance", [None, E], ids=["sum", "sum and estimate"])
def test_margins_of_a_tracking_loop_are_where_it_neither_grows_nor_decays(disturbance):
    law = tracking(dt.Servo(MODEL, C, disturbance=disturbance))
    delay, gain = dt.delay_margin(TRUTH, law, STEP), dt.gain_margin(TRUTH, law, STEP)
    for D, mode in ((delay.lower, delay.lower_mode), (delay.upper, delay.upper_mode)):
        other = dt.SwitchedSystem(TRUTH.A, TRUTH.B, D)
        assert dt.growth_rate(other, law, mode, STEP) == pytest.approx(0.0, abs=1e-9)
    other = dt.SwitchedSystem(TRUTH.A, gain.upper * TRUTH.B, TRUTH.delay)
    assert dt.growth_rate(other, law, gain.upper_mode, STEP) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_a_constant_disturbance_leaves_no_offset_whatever_law_and_plant(law):
    """Neither delay, matrices nor the disturbance are those of the model; two of five modes."""
    force = StepDisturbance([0.5, -1.0, 0.3], start=1.0)
    servo = dt.Servo(MODEL, C, disturbance=E if law == "averaged" else None)
    for mode in (0, 1):
        signal = dt.SwitchingSignal([0.0, 0.5, 1.5, 2.33], [0, 1, 2, mode])
        loop = run(tracking(servo, law), TRUTH, signal, imperfections=[force])
        assert np.abs(loop.measured[:, -1] - [1.0, -2.0]).max() < 1e-9


def test_an_estimate_alone_leaves_none_where_the_forecast_is_right_at_rest():
    servo = dt.Servo(MODEL, C, integral=False, disturbance=E)
    force = StepDisturbance(0.7 * E[:, 0])
    offset = {
        law: np.abs(
            run(tracking(servo, law), imperfections=[force]).measured[:, -1] - [1, -2]
        ).max()
        for law in ("right mode", "exact", "averaged", "wrong mode")
    }
    assert offset["right mode"] < 1e-9
    assert offset["exact"] < 1e-9
    assert min(offset["averaged"], offset["wrong mode"]) > 0.01
    loop = run(tracking(servo, "right mode"), imperfections=[force])
    assert loop.estimates[3, -1] == pytest.approx(0.7, abs=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_a_step_is_tracked_through_switches_that_move_nothing(law):
    """Modes that rest at the same place: switches on and off the grid are not seen in y."""
    plant = plants.resting()
    servo = dt.Servo(plant, [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    times = [0.0, 60.0, 60.17, 60.4, 60.9, 61.333, 62.05]
    signal = dt.SwitchingSignal(times, [0, 1, 2, 0, 2, 1, 0])
    loop = run(tracking(servo, law), plant, signal)
    after = loop.time >= 55.0
    assert np.abs(loop.measured[:, after] - [[1.0], [-2.0]]).max() < 1e-9


def test_on_other_plants_the_outputs_come_back_after_every_switch():
    times = np.arange(4) * 40.0 + np.array([0.0, 0.33, 0.67, 0.01])
    loop = run(tracking(), signal=dt.SwitchingSignal(times, [0, 1, 2, 0]), horizon=160.0)
    error = np.abs(loop.measured - [[1.0], [-2.0]]).max(axis=0)
    for switch in times[1:]:
        k = int(switch / STEP)
        assert error[k] < 1e-6
        assert error[k : k + 60].max() > 1e-2


def test_the_feed_forward_of_the_sum_minimises_the_squared_error_of_a_step():
    servo = dt.Servo(dt.SwitchedSystem(MODEL.A[:1], MODEL.B[:1], MODEL.delay), C)
    K = servo.place(POLES, STEP)

    def squared_error(change):
        gains = K.copy()
        gains[:, :, 5:] -= K[:, :, 3:5] @ change
        law = tracking(servo, "averaged", [1.0, 0.0], gains=gains)
        loop = run(law, servo.base, dt.SwitchingSignal.constant(0))
        return float(np.sum((loop.measured - [[1.0], [0.0]]) ** 2))

    best = squared_error(np.zeros((2, 2)))
    for change in np.eye(4).reshape(4, 2, 2)[[0, 2]]:
        plus, minus = squared_error(0.2 * change), squared_error(-0.2 * change)
        assert min(plus, minus) > best
        assert abs(plus - minus) < 0.02 * (plus + minus - 2.0 * best)


def test_the_sum_is_the_trapezoid_of_what_was_measured():
    kinds = [Noise(0.1), Dropout(0.2)]
    reference = ([0.0, 2.0], [[1.0, 0.0], [1.0, -2.0]])
    loop = run(tracking(reference=reference), TRUTH, horizon=6.0, imperfections=kinds, seed=3)
    x, q, r = loop.estimates[:3].T, loop.estimates[3:5].T, loop.estimates[5:].T
    assert (r == np.where(loop.time[:, None] < 2.0, [1.0, 0.0], [1.0, -2.0])).all()
    lost = np.isnan(loop.measured).any(axis=0)
    assert 10 < lost.sum() < 50
    v = np.where(lost[:, None], x @ C.T, loop.measured.T)
    increments = STEP * ((v[1:] + v[:-1]) / 2.0 - r[:-1])
    plants.close(np.diff(q, axis=0), increments, 1e-12)


def test_references_come_as_constants_schedules_and_functions():
    schedule = ([0.0, 2.0], [[1.0, 1.0], [-1.0, -1.0]])
    same = [schedule, ([0.0, 2.0], [1.0, -1.0]), lambda t: 1.0 if t < 1.99 else -1.0]
    first, *others = [run(tracking(reference=one), horizon=4.0) for one in same]
    for other in others:
        assert (other.states == first.states).all()
    constants = [run(tracking(reference=one), horizon=1.0) for one in (0.5, [0.5, 0.5], (0.5, 0.5))]
    assert all((one.states == constants[0].states).all() for one in constants[1:])


def test_the_sum_stops_where_the_input_is_limited():
    """A step that the limits let through slowly: with the sum running on, y overshoots more."""
    plant = plants.resting()
    servo = dt.Servo(plant, [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    limits, signal = [Saturation(-0.2, 0.2)], dt.SwitchingSignal.constant(2)
    law = tracking(servo, "averaged", [3.0, 0.0])
    stopped = run(law, plant, signal, horizon=60.0, imperfections=limits)
    q = stopped.estimates[3:5]
    limited = np.flatnonzero((stopped.commanded != stopped.inputs).any(axis=0))
    assert limited.size > 40
    assert (np.diff(q[:, limited[0] : limited[0] + 20]) == 0.0).all()
    assert np.abs(stopped.measured[:, -1] - [3.0, 0.0]).max() < 1e-6
    blind = _blind(law)
    running = run(blind, plant, signal, horizon=60.0, imperfections=limits)
    assert running.measured[0].max() - 3.0 > 1.5 * (stopped.measured[0].max() - 3.0) > 0.0


def _blind(law):
    """The same law, its sum never stopped."""

    class Blind(dt.OutputFeedback):
        def _push(self, table):
            return 0.0 * super()._push(table)

    return Blind(law.law, law.observer, servo=law.servo, reference=law.reference)


@pytest.mark.few(1)
@pytest.mark.parametrize("law", [name for name in LAWS if name != "exact"])
def test_a_controller_tracks_as_simulate_does(law):
    reference = ([0.0, 2.0], [[1.0, 0.0], [1.0, -2.0]])
    loop_law = tracking(dt.Servo(MODEL, C, disturbance=E), law, reference)
    kinds = [StepDisturbance([0.5, -1.0, 0.3]), Noise(0.05), Dropout(0.1), Saturation(-1.0, 3.0)]
    loop = run(loop_law, TRUTH, horizon=8.0, imperfections=kinds, seed=5)
    assert (loop.commanded != loop.inputs).any()
    own, told = (dt.Controller(loop_law, STEP, limits=(-1.0, 3.0)) for _ in range(2))
    terms = plants.expected_inputs(
        loop_law.law.digital(STEP), loop.estimates.T, loop.mode, loop.inputs.T
    )[1]
    mode = -1
    for k in range(loop.time.size):
        y = loop.measured[:, k]
        mode = int(loop.mode[k]) if np.isfinite(y).all() else mode
        # The inputs of the simulation, for the loop would carry each rounding on and amplify it.
        applied = loop.inputs[:, k - 1] if k else None
        u = own.update(y, mode, applied=applied)
        assert (np.abs(u - loop.inputs[:, k]) <= 1e-12 * terms[: k + 1].max()).all()
        r = [1.0, 0.0] if loop.time[k] < 1.99 else [1.0, -2.0]
        assert (told.update(y, mode, reference=r, applied=applied) == u).all()
        if k == 70:
            again = dt.Controller(loop_law, STEP, limits=(-1.0, 3.0))
            again.restore(told.state)
            told = again


def test_a_reference_that_is_not_finite_is_refused_and_the_last_one_goes_on():
    law = tracking(reference=[0.0, 0.0])
    bad, good = dt.Controller(law, STEP), dt.Controller(law, STEP)
    for k in range(10):
        r = [1.0, -2.0] if k != 4 else [math.nan, 0.0]
        u = bad.update([0.1, 0.2], 0, reference=r)
        assert (u == good.update([0.1, 0.2], 0, reference=[1.0, -2.0])).all()
        assert bad.status == (Status.BAD_REFERENCE if k == 4 else Status.OK)
    assert bad.refused == 1
    with pytest.raises(
        dt.ArgumentError, match=r"reference must have shape \(tracked,\) = \(2,\), got \(1,\)"
    ):
        bad.update([0.1, 0.2], 0, reference=[1.0])


def test_with_the_whole_state_measured_nothing_need_be_estimated():
    """An observer that believes what it measures: state feedback with a sum of errors."""
    servo = dt.Servo(MODEL, np.eye(3), tracked=C)
    observer = dt.Observer(servo.model, servo.C, np.eye(3), STEP)
    assert np.isneginf(observer.rates).all()
    law = LAWS["averaged"](servo, servo.place(POLES, STEP))
    loop = run(dt.OutputFeedback(law, observer, servo=servo, reference=[1.0, -2.0]), TRUTH)
    assert (loop.estimates[:3] == loop.states).all()
    assert np.abs(C @ loop.states[:, -1] - [1.0, -2.0]).max() < 1e-9


ZERO = dt.SwitchedSystem([[[0.0, 1.0], [0.0, -1.0]]], [[[0.0], [1.0]]], 0.3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: dt.Servo(ZERO, [[0.0, 1.0]]),
            "mode 0 cannot hold the tracked outputs at every reference: rank [A B; HC 0] = 2 < 3",
        ),
        (
            lambda: dt.Servo(ZERO, np.eye(2)),
            "tracked must have at most as many rows as there are inputs, 1, got 2",
        ),
        (lambda: dt.Servo(MODEL, C.T), "C must have n = 3 columns"),
        (lambda: dt.Servo(MODEL, C, [[1.0]]), "tracked must have one column per output, 2, got"),
        (lambda: dt.Servo(MODEL, C, [1.0, 1.0]), "tracked must have shape (r, p), got (2,)"),
        (
            lambda: dt.Servo(MODEL, C, disturbance=E.T),
            "disturbance must have n = 3 rows and a column per constant force",
        ),
        (lambda: SERVO.place([-1, -2, -3]), "poles must have shape (n,) = (5,)"),
        (lambda: SERVO.lqr(np.eye(3), np.eye(2)), "Q must have shape (n, n) = (5, 5)"),
        (lambda: SERVO.place(POLES, -1.0), "step must be positive"),
        (
            lambda: dt.AveragedPredictor(SERVO.plant, SERVO.place(POLES, STEP)),
            "allow_unstable = True accepts it",
        ),
        (
            lambda: dt.luenberger(*_undriven(), [-3, -4, -5, -6], STEP),
            "mode 0 is not observable: rank",
        ),
        (
            lambda: dt.kalman(*_driven(), np.diag([1.0, 1.0, 1.0, 0.0]), np.eye(2), STEP),
            "(a constant disturbance needs some noise to drift)",
        ),
        (lambda: tracking(reference=[1.0, 2.0, 3.0]), "reference must have shape (tracked,)"),
        (lambda: tracking(reference=math.nan), "reference[0] must be finite"),
        (
            lambda: tracking(reference=([0.0, 0.0], [1.0, 2.0])),
            "reference, times must increase, got [0.0, 0.0].",
        ),
        (
            lambda: SERVO.place([1.0, 2.0, 3.0, 4.0, 5.0]),
            "poles of mode 0 must have negative real parts, got 5",
        ),
        (
            lambda: tracking(reference=([0.0, 1.0], [1.0, 2.0, 3.0])),
            "reference, values must have shape (T, tracked) = (2, 2), got (3, 2)",
        ),
        (
            lambda: run(tracking(reference=lambda t: [t, t, t])),
            "reference must have shape (tracked,) = (2,), got (3,)",
        ),
        (
            lambda: dt.OutputFeedback(plants.LAWS["averaged"](MODEL), tracking().observer,
                                      servo=SERVO),
            "law must be made for servo.plant, with states = 7, got states = 3.",
        ),
        (
            lambda: dt.OutputFeedback(
                tracking().law, dt.luenberger(SERVO.plant, np.eye(7), -1.0 - np.arange(7), STEP),
                servo=SERVO,
            ),
            "observer must be made for servo.model, with states = 3, got states = 7.",
        ),
        (
            lambda: dt.OutputFeedback(
                dt.StateDependentPredictor(
                    SERVO.plant, SERVO.place(POLES), lambda x: 0, allow_unstable=True
                ),
                tracking().observer,
                servo=SERVO,
            ),
            "law must be a table to follow a reference, got StateDependentPredictor: laws on a ",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_tracked_is_refused_by_name(call, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        call()


def _driven():
    servo = dt.Servo(MODEL, C, disturbance=E)
    return servo.model, servo.C


def _undriven():
    """A disturbance that the outputs cannot tell from another state."""
    plant = dt.SwitchedSystem(np.diag([0.0, -1.0, -2.0])[None], MODEL.B[:1], 0.3)
    servo = dt.Servo(plant, C, disturbance=[[0.0], [0.0], [0.0]])
    return servo.model, servo.C
