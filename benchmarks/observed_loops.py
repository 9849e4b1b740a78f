"""How close proof and refutation come for loops on measured outputs.

    python benchmarks/observed_loops.py

Five loops, each designed anew for modes α times as far apart: three with a Luenberger observer, one
of them on a plant that is 2 % off its model, and two servos with sums of errors, one of them with
an estimated disturbance. Period 0.1 s. `certified`: the largest α with a proof for the dwell time;
`refuted`: the smallest with a signal under which the loop grows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from margin_rows import HEADINGS, margin_row

import deadtime as dt
from deadtime.margins import StabilityMargin

STEP = 0.1
PAPER = dt.problems.paper().plant
Loop = tuple[dt.SwitchedSystem, dt.Law]

A = np.array([[[0.2, 1.0], [-1.0, -0.3]], [[0.5, 1.4], [-0.7, -0.5]], [[0.0, 0.7], [-1.4, 0.1]]])
B = np.array([[[1.0, 0.0], [0.2, 1.0]], [[1.2, 0.1], [0.1, 0.8]], [[0.9, 0.0], [0.3, 1.1]]])
PAIR = dt.SwitchedSystem(A[:2], B[:2], [0.23, 0.1])
THREE = dt.SwitchedSystem(A, B, [[0.23, 0.1], [0.18, 0.1], [0.23, 0.14]])
MOTOR = dt.SwitchedSystem(
    [[[0.0, 1.0], [0.0, -1.0]], [[0.0, 1.0], [0.0, -0.3]]], [[[0.0], [1.0]], [[0.0], [1.6]]], 0.25
)


def observed(plant: dt.SwitchedSystem, true: dt.SwitchedSystem | None = None) -> Loop:
    """The averaged law on an observer of the first state; the true plant may be another one."""
    gains = dt.lqr(plant, np.eye(2), np.eye(plant.inputs), step=STEP)
    observer = dt.luenberger(plant, [[1.0, 0.0]], [-4.0, -5.0], STEP)
    law = dt.AveragedPredictor(plant, gains, allow_unstable=True)
    return plant if true is None else true, dt.OutputFeedback(law, observer)


def tracking(plant: dt.SwitchedSystem, disturbance: list[list[float]] | None = None) -> Loop:
    """A servo with the sum of its errors, and a disturbance if one is estimated."""
    servo = dt.Servo(plant, [[1.0, 0.0]], disturbance=disturbance)
    gains = servo.lqr(np.diag([1.0, 1.0, 0.5]), [[1.0]], step=STEP)
    law = dt.AveragedPredictor(servo.plant, gains, allow_unstable=True)
    poles = [-3.0, -4.0, -5.0][: servo.model.states]
    observer = dt.luenberger(servo.model, servo.C, poles, STEP)
    return plant, dt.OutputFeedback(law, observer, servo=servo)


def off_by_two_percent(plant: dt.SwitchedSystem) -> Loop:
    """The observer and the law go by the plant, which is another one."""
    return observed(plant, plant.like(1.02 * plant.A, 0.98 * plant.B))


@dataclass(frozen=True)
class Case:
    """A loop for a plant, the plant at α = 1, and the dwell time in seconds."""

    name: str
    loop: Callable[[dt.SwitchedSystem], Loop]
    base: dt.SwitchedSystem
    dwell_time: float
    most: float = 4.0


CASES = (
    Case("paper's, D = 0.3 s", observed, PAPER.like(PAPER.A, PAPER.B, 0 * PAPER.delays + 0.3), 0.3),
    Case("two inputs, own delays", observed, PAIR, 0.4, 20.0),
    Case("three modes, 2 % off", off_by_two_percent, THREE, 0.5),
    Case("motor, sums", tracking, MOTOR, 0.6, 20.0),
    Case(
        "motor, sums, disturbance", lambda plant: tracking(plant, [[0.0], [1.0]]), MOTOR, 0.6, 20.0
    ),
)


def bracket(case: Case, ratio: float = 1.01) -> StabilityMargin:
    """Between proof and refutation, for α."""

    def problem(alpha: float) -> Loop:
        return case.loop(case.base.apart(alpha))

    return dt.stability_margin(problem, (0.02, case.most), case.dwell_time, STEP, ratio)


def main() -> None:
    """Print the table."""
    print(f"| loop | dwell time | {HEADINGS}")
    print("|---|---|---|---|---|---|", flush=True)
    for case in CASES:
        about = f"{case.name} | {case.dwell_time:g} s"
        print(margin_row(about, partial(bracket, case)), flush=True)


if __name__ == "__main__":
    main()
