"""Modes that were not logged: how many rows `dt.identify` labels right, and what that costs.

    python benchmarks/hidden_modes.py noise --draws 100
    python benchmarks/hidden_modes.py noise --case "two modes" --s 0.03 --sensors 0.01 --draws 20
    python benchmarks/hidden_modes.py noise --case "two modes" --s 0.03 --uneven --draws 20
    python benchmarks/hidden_modes.py number --draws 50

Logs are made here, by SciPy's exponentials, with no code of the package: 1,000 rows, h = 0.05 s,
sojourns of 0.5 to 1.5 s that begin at samples or anywhere, process noise s √h per sample and state,
inputs of unit variance. `--sensors`: states are measured with noise of these deviations, and that
is said; `--uneven`: periods are anything between 0.52 h and 1.48 h. Beside each figure is that of
the same log with its modes logged. `number`: in how many logs BIC finds how many modes there are.
"""

import argparse
import itertools

import numpy as np
import pandas as pd
from scipy.linalg import expm

import deadtime as dt

H, PARTS = 0.05, 25  # a period, and how many steps it is simulated in
# name: A, B, delays (multiples of H / PARTS)
TWO = (
    [[[0.0, 1.0], [-2.0, -1.0]], [[0.0, 1.0], [-6.0, -0.5]]],
    [[[0.0], [1.0]], [[0.0], [1.2]]],
    [0.312],
)
THREE = (
    [
        [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, -3.0, -2.0]],
        [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-6.0, -3.0, -1.5]],
        [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-2.0, -8.0, -1.0]],
    ],
    [
        [[0.0, 0.3], [0.0, 0.0], [1.0, 0.0]],
        [[0.0, 0.3], [0.0, 0.5], [1.5, 0.0]],
        [[0.0, -0.3], [0.2, 0.0], [-1.0, 0.0]],
    ],
    [0.312, 0.174],
)
ALIKE = (
    [[[0.0, 1.0], [-2.0, -1.0]], [[0.0, 1.0], [-3.0, -0.5]]],
    [[[0.0], [1.0]], [[0.0], [1.2]]],
    [0.312],
)
CASES = {"two modes": TWO, "three modes, two inputs": THREE, "two that differ little": ALIKE}


def made(case, s, switches, rng, sensor=0.0, uneven=False, count=1000):
    """A log as a table, without modes, and the mode of every row."""
    A, B, D = (np.array(one) for one in CASES[case])
    modes, n, m = B.shape
    short, lags = H / PARTS, np.round(D * PARTS / H).astype(int)
    unit = 1 if switches == "anywhere" else PARTS
    length = rng.integers(10 * PARTS // unit, 30 * PARTS // unit + 1, count) * unit
    each = rng.integers(13, 38, count) if uneven else np.full(count, PARTS)
    rows, steps = np.cumsum(each) - each, int(each.sum())
    order = rng.integers(1, modes, count).cumsum() % modes
    mode = np.repeat(order, length)[:steps]
    if switches == "samples":
        mode = np.repeat(mode[rows], each)
    parts = []
    for a, b in zip(A, B, strict=True):
        Z = np.zeros((n + m, n + m))
        Z[:n, :n], Z[:n, n:] = a, b
        E = expm(Z * short)
        parts.append((E[:n, :n], E[:n, n:]))
    u = rng.standard_normal((count, m))
    held = np.repeat(u, each, axis=0)
    late = np.zeros((steps, m))
    for j, lag in enumerate(lags):
        late[lag:, j] = held[: steps - lag, j]
    w = s * np.sqrt(short) * rng.standard_normal((steps, n))
    x = np.zeros((steps, n))
    for k in range(steps - 1):
        Phi, Gamma = parts[mode[k]]
        x[k + 1] = Phi @ x[k] + Gamma @ late[k] + w[k]
    y = x[rows] + sensor * rng.standard_normal((count, n))
    columns = {"t": short * rows} | {f"x{i}": one for i, one in enumerate(y.T)}
    return pd.DataFrame(columns | {f"u{j}": one for j, one in enumerate(u.T)}), mode[rows]


def matched(found, true, modes):
    """The numbering of modes under which most rows are right, and the share of these."""
    orders = itertools.permutations(range(modes))
    return max(((np.mean(np.array(o)[found] == true), o) for o in orders), key=lambda one: one[0])


def inside(fit, case, order):
    """Whether each delay's interval, and each entry's of A and B, holds the truth."""
    A, B, D = (np.array(one) for one in CASES[case])
    of_AB = []
    for name, whole in (("A", A), ("B", B)):
        for (i, a, b), _ in np.ndenumerate(whole):
            low, high = fit.interval(f"{name}[{i}][{a},{b}]")
            of_AB.append(low < whole[order[i], a, b] < high)
    ends = fit.delay_interval[0]
    return [low < true < high for (low, high), true in zip(ends, D, strict=True)], of_AB


def noise(draws, first, cases, switches, levels, sensors=(0.0,), uneven=False, rows=1000):
    print(f"switches {switches}, {draws} logs each; in brackets with the modes logged")
    print("case | s | sensors | rows right | error of D (ms) | delays inside | A, B inside")
    for case in cases:
        modes, D = len(CASES[case][0]), CASES[case][2]
        for s, sensor in itertools.product(levels, sensors):
            right, tallies = [], []
            for seed in range(first, first + draws):
                rng = np.random.default_rng(seed)
                log, mode = made(case, s, switches, rng, sensor, uneven, rows)
                how = {"delay": (0.0, 1.0), "noise": sensor > 0.0, "switches": switches}
                try:
                    hidden = dt.identify(log, modes=modes, **how)
                except dt.DeadtimeError as error:
                    print(f"  seed {seed}: {error}")
                    continue
                share, order = matched(hidden.hidden.mode, mode, modes)
                right.append(share)
                logged = dt.identify(log.assign(mode=mode), **how)
                pairs = ((hidden, order), (logged, range(modes)))
                tallies.append([(*inside(f, case, o), f.delays[0] - D) for f, o in pairs])
            said = []
            for which in (0, 1):
                of_D, of_AB, off = zip(*(one[which] for one in tallies), strict=True)
                rms = 1e3 * np.sqrt(np.mean(np.square(off), axis=0))
                inside_both = f"{100 * np.mean(of_D):.1f} %", f"{100 * np.mean(of_AB):.1f} %"
                said.append((" / ".join(f"{one:.2f}" for one in rms), *inside_both))
            each = " | ".join(f"{ours} ({theirs})" for ours, theirs in zip(*said, strict=True))
            most = f"{100 * np.mean(right):.1f} %, least {100 * np.min(right):.1f} %"
            print(f"{case} | {s} | {sensor} | {most} | {each} | {len(right)} logs", flush=True)


def number(draws, first, cases, switches, levels):
    print(f"switches {switches}, {draws} logs each: how often BIC finds 1, 2, 3, 4 modes")
    for case in cases:
        for s in levels:
            found = []
            for seed in range(first, first + draws):
                log, _ = made(case, s, switches, np.random.default_rng(seed))
                fit = dt.identify(
                    log, modes=range(1, 5), delay=(0.0, 1.0), noise=False, switches=switches
                )
                found.append(fit.plant.modes)
            print(f"{case} | {s} | {np.bincount(found, minlength=5)[1:].tolist()}", flush=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=["noise", "number"])
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--case", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--switches", default="samples", choices=["samples", "anywhere"])
    parser.add_argument("--s", nargs="*", type=float, default=[0.003, 0.01, 0.03, 0.1, 0.3])
    parser.add_argument("--sensors", nargs="*", type=float, default=[0.0])
    parser.add_argument("--rows", type=int, default=1000)
    parser.add_argument("--uneven", action="store_true")
    given = parser.parse_args()
    shared = given.draws, given.first, given.case, given.switches, given.s
    if given.what == "noise":
        noise(*shared, given.sensors, given.uneven, given.rows)
    else:
        number(*shared)


if __name__ == "__main__":
    main()
