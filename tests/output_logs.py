"""Logs of outputs alone, and what of a plant is then missed; no code of the package."""

import re

import numpy as np
import pandas as pd

from synthetic_logs import Plant

H = 0.05
MOTOR = Plant([[[0.0, 1.0], [-2.0, -1.0]]], [[[0.0], [1.0]]], 0.312, 1e-3 * np.eye(2))
OUTPUTS = {(2, 1): [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], (1, 2): [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]}


def logged(plant, C, count, seed=0, modes=1, sensor=0.003, jitter=0.0, missing=0.0, hold=1):
    """Outputs of a log, as a table; inputs stay for `hold` rows."""
    rng, C = np.random.default_rng(seed), np.array(C)
    t = H * (np.arange(count) + jitter * rng.uniform(-1.0, 1.0, count))
    mode = (np.arange(count) // 23) % modes
    u = rng.standard_normal((count, plant.B.shape[2]))[np.arange(count) // hold]
    x, u = plant.log(t, u, rng, mode)
    y = x @ C.T + sensor * rng.standard_normal((count, len(C)))
    y[rng.random(y.shape) < missing] = np.nan
    columns = {"t": t, "mode": mode} | {f"y{i + 1}": one for i, one in enumerate(y.T)}
    return pd.DataFrame(columns | {f"u{j + 1}": one for j, one in enumerate(u.T)})


def truth_of(plant, C, order):
    """A and B of every mode in the states that C and `order` choose."""
    C, found = np.array(C, float), []
    for own, b in zip(plant.A, plant.B, strict=True):
        chains = [
            C[j] @ np.linalg.matrix_power(own, k) for j, n in enumerate(order) for k in range(n)
        ]
        T = np.array(chains)
        found.append((T @ own @ np.linalg.inv(T), T @ b))
    return found


def misses(fit, plant, C, order):
    """Names of entries whose interval does not hold the truth, and of how many."""
    truth, wrong, names = truth_of(plant, C, order), [], [n for n in fit.names if n[0] in "AB"]
    for name in names:
        i, a, b = map(int, re.findall(r"\d+", name))
        low, high = fit.interval(name)
        if not low < truth[i][name[0] == "B"][a, b] < high:
            wrong.append(name)
    return wrong, len(names)
