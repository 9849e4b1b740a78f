"""Φ, Γ and Gramians of many pieces at once: `deadtime.numerics.exponential` by NumPy.

A step of the series or a doubling is a few operations on all pieces, which lie in the last axis
inside and in the first one of what is given and returned. What is added to what is the same, in
the same order, so each piece has the bits that the kernels give it; a hundred of them cost
little more than one, and nothing is compiled.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from deadtime.base.checks import read_only
from deadtime.numerics.exponential import LARGEST, ROUND_OFF, balance, balanced_norm


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
        unit = _units(A, B, mode, tau)
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
    return stack(_congruence(last(T), last(M)))


def balanced(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of every mode, units (n, modes) in which A is balanced, and its norm in them."""
    return _balanced(A.tobytes(), A.shape)


@lru_cache(maxsize=64)  # searches ask for the same plant a thousand times
def _balanced(A: bytes, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    modes = np.frombuffer(A).reshape(shape)
    units = [balance(mode) for mode in modes]
    return read_only(np.array(units).T), read_only(np.array(list(map(balanced_norm, modes, units))))


def _units(A: np.ndarray, B: np.ndarray, mode: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Units (n + m, pieces) of x, in which A is balanced, and of u, in which B is as large as A."""
    states, norm = balanced(A)
    largest = np.abs(B / states.T[:, :, None]).max(axis=1)[mode].T
    inputs = np.maximum(norm[mode], 1.0 / tau) / largest
    return np.concatenate((states[:, mode], np.where(largest > 0.0, inputs, 1.0)))


def _each(matrices: np.ndarray, mode: np.ndarray) -> np.ndarray:
    """The matrix of every piece."""
    return last(matrices).take(mode, axis=-1)


def products(X: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """X Y of every piece, the last axis, summed in the order of `exponential.product`."""
    result = np.zeros((X.shape[0], *Y.shape[1:]))
    add_products(X, Y, result)
    return result


def add_products(X: np.ndarray, Y: np.ndarray, result: np.ndarray) -> None:
    """Add X Y of every piece, the last axis."""
    for k in range(X.shape[1]):
        result += X[:, k, None] * Y[k]


def _doublings(size: np.ndarray) -> np.ndarray:
    """The least s with size / 2^s ≤ 1/2, of every piece."""
    count = np.zeros(size.shape, np.int64)
    while (large := size > 0.5).any():
        size, count = np.where(large, size * 0.5, size), count + large
    return count


def _transitions(Z: np.ndarray, size: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Φ = e^{Zτ} and W = ∫₀^τ e^{Zs} ds, of |Z| τ = `size`."""
    n, count = Z.shape[0], _doublings(size)
    parts = 2.0**count
    short, bound, k = tau / parts, np.ones(tau.shape), 1
    term = np.zeros(Z.shape)
    term[range(n), range(n)] = short
    W = term.copy()
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
    """∫₀^τ e^{Zᵀs} E e^{Zs} ds, its Taylor series over a part of τ and then doubled."""
    n, count = Q.shape[0], _doublings(size)
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
        np.add(M, _congruence(Phi, M), out=M, where=on)
        np.copyto(Phi, products(Phi, Phi), where=on)
    return M


def _congruence(T: np.ndarray, M: np.ndarray) -> np.ndarray:
    """Tᵀ M T of every piece."""
    return products(T.swapaxes(0, 1), products(M, T))


def last(pieces: np.ndarray) -> np.ndarray:
    """Pieces in the last axis."""
    return np.ascontiguousarray(pieces.transpose(1, 2, 0))


def stack(pieces: np.ndarray) -> np.ndarray:
    """Pieces in the first axis."""
    return np.ascontiguousarray(pieces.transpose(2, 0, 1))
