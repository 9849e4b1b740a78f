"""Compiled sums over the past inputs: a period costs the same whatever N, and nothing drifts.

A factorised row multiplies q = Σ_{j=1..M} S^{j−1} Γ u_{k−j}, M = N − 1. A running sum from which
the oldest term is subtracted would keep its round-off, and e^{A t} would make it grow. Instead the
inputs are divided into blocks of L = ⌈M/2⌉:

      old block      | middle block | newest block
    . . . [f inputs] | all of them  | [b inputs]      b < L,  f + L + b = M

    q = S^b (S^L Q_f + T) + B,    B, T, Q_f: Σ_{i≥1} S^{i−1} Γ w_i over the newest, the middle, and
                                  the f latest inputs of the old block, the latest first.

Q_1, …, Q_L of a block are computed one per period while it is in the middle: all periods take equal
time, and every sum is computed afresh once a block.
"""

from __future__ import annotations

from deadtime.numerics.kernels import kernel


@kernel(eager=True, fastmath={"reassoc", "contract"})
def _add_product(M, v, result):
    """result += M v."""
    for i in range(M.shape[0]):
        total = 0.0
        for j in range(M.shape[1]):
            total += M[i, j] * v[j]
        result[i] += total


@kernel(eager=True)
def _copy(source, target):
    """target = source; a loop compiles in a tenth of the time of an assignment of slices."""
    for i in range(target.size):
        target[i] = source[i]


@kernel(eager=True)
def _clear(target):
    for i in range(target.size):
        target[i] = 0.0


@kernel(eager=True)
def push(u, place, ring):
    """Add u to `ring` (2N, m): from row place[0] on it holds the last N inputs, oldest first."""
    count = ring.shape[0] // 2
    at = place[0]
    for j in range(u.size):
        # Twice, N rows apart: the last N are contiguous wherever the ring begins.
        ring[at, j] = u[j]
        ring[at + count, j] = u[j]
    place[0] = (at + 1) % count


@kernel(eager=True)
def accumulate(u, place, ring, S, steps, power, sums, partial, spare):
    """Update the block sums after the `push` of u.

    place : (position in the ring, b, which half of `partial` is the old block's)
    steps : (L, q, m) S^i Γ;  power : (q, q) S^b;  sums : (2, q) B and T
    partial : (2, L + 1, q) Q of the old and of the middle block;  spare : (q, q)
    """
    count, L, size = ring.shape[0] // 2, steps.shape[0], S.shape[0]
    # B becomes S B + Γ u, from a copy, as each row of S multiplies all of B.
    _copy(sums[0], spare[0])
    _clear(sums[0])
    _add_product(S, spare[0], sums[0])
    _add_product(steps[0], u, sums[0])
    b = place[1] + 1
    filling = partial[1 - place[2]]
    _copy(filling[b - 1], filling[b])
    # Counted from its end, input b of the middle block is 2b − 1 inputs before the latest.
    latest = place[0] + count - 1
    _add_product(steps[b - 1], ring[(latest - 2 * b + 1) % count], filling[b])
    if b < L:
        for i in range(size):
            for j in range(size):
                spare[i, j] = 0.0
                for k in range(size):
                    spare[i, j] += S[i, k] * power[k, j]
        _copy(spare.reshape(-1), power.reshape(-1))
        place[1] = b
        return
    # The newest block is full: it becomes the middle one, and that one the old one.
    place[1], place[2] = 0, 1 - place[2]
    _copy(sums[0], sums[1])
    _clear(sums[0])
    _clear(power.reshape(-1))
    for i in range(size):
        power[i, i] = 1.0


@kernel(eager=True)
def window_sum(window, place, whole, power, sums, partial, spare, q):
    """q of the module; `window` is M and `whole` S^L."""
    L = partial.shape[1] - 1
    _copy(sums[1], spare[0])
    # Row M − L − b of the old block: as many of its inputs are still in the window.
    _add_product(whole, partial[place[2], window - L - place[1]], spare[0])
    _copy(sums[0], q)
    _add_product(power, spare[0], q)


@kernel(eager=True, fastmath={"reassoc", "contract"})
def dense_row(F, G, x, place, ring, u):
    """u = F x + G (the past inputs), G (m, N m) with the oldest first."""
    m = ring.shape[1]
    count = ring.shape[0] // 2
    past = ring.reshape(-1)[place[0] * m : (place[0] + count) * m]
    for i in range(m):
        total = 0.0
        for j in range(past.size):
            total += G[i, j] * past[j]
        for j in range(x.size):
            total += F[i, j] * x[j]
        u[i] = total


@kernel(eager=True)
def factored_row(F, H, last, x, q, place, ring, u):
    """u = F x + H q + (last tap) u_{k−N}."""
    _clear(u)
    _add_product(F, x, u)
    _add_product(H, q, u)
    # u_{k−N} lies where the window begins; its tap is not of the form H S^j Γ.
    _add_product(last, ring[place[0]], u)


@kernel(eager=True, fastmath={"reassoc", "contract"})
def mean_of_dense(F, G, share, x, place, ring, u):
    """u = Σ_c share_c (F_c x + G_c (the past inputs)), G_c (m, N m) with the oldest first."""
    m = ring.shape[1]
    count = ring.shape[0] // 2
    past = ring.reshape(-1)[place[0] * m : (place[0] + count) * m]
    _clear(u)
    for c in range(share.size):
        for i in range(m):
            total = 0.0
            for j in range(past.size):
                total += G[c, i, j] * past[j]
            for j in range(x.size):
                total += F[c, i, j] * x[j]
            u[i] += share[c] * total


@kernel(eager=True)
def mean_of_factored(F, H, last, share, x, q, place, ring, u):
    """u = Σ_c share_c (F_c x + H_c q + (last tap of c) u_{k−N})."""
    _clear(u)
    oldest = ring[place[0]]
    for c in range(share.size):
        for i in range(u.size):
            total = 0.0
            for j in range(x.size):
                total += F[c, i, j] * x[j]
            for j in range(q.size):
                total += H[c, i, j] * q[j]
            for j in range(oldest.size):
                total += last[c, i, j] * oldest[j]
            u[i] += share[c] * total
