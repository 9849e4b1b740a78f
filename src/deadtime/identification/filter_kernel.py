"""Kalman's filter over a log, sensor by sensor, for kernels."""

from __future__ import annotations

import numpy as np

from deadtime.numerics.exponential import product
from deadtime.numerics.kernels import kernel


@kernel
def innovations(y, start, kind, Phi, moved, Q, C, R, x0, P0, error, variance):
    """What each measurement adds to what was expected, and the variance of that, in place.

    y : (T, p), NaN where nothing was measured; start : (T,), whether the state of a sample is x0
    give or take P0 whatever was before; kind : (T,), the row of Phi (kinds, n, n) and Q of the
    period that leads to a sample; moved : (T, n), what inputs add in it. C : (p, n), R : (p,).
    error, variance : (T, p); 0 and 1 where nothing was measured. Sensors err independently, so one
    after the other is the same as all at once, and nothing is inverted.
    """
    samples, sensors = y.shape
    n = x0.size
    x, spare_x, gain = np.zeros(n), np.zeros(n), np.zeros(n)
    P, spare = np.zeros((n, n)), np.zeros((n, n))
    for k in range(samples):
        if start[k]:
            for i in range(n):
                x[i] = x0[i]
                for j in range(n):
                    P[i, j] = P0[i, j]
        else:
            row = kind[k]
            for i in range(n):
                total = moved[k, i]
                for j in range(n):
                    total += Phi[row, i, j] * x[j]
                spare_x[i] = total
            for i in range(n):
                x[i] = spare_x[i]
            product(Phi[row], P, spare)
            for i in range(n):
                for j in range(i + 1):
                    total = Q[row, i, j]
                    for c in range(n):
                        total += spare[i, c] * Phi[row, j, c]
                    P[i, j] = total
                    P[j, i] = total
        for s in range(sensors):
            error[k, s], variance[k, s] = 0.0, 1.0
            if y[k, s] == y[k, s]:
                own, off = R[s], y[k, s]
                for i in range(n):
                    total = 0.0
                    for j in range(n):
                        total += P[i, j] * C[s, j]
                    gain[i] = total
                    own += C[s, i] * total
                    off -= C[s, i] * x[i]
                error[k, s], variance[k, s] = off, own
                for i in range(n):
                    x[i] += gain[i] * off / own
                    for j in range(n):
                        P[i, j] -= gain[i] * gain[j] / own
