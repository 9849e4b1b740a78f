"""`Controller`: the same law as `simulate` runs, period by period, whatever comes in."""

import math

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.controller import Status
from deadtime.controller.controller_arguments import Clock, require_state
from shares import mostly_long

STEP = 0.1
GENERIC = plants.generic()
RUNNING = [name for name in plants.LAWS if name != "exact"]


def recorded(plant, count, seed=0):
    """Bounded states, modes that last a few samples, and inputs that acted."""
    rng = np.random.default_rng(seed)
    modes = np.repeat(rng.integers(0, plant.modes, count), rng.integers(1, 9, count))[:count]
    return rng.normal(size=(count, plant.states)), modes, rng.normal(size=(count, plant.inputs))


def run(controller, x, modes, applied=None):
    """All inputs of a controller; `applied[k]` is reported at the call after."""
    return np.array(
        [
            controller.update(
                x[k], int(modes[k]), applied[k - 1] if applied is not None and k else None
            )
            for k in range(len(x))
        ]
    )


# Over 3 past inputs every law; over 78 a law of every kind of rows.
@pytest.mark.parametrize(
    ("name", "step"),
    mostly_long(
        [(name, step) for name in RUNNING for step in (STEP, 0.003)],
        *((name, STEP) for name in RUNNING),
        *((name, 0.003) for name in ("averaged", "averaged, dwell-aware", "expected")),
    ),
)
def test_every_law_gives_what_its_table_says_whatever_was_applied(name, step):
    law = plants.LAWS[name](GENERIC)
    table = law.digital(step)
    x, modes, applied = recorded(GENERIC, 800)
    u, scale = plants.expected_inputs(table, x, modes, applied)
    assert (np.abs(run(dt.Controller(law, step), x, modes, applied) - u) <= 1e-14 * scale).all()


@pytest.mark.long
@pytest.mark.parametrize("name", mostly_long(["averaged", "single", "mean with gains"], "averaged"))
def test_a_long_delay_loses_no_digits_over_many_windows(name):
    law = plants.LAWS[name](GENERIC)
    table = law.digital(0.234 / 1000)
    assert table.factor is not None
    x, modes, applied = recorded(GENERIC, 4500)
    u, scale = plants.expected_inputs(table, x, modes, applied)
    found = run(dt.Controller(law, 0.234 / 1000), x, modes, applied)
    assert (np.abs(found - u) <= 1e-12 * scale).all()


@pytest.mark.parametrize("taps", [*range(33, 40), 64])
def test_block_sums_hold_at_every_length_of_the_window(taps):
    plant = dt.SwitchedSystem(GENERIC.A, GENERIC.B, taps * 0.004)
    law = plants.LAWS["averaged"](plant)
    x, modes, applied = recorded(plant, 300, taps)
    u, scale = plants.expected_inputs(law.digital(0.004), x, modes, applied)
    assert (np.abs(run(dt.Controller(law, 0.004), x, modes, applied) - u) <= 1e-14 * scale).all()


@pytest.mark.few(2)
@pytest.mark.parametrize("name", RUNNING)
def test_in_the_loop_it_gives_the_inputs_of_simulate(name):
    """On a plant that is not the law's model."""
    plant = dt.SwitchedSystem(1.03 * GENERIC.A, 0.98 * GENERIC.B, 0.251)
    law, signal = plants.LAWS[name](GENERIC), plants.off_grid()
    u0 = np.random.default_rng(3).normal(size=(2, 26))
    loop = dt.simulate(plant, law, signal, [1.0, -1.0, 0.5], 2.0, 0.01, u0)
    controller = dt.Controller(law, 0.01, u0=u0[:, -24:])
    found = run(controller, loop.states.T, loop.mode)
    _, scale = plants.expected_inputs(
        law.digital(0.01), loop.states.T, loop.mode, loop.inputs.T, u0[:, -24:].T
    )
    # Its own inputs come back to it: an error may grow, though not far in two seconds.
    assert (np.abs(found - loop.inputs.T) <= 1e-12 * np.maximum.accumulate(scale)).all()


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["averaged", "averaged, dwell-aware", "expected"])
def test_a_warm_restart_changes_no_bit(name):
    law = plants.LAWS[name](GENERIC)
    x, modes, applied = recorded(GENERIC, 500)
    whole = run(dt.Controller(law, 0.003), x, modes, applied)
    first, second = dt.Controller(law, 0.003), dt.Controller(law, 0.003)
    run(first, x[:237], modes[:237], applied[:237])
    second.restore(first.state)
    assert (second.samples, repr(second)) == (237, repr(first))
    later = [
        second.update(x[k], int(modes[k]), applied[k - 1]).tolist() for k in range(237, len(x))
    ]
    assert later == whole[237:].tolist()
    second.reset()
    again = run(second, x, modes, applied)
    assert again.tolist() == whole.tolist()


def test_a_state_of_another_controller_is_refused():
    state = dt.Controller(plants.LAWS["averaged"](GENERIC), 0.003).state
    for law, step, message in (
        ("mean", 0.003, "of the same law = mean"),
        ("averaged", 0.004, "of the same step"),
    ):
        with pytest.raises(dt.ArgumentError, match=message):
            dt.Controller(plants.LAWS[law](GENERIC), step).restore(state)
    with pytest.raises(dt.ArgumentError, match=r"state\['ring'\] must have shape"):
        dt.Controller(plants.LAWS["averaged"](GENERIC), 0.003).restore(state | {"ring": 0.0})


def test_saturated_inputs_are_what_it_predicts_with():
    law, low, high = plants.LAWS["averaged"](GENERIC), np.array([-0.5, -2.0]), 0.7
    x, modes, _ = recorded(GENERIC, 400)
    controller = dt.Controller(law, 0.003, limits=(low, high))
    found, status = np.empty((400, 2)), []
    for k in range(400):
        found[k] = controller.update(x[k])
        status.append(controller.status)
    asked, scale = plants.expected_inputs(law.digital(0.003), x, modes, found)
    assert (np.abs(np.clip(asked, low, high) - found) <= 1e-13 * scale).all()
    beyond = ((asked < low) | (asked > high)).any(axis=1)
    assert 0 < beyond.sum() < 400
    assert [one == Status.SATURATED for one in status] == beyond.tolist()
    assert controller.refused == 0


@pytest.mark.parametrize("name", ["averaged", "averaged, dwell-aware"])
def test_what_is_unusable_is_refused_held_and_counted(name):
    law = plants.LAWS[name](GENERIC)
    x, modes, _ = recorded(GENERIC, 300)
    modes = np.repeat(modes[:60], 5)
    bad = {40: "x", 41: "x", 90: "applied", 150: "huge"}
    if name != "averaged":
        bad |= {200: "mode", 201: "mode"}
    controller, found = dt.Controller(law, 0.003), np.empty((300, 2))
    statuses = {
        "x": Status.BAD_STATE,
        "applied": Status.BAD_APPLIED,
        "huge": Status.OVERFLOW,
        "mode": Status.BAD_MODE,
    }
    for k in range(300):
        kind = bad.get(k)
        state = x[k] * {"x": math.nan, "huge": 1e308}.get(kind, 1.0)
        mode = 7 if kind == "mode" else int(modes[k])
        applied = [math.inf, 0.0] if kind == "applied" else None
        found[k] = controller.update(state, mode, applied)
        assert controller.status == statuses.get(kind, Status.OK)
        if kind:
            assert (found[k] == found[k - 1]).all()
    assert controller.refused == len(bad)
    assert np.isfinite(found).all()
    # All other periods are as if the held inputs had been meant.
    u, scale = plants.expected_inputs(law.digital(0.003), x, modes, found)
    good = [k for k in range(300) if k not in bad]
    assert (np.abs(found - u)[good] <= 1e-13 * scale[good]).all()


def test_a_refused_period_counts_for_the_age_of_the_mode():
    law = plants.LAWS["averaged, dwell-aware"](GENERIC)
    table = law.digital(0.05)
    controller = dt.Controller(law, 0.05, mode_age=1)
    modes = [1, 1, 9, 1, 1, 1, 2, 2]
    x = np.eye(3)[0]
    found = [controller.update(x, mode, np.zeros(2)) for mode in modes]
    ages = [1, 2, None, 4, 5, 6, 0, 1]
    for mode, age, u in zip(modes, ages, found, strict=True):
        if age is not None:
            row = mode * table.ages + min(age, table.ages - 1)
            plants.close(u, table.state_gain[row] @ x, 1e-14)


def test_out_is_written_in_place_and_answers_are_not_shared():
    controller = dt.Controller(plants.LAWS["averaged"](GENERIC), STEP)
    out = np.zeros(2)
    assert controller.update([1.0, 2.0, 3.0], out=out) is out
    kept = controller.update([1.0, 2.0, 3.0])
    before = kept.copy()
    controller.update([3.0, 2.0, 1.0])
    assert (kept == before).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: dt.Controller(plants.LAWS["exact"](GENERIC), STEP),
            "ExactPredictor needs a preview",
        ),
        (
            lambda: dt.Controller(
                dt.StateDependentPredictor(
                    GENERIC, plants.gains(GENERIC), lambda x: int(x[0] > 0.0)
                ),
                STEP,
            ),
            "StateDependentPredictor is no table",
        ),
        (lambda: limited((1.0, 1.0)), "limits must have low < high"),
        (lambda: limited((0.0, [1.0, -1.0])), "limits must have low < high"),
        (lambda: limited((0.0, [1.0, 1.0, 1.0])), r"limits, high must have shape \(m,\) = \(2,\)"),
        (lambda: limited((math.nan, 1.0)), "limits, low"),
        (lambda: limited(None).update([1.0, 2.0]), r"x must have shape \(3,\), got \(2,\)"),
        (lambda: limited(None).update(np.ones(3), 0, [1.0]), r"applied must have shape \(2,\)"),
        (
            lambda: dt.Controller(plants.LAWS["expected"](GENERIC), STEP).update(np.ones(3)),
            "mode must be given: the rows of this law depend on it",
        ),
    ],
)
def test_misuse_is_refused_by_name(make, message):
    with pytest.raises(dt.ArgumentError, match=message):
        make()


def limited(limits):
    return dt.Controller(plants.LAWS["averaged"](GENERIC), STEP, limits=limits)


def timed(name="averaged, dwell-aware"):
    return dt.Controller(plants.LAWS[name](GENERIC), STEP)


def test_jitter_below_half_a_period_changes_nothing():
    rng = np.random.default_rng(1)
    plain, jittery = timed(), timed()
    for k in range(40):
        x, mode = rng.normal(size=3), int(k // 7 % 3)
        time = 1e5 + (k + 0.49 * rng.uniform(-1.0, 1.0) * (k > 0)) * STEP
        assert (jittery.update(x, mode, time=time) == plain.update(x, mode)).all()
        assert jittery.status == Status.OK
    assert jittery.late == jittery.refused == 0
    assert jittery.samples == 40


def test_a_call_out_of_order_is_refused_and_changes_nothing_else():
    plain, confused = timed(), timed()
    x = np.array([1.0, -0.5, 0.2])
    for k in range(10):
        u = confused.update(x, k % 2, time=k * STEP)
        assert (u == plain.update(x, k % 2)).all()
        for time in (k * STEP, (k - 3) * STEP, (k + 0.4) * STEP, math.nan, math.inf):
            again = confused.update(100.0 * x, 2, time=time)
            assert (again == u).all()
            assert confused.status == Status.OUT_OF_ORDER
    assert confused.refused == 50
    assert confused.samples == 10


@pytest.mark.parametrize("missed", [1, 2, 5, 40])
@pytest.mark.parametrize("name", ["averaged, dwell-aware", "mean"])
def test_periods_without_a_call_count_as_held_inputs(name, missed):
    regular, late = timed(name), timed(name)
    rng = np.random.default_rng(2)
    for k in range(12):
        x = rng.normal(size=3)
        assert (late.update(x, 1, time=k * STEP) == regular.update(x, 1)).all()
    held = regular.update(np.full(3, math.nan), 1)
    for _ in range(missed - 1):
        assert (regular.update(np.full(3, math.nan), 1) == held).all()
    x = rng.normal(size=3)
    u = late.update(x, 1, time=(11 + missed + 1) * STEP)
    plants.close(u, regular.update(x, 1), 1e-12)
    assert late.status == Status.LATE
    assert late.late == missed
    assert late.refused == 0
    # The next call is in time again.
    late.update(x, 1, time=(13 + missed + 0.2) * STEP)
    assert late.status == Status.OK


def test_an_observer_predicts_over_periods_without_a_call():
    law = dt.OutputFeedback(
        plants.LAWS["averaged"](GENERIC),
        dt.luenberger(GENERIC, np.eye(3)[:2], [-2.0, -3.0, -4.0], STEP),
    )
    regular, late = dt.Controller(law, STEP), dt.Controller(law, STEP)
    for k in range(6):
        y = np.array([1.0, 0.1 * k])
        assert (late.update(y, 0, time=k * STEP) == regular.update(y, 0)).all()
    held = late.update([1.0, 1.0], 0, time=6 * STEP)
    regular.update([1.0, 1.0], 0)
    for _ in range(2):  # what the actuator had is the held input, whatever the law would ask for
        regular.update(np.full(2, math.nan), 0, held)
    u = late.update([0.5, 0.5], 0, time=9 * STEP)
    plants.close(u, regular.update([0.5, 0.5], 0, held), 1e-12)
    assert late.late == 2


def test_the_clock_is_part_of_a_warm_restart():
    first, second = timed("mean"), timed("mean")
    for k in range(5):
        first.update(np.ones(3), 0, time=7.0 + k * STEP)
    second.restore(first.state)
    for controller in (first, second):
        controller.update(np.ones(3), 0, time=7.0 + 8 * STEP)
        assert (controller.status, controller.late, controller.samples) == (Status.LATE, 3, 9)
    assert (first.update(np.ones(3), 0) == second.update(np.ones(3), 0)).all()


def test_a_gap_longer_than_the_window_counts_for_the_age_and_the_samples():
    plant = plants.scalar([0.3, 0.1], delay=0.3)
    law = dt.AveragedPredictor(plant, dt.place(plant, [-1.0]), None, 2.0)
    late, regular = dt.Controller(law, 0.1), dt.Controller(law, 0.1)
    late.update([1.0], 0, time=0.0)
    u = regular.update([1.0], 0)
    for _ in range(17):
        regular.update([math.nan], 0, u)
    plants.close(late.update([0.8], 0, time=1.8), regular.update([0.8], 0, u), 1e-13)
    assert late.samples == regular.samples == 19


def test_a_call_that_is_refused_with_an_error_changes_nothing():
    rng = np.random.default_rng(3)
    clean, shaken = timed("expected"), timed("expected")
    for k in range(5):
        x = rng.normal(size=3)
        for wrong in (
            {"x": x},
            {"x": x, "mode": 0, "applied": [1.0]},
            {"x": x, "mode": 0, "reference": [1.0]},
            {"x": x[:2], "mode": 0},
            {"x": ["a", "b", "c"], "mode": 0},
        ):
            with pytest.raises(dt.ArgumentError):
                shaken.update(**{"time": k * STEP, **wrong})
        plants.close(shaken.update(x, 0, time=k * STEP), clean.update(x, 0), 0.0, 1.0)
    assert shaken.status == Status.OK


def test_a_clock_that_jumps_far_ahead_is_not_believed():
    controller = timed("mean")
    u = controller.update(np.ones(3), 0, time=0.0)
    for time in (1e308, -1e308, 2e5 * STEP):
        assert (controller.update(np.zeros(3), 0, time=time) == u).all()
        assert controller.status == Status.OUT_OF_ORDER


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mode": 99}, r"state\['mode'\] must be in -1..2, got 99"),
        ({"mode": "x"}, r"state\['mode'\] must hold real numbers"),
        ({"age": -1}, r"state\['age'\] must be an integer of at least 0"),
        ({"input": np.full(2, math.nan)}, r"state\['input'\] must be finite"),
        ({"ring": None}, r"state\['ring'\] must have shape"),
    ],
)
def test_a_spoilt_state_is_refused(change, message):
    controller = timed("averaged, dwell-aware")
    with pytest.raises(dt.ArgumentError, match=message):
        controller.restore({**controller.state, **change})
    with pytest.raises(dt.ArgumentError, match=r"state must be what `Controller\.state` gave"):
        require_state(None, controller.state, 3)


def test_limits_on_one_side_are_limits():
    controller = limited((0.0, math.inf))
    assert (controller.update([5.0, -3.0, 2.0]) >= 0.0).all()


@pytest.mark.parametrize("time", ["noon", [0.3], 1j])
def test_a_time_that_is_no_number_is_refused_by_name(time):
    with pytest.raises(dt.ArgumentError, match="time must be a number, in seconds, got"):
        Clock(STEP).periods(time)


def test_calls_without_a_time_are_the_next_periods():
    controller = timed("mean")
    for time in (None, 1.0, None, None, 1.0 + 3 * STEP, None, 1.0 + 5.2 * STEP):
        controller.update(np.ones(3), 0, time=time)
        assert controller.status == Status.OK
    controller.update(np.ones(3), 0, time=1.0 + 7 * STEP)
    assert (controller.status, controller.late) == (Status.LATE, 1)
