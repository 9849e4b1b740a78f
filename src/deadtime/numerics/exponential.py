"""Φ, Γ and Gramians over a piece of time, as kernels, and of many pieces together by NumPy.

A piece of length τ in mode i under a constant input u takes x to Φ x + Γ u,

    Φ = e^{Aτ},    Γ = W B,    W = ∫₀^τ e^{As} ds,    Φ = I + A W.

W is summed as a Taylor series for a short τ and doubled, W(2τ) = W(τ) + Φ(τ) W(τ), in units of
the states in which A is balanced. The number of doublings depends on the balanced ‖A‖τ only, so
that bad scaling of the plant or of B costs no accuracy; no matrix is inverted, so that a singular A
is no special case. The tests compare it with the exponential of [[A, B], [0, 0]], by SciPy and in
50-digit arithmetic.

The Gramian of a piece gives integrals of xᵀQx exactly: with z = (x, u), dz/dt = Z z,
Z = [[A, B], [0, 0]], E = diag(Q, 0),

    ∫₀^τ xᵀQx dt = z(0)ᵀ M z(0),    M(τ) = ∫₀^τ e^{Zᵀs} E e^{Zs} ds,
    M(2τ) = M(τ) + e^{Zᵀτ} M(τ) e^{Zτ}:   a sum of positive terms, no cancellation.

In NumPy each term of the series and each doubling is a few operations on the arrays of all pieces,
with the pieces in the last axis (the first one of arguments and results). The order of additions is
that of the kernels, so that results are bitwise equal; a hundred pieces take little more time than
one, and nothing is compiled.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from deadtime.base.checks import read_only
from deadtime.numerics.kernels import kernel

ROUND_OFF = 1e-18  # relative: later terms of a Taylor series do not change a double
LARGEST = 2.0**1000  # |A|τ from which the exponential is NaN


@kernel
def product(X, Y, result):
    """result = X Y for small matrices, without the call overhead of BLAS."""
    for i in range(X.shape[0]):
        for j in range(Y.shape[1]):
            result[i, j] = 0.0
        for k in range(X.shape[1]):
            factor = X[i, k]
            for j in range(Y.shape[1]):
                result[i, j] += factor * Y[k, j]


@kernel
def multiply(X, Y):
    """X Y for small matrices."""
    result = np.empty((X.shape[0], Y.shape[1]))
    product(X, Y, result)
    return result


@kernel
def add_congruence(T, M, spare, result):
    """Add Tᵀ M T to result, all (n, n); `spare` is overwritten by M T."""
    n = M.shape[0]
    product(M, T, spare)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += T[k, i] * spare[k, j]
            result[i, j] += total


@kernel
def balance(A):
    """Powers of two t with diag(1/t) A diag(t) balanced: rows as large as columns (Osborne)."""
    n = A.shape[0]
    t = np.ones(n)
    for _ in range(100):
        done = True
        for i in range(n):
            row = column = 0.0
            for j in range(n):
                if j != i:
                    row += abs(A[i, j]) * t[j] / t[i]
                    column += abs(A[j, i]) * t[i] / t[j]
            if row > 0.0 and column > 0.0:
                # Powers of two, so that scaling by them is exact.
                power = np.rint(0.5 * np.log2(row / column))
                if abs(power) >= 1.0:
                    t[i] *= 2.0**power
                    done = False
        if done:
            break
    return t


@kernel
def balanced_norm(A, t):
    """The largest row sum of diag(1/t) A diag(t)."""
    largest = 0.0
    for i in range(A.shape[0]):
        total = 0.0
        for j in range(A.shape[1]):
            total += abs(A[i, j] * t[j] / t[i])
        largest = max(largest, total)
    return largest


@kernel
def _doublings(size):
    """The least s with size / 2^s ≤ 1/2; −1 for a size whose 2^s floats hardly hold, or none."""
    if not size < LARGEST:
        return -1
    count = 0
    while size > 0.5:
        size *= 0.5
        count += 1
    return count


@kernel
def advance(Phi, Gamma, x, u, result):
    """result = Φ x + Γ u."""
    for i in range(x.size):
        total = 0.0
        for j in range(x.size):
            total += Phi[i, j] * x[j]
        for j in range(u.size):
            total += Gamma[i, j] * u[j]
        result[i] = total


@kernel
def _transition(Z, size, tau, Phi, W):
    """Φ = e^{Zτ} and W = ∫₀^τ e^{Zs} ds, of |Z| τ = `size`."""
    n, count = Z.shape[0], _doublings(size)
    term, spare = np.zeros((n, n)), np.empty((n, n))
    short, bound, k = tau / 2.0**count, 1.0, 1
    for i in range(n):
        term[i, i] = short
        for j in range(n):
            W[i, j] = term[i, j]
    while bound > ROUND_OFF and k < 40:
        k += 1
        product(Z, term, spare)
        for i in range(n):
            for j in range(n):
                term[i, j] = spare[i, j] * (short / k)
                W[i, j] += term[i, j]
        bound *= size / 2.0**count / k
    # Φ = I + Z W, and not a series of its own: so W and Φ agree, and Φ − I keeps its precision.
    product(Z, W, Phi)
    for i in range(n):
        Phi[i, i] += 1.0
    for _ in range(count):
        product(Phi, W, term)
        product(Phi, Phi, spare)
        for i in range(n):
            for j in range(n):
                W[i, j] += term[i, j]
                Phi[i, j] = spare[i, j]


@kernel
def discretise_into(A, B, tau, Phi, Gamma):
    """`discretise` into the arrays Phi and Gamma."""
    n, m = B.shape
    Z, W = np.empty((n, n)), np.empty((n, n))
    unit = balance(A)
    size = balanced_norm(A, unit) * abs(tau)
    for i in range(n):
        for j in range(n):
            Z[i, j] = A[i, j] * unit[j] / unit[i]
            Phi[i, j] = np.nan  # stays if the exponential overflows
        for j in range(m):
            Gamma[i, j] = np.nan
    if size < LARGEST:
        _transition(Z, size, tau, Phi, W)
        for i in range(n):
            for j in range(n):
                Phi[i, j] = Phi[i, j] * unit[i] / unit[j]
                W[i, j] = W[i, j] * unit[i] / unit[j]
        product(W, B, Gamma)


@kernel
def discretise(A, B, tau):
    """Φ (n, n) and Γ (n, m): dx/dt = A x + B u over `tau` seconds with the input held.

    Both are NaN where |A|τ overflows.
    """
    Phi, Gamma = np.empty(A.shape), np.empty(B.shape)
    discretise_into(A, B, tau, Phi, Gamma)
    return Phi, Gamma


@kernel
def discretise_modes(A, B, tau):
    """`discretise` for every mode: Φ (modes, n, n) and Γ (modes, n, m)."""
    Phi, Gamma = np.empty(A.shape), np.empty(B.shape)
    for mode in range(A.shape[0]):
        discretise_into(A[mode], B[mode], tau, Phi[mode], Gamma[mode])
    return Phi, Gamma


@kernel
def discretise_each(A, B, tau):
    """`discretise` of many, each with its own A (count, n, n), B (count, n, m) and tau (count,)."""
    Phi, Gamma = np.empty(A.shape), np.empty(B.shape)
    for i in range(tau.size):
        discretise_into(A[i], B[i], tau[i], Phi[i], Gamma[i])
    return Phi, Gamma


@kernel(error_model="numpy")
def _units(A, B, tau):
    """Units (n + m,) of z = (x, u), in which A is balanced and B is as large as A."""
    n, m = B.shape
    unit, states = np.ones(n + m), balance(A)
    size = max(balanced_norm(A, states), 1.0 / tau)
    for i in range(n):
        unit[i] = states[i]
    for j in range(m):
        largest = 0.0
        for i in range(n):
            largest = max(largest, abs(B[i, j] / states[i]))
        if largest > 0.0:
            unit[n + j] = size / largest
    return unit


@kernel(error_model="numpy")  # a unit may overflow to infinity
def gramian(A, B, tau, Q):
    """M (n + m, n + m) with ∫₀^τ xᵀQx dt = zᵀ M z, z = (x(0), u), the input held.

    The number of doublings is that in units in which A is balanced and B as large as A. M is NaN
    where |A|τ overflows.
    """
    n, m = B.shape
    q = n + m
    M, Z = np.zeros((q, q)), np.zeros((q, q))
    if tau == 0.0:
        return M
    unit = _units(A, B, tau)
    for i in range(n):
        for j in range(n):
            Z[i, j] = A[i, j] * unit[j] / unit[i]
        for j in range(m):
            Z[i, n + j] = B[i, j] / unit[i] * unit[n + j]
    # The rows of u in Z are zero; the factor 2 is for Zᵀ and Z on both sides of the Gramian.
    largest = 0.0
    for i in range(n):
        total = 0.0
        for j in range(q):
            total += abs(Z[i, j])
        largest = max(largest, total)
    size = 2.0 * largest * tau
    count = _doublings(size)
    if count < 0:
        for i in range(q):
            for j in range(q):
                M[i, j] = np.nan
        return M
    _double_gramian(Z, Q, unit, size, count, tau, M)
    for i in range(q):
        for j in range(q):
            M[i, j] /= unit[i] * unit[j]
    return M


@kernel
def _double_gramian(Z, Q, unit, size, count, tau, M):
    """M += ∫₀^τ e^{Zᵀs} E e^{Zs} ds: its Taylor series over τ/2^count, then `count` doublings."""
    n, q = Q.shape[0], Z.shape[0]
    term, half, spare = np.zeros((q, q)), np.empty((q, q)), np.empty((q, q))
    Phi, short = np.empty((q, q)), tau / 2.0**count
    for i in range(n):
        for j in range(n):
            term[i, j] = short * Q[i, j] * (unit[i] * unit[j])
            M[i, j] = term[i, j]
    bound, k = 1.0, 1
    while bound > ROUND_OFF and k < 40:
        k += 1
        product(term, Z, half)
        for i in range(q):
            for j in range(q):
                term[i, j] = (half[i, j] + half[j, i]) * (short / k)
                M[i, j] += term[i, j]
        bound *= size / 2.0**count / k
    _transition(Z, size / 2.0 / 2.0**count, short, Phi, half)
    for _ in range(count):
        # A copy, because `add_congruence` writes to M while it reads.
        for i in range(q):
            for j in range(q):
                half[i, j] = M[i, j]
        add_congruence(Phi, half, spare, M)
        product(Phi, Phi, spare)
        for i in range(q):
            for j in range(q):
                Phi[i, j] = spare[i, j]


def discretise_all(
    A: np.ndarray, B: np.ndarray, mode: np.ndarray, tau: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Φ (pieces, n, n) and Γ (pieces, n, m) of pieces of tau[p] seconds in mode[p]."""
    unit, norm = balanced(A)
    Phi = np.full((*A.shape[1:], mode.size), np.nan)
    Gamma = np.full((*B.shape[1:], mode.size), np.nan)
    with np.errstate(all="ignore"):
        size = norm[mode] * np.abs(tau)
        (held,) = np.nonzero(size < LARGEST)
        of = mode[held]
        to = unit[:, of]  # powers of two, so that every quotient is exact
        carried, W = _transitions(_each(A, of) * to / to[:, None], size[held], tau[held])
        Phi[:, :, held] = carried * to[:, None] / to
        Gamma[:, :, held] = products(W * to[:, None] / to, _each(B, of))
    return stack(Phi), stack(Gamma)


def gramian_all(
    A: np.ndarray, B: np.ndarray, mode: np.ndarray, tau: np.ndarray, Q: np.ndarray
) -> np.ndarray:
    """`gramian` (pieces, n + m, n + m) of pieces of tau[p] seconds in mode[p]."""
    _, n, m = B.shape
    Z = np.zeros((n + m, n + m, mode.size))
    M = np.zeros(Z.shape)
    with np.errstate(all="ignore"):
        unit = _units_all(A, B, mode, tau)
        Z[:n, :n] = _each(A, mode) * unit[:n] / unit[:n, None]
        Z[:n, n:] = _each(B, mode) / unit[:n, None] * unit[n:]
        rows = np.zeros((n, mode.size))
        for j in range(n + m):
            rows += np.abs(Z[:n, j])
        size = 2.0 * rows.max(axis=0) * tau
        M[:, :, ~(size < LARGEST)] = np.nan
        (held,) = np.nonzero(size < LARGEST)
        M[:, :, held] = _doubled(Z[:, :, held], Q, unit[:, held], size[held], tau[held])
        M /= unit[:, None] * unit
        M[:, :, tau == 0.0] = 0.0
    return stack(M)


def product_all(X: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """X Y of every piece."""
    return stack(products(last(X), last(Y)))


def congruence_all(T: np.ndarray, M: np.ndarray) -> np.ndarray:
    """Tᵀ M T of every piece."""
    return stack(_congruences(last(T), last(M)))


def balanced(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Units (n, modes) in which A of each mode is balanced, and its norm in them."""
    return _balanced(A.tobytes(), A.shape)


@lru_cache(maxsize=64)  # searches evaluate the same plant a thousand times
def _balanced(A: bytes, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    modes = np.frombuffer(A).reshape(shape)
    units = [balance(mode) for mode in modes]
    return read_only(np.array(units).T), read_only(np.array(list(map(balanced_norm, modes, units))))


def _units_all(A: np.ndarray, B: np.ndarray, mode: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """`_units` (n + m, pieces) of all pieces."""
    states, norm = balanced(A)
    largest = np.abs(B / states.T[:, :, None]).max(axis=1)[mode].T
    inputs = np.maximum(norm[mode], 1.0 / tau) / largest
    return np.concatenate((states[:, mode], np.where(largest > 0.0, inputs, 1.0)))


def _each(matrices: np.ndarray, mode: np.ndarray) -> np.ndarray:
    return last(matrices).take(mode, axis=-1)


def products(X: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """X Y of every piece, the last axis, summed in the order of `product`."""
    result = np.zeros((X.shape[0], *Y.shape[1:]))
    for k in range(X.shape[1]):
        result += X[:, k, None] * Y[k]
    return result


def _doublings_all(size: np.ndarray) -> np.ndarray:
    """`_doublings` of every piece."""
    count = np.zeros(size.shape, np.int64)
    while (large := size > 0.5).any():
        size, count = np.where(large, size * 0.5, size), count + large
    return count


def _transitions(Z: np.ndarray, size: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`_transition` of every piece."""
    n, count = Z.shape[0], _doublings_all(size)
    parts = 2.0**count
    short, bound, k = tau / parts, np.ones(tau.shape), 1
    term = np.zeros(Z.shape)
    term[range(n), range(n)] = short
    W = term.copy()
    # Pieces leave the sum one by one, each after as many terms as in the kernel.
    while k < 40 and (on := bound > ROUND_OFF).any():
        k += 1
        term = products(Z, term) * (short / k)
        np.add(W, term, out=W, where=on)
        bound = np.where(on, bound * (size / parts / k), bound)
    Phi = products(Z, W)
    Phi[range(n), range(n)] += 1.0
    for s in range(count.max(initial=0)):
        on = count > s
        np.add(W, products(Phi, W), out=W, where=on)
        np.copyto(Phi, products(Phi, Phi), where=on)
    return Phi, W


def _doubled(
    Z: np.ndarray, Q: np.ndarray, unit: np.ndarray, size: np.ndarray, tau: np.ndarray
) -> np.ndarray:
    """`_double_gramian` of every piece."""
    n, count = Q.shape[0], _doublings_all(size)
    parts = 2.0**count
    short, bound, k = tau / parts, np.ones(tau.shape), 1
    M = np.zeros(Z.shape)
    M[:n, :n] = short * Q[:, :, None] * (unit[:n, None] * unit[:n])
    term = M.copy()
    while k < 40 and (on := bound > ROUND_OFF).any():
        k += 1
        half = products(term, Z)
        term = (half + half.swapaxes(0, 1)) * (short / k)
        np.add(M, term, out=M, where=on)
        bound = np.where(on, bound * (size / parts / k), bound)
    Phi, _ = _transitions(Z, size / 2.0 / parts, short)
    for s in range(count.max(initial=0)):
        on = count > s
        np.add(M, _congruences(Phi, M), out=M, where=on)
        np.copyto(Phi, products(Phi, Phi), where=on)
    return M


def _congruences(T: np.ndarray, M: np.ndarray) -> np.ndarray:
    """Tᵀ M T of every piece."""
    return products(T.swapaxes(0, 1), products(M, T))


def last(pieces: np.ndarray) -> np.ndarray:
    """Pieces in the last axis."""
    return np.ascontiguousarray(pieces.transpose(1, 2, 0))


def stack(pieces: np.ndarray) -> np.ndarray:
    """Pieces in the first axis."""
    return np.ascontiguousarray(pieces.transpose(2, 0, 1))
