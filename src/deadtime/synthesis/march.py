"""The cost and the inputs of a loop along its own runs, compiled."""

from __future__ import annotations

import numpy as np

from deadtime.numerics.exponential import advance
from deadtime.numerics.kernels import kernel

LARGEST = 1e60  # |x|²: beyond, the loop grows


@kernel(eager=True)
def _form(Q, x, u):
    """zᵀ Q z, z = (x, u)."""
    n = x.size
    total = 0.0
    for i in range(n + u.size):
        row = 0.0
        for j in range(n):
            row += Q[i, j] * x[j]
        for j in range(u.size):
            row += Q[i, n + j] * u[j]
        total += row * (x[i] if i < n else u[i - n])
    return total


@kernel(eager=True)
def cost_of_run(Phi, Gamma, Q, lags, F, G, step, x0, block, most, done, R):
    """∫ xᵀQx + uᵀRu from x0 with no inputs in the past.

    `Phi`, `Gamma`, the forms `Q` of ∫xᵀQx and `lags` (pieces, m) hold the pieces of a period;
    G (m, taps·m) has the oldest tap first; an `R` of None is the identity.
    Blocks of `block` periods are run until one adds less than `done` of the sum, or `most` are;
    what is then missing is the tail of a geometric series. Returns the cost and the ratio of the
    last two blocks; a cost of ∞ where that is 1 or more.
    """
    m, n = F.shape
    taps = G.shape[1] // m
    past = max(taps, lags.max())
    inputs = np.zeros((past + block) * m)
    x, middle, u = x0.copy(), np.empty(n), np.empty(m)
    total, before, ratio, first = 0.0, 0.0, 0.0, 0.0
    for rounds in range(most):
        inputs[: past * m] = inputs[block * m :]
        added = 0.0
        for k in range(past, past + block):
            window = inputs[(k - taps) * m : k * m]
            for i in range(m):
                value = np.dot(G[i], window)
                for j in range(n):
                    value += F[i, j] * x[j]
                inputs[k * m + i] = value
                if R is None:
                    added += step * value * value
            if R is not None:
                u[:] = inputs[k * m : (k + 1) * m]
                for i in range(m):
                    for j in range(m):
                        added += step * u[i] * R[i, j] * u[j]
            for piece in range(lags.shape[0]):
                for i in range(m):
                    u[i] = inputs[(k - lags[piece, i]) * m + i]
                added += _form(Q[piece], x, u)
                advance(Phi[piece], Gamma[piece], x, u, middle)
                x[:] = middle
        total += added
        if not total < LARGEST:
            return np.inf, (added / first) ** (1.0 / rounds) if rounds > 0 else LARGEST
        if added <= done * total:
            return total, added / before if before > 0.0 else 0.0
        ratio = added / before if before > 0.0 else 1.0
        before = added
        first = first if first > 0.0 else added
    if ratio >= 1.0:
        return np.inf, ratio
    return total + before * ratio / (1.0 - ratio), ratio


@kernel(eager=True)
def run_block(Phi, Gamma, lags, F, G, past, states, inputs):
    """Runs from the rows of `states`, side by side, over as many periods as `inputs` has room for.

    A row of `inputs` holds `past` periods before the block, then the block's own, which are filled
    in; `states` are those at its end.
    """
    m, n = F.shape
    taps = G.shape[1] // m
    middle, u = np.empty(n), np.empty(m)
    for run in range(states.shape[0]):
        x, row = states[run], inputs[run]
        for k in range(past, row.size // m):
            window = row[(k - taps) * m : k * m]
            for i in range(m):
                value = np.dot(G[i], window)
                for j in range(n):
                    value += F[i, j] * x[j]
                row[k * m + i] = value
            for piece in range(lags.shape[0]):
                for i in range(m):
                    u[i] = row[(k - lags[piece, i]) * m + i]
                advance(Phi[piece], Gamma[piece], x, u, middle)
                x[:] = middle
