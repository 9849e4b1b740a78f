"""Step tests as plants get them: `dt.identify` as it is, on plants of one and two states.

    python benchmarks/step_tests.py --draws 100 --kind fopdt states position

Logs are made here, by SciPy's exponentials, with no code of the package: time constants of 0.2 to
2 s, delays of 0.05 to 1.9 s, at rest for 0.1 to 3 times the range of delays that is looked in (2 s)
before the input moves: a step, a pulse, ups and downs; sensors' noise of 0.1 to 5 % of what the
output moves by; half of them about a level of output and input. Of each kind: the share of 95 %
intervals of the delay that hold the truth, wrong signs of the gain, refusals, and the time.
"""

import argparse
import time

import numpy as np
import pandas as pd
from scipy.linalg import expm

import deadtime as dt

KINDS = ("fopdt", "states", "position")
RANGE = 2.0  # s: the default


def drawn(kind, rng):
    """A, b, delay of a plant: gain of either sign; of two states a position and its speed."""
    gain, D = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(-1.5, 1.5)), rng.uniform(0.05, 1.9)
    if kind == "fopdt":
        T = np.exp(rng.uniform(np.log(0.2), np.log(2.0)))
        return np.array([[-1.0 / T]]), np.array([gain / T]), D, 3.0 * T
    w, damping = np.exp(rng.uniform(np.log(1.0), np.log(5.0))), rng.uniform(0.3, 1.5)
    A = np.array([[0.0, 1.0], [-(w**2), -2.0 * damping * w]])
    slowest = 1.0 / np.abs(np.linalg.eigvals(A).real).min()
    return A, np.array([0.0, gain * w**2]), D, 3.0 * slowest


def made(kind, rng):
    """A log, and its truth."""
    A, b, D, settling = drawn(kind, rng)
    h, rest = rng.choice([0.02, 0.05]), rng.uniform(0.1, 3.0) * RANGE
    edges, size = [rest], [1.0]
    for _ in range(rng.integers(0, 4)):
        edges.append(edges[-1] + D * rng.uniform(0.3, 1.0) + rng.uniform(0.1, 1.0) * settling)
        size.append(rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5))
    edges = h * np.round(np.array(edges) / h)
    t = h * np.arange(int((edges[-1] + D + settling) / h) + 1)
    x, u, steady = np.zeros((t.size, len(A))), np.zeros(t.size), np.linalg.solve(A, b)
    for edge, step in zip(edges, size, strict=True):
        u += step * (t >= edge - 1e-9)
        late = np.flatnonzero(t > edge + D)
        x[late] += step * np.array(
            [(expm(A * (s - edge - D)) - np.eye(len(A))) @ steady for s in t[late]]
        )
    noise = np.exp(rng.uniform(np.log(1e-3), np.log(5e-2))) * np.ptp(x, axis=0)
    y = x + noise * rng.standard_normal(x.shape)
    if rng.random() < 0.5:
        u += rng.uniform(-50.0, 50.0)
        y[:, 0] += rng.uniform(-50.0, 50.0) * np.ptp(x[:, 0])
    columns = {"t": t, "u1": u} | {f"x{i + 1}": y[:, i] for i in range(len(A))}
    if kind == "position":
        columns = {"t": t, "u1": u, "y1": y[:, 0]}
    return pd.DataFrame(columns), D, float(-steady[0])


def tried(kind, seed):
    """Of one log: how far off the delay is, whether interval and sign are right, seconds."""
    log, D, gain = made(kind, np.random.default_rng(seed))
    began = time.perf_counter()
    options = {"order": 2} if kind == "position" else {}
    try:
        fit = dt.identify(log, modes=None, **options)
    except dt.ArgumentError as error:
        return None, str(error), log, time.perf_counter() - began
    low, high = fit.delay_interval[0, 0]
    found = float(-np.linalg.solve(fit.plant.A[0], fit.plant.B[0])[0, 0])
    own = {"D": D, "found": fit.delays[0, 0], "low": low, "high": high}
    own |= {"inside": low <= D <= high, "sign": found * gain > 0.0, "white": fit.tests.white}
    own |= {"own": low <= fit.delays[0, 0] <= high}
    return own, fit.message, log, time.perf_counter() - began


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--kind", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--each", action="store_true", help="print logs whose interval misses")
    given = parser.parse_args()
    print(
        "| kind | logs | refused | delay inside | outside its interval | wrong sign | width | s |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for kind in given.kind:
        every = []
        for seed in range(given.first, given.first + given.draws):
            every.append(tried(kind, seed))
            one, said, log, _ = every[-1]
            if given.each and (one is None or not (one["inside"] and one["sign"])):
                print(f"  {kind} {seed}: {one} rows {len(log)} {said[:300]}", flush=True)
        found = [one for one, *_ in every if one]
        inside = 100.0 * np.mean([one["inside"] for one in found])
        width = np.median([(one["high"] - one["low"]) / one["D"] for one in found])
        print(
            f"| {kind} | {len(every)} | {len(every) - len(found)} | {inside:.1f} % | "
            f"{sum(not one['own'] for one in found)} | {sum(not one['sign'] for one in found)} | "
            f"{100.0 * width:.1f} % | {np.median([s for *_, s in every]):.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
