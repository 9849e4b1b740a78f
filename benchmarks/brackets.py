"""Up to which mode distance is each law stable for every admissible signal?

    python benchmarks/brackets.py

The paper's plant (τ_d = 0.2 s) and the three-mode plant (τ_d = 0.9 s), modes α times as far from
mode 0, gains placed for each α, period 0.01 s. `certified`: the largest α with a proof; `refuted`:
the smallest α with a signal under which the loop grows; their ratio; the witness; the time of both
searches. The expected law is made for Markov switching with mean sojourns of twice the dwell time.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable

import numpy as np

import deadtime as dt
from deadtime.numerics import kernels

STEP = 0.01
Family = Callable[[dt.SwitchedSystem], dt.Law]


def laws(poles: list[float], modes: int, dwell_time: float) -> dict[str, Family]:
    """The laws, each as a function of its plant."""
    rate = 1.0 / (2.0 * dwell_time * (modes - 1))
    model = dt.Markov(rate * (np.ones((modes, modes)) - np.eye(modes)))

    def placed(plant: dt.SwitchedSystem) -> np.ndarray:
        return dt.place(plant, poles)

    def mean(plant: dt.SwitchedSystem, dwell: float | None = None) -> dt.MeanPredictor:
        return dt.MeanPredictor(plant, placed(plant.mean())[0], None, dwell)

    return {
        "averaged": lambda plant: dt.AveragedPredictor(plant, placed(plant)),
        "mean": mean,
        "single, mode 0": lambda plant: dt.SingleModePredictor(plant, placed(plant), 0),
        "single, mode 1": lambda plant: dt.SingleModePredictor(plant, placed(plant), 1),
        "expected": lambda plant: dt.ExpectedPredictor(plant, placed(plant), model),
        "averaged, dwell-aware": lambda plant: dt.AveragedPredictor(
            plant, placed(plant), None, dwell_time
        ),
        "mean, dwell-aware": lambda plant: mean(plant, dwell_time),
    }


def bracket(base: dt.SwitchedSystem, law: Family, dwell_time: float) -> str:
    """The rest of a line of the table."""

    def problem(alpha: float) -> tuple[dt.SwitchedSystem, dt.Law]:
        plant = base.apart(alpha)
        return plant, law(plant)

    start = time.perf_counter()
    margin = dt.stability_margin(problem, (0.05, 2.0), dwell_time, STEP)
    spent = time.perf_counter() - start
    if margin.refuted is None or margin.witness is None:
        return f" {margin.certified:.4f} | – | – | {margin.message} | {spent:.0f} s |"
    assert margin.proven
    assert margin.certified < margin.refuted
    worst = margin.witness
    cycle = ", ".join(
        f"mode {mode}, constant" if sojourn == np.inf else f"mode {mode} {sojourn:.4g} s"
        for mode, sojourn in zip(worst.modes, worst.sojourns, strict=True)
    )
    return (
        f" {margin.certified:.4f} | {margin.refuted:.4f} | "
        f"{margin.refuted / margin.certified:.4f} | {cycle} | {spent:.0f} s |"
    )


def main() -> None:
    """Print the table."""
    kernels.WISH = "always"  # what is timed is warm
    print(f"deadtime {dt.__version__}, Python {platform.python_version()}, {os.cpu_count()} cores")
    print("\n| plant | law | certified | refuted | ratio | witness | time |")
    print("|---|---|---|---|---|---|---|")
    plants = {
        "paper": (dt.problems.paper().plant, [-1.0, -2.0], 0.2),
        "three-mode": (dt.problems.three_mode().plant, [-2.0, -3.0], 0.9),
    }
    for name, (base, poles, dwell_time) in plants.items():
        for label, law in laws(poles, base.modes, dwell_time).items():
            print(f"| {name} | {label} |{bracket(base, law, dwell_time)}", flush=True)


if __name__ == "__main__":
    main()
