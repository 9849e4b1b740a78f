"""The compiled loop over a cycle, forwards and transposed.

Both run the weighted loop, x̃_k = w^k x_k and ũ_k = w^k u_k, so that a long cycle neither
overflows nor underflows when w is near 1/(growth over a period):

    ũ_k = F x̃_k + Σ_j w^j G_j ũ_{k−j},
    x̃ ← Φ x̃ + Σ_j w^{lag_j} Γ_j ũ_{k−lag_j, j} over each piece of a period,
    x̃_{k+1} = w x̃.

A period begins with its sample. A `loop` is a `CycleTable` of `cycle_growth`: its pieces,
and the rows of the law, weighted, the oldest input first. Searches run these loops for long, so
Python never does. They make no arrays, which halves what compiling them takes.
"""

from __future__ import annotations

from deadtime.numerics.kernels import kernel


@kernel(
    eager=True,
    fastmath={"reassoc", "contract"},
    nogil=True,
    no_cpython_wrapper=True,
    forceinline=True,
    _nrt=False,
)
def _dot(a, b):
    """Σ a_i b_i, summed in any order (so that it vectorises)."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@kernel(eager=True, nogil=True, _nrt=False)
def forward(loop, x, line, states):
    """Run cycle after cycle from x and the inputs at the beginning of `line`, in place.

    `line` ((W + samples)·m,) has the inputs of one period after those of another, and `states`
    (samples, n) gets x̃ at the end of every period.
    """
    F, G, Phi, Gamma = loop.F, loop.G, loop.Phi, loop.Gamma
    n, m, window, cycle = x.size, G.shape[1], G.shape[2], loop.rows.size
    samples = states.shape[0]
    past = line.size // m - samples
    for k in range(samples):
        step = k % cycle
        row, now = loop.rows[step], (past + k) * m
        for i in range(m):
            line[now + i] = _dot(G[row, i], line[now - window : now]) + _dot(F[row, i], x)
        for q in range(loop.first[step], loop.first[step + 1]):
            e = loop.entry[q]
            for i in range(n):
                total = 0.0
                for j in range(m):
                    acting = loop.others[e, j] * line[now - loop.lag[e, j] * m + j]
                    total += Gamma[e, i, j] * acting
                total *= loop.power[e]
                for j in range(n):
                    total += Phi[e, i, j] * x[j]
                states[k, i] = total
            for i in range(n):
                x[i] = states[k, i]
        for i in range(n):
            x[i] *= loop.weight
            states[k, i] = x[i]


@kernel(eager=True, nogil=True, _nrt=False)
def carry_back(loop, p, line, moved):
    """Carry a functional of the lifted state back over one cycle, in place.

    It is (p, the last W inputs of `line`) at the end, and (p, the first W) at the start, `line`
    ((W + samples)·m,) as in `forward`; the others must be 0 at first. `moved` (n,) is overwritten.
    """
    F, G, Phi, Gamma = loop.F, loop.G, loop.Phi, loop.Gamma
    n, m, window, cycle = p.size, G.shape[1], G.shape[2], loop.rows.size
    past = line.size // m - cycle
    for k in range(cycle - 1, -1, -1):
        row, now = loop.rows[k], (past + k) * m
        for q in range(loop.first[k + 1] - 1, loop.first[k] - 1, -1):
            e = loop.entry[q]
            end = loop.weight if q == loop.first[k + 1] - 1 else 1.0
            for j in range(m):
                acts = now - loop.lag[e, j] * m + j
                own = end * loop.power[e] * loop.others[e, j]
                for i in range(n):
                    line[acts] += own * Gamma[e, i, j] * p[i]
            for j in range(n):
                moved[j] = 0.0
                for i in range(n):
                    moved[j] += end * Phi[e, i, j] * p[i]
            for j in range(n):
                p[j] = moved[j]
        for i in range(m):
            u = line[now + i]
            for j in range(n):
                p[j] += F[row, i, j] * u
            for j in range(window):
                line[now - window + j] += G[row, i, j] * u
