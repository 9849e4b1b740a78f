"""Logs of plants that are known, by matrix exponentials between cuts; no code of the package."""

import itertools
from typing import Any

import numpy as np
from scipy.integrate import simpson
from scipy.linalg import expm


class Plant:
    """dx/dt = A_i x + Σ_j b_ij u_j(t − D_ij) + noise of intensity W, one or one of every mode.

    Or a period adds R ξ instead, ξ standard normal, R `added` (n, r).
    """

    def __init__(self, A, B, D, W=None, added=None):
        self.A, self.B = np.array(A, float), np.array(B, float)
        self.D = np.broadcast_to(np.asarray(D, float), (len(self.A), self.B.shape[2]))
        self.W, self.kept = np.zeros(self.A[0].shape) if W is None else W, {}
        self.added = None if added is None else np.array(added)

    def piece(self, mode, length):
        """Φ and Γ of a stretch."""
        if ("piece", mode, length) not in self.kept:
            self.kept["piece", mode, length] = self._piece(mode, length)
        return self.kept["piece", mode, length]

    def _piece(self, mode, length):
        n, m = self.B.shape[1:]
        Z = np.zeros((n + m, n + m))
        Z[:n, :n], Z[:n, n:] = self.A[mode], self.B[mode]
        E = expm(Z * length)
        return E[:n, :n], E[:n, n:]

    def covariance(self, mode, length):
        """What the noise adds in a while."""
        if ("noise", mode, length) not in self.kept:
            self.kept["noise", mode, length] = self._covariance(mode, length)
        return self.kept["noise", mode, length]

    def _covariance(self, mode, length):
        s = np.linspace(0.0, length, 201)
        E = expm(self.A[mode] * s[:, None, None])
        W = np.broadcast_to(self.W, self.A.shape)[mode]
        return simpson(E @ W @ E.transpose(0, 2, 1), x=s, axis=0)

    def period(self, t, u, mode, k):
        """Φ and what the inputs add from t[k] to t[k + 1]."""
        i, n = mode[k], self.A.shape[1]
        arrivals = [t + D for D in self.D[i]]
        inside = [a[(a > t[k] + 1e-12) & (a < t[k + 1] - 1e-12)] for a in arrivals]
        cuts = np.unique(np.concatenate(([t[k], t[k + 1]], *inside)))
        Phi, added = np.eye(n), np.zeros(n)
        for start, stop in itertools.pairwise(cuts):
            middle = 0.5 * (start + stop)
            acting = [np.searchsorted(a, middle) - 1 for a in arrivals]
            now = np.array([u[q, j] if q >= 0 else 0.0 for j, q in enumerate(acting)])
            over, gamma = self.piece(i, round(stop - start, 13))
            Phi, added = over @ Phi, over @ added + gamma @ now
        return Phi, added

    def log(self, t, u, rng, mode=None, sensor: Any = 0.0, feedback=None):
        """States as measured, and the inputs; `feedback` adds K y_k to them."""
        n, u = self.A.shape[1], u.copy()
        mode = np.zeros(t.size, int) if mode is None else mode
        x, y = np.zeros((t.size, n)), np.zeros((t.size, n))
        for k in range(t.size):
            y[k] = x[k] + sensor * rng.standard_normal(n)
            if feedback is not None:
                u[k] += feedback @ y[k]
            if k + 1 < t.size:
                Phi, added = self.period(t, u, mode, k)
                x[k + 1] = Phi @ x[k] + added
                if self.added is not None:
                    x[k + 1] += self.added @ rng.standard_normal(self.added.shape[1])
                elif self.W.any():
                    Q = self.covariance(mode[k], round(t[k + 1] - t[k], 13))
                    x[k + 1] += np.linalg.cholesky(Q) @ rng.standard_normal(n)
        return y, u


def oscillator(D: Any = 0.312, W=1e-3):
    """Two modes of an oscillator."""
    A = [[[0.0, 1.0], [-2.0, -1.0]], [[0.0, 1.0], [-3.0, -0.5]]]
    return Plant(A, [[[0.0], [1.0]], [[0.0], [1.2]]], D, W * np.eye(2))
