"""What does an imperfection add to the cost of many runs?

    python benchmarks/imperfections.py [--quick] [name …]

10,000 scenarios of 1,000 periods of the paper's example, N = 100, switches anywhere (those of
`batch.py`): each imperfection alone, and a few together, under the averaged law, which is one row,
and under the expected one of a Markov process, a row per mode. Times are processor seconds of
`monte_carlo`, all threads together; perfect and imperfect runs alternate, and a ratio is the median
of those of neighbours. Before anything is timed, every figure of the first and of the last of
eleven scenarios is compared with that of `simulate` for the same seed, to 1e-9. Observers and
servos have C = [1, 0] and are compared with the perfect loop of the law on the state.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Sequence

import numpy as np
from batch_problem import LAWS, MODEL, PAPER, USUAL, X0, run
from machine import heading, processors

import deadtime as dt
from deadtime.imperfections import (
    ColouredDisturbance,
    Dropout,
    Imperfection,
    Jitter,
    LateSamples,
    MeasurementDelay,
    ModeDelay,
    Noise,
    RateLimit,
    Saturation,
    StepDisturbance,
    WhiteDisturbance,
    WrongMode,
)
from deadtime.numerics import kernels
from deadtime.scenarios import scenario_seed
from deadtime.switching import SignalBatch

QUICK = "--quick" in sys.argv[1:]
SCENARIOS, REPEATS = (64, 1) if QUICK else (10_000, 7)
WHITE = WhiteDisturbance(0.01)
COLOURED = ColouredDisturbance(0.3, 0.5, [0.0, 1.0])
STEP = StepDisturbance([0.0, 0.5], 2.0, 6.0)
DELAY = 0.03  # seconds
CASES: dict[str, Sequence[Imperfection]] = {
    "noise": [Noise(0.01)],
    "lost samples": [Dropout(0.1)],
    "late samples": [LateSamples(3, 0.3)],
    "late modes": [ModeDelay(5)],
    "wrong modes": [WrongMode(0.05)],
    "measurement delay, whole periods": [MeasurementDelay(DELAY)],
    "measurement delay, a fraction": [MeasurementDelay(DELAY + 0.4 * USUAL.step)],
    "jitter": [Jitter(0.8 * USUAL.step)],
    "saturation": [Saturation(-20.0, 20.0)],
    "rate limit": [RateLimit(200.0)],
    "step": [STEP],
    "white": [WHITE],
    "coloured": [COLOURED],
    "step, white and coloured": [STEP, WHITE, COLOURED],
    "noise, lost, saturation": [Noise(0.01), Dropout(0.1), Saturation(-20.0, 20.0)],
    "jitter and white": [Jitter(0.8 * USUAL.step), WHITE],
}


def remembering() -> dict[str, dt.Law]:
    """Laws on an estimate from the first state alone."""
    plant, C, step = PAPER.plant, np.array([[1.0, 0.0]]), USUAL.step
    observer = dt.kalman(plant, C, 0.1 * np.eye(2), [[0.01]], step=step)
    observed = dt.OutputFeedback(LAWS["averaged"], observer, estimate=X0)
    servo = dt.Servo(plant, C)
    K = servo.place([-1.0, -1.5, -2.0], step=step)
    law = dt.AveragedPredictor(servo.plant, K, allow_unstable=True)
    observer = dt.kalman(servo.model, servo.C, 0.1 * np.eye(2), [[0.01]], step=step)
    tracking = dt.OutputFeedback(
        law, observer, servo=servo, estimate=X0, reference=([0.0, 2.0], [[0.0], [0.5]])
    )
    return {"OutputFeedback": observed, "Servo": tracking}


def require_single_runs(law: dt.Law, given: Sequence[Imperfection], batch: SignalBatch) -> None:
    """Every figure of two scenarios is that of `simulate` to 1e-9."""
    few = batch.slice(0, 11)
    data = run(law, few, USUAL, imperfections=given).sel(law="law")
    for i in (0, len(few) - 1):
        seed = scenario_seed(0, i)
        one = dt.simulate(
            PAPER.plant, law, few[i], X0, USUAL.horizon, USUAL.step, imperfections=given, seed=seed
        )
        for name, value in one.metrics().items():
            np.testing.assert_allclose(data[name].values[i], value, rtol=1e-9, err_msg=name)


def spent(law: dt.Law, given: Sequence[Imperfection], batch: SignalBatch) -> float:
    """Processor seconds of a call."""
    began = time.process_time()
    data = run(law, batch, USUAL, imperfections=given)
    seconds = time.process_time() - began
    assert not data.attrs["one_by_one"], given
    return seconds


def row(
    what: str, law: dt.Law, given: Sequence[Imperfection], perfect: dt.Law, batch: SignalBatch
) -> str:
    """A line of the table."""
    require_single_runs(law, given, batch)
    spent(law, given, batch)
    pairs = [(spent(perfect, [], batch), spent(law, given, batch)) for _ in range(REPEATS)]
    ratio = statistics.median(mine / plain for plain, mine in pairs)
    rate = len(batch) * USUAL.periods / statistics.median(mine for _, mine in pairs)
    return f"| {what} | {1e9 / rate:.1f} | {ratio:.1f} |"


def main() -> None:
    kernels.WISH = "always"  # what is timed is warm
    wanted = [name for name in sys.argv[1:] if not name.startswith("--")]
    batch = MODEL.draw(USUAL.horizon + 1.0, 3, 0, SCENARIOS)
    averaged, markov, memory = LAWS["averaged"], LAWS["expected, Markov"], remembering()
    spent(averaged, [], batch)
    print(f"{heading()}\n\n{SCENARIOS:,} scenarios, {processors()} threads\n")
    print("| what | ns a scenario-step | times the perfect loop |\n|---|---|---|")
    for heard, law in (("", averaged), (", a row per mode", markov)):
        for name, given in CASES.items():
            if not wanted or name in wanted:
                print(row(name + heard, law, given, law, batch), flush=True)
    for name, law in memory.items():
        if not wanted or name in wanted:
            print(row(name, law, [], averaged, batch), flush=True)


if __name__ == "__main__":
    main()
