"""The compiled inner loops of the digital simulation."""

from __future__ import annotations

import numpy as np

from deadtime.estimation.kernel import remember
from deadtime.numerics.exponential import advance
from deadtime.numerics.kernels import kernel
from deadtime.plant.cut_pieces import up_to
from deadtime.simulation.foreseen import foresee

LIMIT = 1e100


@kernel
def _dot(a, b):
    """Σ a_i b_i in four sums, so that it vectorises, in one order wherever it is run."""
    first = second = third = fourth = 0.0
    whole = a.size - a.size % 4
    for i in range(0, whole, 4):
        first += a[i] * b[i]
        second += a[i + 1] * b[i + 1]
        third += a[i + 2] * b[i + 2]
        fourth += a[i + 3] * b[i + 3]
    total = (first + second) + (third + fourth)
    for i in range(whole, a.size):
        total += a[i] * b[i]
    return total


@kernel
def _within_limit(x):
    """Whether |x| ≤ LIMIT (false when x is not a number)."""
    square = 0.0
    for i in range(x.size):
        square += (x[i] / LIMIT) ** 2
    return square <= 1.0


@kernel
def _finite(a):
    """Whether all are finite."""
    finite = True
    for i in range(a.size):
        finite &= np.isfinite(a[i])
    return finite


@kernel
def _limit(u, before, low, high, relative):
    """An input under limits, one after the other, `before` being what was applied before it."""
    for j in range(relative.size):
        base = before if relative[j] else 0.0
        u = np.minimum(np.maximum(u, base + low[j]), base + high[j])
    return u


@kernel
def _go_on(Phi, Gamma, x, inputs, now, lag, force, result):
    """x further on in its piece, under the inputs of `lag` samples before `now`, and the force."""
    m = lag.size
    acting = np.empty(Gamma.shape[1])
    for i in range(acting.size):
        acting[i] = inputs[now - lag[i], i] if i < m else force[i - m]
    advance(Phi, Gamma, x, acting, result)


@kernel
def closed_loop(table, rows, memory, foreseen, line, sight, clip, shift, x0):
    """Run the loop over the samples 0, …, rows.row.size − 1 and on until an input is missing.

    `table` is a `deadtime.plant.pieces.PieceTable`, `memory` a `deadtime.feedback.memory.Memory` or
    None, `foreseen` one of its file in place of rows or None; the others are of
    `deadtime.simulation`, too: `rows` and `line` of `digital`, `sight` of its file, `clip` of
    `compiled`; `shift` (pieces, n), or empty, is what disturbances add. Returns (samples, path):
    how many samples were kept before |x| left the limit, and x at the start of every piece that was
    run and at the end of the last.
    """
    m, window = line.inputs.shape[1], rows.G.shape[2]
    n, past, samples = x0.size, line.past, rows.row.size
    told, outputs, noises = line.told.reshape(-1), sight.C.shape[1], sight.noise.shape[1]
    spare, acting, answer = np.empty(n), np.empty(m), np.zeros(m)
    path = np.empty((table.entry.size + 1, n))
    for i in range(n):
        path[0, i] = x0[i]
    for k in range(table.first.size - 1):
        if k < samples and k > 0 and not _within_limit(path[table.first[k]]):
            samples = k
        if k < samples:
            row, at, q, way = rows.row[k], past + k, sight.piece[k], sight.way[k]
            recent, seen = told[at * m - window : at * m], line.measured[k]
            x = path[max(q, 0)]
            if way >= 0:
                now, lag = past + sight.step[k], table.lag[table.entry[q]]
                Phi, Gamma, force = sight.Phi[way], sight.Gamma[way], sight.force[q]
                _go_on(Phi, Gamma, x, line.inputs, now, lag, force, spare)
                x = spare
            for i in range(seen.size):
                if q < 0:
                    seen[i] = np.nan
                else:
                    seen[i] = _dot(sight.C[sight.mode[k], i], x) if outputs else x[i]
            for i in range(noises):
                seen[i] += sight.noise[k, i]
            known = seen
            if memory is not None:
                known = line.estimates[k]
                remember(memory, rows.mode, k, line.told, past, seen, answer, line.estimates)
            if foreseen is not None:
                foresee(foreseen, k, past, line.told, known, answer)
            else:
                for i in range(m):
                    answer[i] = _dot(rows.G[row, i], recent) + _dot(rows.F[row, i], known)
            held = not (_finite(seen) or _finite(answer))
            for i in range(m):
                command = line.asked[at - 1, i] if held else answer[i]
                line.asked[at, i] = command
                line.inputs[at, i] = _limit(
                    command, line.inputs[at - 1, i], clip.low[:, i], clip.high[:, i], clip.relative
                )
        for q in range(table.first[k], table.first[k + 1]):
            e = table.entry[q]
            for i in range(m):
                sample = k - table.lag[e, i]
                if sample >= samples:
                    return samples, path[: q + 1]
                acting[i] = line.inputs[past + sample, i]
            advance(table.Phi[e], table.Gamma[e], path[q], acting, path[q + 1])
            if shift.size:
                for i in range(n):
                    path[q + 1, i] += shift[q, i]
    return samples, path


@kernel
def states_at(A, B, table, cut_offset, cut_mode, step, offset, path, acting):
    """x at the instants t_k + offset, k = `step`; acting[q] is held over piece q."""
    result = np.empty((step.size, A.shape[1]))
    for i in range(step.size):
        q = table.first[step[i]]
        last = min(table.first[step[i] + 1], path.shape[0]) - 1
        while q < last and table.start[table.entry[q + 1]] <= offset[i]:
            q += 1
        Phi, Gamma = up_to(A, B, table, cut_offset, cut_mode, table.entry[q], offset[i])
        advance(Phi, Gamma, path[q], acting[q], result[i])
    return result


@kernel
def ways(A, B, table, cut_offset, cut_mode, entry, offset):
    """Φ and Γ of entries from their starts up to `offset` seconds after their period's sample."""
    n, m = B.shape[1:]
    Phi, Gamma = np.empty((entry.size, n, n)), np.empty((entry.size, n, m))
    for v in range(entry.size):
        one_Phi, one_Gamma = up_to(A, B, table, cut_offset, cut_mode, entry[v], offset[v])
        for i in range(n):
            for j in range(n):
                Phi[v, i, j] = one_Phi[i, j]
            for j in range(m):
                Gamma[v, i, j] = one_Gamma[i, j]
    return Phi, Gamma


@kernel
def form_integral(M, entry, pieces, path, acting):
    """The sum of the forms M of the entries over the first pieces."""
    n, m = path.shape[1], acting.shape[1]
    total = 0.0
    z = np.empty(n + m)
    for q in range(pieces):
        for i in range(n):
            z[i] = path[q, i]
        for i in range(m):
            z[n + i] = acting[q, i]
        form = M[entry[q]]
        for i in range(n + m):
            total += z[i] * _dot(form[i], z)
    return total
