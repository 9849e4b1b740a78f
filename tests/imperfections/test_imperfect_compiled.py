"""Imperfections in the compiled loop: what they make of a law called period by period."""

import itertools

import numpy as np
import pytest

import deadtime as dt
import plants
from by_period import CLIP, MODEL, NOISE, OTHER, PLANT, RATE, SIGNAL, TIGHT, X0, require_same
from by_sample import by_sample
from deadtime.imperfections import (
    Dropout,
    Jitter,
    LateSamples,
    MeasurementDelay,
    ModeDelay,
    Noise,
    RateLimit,
    Saturation,
    Seen,
    Sizes,
    StepDisturbance,
    WhiteDisturbance,
    WrongMode,
)

SENSORS = [Dropout(0.3), LateSamples(2, 0.4), LateSamples(3), ModeDelay(2), WrongMode(0.3)]
TIMINGS = [MeasurementDelay(0.13), MeasurementDelay(0.2), Jitter(0.06)]
AGED = dt.SwitchingSignal(SIGNAL.times, SIGNAL.modes, initial_age=0.25)
FORCES = [WhiteDisturbance(0.1), StepDisturbance([0.4, -1.0, 0.7])]


@pytest.mark.parametrize("predict", ["applied", "commanded"])
@pytest.mark.parametrize("law", plants.LAWS)
def test_every_law_meets_the_same_noise_and_limits_as_by_periods(law, predict):
    require_same(plants.LAWS[law](MODEL), [NOISE, RATE, CLIP], predict=predict)


@pytest.mark.parametrize("predict", ["applied", "commanded"])
@pytest.mark.parametrize("law", plants.LAWS)
def test_every_law_meets_the_same_sensors_as_by_periods(law, predict):
    kinds = [NOISE, *TIMINGS, *SENSORS, RATE, CLIP]
    require_same(plants.LAWS[law](MODEL), kinds, predict=predict)


@pytest.mark.parametrize("first", [NOISE, *SENSORS, *TIMINGS])
def test_sensors_in_any_order_are_as_by_periods(first):
    law = plants.LAWS["averaged, dwell-aware"](MODEL)
    for second in [NOISE, *SENSORS, *TIMINGS]:
        if second is not first:
            require_same(law, [first, second], signal=AGED)


@pytest.mark.few(1)
@pytest.mark.parametrize("step", [0.1, 0.251, 0.4])
def test_measurements_within_disturbed_periods_are_as_by_periods(step):
    for kinds in itertools.product(FORCES, [*TIMINGS, SENSORS[1]], [NOISE, SENSORS[0]]):
        require_same(plants.LAWS["averaged"](MODEL), list(kinds), step=step)


@pytest.mark.parametrize("kind", [NOISE, *SENSORS])
def test_a_sensor_beside_one_of_a_users_own_hears_what_it_does_alone(kind):
    sizes, rng = Sizes.of(PLANT, 0.1), np.random.default_rng
    one, other = kind.sensor(sizes, rng(5)), by_sample(kind).sensor(sizes, rng(5))
    for k in range(300):
        seen = Seen(np.array([k, -k, np.nan if k % 7 == 0 else 1.0]), -1 if k % 5 == 0 else k % 3)
        (x, mode), (reference, its) = one(seen), other(seen)
        np.testing.assert_array_equal(x, reference)
        assert mode == its


@pytest.mark.parametrize(
    "kinds",
    [
        [NOISE],
        [NOISE, OTHER],
        [CLIP],
        [RATE, CLIP],
        [CLIP, RATE],
        [CLIP, NOISE, RATE, TIGHT, OTHER],
        [TIGHT, RATE, RateLimit(12.0), CLIP],
        [WhiteDisturbance(0.1), NOISE, CLIP],
    ],
)
@pytest.mark.parametrize("step", [0.1, 0.251, 0.4])
def test_noises_and_limits_in_any_order_are_as_by_periods(kinds, step):
    require_same(plants.LAWS["averaged, dwell-aware"](MODEL), kinds, step=step)


def test_the_order_of_limits_matters():
    law, u0 = plants.LAWS["averaged"](MODEL), np.array([6.0, 0.0])
    clipped_last, slowed_last = (
        require_same(law, kinds, u0=u0) for kinds in ([RATE, CLIP], [CLIP, RATE])
    )
    assert clipped_last.inputs[0, 0] <= 3.0
    assert slowed_last.inputs[0, 0] == 4.0  # 20·0.1 below what was applied before time 0


@pytest.mark.parametrize("delay", [0.08, 0.25])
@pytest.mark.parametrize(
    "kinds",
    [
        [Noise(0.1)],
        [Noise(0.1), Saturation(-1, 1), RateLimit(3.0)],
        [Dropout(0.1), Jitter(0.05), LateSamples(1, 0.2)],
    ],
)
def test_a_run_that_diverges_ends_as_by_periods(kinds, delay):
    plant = plants.scalar([30.0, 31.0], delay=delay)
    law = dt.DelayedStateFeedback(plant, [[[-32.0]], [[-33.0]]])
    signal = dt.SwitchingSignal([0.0, 0.43], [0, 1])
    run = require_same(law, kinds, 20.0, plant=plant, signal=signal, x0=np.array([1.0]), u0=0.5)
    assert run.diverged
    assert run.measured.shape == run.states.shape


def test_where_a_measurement_overflows_the_last_command_is_held():
    kinds = [Noise([1.7e308, 0.0, 0.0]), Saturation(-4.0, 5.0)]
    run = require_same(plants.LAWS["averaged"](MODEL), kinds)
    lost = np.flatnonzero(~np.isfinite(run.measured[0]))
    assert lost.size > 1
    assert (run.commanded[:, lost[1:]] == run.commanded[:, lost[1:] - 1]).all()


def test_only_beside_a_sensor_that_is_no_array_is_the_law_called_by_periods(monkeypatch):
    law = plants.LAWS["averaged"](MODEL)

    def refuse(self, step, signal, steps):
        raise AssertionError("called by periods")

    monkeypatch.setattr(type(law), "online", refuse)
    options = {"horizon": 1.0, "step": 0.1}
    kinds = [NOISE, RATE, *SENSORS, MeasurementDelay(0.13), Jitter(0.06), CLIP]
    dt.simulate(PLANT, law, SIGNAL, X0, **options, imperfections=kinds)
    with pytest.raises(AssertionError, match="called by periods"):
        dt.simulate(PLANT, law, SIGNAL, X0, **options, imperfections=[NOISE, by_sample(NOISE)])


def test_noise_is_the_same_in_blocks_and_one_by_one():
    sizes = Sizes.of(PLANT, 0.1)
    one, block = (NOISE.sampler(sizes, np.random.default_rng(3)) for _ in range(2))
    assert (block(5) == np.vstack([one(1) for _ in range(5)])).all()


@pytest.mark.parametrize("kind", [RATE, CLIP])
def test_limits_are_numpys_clip(kind):
    sizes = Sizes.of(PLANT, 0.1)
    low, high, relative = kind.limits(sizes)
    asked, before = np.array([7.0, -9.0]), np.array([1.0, 2.0])
    base = before if relative else 0.0
    assert (kind.actuator(sizes)(asked, before) == np.clip(asked, base + low, base + high)).all()
