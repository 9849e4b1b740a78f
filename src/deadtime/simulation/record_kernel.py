"""The inner loops of a record: states at any time, and quadratic forms over its pieces."""

from __future__ import annotations

import numpy as np

from deadtime.numerics.exponential import advance
from deadtime.numerics.kernels import kernel
from deadtime.plant.pieces import up_to

# Numbers of a run, some 14 a period, for which Python's loop takes about the two seconds that
# compiling the kernel takes.
LONG = 400_000


@kernel
def dot(a, b):
    """Σ a_i b_i of arrays, or uncompiled of lists, in four sums: one order wherever it is run."""
    # Compilers keep the order of sums that is written: only of four independent ones can they make
    # vector instructions.
    first = second = third = fourth = 0.0
    whole = len(a) - len(a) % 4
    for i in range(0, whole, 4):
        first += a[i] * b[i]
        second += a[i + 1] * b[i + 1]
        third += a[i + 2] * b[i + 2]
        fourth += a[i + 3] * b[i + 3]
    total = (first + second) + (third + fourth)
    for i in range(whole, len(a)):
        total += a[i] * b[i]
    return total


@kernel
def states_at(A, B, table, cut_offset, cut_mode, step, offset, path, acting):
    """x at the instants t_k + offset, k = `step`; acting[q] is held over piece q."""
    result = np.empty((step.size, A.shape[1]))
    for i in range(step.size):
        q = table.first[step[i]]
        # A run may have ended within the period: its path has fewer pieces than the table.
        last = min(table.first[step[i] + 1], path.shape[0]) - 1
        while q < last and table.start[table.entry[q + 1]] <= offset[i]:
            q += 1
        Phi, Gamma = up_to(A, B, table, cut_offset, cut_mode, table.entry[q], offset[i])
        advance(Phi, Gamma, path[q], acting[q], result[i])
    return result


def _forms_at_once(
    M: np.ndarray, entry: np.ndarray, pieces: int, path: np.ndarray, acting: np.ndarray
) -> float:
    """`form_integral` by NumPy: the four sums of `dot` for all pieces at once, to the same bits."""
    z = np.hstack((path[:pieces], acting[:pieces]))
    forms, size = M[entry[:pieces]], z.shape[1]
    whole = size - size % 4
    sums = np.zeros((4, pieces, size))
    for i in range(whole):
        sums[i % 4] += forms[:, :, i] * z[:, i, None]
    total = (sums[0] + sums[1]) + (sums[2] + sums[3])
    for i in range(whole, size):
        total += forms[:, :, i] * z[:, i, None]
    # Not `sum`, which adds in pairs: the kernel adds piece by piece.
    return np.add.accumulate(np.append(0.0, z * total))[-1]


@kernel(plain=_forms_at_once, large=LONG)
def form_integral(M, entry, pieces, path, acting):
    """Σ_q z_qᵀ M z_q over the first pieces, M (entries, n + m, n + m) that of the piece's entry."""
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
            total += z[i] * dot(form[i], z)
    return total
