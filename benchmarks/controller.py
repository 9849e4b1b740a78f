"""What does a period of the controller cost, and does it stay exact for a million of them?

    python benchmarks/controller.py [--steps 1000000]

Every table law but the oracle on three plants, fed bounded states, modes and applied inputs,
against rows of the law's table (sums by NumPy): the largest error relative to Σ|terms| is asserted
to be at most 1e-12. Then the time of a call against N, beside one NumPy product of a whole row.
"""

from __future__ import annotations

import argparse
import os
import platform
import time

import numpy as np

import deadtime as dt
from deadtime.numerics import kernels

CHUNK = 20_000


def laws(problem: dt.problems.Problem) -> dict[str, dt.Law]:
    """The problem's laws, and those that know something of the switching."""
    plant, gains = problem.plant, problem.gains
    rates = 0.8 * (np.ones((plant.modes, plant.modes)) - np.eye(plant.modes))
    sojourn = dt.SemiMarkov([0.4 + 0.1 * mode for mode in range(plant.modes)])
    found = {n: law for n, law in problem.laws.items() if not isinstance(law, dt.ExactPredictor)}
    options = {"allow_unstable": True}
    return found | {
        "averaged, dwell-aware": dt.AveragedPredictor(plant, gains, None, 0.3, **options),
        "expected, Markov": dt.ExpectedPredictor(plant, gains, dt.Markov(rates), **options),
        "expected, semi-Markov": dt.ExpectedPredictor(plant, gains, sojourn, **options),
    }


def worst_error(law: dt.Law, step: float, count: int) -> float:
    """The largest |u − row of the table|/Σ|terms| over so many periods."""
    plant, table, rng = law.plant, law.digital(step), np.random.default_rng(0)
    taps, m = table.input_gain.shape[1:3]
    controller, past, worst = dt.Controller(law, step), np.zeros((taps, m)), 0.0
    modes = np.repeat(rng.integers(0, plant.modes, count // 20 + 1), 20)[:count]
    rows = table.rows(modes)
    for begin in range(0, count, CHUNK):
        size = min(CHUNK, count - begin)
        x, applied = rng.normal(size=(size, plant.states)), rng.normal(size=(size, m))
        u = np.empty((size, m))
        last = past[-1] if begin else None
        for k in range(size):
            before = applied[k - 1] if k else last
            controller.update(x[k], int(modes[begin + k]), before, u[k])
        whole = np.concatenate((past, applied))
        windows = np.lib.stride_tricks.sliding_window_view(whole[:-1], taps, axis=0)[..., ::-1]
        for row in np.unique(rows[begin : begin + size]):
            at = np.flatnonzero(rows[begin : begin + size] == row)
            F, G = table.state_gain[row], table.input_gain[row].transpose(1, 2, 0).reshape(m, -1)
            seen = windows[at].reshape(at.size, -1)
            exact = x[at] @ F.T + seen @ G.T
            scale = np.abs(x[at]) @ np.abs(F).T + np.abs(seen) @ np.abs(G).T
            worst = max(worst, float((np.abs(u[at] - exact) / scale).max()))
        past = whole[-taps:]
    return worst


def call_times(law: dt.Law, step: float) -> tuple[float, float, float]:
    """Median and 99.9 % quantile of a call, and the median of one dense product, microseconds."""
    plant, table = law.plant, law.digital(step)
    controller = dt.Controller(law, step)
    x, out = np.ones(plant.states), np.zeros(plant.inputs)
    dense = table.input_gain[0].transpose(1, 0, 2).reshape(plant.inputs, -1).copy()
    past = np.ones(dense.shape[1])
    spent = np.empty((2, 20_000))
    for k in range(spent.shape[1]):
        began = time.perf_counter_ns()
        controller.update(x, 0, x[: plant.inputs], out)
        middle = time.perf_counter_ns()
        dense @ past
        spent[:, k] = middle - began, time.perf_counter_ns() - middle
    spent /= 1e3
    median, dense = np.median(spent, axis=1)
    return float(median), float(np.quantile(spent[0], 0.999)), float(dense)


def main() -> None:
    """Print both tables."""
    kernels.WISH = "always"  # what is timed is warm
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=1_000_000)
    count = parser.parse_args().steps
    print(f"deadtime {dt.__version__}, Python {platform.python_version()}, {os.cpu_count()} cores")
    print(f"\n| plant | law | N | error after {count:,} periods |")
    print("|---|---|---|---|")
    for name, make in dt.problems.NAMED.items():
        problem = make()
        step = problem.plant.delay / 49.7
        for label, law in laws(problem).items():
            error = worst_error(law, step, count)
            assert error <= 1e-12, (name, label, error)
            print(f"| {name} | {label} | {law.digital(step).taps} | {error:.1e} |", flush=True)
    print("\n| N | median call, µs | 99.9 %, µs | one dense product, µs |")
    print("|---|---|---|---|")
    problem = dt.problems.paper()
    law = dt.AveragedPredictor(problem.plant, problem.gains)
    for N in (100, 1000, 10_000, 100_000):
        median, tail, dense = call_times(law, problem.plant.delay / N)
        print(f"| {N:,} | {median:.1f} | {tail:.1f} | {dense:.1f} |")


if __name__ == "__main__":
    main()
