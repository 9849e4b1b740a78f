"""What is a noise of every mode's own worth to a filter that is told no mode?

    python benchmarks/noise_per_mode.py --runs 40

Two modes of an oscillator, x″ = −2 x − x′ + u(t − 0.312) and x″ = −3 x − 0.5 x′ + 1.2 u(t − 0.312),
with white noise on x′ of intensity s² in the first and (10 s)² in the second; rates of 0.8 and 1.3
1/s, switches anywhere, h = 0.05 s, u = ±1 held for four samples. Runs of 400 samples are made by
SciPy's exponentials between switches and arrivals, without code of the package. `ModeFilter` sees
both states, `OutputModeFilter` x with a noise of 0.003; each counts with the W of every mode, and
with their mean. Last, both W are those of `identify` on another run, 1,200 samples long, of which
the modes were logged.

For each: the share of samples at which the mode that is there is the likeliest, with its standard
error over runs, and the mean of −ln P(mode that is there).
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np
import pandas as pd
from scipy.linalg import expm

import deadtime as dt

A = np.array([[[0.0, 1.0], [-2.0, -1.0]], [[0.0, 1.0], [-3.0, -0.5]]])
B = np.array([[[0.0], [1.0]], [[0.0], [1.2]]])
DELAY, H, LOUDER, SENSOR = 0.312, 0.05, 10.0, 0.003
PLANT = dt.SwitchedSystem(A, B, DELAY)
MODEL = dt.Markov([[0.0, 0.8], [1.3, 0.0]])


def intensity(s):
    """W of both modes."""
    return np.diag([0.0, s**2]) * np.array([1.0, LOUDER**2])[:, None, None]


def over(mode, time, W):
    """Φ, Γ and the covariance of a while in a mode, by Van Loan's exponential."""
    block = np.zeros((4, 4))
    block[:2, :2], block[:2, 2:], block[2:, 2:] = -A[mode], W[mode], A[mode].T
    E = expm(block * time)
    Phi = E[2:, 2:].T
    forced = np.zeros((3, 3))
    forced[:2, :2], forced[:2, 2:] = A[mode], B[mode]
    return Phi, expm(forced * time)[:2, 2], Phi @ E[:2, 2:]


def modes_of(rng, end):
    """The instants of switches from 0 on and the modes after them."""
    rates, times, modes = (0.8, 1.3), [0.0], [int(rng.integers(2))]
    while times[-1] < end:
        times.append(times[-1] + rng.exponential(1.0 / rates[modes[-1]]))
        modes.append(1 - modes[-1])
    return np.array(times), np.array(modes)


def run_of(rng, samples, W):
    """States, inputs and modes at the samples of a run."""
    times, modes = modes_of(rng, samples * H)
    u = np.repeat(rng.choice([-1.0, 1.0], samples // 4 + 1), 4)[:samples]
    x, arrivals = np.zeros((samples, 2)), np.arange(samples) * H + DELAY
    marks = np.unique(np.concatenate((times, arrivals, np.arange(samples) * H)).round(12))
    for k in range(samples - 1):
        now, edges = x[k], marks[(marks > k * H - 1e-9) & (marks < (k + 1) * H + 1e-9)]
        for a, b in itertools.pairwise(edges):
            middle = 0.5 * (a + b)
            acting = np.searchsorted(arrivals, middle) - 1
            mode = modes[np.searchsorted(times, middle) - 1]
            Phi, Gamma, Q = over(mode, b - a, W)
            now = Phi @ now + Gamma * (u[acting] if acting >= 0 else 0.0)
            values, vectors = np.linalg.eigh(Q)
            now = now + vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(2))
        x[k + 1] = now
    return x, u, modes[np.searchsorted(times, np.arange(samples) * H + 1e-9) - 1]


def filters(plant, W):
    """By what is measured."""
    return {
        "both states": dt.ModeFilter(plant, MODEL, H, disturbance=W),
        "a position": dt.OutputModeFilter(
            plant, MODEL, H, [[1.0, 0.0]], covariance=1e-6, disturbance=W, noise=SENSOR
        ),
    }


def shares(filt, runs):
    """Of every run the share of samples with the right mode likeliest, and the mean −ln P."""
    found = []
    for x, y, u, mode in runs:
        running = filt.start()
        seen = x if isinstance(filt, dt.ModeFilter) else y
        belief = np.array([running.update(one, [u[k - 1]]) for k, one in enumerate(seen)])
        right = belief[np.arange(len(mode)), mode]
        found.append(((right > 0.5).mean(), -np.log(np.maximum(right, 1e-300)).mean()))
    return np.array(found)


def identified(rng, W):
    """The plant and the W of every mode of another run, its modes logged."""
    x, u, mode = run_of(rng, 1200, W)
    columns = {"t": np.arange(1200) * H, "x1": x[:, 0], "x2": x[:, 1], "u1": u, "mode": mode}
    fit = dt.identify(pd.DataFrame(columns), delay=(0.0, 1.0), noise=False)
    return fit.plant, fit.disturbance


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--quiet", type=float, nargs="+", default=[0.003, 0.01, 0.03, 0.1])
    args = parser.parse_args()
    print("W of        measured      s       own W: right, −ln P       mean W: right, −ln P")
    for s in args.quiet:
        W, runs = intensity(s), []
        for seed in range(args.runs):
            rng = np.random.default_rng(seed)
            x, u, mode = run_of(rng, 400, W)
            runs.append((x, x[:, :1] + SENSOR * rng.standard_normal((400, 1)), u, mode))
        known = PLANT, W
        for of, (plant, own) in (
            ("the truth", known),
            ("identify", identified(np.random.default_rng(10_000), W)),
        ):
            both = filters(plant, own), filters(plant, own.mean(axis=0))
            for name in both[0]:
                line = f"{of:11} {name:12} {s:6g}"
                for each in both:
                    found = shares(each[name], runs)
                    error = found[:, 0].std(ddof=1) / np.sqrt(len(found))
                    right, log = found.mean(axis=0)
                    line += f"    {100 * right:5.1f} ± {100 * error:.1f} %  {log:6.3f}"
                print(line, flush=True)


if __name__ == "__main__":
    main()
