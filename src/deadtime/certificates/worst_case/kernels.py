"""The compiled loop over a cycle, forwards and transposed.

Both run the weighted loop, x̃_k = w^k x_k and ũ_k = w^k u_k, so that a long cycle neither
overflows nor underflows when w is near 1/(growth over a period):

    ũ_k = F x̃_k + Σ_j w^j G_j ũ_{k−j},
    x̃ ← Φ x̃ + Σ_j w^{lag_j} Γ_j ũ_{k−lag_j, j} over each piece of a period,
    x̃_{k+1} = w x̃.

A period begins with its sample. A `loop` is a `Table` of `deadtime.certificates.worst_case.loop`:
its pieces, and the rows of the law, weighted, the oldest input first. Searches
run these loops for long, so Python never does.
"""

from __future__ import annotations

import numpy as np

from deadtime.numerics.kernels import kernel


@kernel(eager=True, fastmath={"reassoc", "contract"})
def _dot(a, b):
    """Σ a_i b_i, summed in any order (so that it vectorises)."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@kernel(eager=True)
def _control(F, G, x, line, now):
    """u = F x + G (past inputs), into its place in the delay line."""
    m, window = G.shape
    for i in range(m):
        line[now + i] = _dot(G[i], line[now - window : now]) + _dot(F[i], x)


@kernel(eager=True)
def forward(loop, repeats, x, inputs, states):
    """Run `repeats` cycles from x and the first rows of `inputs` (W + samples, m), in place.

    `states` (samples, n) gets x̃ at the end of every period.
    """
    weight = loop.weight
    n, m, cycle = x.size, loop.G.shape[1], loop.rows.size
    past = inputs.shape[0] - repeats * cycle
    line = inputs.reshape(-1)
    moved, acting = np.empty(n), np.empty(m)
    power, others = loop.power, loop.others
    for k in range(repeats * cycle):
        step = k % cycle
        row, now = loop.rows[step], past + k
        _control(loop.F[row], loop.G[row], x, line, now * m)
        for q in range(loop.first[step], loop.first[step + 1]):
            e = loop.entry[q]
            for j in range(m):
                acting[j] = others[e, j] * inputs[now - loop.lag[e, j], j]
            for i in range(n):
                total = 0.0
                for j in range(m):
                    total += loop.Gamma[e, i, j] * acting[j]
                total *= power[e]
                for j in range(n):
                    total += loop.Phi[e, i, j] * x[j]
                moved[i] = total
            for i in range(n):
                x[i] = moved[i]
        for i in range(n):
            x[i] *= weight
            states[k, i] = x[i]


@kernel(eager=True)
def after(loop, repeats, held, z):
    """The lifted state z = (x, the `held` last inputs, the oldest first) after some cycles."""
    m, n = loop.F.shape[1:]
    samples = repeats * loop.rows.size
    x, result = np.empty(n), np.empty(z.size)
    inputs, states = np.empty((held + samples, m)), np.empty((samples, n))
    for i in range(n):
        x[i] = z[i]
    for j in range(held):
        for i in range(m):
            inputs[j, i] = z[n + j * m + i]
    forward(loop, repeats, x, inputs, states)
    for i in range(n):
        result[i] = x[i]
    for j in range(held):
        for i in range(m):
            result[n + j * m + i] = inputs[samples + j, i]
    return result


@kernel(eager=True)
def _control_adjoint(F, G, p, line, now):
    """`_control`, transposed."""
    m, window = G.shape
    for i in range(m):
        u = line[now + i]
        for j in range(p.size):
            p[j] += F[i, j] * u
        for j in range(window):
            line[now - window + j] += G[i, j] * u


@kernel(eager=True)
def carry_back(loop, p, inputs):
    """Carry a functional of the lifted state back over one cycle, in place.

    It is (p, the last W rows of `inputs` (W + samples, m)) at the end, and (p, the first W) at
    the start; the other rows of `inputs` must be 0 at first.
    """
    weight = loop.weight
    n, m, cycle = p.size, loop.G.shape[1], loop.rows.size
    past = inputs.shape[0] - cycle
    line = inputs.reshape(-1)
    moved = np.empty(n)
    power, others = loop.power, loop.others
    for k in range(cycle - 1, -1, -1):
        row, now = loop.rows[k], past + k
        for q in range(loop.first[k + 1] - 1, loop.first[k] - 1, -1):
            e = loop.entry[q]
            end = weight if q == loop.first[k + 1] - 1 else 1.0
            for j in range(m):
                acts, own = now - loop.lag[e, j], end * power[e] * others[e, j]
                for i in range(n):
                    inputs[acts, j] += own * loop.Gamma[e, i, j] * p[i]
            for j in range(n):
                moved[j] = 0.0
                for i in range(n):
                    moved[j] += end * loop.Phi[e, i, j] * p[i]
            for j in range(n):
                p[j] = moved[j]
        _control_adjoint(loop.F[row], loop.G[row], p, line, now * m)
