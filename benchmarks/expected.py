"""What does the expected law's table cost, and what would averaging sampled futures cost instead?

    python benchmarks/expected.py

The paper's plant, gamma sojourns, h = D/N. The peer does what one would do without the
recursion: draw futures, fill the exact predictor's row along each, and average; it does so for
one row of the table, and its error is that of a mean over that many draws. Accuracy: the row of
the table lies within 5 standard errors of the peer's mean (asserted, outside the timed region).
Peak memory is that of a fresh process that imports deadtime and fills one table.
"""

from __future__ import annotations

import os
import platform
import statistics
import subprocess
import sys
import time

import numpy as np
from scipy import stats

import deadtime as dt
from deadtime.numerics import kernels

PAPER = dt.problems.paper()
MODEL = dt.SemiMarkov(stats.gamma(3.0, scale=0.12))
FUTURES = 400


def built(taps: int, ages: int) -> tuple[dt.Feedback, float]:
    """The table with `taps` inputs in the window, and the median time to fill it."""
    times = []
    for _ in range(5):
        law = dt.ExpectedPredictor(PAPER.plant, PAPER.gains, MODEL, ages=ages)
        start = time.perf_counter()
        table = law.digital(1.0 / taps)
        times.append(time.perf_counter() - start)
    return table, statistics.median(times)


def averaged_row(taps: int, futures: int) -> tuple[np.ndarray, np.ndarray, float]:
    """State gain of a mode 0 just entered: mean and standard error over futures, and the time."""
    step, rows, start = 1.0 / taps, [], time.perf_counter()
    law = dt.ExactPredictor(PAPER.plant, PAPER.gains)
    for seed in range(2 * futures):
        signal = MODEL.sample(1.5, seed=seed)
        if signal.modes[0] != 0:
            continue
        # Switches are seen at samples: round them up, as the table does.
        ceiled = np.ceil(signal.times / step - 1e-9) * step
        keep = np.concatenate((np.diff(ceiled) > 0.0, [True]))
        seen = dt.SwitchingSignal(ceiled[keep], signal.modes[keep])
        rows.append(law.digital(step, seen, 1).state_gain[0])
    spent = time.perf_counter() - start
    return np.mean(rows, axis=0), np.std(rows, axis=0) / np.sqrt(len(rows)), spent


def peak_memory(taps: int, ages: int) -> float:
    """Peak resident memory of a process that fills one table, bytes."""
    code = (
        "import resource, deadtime as dt; from scipy import stats; p = dt.problems.paper(); "
        f"m = dt.SemiMarkov(stats.gamma(3.0, scale=0.12)); "
        f"dt.ExpectedPredictor(p.plant, p.gains, m, ages={ages}).digital(1 / {taps}); "
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return 1024.0 * float(result.stdout)


def main() -> None:
    kernels.WISH = "always"  # what is timed is warm
    for taps in (100, 1000):
        built(taps, 2)  # compiles
    print(
        f"deadtime {dt.__version__}, Python {platform.python_version()}, {os.cpu_count()} cores\n"
    )
    print("| N | ages | table | one row by averaging futures | ratio, whole table | memory |")
    print("|---|---|---|---|---|---|")
    for taps, ages in ((100, 200), (1000, 1000)):
        table, spent = built(taps, ages)
        mean, error, peer = averaged_row(taps, FUTURES)
        assert (np.abs(table.state_gain[0] - mean) <= 5.0 * error).all()
        rows = table.state_gain.shape[0]
        memory = peak_memory(taps, ages)
        print(
            f"| {taps} | {table.ages} | {1e3 * spent:.1f} ms | {1e3 * peer:.0f} ms, "
            f"± {100 * float((error / np.abs(mean)).max()):.1f} % | {peer * rows / spent:,.0f} | "
            f"{memory / 1e6:.0f} MB, of which table {8e-6 * table.input_gain.size:.1f} MB |"
        )


if __name__ == "__main__":
    main()
