"""Kalman filters side by side, one per mode that may be active, for kernels.

Of sample k each mode i has a normal state x_i, P_i and a probability. Over a period it is carried
by the filter of the mode in which the period begins, or by halves of two where the mode changes
within it, and measured. Then all that lead to mode j are mixed to one normal of their mean and
covariance, as likely as they are (Kim, J. Econometrics 60, 1994; where a period depends on the mode
it begins in alone that is the filter of Blom and Bar-Shalom, IEEE Trans. Automat. Control 33(8),
1988, too).
"""

from __future__ import annotations

import math

import numpy as np

from deadtime.numerics.exponential import product
from deadtime.numerics.kernels import kernel


@kernel
def filter_modes(y, start, kind, Phi, moved, Q, C, R, P0, chain, which, within, stay, move, gained):
    """Log densities of what every period leads to, and what each sample adds to log L, in place.

    y : (T, p), NaN where nothing was measured; start : (T,), whether nothing is known of a state
    but P0. Phi, Q : (modes, kinds, n, n), moved : (modes, T, n), kind : (T,), of the period that
    leads to a sample. C : (p, n), R : (p,). chain : (kinds, modes, modes), logs of probabilities,
    which : (T − 1,); within : whether the mode changes within periods. stay : (T − 1, modes) and
    move : (T − 1, modes, modes), of periods that end in the mode that they begin in, and of others;
    gained : (T,).
    """
    samples, n, modes = y.shape[0], P0.shape[0], chain.shape[1]
    x, P = np.zeros((modes, n)), np.zeros((modes, n, n))
    led_x, led_P = np.zeros((modes, modes, n)), np.zeros((modes, modes, n, n))
    chance, after, share = np.empty(modes), np.empty(modes), np.empty(modes)
    density, spare, gain = np.zeros((modes, modes)), np.zeros((3, n, n)), np.zeros((2, n))
    for i in range(modes):
        chance[i] = -math.log(modes)
        begin(x[i], P[i], P0)
        gained[0] = correct(x[i], P[i], y[0], C, R, gain[0])
    for k in range(1, samples):
        at = kind[k]
        for i in range(modes):
            for j in range(modes):
                if i != j and not within:
                    continue
                if start[k]:
                    begin(led_x[i, j], led_P[i, j], P0)
                elif i == j:
                    own = Phi[i, at], moved[i, k], Q[i, at]
                    carry(x[i], P[i], *own, led_x[i, i], led_P[i, i], spare[0])
                else:
                    own = Phi[i, at], moved[i, k], Q[i, at]
                    other = Phi[j, at], moved[j, k], Q[j, at]
                    carry_halves(x[i], P[i], *own, *other, led_x[i, j], led_P[i, j], spare, gain)
                density[i, j] = correct(led_x[i, j], led_P[i, j], y[k], C, R, gain[0])
            stay[k - 1, i] = density[i, i]
            for j in range(modes):
                move[k - 1, i, j] = density[i, j] if within else density[i, i]
        largest, of = -math.inf, which[k - 1]
        for j in range(modes):
            top, total = -math.inf, 0.0
            for i in range(modes):
                share[i] = chance[i] + chain[of, i, j] + move[k - 1, i, j]
                top = max(top, share[i])
            for i in range(modes):
                share[i] = math.exp(share[i] - top)
                total += share[i]
            after[j] = top + math.log(total)
            largest = max(largest, after[j])
            for i in range(modes):
                share[i] /= total
            mix(led_x, led_P, share, j, within, x[j], P[j])
        total = 0.0
        for j in range(modes):
            total += math.exp(after[j] - largest)
        gained[k] = largest + math.log(total)
        for j in range(modes):
            chance[j] = after[j] - gained[k]


@kernel
def begin(x, P, P0):
    """Nothing is known of the state but P0."""
    for i in range(x.size):
        x[i] = 0.0
        for j in range(x.size):
            P[i, j] = P0[i, j]


@kernel
def carry(x, P, Phi, moved, Q, new_x, new_P, spare):
    """A state over a period."""
    n = x.size
    for i in range(n):
        total = moved[i]
        for j in range(n):
            total += Phi[i, j] * x[j]
        new_x[i] = total
    product(Phi, P, spare)
    for i in range(n):
        for j in range(i + 1):
            total = Q[i, j]
            for c in range(n):
                total += spare[i, c] * Phi[j, c]
            new_P[i, j] = total
            new_P[j, i] = total


@kernel
def carry_halves(x, P, Phi, moved, Q, other, other_moved, other_Q, new_x, new_P, spare, ends):
    """A state over a period that is partly of one mode and partly of another, share unknown."""
    n = x.size
    for i in range(n):
        ends[0, i], ends[1, i] = moved[i], other_moved[i]
        for j in range(n):
            ends[0, i] += Phi[i, j] * x[j]
            ends[1, i] += other[i, j] * x[j]
            spare[1, i, j] = 0.5 * (Phi[i, j] + other[i, j])
            spare[2, i, j] = 0.5 * (Q[i, j] + other_Q[i, j])
    carry(x, P, spare[1], moved, spare[2], new_x, new_P, spare[0])
    for i in range(n):
        new_x[i] = 0.5 * (ends[0, i] + ends[1, i])
        for j in range(n):
            new_P[i, j] += (ends[0, i] - ends[1, i]) * (ends[0, j] - ends[1, j]) / 12.0


@kernel
def correct(x, P, y, C, R, gain):
    """A state by its measurements, in place; their log density."""
    n, found = x.size, 0.0
    for s in range(y.size):
        if y[s] == y[s]:
            whole, off = R[s], y[s]
            for i in range(n):
                total = 0.0
                for j in range(n):
                    total += P[i, j] * C[s, j]
                gain[i] = total
                whole += C[s, i] * total
                off -= C[s, i] * x[i]
            found -= 0.5 * (off * off / whole + math.log(2.0 * math.pi * whole))
            for i in range(n):
                x[i] += gain[i] * off / whole
                for j in range(n):
                    P[i, j] -= gain[i] * gain[j] / whole
    return found


@kernel
def mix(led_x, led_P, share, j, within, x, P):
    """The mean and covariance of what leads to mode j, in place."""
    n = x.size
    for a in range(n):
        x[a] = 0.0
        for b in range(n):
            P[a, b] = 0.0
    for i in range(share.size):
        to = j if within else i
        for a in range(n):
            x[a] += share[i] * led_x[i, to, a]
    for i in range(share.size):
        to = j if within else i
        for a in range(n):
            for b in range(n):
                apart = (led_x[i, to, a] - x[a]) * (led_x[i, to, b] - x[b])
                P[a, b] += share[i] * (led_P[i, to, a, b] + apart)
