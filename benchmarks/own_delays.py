"""How close proof and refutation come on plants with two different delays.

    python benchmarks/own_delays.py

Plants drawn at random, two unstable modes, n = 2: even numbers with a delay per input, odd ones per
mode. Modes α times as far from mode 0, gains of `lqr` for each α, the averaged law at a period
of 0.05 s, dwell time 0.3 s. `certified`: the largest α with a proof; `refuted`: the smallest with a
signal under which the loop grows.
"""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np
from margin_rows import HEADINGS, margin_row

import deadtime as dt
from deadtime.margins import StabilityMargin

STEP, DWELL, RANGE = 0.05, 0.3, (0.02, 4.0)
NUMBERS = (0, 1, 3, 4, 5, 7, 8, 9, 13, 14, 17)
_NEXT = 10  # from a draw to the next of the same number


def drawn(number: int) -> dt.SwitchedSystem:
    """A plant with two different delays: of its inputs, or, for odd numbers, of its modes.

    The first of its draws that some constant mode makes unstable at the end of the range.
    """
    inputs = 1 + (number + 1) % 2
    for attempt in itertools.count():
        rng = np.random.default_rng(100 + number + _NEXT * attempt)
        A, B = rng.normal(size=(2, 2)), rng.normal(size=(2, inputs))
        A += (1.5 - np.linalg.eigvals(A).real.max()) * np.eye(2)
        delays = rng.choice([0.2, 0.25, 0.3, 0.35, 0.4], size=2, replace=False)
        delays = delays + rng.choice([0.0, 0.02, 0.03], size=2)  # most of them fractional
        base = dt.SwitchedSystem(
            np.array([A, A + 0.7 * rng.normal(size=(2, 2))]),
            np.array([B, B + 0.4 * rng.normal(size=B.shape)]),
            delays if inputs == 2 else delays[:, None],
        )
        loop = loop_of(base, RANGE[1])
        if max(dt.growth_rate(*loop, mode, STEP) for mode in (0, 1)) > 0.0:
            return base
    raise AssertionError


def loop_of(base: dt.SwitchedSystem, alpha: float) -> tuple[dt.SwitchedSystem, dt.Law]:
    """The plant with its modes α times as far apart, and its law."""
    plant = base.apart(alpha)
    gains = dt.lqr(plant, np.eye(2), np.eye(plant.inputs))
    return plant, dt.AveragedPredictor(plant, gains, allow_unstable=True)


def bracket(number: int, ratio: float = 1.01) -> StabilityMargin:
    """Between proof and refutation, for α."""
    base = drawn(number)
    return dt.stability_margin(lambda alpha: loop_of(base, alpha), RANGE, DWELL, STEP, ratio)


def main() -> None:
    """Print the table."""
    print(f"| plant | delays, s | {HEADINGS}")
    print("|---|---|---|---|---|---|", flush=True)
    for number in NUMBERS:
        delays = np.unique(drawn(number).delays)
        whose = "inputs" if number % 2 == 0 else "modes"
        about = f"{number} | {delays[0]:.2f}, {delays[1]:.2f} ({whose})"
        print(margin_row(about, partial(bracket, number)), flush=True)


if __name__ == "__main__":
    main()
