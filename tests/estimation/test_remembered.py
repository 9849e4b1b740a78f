"""Laws with a memory in the compiled loop: what they do when they are called period by period."""

import math

import numpy as np
import pytest

import deadtime as dt
import plants
from by_period import require_same
from deadtime.imperfections import (
    Dropout,
    Jitter,
    LateSamples,
    MeasurementDelay,
    ModeDelay,
    Noise,
    RateLimit,
    Saturation,
    WhiteDisturbance,
    WrongMode,
)

MODEL, C, STEP = plants.near(), plants.OUTPUTS, 0.05
TRUTH = dt.SwitchedSystem(1.01 * MODEL.A, 0.99 * MODEL.B, 0.251)
PUSHED = dt.SwitchedSystem(MODEL.A + 25.0 * np.eye(3), MODEL.B, 0.251)
OPTIONS = {"plant": TRUTH, "step": STEP, "u0": np.random.default_rng(0).normal(size=(2, 6))}
OBSERVER = dt.luenberger(MODEL, [C, 1.1 * C, C + 0.1], [-3, -4, -5], STEP)
SCHEDULE = ([0.0, 1.0], [[1.0, 0.0], [1.0, -2.0]])
LIMITED = [RateLimit(3.0), Saturation(-0.3, 0.25)]
KINDS = [
    [Noise(0.05)],
    [Dropout(0.3), *LIMITED],
    [LateSamples(2, 0.4), ModeDelay(2)],
    [WrongMode(0.3), Dropout(0.2), ModeDelay(1), *LIMITED],
    [MeasurementDelay(0.13), Jitter(0.03), WhiteDisturbance(0.1)],
]


def tracking(integral, reference):
    servo = dt.Servo(MODEL, C, integral=integral, disturbance=[[1.0], [0.0], [0.5]])
    gains = servo.place([-1, -1.2, -1.5, -1.8, -2][: 5 if integral else 3], STEP)
    law = dt.AveragedPredictor(servo.plant, gains, None, 0.1634, allow_unstable=True)
    observer = dt.luenberger(servo.model, servo.C, [-3, -3.5, -4, -5], STEP)
    return dt.OutputFeedback(law, observer, servo=servo, reference=reference)


@pytest.mark.few(5)
@pytest.mark.parametrize("predict", ["applied", "commanded"])
@pytest.mark.parametrize("name", plants.LAWS)
def test_every_law_on_estimates_runs_as_by_periods(name, predict):
    law = dt.OutputFeedback(plants.LAWS[name](MODEL), OBSERVER, estimate=[1.0, 2.0, 3.0])
    for kinds in KINDS:
        require_same(law, kinds, predict=predict, **OPTIONS)


@pytest.mark.few(3)
@pytest.mark.parametrize("predict", ["applied", "commanded"])
@pytest.mark.parametrize("integral", [True, False])
@pytest.mark.parametrize("reference", [1.0, SCHEDULE, lambda t: [math.sin(t), 0.0]])
def test_a_servo_runs_as_by_periods(integral, reference, predict):
    law = tracking(integral, reference)
    for kinds in KINDS:
        require_same(law, kinds, horizon=4.0, predict=predict, **OPTIONS)


def test_a_loop_on_estimates_that_diverges_ends_as_by_periods():
    for law in (dt.OutputFeedback(plants.LAWS["averaged"](MODEL), OBSERVER), tracking(True, 1.0)):
        run = require_same(law, KINDS[0], 30.0, **{**OPTIONS, "plant": PUSHED})
        assert run.diverged


def test_a_law_on_estimates_is_called_by_periods_only_where_its_law_is_no_table(monkeypatch):
    def refuse(self, *args):
        raise AssertionError("called by periods")

    monkeypatch.setattr(dt.OutputFeedback, "online", refuse)
    signal, x0 = plants.off_grid(2), [-1.0, 1.0]
    plant, rule = plants.paper(), dt.HalfSpace([1.0, 0.0], 0.0)
    observer = dt.luenberger(plant, [[1.0, 0.0]], [-4.0, -5.0], STEP)
    table = dt.OutputFeedback(dt.AveragedPredictor(plant, plants.gains(plant)), observer)
    called = dt.OutputFeedback(
        dt.StateDependentPredictor(plant, plants.gains(plant), rule), observer
    )
    assert not dt.simulate(plant, table, signal, x0, 1.0, STEP).diverged
    with pytest.raises(AssertionError, match="called by periods"):
        dt.simulate(plant, called, signal, x0, 1.0, STEP)
