"""What does a certificate cost and how far does it reach, against a plain dense formulation?

    python benchmarks/certificates.py [--large]

The paper's plant with its modes α times as far apart, the averaged law, dwell time 0.2 s, N past
inputs. For each N the largest α is bracketed by bisection to 0.2 %: from below by certificates,
from above by the limit of constant signals (no certificate can be beyond it). The peer does what
one would write down first: one symmetric matrix P of the loop's order in cvxpy with
P ⪰ I and M_iᵀ P M_i ⪯ P − εI for the modes, switches on the grid only, solved by Clarabel, and no
proof. It gets the same α values until a solve takes longer than a minute.

Accuracy: every certificate is proved and re-verified from its file (asserted, outside the timed
region), and none lies beyond the limit. With --large also N = 1,000, in a process of its own for
the peak memory.
"""

from __future__ import annotations

import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import cvxpy as cp
import numpy as np

import deadtime as dt
from deadtime.numerics import kernels
from deadtime.spectrum import lifted_loop

DWELL_TIME = 0.2
PLANT = dt.problems.paper().plant
TOLERANCE = 2e-3
LIMIT_S = 60.0


def loop(alpha: float) -> tuple[dt.SwitchedSystem, dt.AveragedPredictor]:
    """The plant and the law at a mode distance."""
    plant = PLANT.apart(alpha)
    return plant, dt.AveragedPredictor(plant, dt.place(plant, [-1.0, -2.0]))


def limit(step: float) -> float:
    """Where a constant signal first grows."""
    low, high = 0.3, 1.0
    while high / low > 1.0 + 1e-5:
        middle = 0.5 * (low + high)
        plant, law = loop(middle)
        if max(dt.growth_rate(plant, law, mode, step) for mode in (0, 1)) < 0.0:
            low = middle
        else:
            high = middle
    return low


def certified(alpha: float, step: float) -> tuple[bool, float]:
    """Whether a proof is found, and the time it took, proof included."""
    plant, law = loop(alpha)
    start = time.perf_counter()
    certificate = dt.certify(plant, law, DWELL_TIME, step, decay_rate=0.0, search_signals=False)
    spent = time.perf_counter() - start
    if certificate.stable:
        with tempfile.TemporaryDirectory() as folder:
            assert dt.verify(certificate.save(Path(folder) / "certificate.json")).proven
    return bool(certificate.stable), spent


def dense(alpha: float, step: float) -> tuple[bool, float]:
    """Whether a common P exists by a dense semidefinite program, and the time it took."""
    plant, law = loop(alpha)
    table = law.digital(step)
    start = time.perf_counter()
    loops = [lifted_loop(plant, table, mode) for mode in (0, 1)]
    order = len(loops[0])
    P = cp.Variable((order, order), symmetric=True)
    margin = cp.Variable()
    eye = np.eye(order)
    bounds = [P >> eye * 1e-6, P << eye]
    falls = [P - M.T @ P @ M >> margin * eye for M in loops]
    problem = cp.Problem(cp.Maximize(margin), bounds + falls)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an inaccurate answer is judged below
            problem.solve(solver=cp.CLARABEL, time_limit=LIMIT_S)
    except cp.error.SolverError:
        return False, time.perf_counter() - start
    spent = time.perf_counter() - start
    value = P.value
    holds = value is not None and all(
        np.linalg.eigvalsh(value - M.T @ value @ M).min() > 0.0 for M in loops
    )
    return holds and bool(np.linalg.eigvalsh(value).min() > 0.0), spent


def reach(method, step: float, most: float) -> tuple[float, list[float]]:
    """The largest α that a method certifies below a limit, and the times of its calls."""
    low, high, times = 0.0, most, []
    trial = most * (1.0 - TOLERANCE)
    while True:
        holds, spent = method(trial, step)
        times.append(spent)
        low, high = (trial, high) if holds else (low, trial)
        if high - low <= TOLERANCE * most or spent > LIMIT_S:
            return low, times
        trial = 0.5 * (low + high)


def row(taps: int, with_peer: bool) -> str:
    """One line of the table."""
    step = 1.0 / taps
    most = limit(step)
    alpha, times = reach(certified, step, most)
    assert alpha <= most
    ours = float(np.median(times))
    line = f"| {taps:,} | {most:.4f} | {alpha:.4f} | {alpha / most:.4f} | {ours:.2f} s |"
    if not with_peer:
        return line + " – | – | – |"
    peer, peer_times = reach(dense, step, most)
    assert peer <= most * (1.0 + TOLERANCE)
    spent = float(np.median(peer_times))
    found = f"{peer:.4f}" if peer else "none found"
    return line + f" {found} | {spent:.2f} s | {spent / ours:.1f} |"


def large() -> str:
    """N = 1,000: one proof near the limit, time and peak memory of the process."""
    step = 1e-3
    holds, spent = certified(0.636, step)
    assert holds
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return f"N = 1,000, α = 0.636: proved in {spent:.1f} s, peak memory {peak:.2f} GB."


def main() -> None:
    """Print the table."""
    kernels.WISH = "always"  # what is timed is warm
    if "--only-large" in sys.argv:
        print(large())
        return
    print(f"deadtime {dt.__version__}, Python {platform.python_version()}, {os.cpu_count()} cores")
    certified(0.3, 0.5)  # first call apart
    dense(0.3, 0.5)
    print(
        "\n| N | limit α | certified α | ratio | median time, proof included | dense cvxpy: α "
        "| its time, no proof | time ratio |\n|---|---|---|---|---|---|---|---|"
    )
    for taps, with_peer in ((5, True), (10, True), (20, True), (30, True), (100, False)):
        print(row(taps, with_peer), flush=True)
    if "--large" in sys.argv:
        command = [sys.executable, __file__, "--only-large"]
        print("\n" + subprocess.run(command, capture_output=True, text=True, check=True).stdout)


if __name__ == "__main__":
    main()
