"""Do intervals hold the truth where noise hides the delay?

    python benchmarks/faint_inputs.py --draws 400

Logs of 120 rows of dx/dt = −x + b u(t − D) + white noise of intensity 1, u = ±1 held for 4 rows of
0.05 s, delays looked for from 0 to 1 s, made by SciPy's exponentials with no code of the package.
"About the likeliest": intervals that take the likeliest delay for granted.
"""

import argparse

import numpy as np
import pandas as pd
from uneven_logs import uneven_states

import deadtime as dt

H, COUNT, HELD = 0.05, 120, 4
# name: b, D, jitter of the rows' times in periods, deviation of the sensor
CASES = {
    "b = 0.5": (0.5, 0.512, 0.0, 0.0),
    "b = 1": (1.0, 0.512, 0.0, 0.0),
    "b = 2": (2.0, 0.512, 0.0, 0.0),
    "short delay": (1.0, 0.062, 0.0, 0.0),
    "uneven": (1.0, 0.512, 0.3, 0.0),
    "noisy": (1.0, 0.512, 0.0, 0.2),
    "uneven, noisy": (1.0, 0.512, 0.3, 0.2),
}


def made(seed, b, D, jitter, sensor):
    """A log as a table."""
    rng = np.random.default_rng(seed)
    t = H * (np.arange(COUNT) + jitter * rng.integers(-1000, 1001, COUNT) / 1000.0)
    u = np.repeat(rng.choice([-1.0, 1.0], (COUNT // HELD, 1)), HELD, axis=0)
    A, B = np.array([[[-1.0]]]), np.array([[[b]]])
    x = uneven_states(A, B, [D], 1.0, t, u, np.zeros(COUNT, int), rng)
    x += sensor * rng.standard_normal(x.shape)
    return pd.DataFrame({"t": t, "x": x[:, 0], "u": u[:, 0]})


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--draws", type=int, default=400)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--case", nargs="*", default=list(CASES), choices=list(CASES))
    given = parser.parse_args()
    print("case | logs | A inside | B inside | delay inside | about the likeliest: A | B")
    for case in given.case:
        b, D, _, sensor = CASES[case]
        inside, alone = [], []
        for seed in range(given.first, given.first + given.draws):
            fit = dt.identify(made(seed, *CASES[case]), None, (0.0, 1.0), noise=sensor > 0.0)
            ends = [fit.interval(name) for name in fit.names[:3]]
            inside += [[low < v < high for (low, high), v in zip(ends, (-1.0, b, D), strict=True)]]
            spread, theta = fit._estimate.spread, fit._estimate.best.theta
            half = spread.reach * np.sqrt(np.diagonal(spread.covariance))
            alone.append(np.abs(theta - [-1.0, b, *theta[2:]])[:2] < half[:2])
        shares = 100.0 * np.concatenate((np.mean(inside, axis=0), np.mean(alone, axis=0)))
        print(f"{case} | {given.draws} | {' | '.join(f'{s:.1f} %' for s in shares)}", flush=True)


if __name__ == "__main__":
    main()
