"""How much of what a log leaves open is proved at once: an ellipsoid of plants, against corners.

    python benchmarks/certify_ellipsoid.py

Hidden plants of `log_to_law.py` are logged and identified; the law is an averaged predictor on LQR
gains. The radius of the 95 % ellipsoid of A and B is multiplied by s, the delays are the likeliest
ones, and the largest s is looked for by bisection with which

- `certify(known, …)` proves the loop,
- `certify(corners(known), …)` does, the hull of the least cross-polytope about the ellipsoid;
  an attempt that takes more than `--limit` CPU seconds counts as none,
- no plant that was found on the surface grows with a mode held: from eight random ones uphill, by
  eigenvalues of the lifted loop from SciPy's exponentials.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import time

import numpy as np
from log_to_law import H, Hidden, logged
from scipy.linalg import expm

import deadtime as dt
from deadtime.feedback.recurrence import recurrence_of

LEAST, MOST, STEPS = 0.02, 64.0, 6


def scaled(known, s):
    """The same with the ellipsoid of A and B s times as wide."""
    entries = known.plant.A.size + known.plant.B.size
    by = np.ones(len(known.covariance))
    by[:entries] = s
    return dt.UncertainPlant(known.plant, known.covariance * by * by[:, None])


def corners(known):
    """The vertices of the least cross-polytope about the ellipsoid, two for every axis."""
    plant, axes = known.plant, known.axes()
    both = np.sqrt(len(axes)) * np.concatenate((axes, -axes))
    of_A, of_B = np.split(both, [plant.states], axis=3)
    return [plant.like(plant.A + a, plant.B + b) for a, b in zip(of_A, of_B, strict=True)]


def lifted(A, B, delays, F, G):
    """The loop's matrix over a period; inputs read by their own delays."""
    n, m = B.shape
    lags = [max(int(np.ceil(D / H - 1e-9)), 1) for D in delays]
    W = max(*lags, len(G))
    row = np.zeros((m, n + W * m))
    row[:, :n] = F
    for j, tap in enumerate(G):
        row[:, n + j * m : n + (j + 1) * m] = tap
    M = np.zeros((n + W * m,) * 2)
    M[:n, :n] = expm(A * H)
    for c, (D, N) in enumerate(zip(delays, lags, strict=True)):
        late = D - (N - 1) * H

        def over(t, b=B[:, c]):
            Z = np.zeros((n + 1, n + 1))
            Z[:n, :n], Z[:n, n] = A, b
            return expm(Z * t)[:n, n]

        first = expm(A * (H - late)) @ over(late)
        M[:n, n + (N - 1) * m + c] += first
        if N == 1:
            M[:n] += np.outer(over(H - late), row[c])
        else:
            M[:n, n + (N - 2) * m + c] += over(H - late)
    M[n : n + m] = row
    M[n + m :, n : n + (W - 1) * m] = np.eye((W - 1) * m)
    return M


def grows(known, law, rng):
    """Whether some plant of the surface grows with a mode held, as far as was found."""
    table, axes, plant = recurrence_of(law, H), known.axes(), known.plant
    n = plant.states

    def radius(z, i):
        moved = np.tensordot(z / np.linalg.norm(z), axes[:, i], 1)
        row = i if table.context == "mode" else 0
        A, B = plant.A[i] + moved[:, :n], plant.B[i] + moved[:, n:]
        M = lifted(A, B, plant.delays[i], table.state_gain[row], table.input_gain[row])
        return float(np.abs(np.linalg.eigvals(M)).max())

    for i in range(plant.modes):
        for _ in range(8):
            z = rng.standard_normal(len(axes))
            for _ in range(4):
                here, unit = radius(z, i), z / np.linalg.norm(z)
                steps = unit + 1e-4 * np.eye(len(axes))
                slope = np.array([radius(one, i) - here for one in steps])
                z = slope if slope.any() else z
            if radius(z, i) > 1.0:
                return True
    return False


def proves(plants, delays, law, dwell):
    """Whether it is proved."""
    found = dt.certify(plants, law, dwell, H, delays=delays, decay_rate=0.0, search_signals=False)
    return found.proven and found.stable


def within(limit, *arguments):
    """The same in a process of its own that may take so many CPU seconds."""
    context = multiprocessing.get_context("fork")
    mine, theirs = context.Pipe(False)

    def run():
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))
        theirs.send(proves(*arguments))

    child = context.Process(target=run)
    child.start()
    theirs.close()
    try:
        return mine.recv()
    except EOFError:
        return False
    finally:
        child.join()


def largest(holds, steps=STEPS):
    """The largest s between LEAST and MOST with which something holds, and CPU s per attempt."""
    began = time.process_time() + sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
    low, high, tried = LEAST, MOST, 1
    if holds(LEAST):
        for _ in range(steps):
            middle = float(np.sqrt(low * high))
            tried += 1
            low, high = (middle, high) if holds(middle) else (low, middle)
    else:
        low = 0.0
    ended = time.process_time() + sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
    return low, (ended - began) / tried


def row(seed, limit):
    """What becomes of one plant, as a row of the table; why not elsewhere."""
    rng = np.random.default_rng(seed)
    plant, dwell = Hidden(rng), 1.0
    try:
        log = logged(plant, rng, dwell)
        fit = dt.identify(log, delay=(0.0, 0.8), noise=False, per_mode=plant.per_mode)
    except dt.DeadtimeError as error:
        return f"seed {seed}: not identified, {error!s:.60}"
    gains = dt.lqr(fit.plant, np.eye(plant.n), 10.0 * np.eye(plant.m))
    law, known = dt.AveragedPredictor(fit.plant, gains), fit.uncertain
    how = (fit.plant.delays, fit.plant.delays), law, dwell
    new, quick = largest(lambda s: proves(scaled(known, s), *how))
    old, slow = largest(lambda s: within(limit, corners(scaled(known, s)), *how), 4)
    bad, _ = largest(lambda s: not grows(scaled(known, s), law, rng))
    return (
        f"| {seed} | {plant.n}, {plant.m}, {plant.modes} | {len(known.axes())} | {new:.2g} | "
        f"{quick:.2g} | {old:.2g} | {slow:.2g} | {bad:.2g} |"
    )


def main():
    parser = argparse.ArgumentParser(description="Ellipsoids of plants proved, against corners.")
    parser.add_argument("--seeds", type=int, nargs="*", default=[34, 27, 28, 19, 14, 11, 2])
    parser.add_argument("--limit", type=int, default=30)
    arguments = parser.parse_args()
    print("| seed | n, m, modes | entries | proved | CPU s | corners | CPU s | grows |")
    print("|---|---|---|---|---|---|---|---|")
    for seed in arguments.seeds:
        print(row(seed, arguments.limit), flush=True)


if __name__ == "__main__":
    main()
