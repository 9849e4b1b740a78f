"""Ideal loops of one mode by their definition: the determinant, roots on the right."""

import numpy as np
from scipy.linalg import expm

import deadtime as dt


def determinant(plant, law, s, delay):
    """det Δ(s)/(s + 1)ⁿ of the ideal loop, from the laws' definitions."""
    A, B, model = plant.A[0], plant.B[0], law.plant
    n, m = B.shape
    if isinstance(law, dt.DelayedStateFeedback):
        F, W = law.gains[0], np.zeros((s.size, m, m))
    else:
        K, S, R, D = law.gains[0], model.A[0], model.B[0], model.delay
        E = expm(S * D)
        F = K @ E
        rest = R - np.exp(-s * D)[:, None, None] * (E @ R)
        W = K @ np.linalg.solve(s[:, None, None] * np.eye(n) - S, rest)
    whole = np.zeros((s.size, n + m, n + m), complex)
    whole[:, :n, :n] = s[:, None, None] * np.eye(n) - A
    whole[:, :n, n:] = -np.exp(-s * delay)[:, None, None] * B
    whole[:, n:, :n], whole[:, n:, n:] = -F, np.eye(m) - W
    return np.linalg.det(whole) / (s + 1.0) ** n


AXIS = 1j * np.concatenate((np.linspace(0.0, 60.0, 6001), np.geomspace(60.0, 6e4, 2000)))


def unstable_roots(plant, law, delay):
    """Characteristic roots on the right: the determinant goes round 0 so often along the axis."""
    turn = np.unwrap(np.angle(determinant(plant, law, AXIS, delay)))
    return round((turn[0] - turn[-1]) / np.pi)


def random_loop(seed):
    """A stable loop of one mode: plain or predictor feedback, whose model may be a little off."""
    rng = np.random.default_rng(seed)
    while True:
        n, m = int(rng.integers(1, 4)), int(rng.integers(1, 3))
        delay = float(rng.uniform(0.1, 0.8))
        A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
        plant = dt.SwitchedSystem([A], [B], delay)
        model = dt.SwitchedSystem([A * rng.uniform(0.9, 1.1)], [B], delay * rng.uniform(0.97, 1.03))
        try:
            if rng.random() < 0.5:
                stable = A - (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(n)
                plant = dt.SwitchedSystem([stable], [B], delay)
                law = dt.DelayedStateFeedback(plant, [0.8 * rng.normal(size=(m, n))])
            else:
                law = dt.SingleModePredictor(model, dt.lqr(model, np.eye(n), np.eye(m)), 0)
        except dt.ArgumentError:
            continue
        if max(dt.growth_rate(plant, law, 0, step) for step in (None, 0.1)) < -0.05:
            return plant, law
