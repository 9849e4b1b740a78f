"""What the machine can do, measured: the bounds that a benchmark of compiled loops is held to.

A bound is the best of a few runs, not their median.
"""

from __future__ import annotations

import os
import platform
import statistics
import subprocess
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit

import deadtime as dt
from deadtime.numerics.lanes import LANES, load, same, store, times

_LATENCY = 4.0  # cycles of a dependent fma: Intel since Skylake, AMD since Zen 3


class Machine(NamedTuple):
    """Fused multiply-adds, floating-point operations per second; triad, bytes per second."""

    fma_one: float
    fma_all: float
    triad_one: float
    triad_all: float
    clock: float


@njit(cache=True, nogil=True)
def _chains(like, numbers, rounds):
    """len(like) independent chains of a vector fma, `rounds` long; nothing to fold, no fastmath."""
    a, x = load(numbers, 0, like), load(numbers, 0, like)
    b = same(numbers[0] * 1e-3, like)
    for _ in range(rounds):
        x = times(x, a, b)
    store(numbers, 0, x)


@njit(cache=True, nogil=True)
def _triad(a, b, c, s):
    for i in range(a.size):
        a[i] = b[i] + s * c[i]


def processors() -> int:
    """How many processors this process may use."""
    has = hasattr(os, "sched_getaffinity")
    return len(os.sched_getaffinity(0)) if has else os.cpu_count() or 1


def seconds(work: Callable[[], object], repeats: int) -> list[float]:
    """Of each call."""
    spent = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        spent.append(time.perf_counter() - start)
    return spent


def median_of(work: Callable[[], object], repeats: int) -> float:
    """Median seconds of a call; the caller has made the first one."""
    return statistics.median(seconds(work, repeats))


def _fma(chains: int, threads: int, rounds: int) -> float:
    """Operations per second, two for each entry of each fma."""
    like = (0.0,) * chains
    each = [np.full(chains * LANES, 0.5) for _ in range(threads)]

    def one(numbers: np.ndarray) -> None:
        _chains(like, numbers, rounds)

    one(each[0].copy())
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(abs, range(threads)))  # starts the threads
        spent = min(seconds(lambda: list(pool.map(one, each)), 5))
    assert all((np.abs(numbers) <= 1.0).all() for numbers in each)
    return 2.0 * LANES * chains * rounds * threads / spent


def _bandwidth(threads: int, size: int) -> float:
    """Bytes per second of a = b + s c, 24 an element; `a` is not read, as far as this counts."""
    a, b, c = np.zeros(size), np.ones(size), np.ones(size)
    edges = np.linspace(0, size, threads + 1).astype(int)
    parts = [slice(*pair) for pair in pairwise(edges)]

    def work() -> None:
        list(pool.map(lambda part: _triad(a[part], b[part], c[part], 3.0), parts))

    with ThreadPoolExecutor(threads) as pool:
        work()
        spent = min(seconds(work, 5))
    assert a[0] == a[-1] == 4.0
    return 24.0 * size / spent


def measured(quick: bool) -> Machine:
    """Measure it: the best of several numbers of chains, since registers differ in number."""
    rounds, size, every = (
        (3 * 10**6, 2**22, processors()) if quick else (10**7, 2**24, processors())
    )
    one = {chains: _fma(chains, 1, rounds) for chains in (1, 5, 8, 12)}
    best = max(one, key=one.__getitem__)
    # A single chain waits for itself: its vectors of eight come one every `_LATENCY` cycles.
    clock = one[1] / (2.0 * LANES) * _LATENCY
    fma_all = _fma(best, every, rounds)
    return Machine(one[best], fma_all, _bandwidth(1, size), _bandwidth(every, size), clock)


def heading() -> str:
    """What ran, and where."""
    git = ["git", "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(
        git, cwd=Path(__file__).parent, capture_output=True, text=True, check=False
    )
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    processor = names[0] if names else platform.processor()
    return (
        f"deadtime {dt.__version__} at {commit.stdout.strip() or 'no commit'}, Python "
        f"{platform.python_version()}, {processors()} cores, {processor}"
    )
