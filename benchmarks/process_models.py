"""Gain, time constant and dead time of step tests: how often the 95 % intervals hold the truth.

    python benchmarks/process_models.py --draws 100 --rows 1 5 --moves 2 4 20 --noise 0.01 0.1

Logs in closed form, with no code of the package: K = 2, τ = 60 s, D = 12.3 s, an input that is held
for 180 s (60 s where it moves 20 times) at levels of ±1 by chance, noise of the sensor as a share
of the gain, delays looked for up to 60 s, `model="fopdt"`. In brackets: least squares on the closed
form, which knows it, on the same logs.
"""

import argparse
import time

import numpy as np
import pandas as pd
from scipy.optimize import curve_fit

import deadtime as dt

GAIN, LAG, DEAD = 2.0, 60.0, 12.3
TRUTH = {"gain": GAIN, "time constant": LAG, "dead time": DEAD}


def made(rng, h, moves, noise):
    """A log of so many moves of the input, each by ±1 or ±2."""
    held, t0 = (60.0 if moves > 10 else 180.0), 30.0
    t = np.arange(0.0, t0 + moves * held, h)
    u, y, level = np.zeros(t.size), np.zeros(t.size), 0.0
    for i in range(moves):
        new = rng.choice([one for one in (-1.0, 0.0, 1.0) if one != level])
        at = t0 + i * held
        late = np.maximum(t - at - DEAD, 0.0)
        y += (new - level) * GAIN * -np.expm1(-late / LAG)
        u[t >= at - 1e-9], level = new, new
    return pd.DataFrame({"t": t, "y1": y + noise * GAIN * rng.standard_normal(t.size), "u1": u})


def least_squares(log):
    """For each quantity whether ± 1.96 standard errors of the closed form hold the truth.

    The first state is unknown there, too; the form and white noise of the sensor are known.
    """
    t, u = log["t"].to_numpy(), log["u1"].to_numpy()
    moved = [(at, size) for at, size in zip(t, np.diff(u, prepend=0.0), strict=True) if size]

    def output(t, gain, lag, dead, first):
        late = [np.maximum(t - at - dead, 0.0) for at, _ in moved]
        steps = sum(size * -np.expm1(-s / lag) for s, (_, size) in zip(late, moved, strict=True))
        return first * np.exp(-t / lag) + gain * steps

    best, covariance = curve_fit(output, t, log["y1"], p0=[*TRUTH.values(), 0.0])
    off = np.abs(best[:3] - np.array(list(TRUTH.values())))
    return off < 1.96 * np.sqrt(np.diagonal(covariance))[:3]


def tried(seed, h, moves, noise):
    """Whether intervals hold the truth, their lengths over it, and those of least squares."""
    own = seed, int(h), moves, int(1e3 * noise)
    log = made(np.random.default_rng(own), h, moves, noise)
    began = time.perf_counter()
    try:
        processes = dt.identify(log, None, (0.0, 60.0), model="fopdt").processes
    except dt.ArgumentError:  # several delays are open
        processes = ()
    spent = time.perf_counter() - began
    if not processes:
        return None, spent
    (one,) = processes
    found = dict(zip(TRUTH, (one.gain, one.time_constants[0], one.dead_time), strict=True))
    other = dict(zip(TRUTH, least_squares(log), strict=True))
    return {
        name: (
            each.low <= TRUTH[name] <= each.high,
            (each.high - each.low) / TRUTH[name],
            other[name],
        )
        for name, each in found.items()
    }, spent


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--rows", type=float, nargs="+", default=[1.0, 5.0])
    parser.add_argument("--moves", type=int, nargs="+", default=[2, 4, 20])
    parser.add_argument("--noise", type=float, nargs="+", default=[0.01, 0.1])
    given = parser.parse_args()
    print(f"| h, moves, noise | logs | not told | {' | '.join(TRUTH)} | s a log |")
    for h in given.rows:
        for moves in given.moves:
            for noise in given.noise:
                every = [tried(seed, h, moves, noise) for seed in range(given.draws)]
                told = [one for one, _ in every if one is not None]
                cells = []
                for name in TRUTH:
                    inside = np.mean([one[name][0] for one in told])
                    width = np.median([one[name][1] for one in told])
                    beside = np.mean([one[name][2] for one in told])
                    cells.append(f"{inside:.1%} ({beside:.1%}), {width:.1%} wide")
                spent = np.mean([one for _, one in every])
                few = f"{given.draws - len(told)}"
                cells = (
                    f"{h:g} s, {moves}, {noise:.0%}",
                    f"{len(told)}",
                    few,
                    *cells,
                    f"{spent:.1f}",
                )
                print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
