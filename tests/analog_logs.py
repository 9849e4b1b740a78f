"""Logs of plants whose inputs change linearly between samples, by Runge and Kutta's method."""

import itertools

import numpy as np
import pandas as pd


class AnalogPlant:
    """dx/dt = A_i x + Σ_j b_ij u_j(t − D_j) + noise of intensity W, u interpolated by NumPy."""

    def __init__(self, A, B, D, W=None):
        self.A, self.B, self.D = np.array(A, float), np.array(B, float), np.array(D, float)
        self.W = np.zeros(self.A[0].shape) if W is None else np.array(W, float)

    def period(self, t, u, mode, k, x):
        """The state at t[k + 1] from x at t[k], without noise; inputs before the log rest."""
        cuts = [t[k], t[k + 1]]
        for D in self.D:
            cuts += [one for one in t + D if t[k] < one < t[k + 1]]
        for start, stop in itertools.pairwise(sorted(cuts)):
            x = self._piece(t, u, mode[k], start, stop, x)
        return x

    def _piece(self, t, u, mode, start, stop, x, steps=6):
        h = (stop - start) / steps

        def slope(time, x):
            now = [np.interp(time - D, t, u[:, j]) for j, D in enumerate(self.D)]
            return self.A[mode] @ x + self.B[mode] @ np.array(now)

        for s in start + h * np.arange(steps):
            a = slope(s, x)
            b = slope(s + 0.5 * h, x + 0.5 * h * a)
            c = slope(s + 0.5 * h, x + 0.5 * h * b)
            d = slope(s + h, x + h * c)
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        return x

    def log(self, t, u, rng, mode=None, sensor=0.0):
        """States as measured; the noise of a period is W τ to first order."""
        n = self.A.shape[1]
        mode, x = np.zeros(t.size, int) if mode is None else mode, np.zeros((t.size, n))
        root = np.linalg.cholesky(self.W) if self.W.any() else self.W
        for k in range(t.size - 1):
            x[k + 1] = self.period(t, u, mode, k, x[k])
            x[k + 1] += root @ rng.standard_normal(n) * np.sqrt(t[k + 1] - t[k])
        return x + sensor * rng.standard_normal(x.shape)


def table(t, x, u, mode=None):
    columns = {"t": t} if mode is None else {"t": t, "mode": mode}
    columns |= {f"x{i + 1}": one for i, one in enumerate(x.T)}
    return pd.DataFrame(columns | {f"u{j + 1}": one for j, one in enumerate(u.T)})
