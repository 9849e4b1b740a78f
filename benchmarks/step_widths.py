"""Are intervals of slow step tests as long as the noise makes them? Coverage and width.

    python benchmarks/step_widths.py --draws 60 --case 1,240,0.01 4,240,0.1

Logs of a first-order plant, gain 2, time constant 60 s, delay 12.3 s, rows every second, at rest
for 20 s, then some moves of the input to random levels; its response is known in closed form. Noise
of the sensor as a share of the gain; `--W` adds noise of the plant, x² per second. The bound is
that of Cramér and Rao for output errors: of the plant's parameters and its first state, without
noise of the plant.
"""

import argparse
import time

import numpy as np
import pandas as pd
from scipy.signal import lfilter

import deadtime as dt

A, B, D, LEAD = -1.0 / 60.0, 2.0 / 60.0, 12.3, 20
NAMES = ("A[0][0,0]", "B[0][0,0]", "delay")


def response(t, a, b, delay, steps):
    """x of dx/dt = a x + b u(t − delay) from rest."""
    return sum(s * b / a * np.expm1(a * np.maximum(t - row - delay, 0.0)) for row, s in steps)


def made(moves, rows, share, W, seed):
    """A log, and the standard errors of A, B and the delay by the bound."""
    rng, t = np.random.default_rng(seed), np.arange(float(rows))
    at = LEAD + np.arange(moves) * (rows - LEAD) // moves
    drawn = [float(rng.choice([-1, 1])) * rng.uniform(0.5, 1.0) for _ in at] if moves > 1 else [1.0]
    steps = list(zip(at.tolist(), np.diff(drawn, prepend=0.0).tolist(), strict=True))
    noise = 2.0 * share
    y = response(t, A, B, D, steps) + noise * rng.standard_normal(rows)
    if W:
        added = np.sqrt(W * np.expm1(2.0 * A) / (2.0 * A)) * rng.standard_normal(rows)
        y += lfilter([1.0], [1.0, -np.exp(A)], added)
    u = sum(s * (t >= row) for row, s in steps)
    theta, moved = np.array([A, B, D]), [np.exp(A * t)]
    for step in np.diag([1e-7, 1e-7, 1e-4]):
        ahead, behind = (response(t, *(theta + s), steps) for s in (step, -step))
        moved.append((ahead - behind) / (2.0 * step.sum()))
    bound = np.linalg.inv(np.array(moved) @ np.array(moved).T) * noise**2
    return pd.DataFrame({"t": t, "x": y, "u": u}), np.sqrt(np.diagonal(bound))[1:]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--case", nargs="+", default=["1,240,0.01", "2,240,0.1", "20,600,0.1"])
    parser.add_argument("--W", type=float, default=0.0)
    given = parser.parse_args()
    print(
        "| moves, rows, noise | logs | A, B, delay inside | mean width / bound | largest | CPU s |"
    )
    print("|---|---|---|---|---|---|")
    for case in given.case:
        moves, rows, share = case.split(",")
        inside, width, began = [], [], time.process_time()
        for seed in range(given.draws):
            log, error = made(int(moves), int(rows), float(share), given.W, seed)
            fit = dt.identify(log, modes=None, delay=(0.0, 40.0))
            ends = np.array([fit.interval(name) for name in NAMES])
            inside.append((ends[:, 0] <= [A, B, D]) & (ends[:, 1] >= [A, B, D]))
            width.append((ends[:, 1] - ends[:, 0]) / (2.0 * 1.96 * error))
        held = ", ".join(f"{100.0 * one:.0f} %" for one in np.mean(inside, axis=0))
        mean, most = (
            ", ".join(f"{one:.2f}" for one in f(width, axis=0)) for f in (np.mean, np.max)
        )
        took = (time.process_time() - began) / given.draws
        row = f"| {moves}, {rows}, {share} | {given.draws} | {held} | {mean} | {most} |"
        print(f"{row} {took:.2f} |", flush=True)


if __name__ == "__main__":
    main()
