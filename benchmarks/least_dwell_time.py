"""How close does the proved least dwell time come to a signal that grows?

    python benchmarks/least_dwell_time.py

Random plants with two and three modes, half of them without feedback, half with an averaged law of
weak gains over a delay of four to eight periods. Every constant mode decays, so switching decides.
`certified`: the least dwell time with a proof; `refuted`: the largest with a signal that grows.
"""

from __future__ import annotations

import os
import platform
import time

import numpy as np

import deadtime as dt
from deadtime.numerics import kernels

STEP = 0.05
PLANTS = 30
WEAK = 0.15  # of the gains


def modes(rng: np.random.Generator, count: int) -> np.ndarray:
    """Planar modes that decay and turn, each along ellipses of its own."""
    A = []
    for _ in range(count):
        decay, speed = rng.uniform(0.15, 0.6), rng.uniform(1.0, 4.0)
        stretch, angle = rng.uniform(1.2, 3.5), rng.uniform(0.0, np.pi)
        Q = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        A.append(Q @ [[-decay, speed * stretch], [-speed / stretch, -decay]] @ Q.T)
    return np.array(A)


def problem(seed: int) -> tuple[dt.SwitchedSystem, dt.Law]:
    """A plant and a law under which every constant mode decays."""
    rng = np.random.default_rng(seed)
    count, idle = 2 + seed % 2, seed % 4 < 2
    while True:
        A, B = modes(rng, count), rng.normal(size=(count, 2, 1))
        plant = dt.SwitchedSystem(A, B, STEP * int(rng.integers(4, 9)))
        gains = (0.0 if idle else WEAK) * rng.normal(size=(count, 1, 2))
        law = dt.AveragedPredictor(plant, gains, allow_unstable=True)
        if all(dt.growth_rate(plant, law, mode, STEP) < -0.05 for mode in range(count)):
            return plant, law


def main() -> None:
    """Print the table."""
    kernels.WISH = "always"  # what is timed is warm
    print(f"deadtime {dt.__version__}, Python {platform.python_version()}, {os.cpu_count()} cores")
    print("\n| seed | modes | order | certified | refuted | ratio | witness | time |")
    print("|---|---|---|---|---|---|---|---|")
    ratios, times = [], []
    for seed in range(PLANTS):
        plant, law = problem(seed)
        start = time.perf_counter()
        found = dt.least_dwell_time(plant, law, STEP)
        times.append(time.perf_counter() - start)
        line = f"| {seed} | {plant.modes} |"
        if found.certificate is not None and found.certificate.evidence is not None:
            assert found.proven
            line += f" {found.certificate.evidence.setting.order} | {found.certified:.4f} s |"
        else:
            line += " | – |"
        if found.ratio is None or found.witness is None:
            print(f"{line} – | – | {found.message} | {times[-1]:.1f} s |", flush=True)
            continue
        ratios.append(found.ratio)
        cycle = " ".join(map(str, found.witness.modes))
        line += f" {found.refuted:.4f} s | {found.ratio:.4f} | modes {cycle} |"
        print(f"{line} {times[-1]:.1f} s |", flush=True)
    print(
        f"\nDecided by switching: {len(ratios)} of {PLANTS}; their ratio: median "
        f"{np.median(ratios):.3f}, largest {max(ratios):.3f}. Median time {np.median(times):.1f} s."
    )


if __name__ == "__main__":
    main()
