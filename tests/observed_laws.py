"""Laws on outputs, for exports: three modes, two inputs with own delays, two of three states."""

import math

import numpy as np

import deadtime as dt
import plants

STEP, C = 0.05, plants.OUTPUTS
RESTING = plants.resting()
PLANT = dt.SwitchedSystem(RESTING.A, RESTING.B, [0.17, 0.234])
SCHEDULE = ([0.0, 3.0, 9.02], [[1.0, 0.0], [0.0, 2.0], [-1.0, 1.0]])
PUSH = np.array([[1.0], [0.5], [0.0]])


def servo(make=dt.AveragedPredictor, plant=PLANT, step=STEP, reference=SCHEDULE, **options):
    """Sums, a disturbance that is estimated, and a schedule of references."""
    options = {"disturbance": PUSH} | options
    whole = dt.Servo(plant, C, **options)
    gains = whole.lqr(np.eye(3 + whole.sums), np.eye(2), step=step)
    n = whole.model.states
    observer = dt.kalman(whole.model, whole.C, np.eye(n), 0.01 * np.eye(2), step)
    law = make(whole.plant, gains, allow_unstable=True)
    return dt.OutputFeedback(law, observer, servo=whole, reference=reference)


def observed(name="averaged", plant=None):
    """Without a reference; the first estimate is not 0."""
    plant = plants.near() if plant is None else plant
    observer = dt.luenberger(plant, C, [-3.0, -4.0, -5.0], STEP)
    return dt.OutputFeedback(plants.LAWS[name](plant), observer, estimate=[0.1, -0.2, 0.3])


def dwell_aware(plant, gains, **options):
    return dt.AveragedPredictor(plant, gains, None, 0.31, **options)


def one_mode():
    """Nobody has to tell the mode: it is not read."""
    return servo(plant=dt.SwitchedSystem(PLANT.A[:1], PLANT.B[:1], 0.2), reference=[1.0, -1.0])


def small(delay=0.12):
    """One state, one input, two modes: soon analysed."""
    plant = dt.SwitchedSystem([[[0.0]], [[0.3]]], [[[1.0]], [[1.2]]], delay)
    whole = dt.Servo(plant, [[1.0]])
    law = dt.AveragedPredictor(whole.plant, whole.place([-1.0, -2.0], STEP), allow_unstable=True)
    observer = dt.luenberger(whole.model, whole.C, [-4.0], STEP)
    return dt.OutputFeedback(law, observer, servo=whole, reference=([0.0, 5.0], [1.0, 2.0]))


LAWS = {
    "servo": servo,
    "small": small,
    "without sums": lambda: servo(integral=False, reference=[1.0, 2.0]),
    "dwell-aware": lambda: servo(dwell_aware),
    "one mode": one_mode,
    "observed": observed,
    "rows by mode": lambda: observed("expected"),
    "small, factorised": lambda: small(2.0),
    "factorised": lambda: servo(plant=dt.SwitchedSystem(PLANT.A, PLANT.B, 0.9), step=0.02),
}


def hostile(law, count, seed=1):
    """Calls in all that can be wrong with one: y, modes, applied, times, references."""
    rng, m, p = np.random.default_rng(seed), law.plant.inputs, law.outputs.shape[1]
    r = len(law.servo.tracked) if law.servo else 0
    y = np.cumsum(rng.normal(size=(count, p)), axis=0)
    y = np.sin(0.05 * y) + 0.01 * rng.normal(size=y.shape)
    modes = np.repeat(rng.integers(0, law.plant.modes, count), rng.integers(1, 30, count))[:count]
    applied, times, references, clock, reference = [], [], [], 0.0, None
    for k in range(count):
        kind, odd = rng.integers(0, 30), (math.nan, math.inf, -math.inf)[k % 3]
        told = 0.3 * rng.normal(size=m) if kind < 4 else None
        if kind == 5:
            told = np.full(m, odd)
        if kind in (6, 7, 8):
            y[k, k % p] = odd
        if kind == 9:
            modes[k] = (-1, 7)[k % 2]
        if kind == 10 and r:
            reference = None if reference is not None else rng.normal(size=r)
        lost = kind == 11 and r > 0
        clock += rng.choice([0.0, *9 * [1.0], 3.0, 40.0], p=[0.02, *9 * [0.95 / 9], 0.02, 0.01])
        when = (
            None if k < count // 2 else (clock + 0.4 * rng.uniform(-1.0, 1.0)) * law.observer.step
        )
        if kind == 12 and when is not None:
            when = rng.choice([math.nan, -1e300, 1e300, when - 1.0])
        applied.append(told)
        times.append(when)
        references.append(np.full(r, odd) if lost else reference)
    return y, modes, applied, times, references
