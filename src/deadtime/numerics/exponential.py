"""Φ and Γ over a piece of time, compiled.

A piece of length τ in mode i under a constant input u takes x to Φ x + Γ u,

    Φ = e^{Aτ},    Γ = W B,    W = ∫₀^τ e^{As} ds,    Φ = I + A W.

W is summed as a Taylor series for a short τ and doubled, W(2τ) = W(τ) + Φ(τ) W(τ), in units of
the states in which A is balanced: how often depends on that balanced ‖A‖τ alone, so neither a
badly scaled plant nor a badly scaled B costs accuracy, and no matrix is inverted, so a
singular A needs no special case. The tests hold it against the exponential of
[[A, B], [0, 0]] computed by SciPy and in 50-digit arithmetic.

The Gramian of a piece gives integrals of xᵀQx exactly: with z = (x, u), dz/dt = Z z,
Z = [[A, B], [0, 0]], E = diag(Q, 0),

    ∫₀^τ xᵀQx dt = z(0)ᵀ M z(0),    M(τ) = ∫₀^τ e^{Zᵀs} E e^{Zs} ds,
    M(2τ) = M(τ) + e^{Zᵀτ} M(τ) e^{Zτ}:   a sum of positive terms, no cancellation.

This module needs Numba, so it is imported where it is used.
"""

from __future__ import annotations

import numpy as np
from numba import njit

ROUND_OFF = 1e-18


@njit(cache=True)
def multiply(X, Y):
    """X Y for small matrices, without the call overhead of BLAS."""
    rows, inner = X.shape
    columns = Y.shape[1]
    result = np.zeros((rows, columns))
    for i in range(rows):
        for k in range(inner):
            factor = X[i, k]
            for j in range(columns):
                result[i, j] += factor * Y[k, j]
    return result


@njit(cache=True)
def norm(A):
    """Largest row sum |A|_∞."""
    largest = 0.0
    for i in range(A.shape[0]):
        total = 0.0
        for j in range(A.shape[1]):
            total += abs(A[i, j])
        largest = max(largest, total)
    return largest


@njit(cache=True)
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
                power = np.rint(0.5 * np.log2(row / column))
                if abs(power) >= 1.0:
                    t[i] *= 2.0**power
                    done = False
        if done:
            break
    return t


@njit(cache=True)
def _doublings(size):
    """The least s with size / 2^s ≤ 1/2, at most 1025; −1 where no s is, of a size not finite."""
    if not size < np.inf:
        return -1
    count = 0
    while size > 0.5:
        size *= 0.5
        count += 1
    return count


@njit(cache=True)
def advance(Phi, Gamma, x, u, result):
    """result = Φ x + Γ u."""
    for i in range(x.size):
        total = 0.0
        for j in range(x.size):
            total += Phi[i, j] * x[j]
        for j in range(u.size):
            total += Gamma[i, j] * u[j]
        result[i] = total


@njit(cache=True)
def discretise(A, B, tau):
    """Φ (n, n) and Γ (n, m): dx/dt = A x + B u over `tau` seconds with the input held.

    Both are NaN where |A|τ is beyond what floats hold.
    """
    n = A.shape[0]
    unit = balance(A)
    balanced = A * unit / unit.reshape(n, 1)
    size = norm(balanced) * tau
    count = _doublings(size)
    if count < 0:
        return np.full((n, n), np.nan), np.full(B.shape, np.nan)
    short = tau / 2.0**count
    term = short * np.eye(n)
    W = term.copy()
    bound, k = 1.0, 1
    while bound > ROUND_OFF and k < 40:
        k += 1
        term = multiply(balanced, term)
        term *= short / k
        W += term
        bound *= size / 2.0**count / k
    Phi = multiply(balanced, W)
    for i in range(n):
        Phi[i, i] += 1.0
    for _ in range(count):
        W = W + multiply(Phi, W)
        Phi = multiply(Phi, Phi)
    back = unit.reshape(n, 1)
    return Phi * back / unit, multiply(W * back / unit, B)


@njit(cache=True)
def discretise_modes(A, B, tau):
    """`discretise` for every mode: Φ (modes, n, n) and Γ (modes, n, m)."""
    Phi = np.empty_like(A)
    Gamma = np.empty_like(B)
    for i in range(A.shape[0]):
        Phi[i], Gamma[i] = discretise(A[i], B[i], tau)
    return Phi, Gamma


@njit(cache=True)
def energy_gramian(A, B, tau, Q=None):
    """M (n + m, n + m) with ∫₀^τ xᵀQx dt = zᵀ M z, z = (x(0), u), the input held; None: Q = I.

    States are measured in units in which A is balanced, inputs in units in which B is as large
    as A, so that bad scaling does not ask for needless doublings. M is NaN where |A|τ is beyond
    what floats hold.
    """
    n, m = B.shape
    if tau == 0.0:
        return np.zeros((n + m, n + m))
    unit = np.ones(n + m)
    unit[:n] = balance(A)
    back = unit[:n].copy().reshape(n, 1)
    balanced, scaled = A * unit[:n] / back, B / back
    for j in range(m):
        largest = np.abs(scaled[:, j]).max()
        if largest > 0.0:
            unit[n + j] = max(norm(balanced), 1.0 / tau) / largest
            scaled[:, j] *= unit[n + j]
    Z = np.zeros((n + m, n + m))
    Z[:n, :n] = balanced
    Z[:n, n:] = scaled
    size = 2.0 * norm(Z) * tau
    count = _doublings(size)
    if count < 0:
        return np.full((n + m, n + m), np.nan)
    short = tau / 2.0**count
    term = np.zeros((n + m, n + m))
    if Q is None:
        for i in range(n):
            term[i, i] = short * unit[i] ** 2
    else:
        term[:n, :n] = short * Q * np.outer(unit[:n], unit[:n])
    M = term.copy()
    bound, k = 1.0, 1
    while bound > ROUND_OFF and k < 40:
        k += 1
        half = multiply(term, Z)
        term = (half + half.T) * (short / k)
        M += term
        bound *= size / 2.0**count / k
    transition = extend(*discretise(balanced, scaled, short))
    for _ in range(count):
        M = M + multiply(multiply(transition.T, M), transition)
        transition = multiply(transition, transition)
    return M / np.outer(unit, unit)


@njit(cache=True)
def extend(Phi, Gamma):
    """[[Φ, Γ], [0, I]], the transition of z = (x, u)."""
    n, m = Gamma.shape
    result = np.eye(n + m)
    result[:n, :n] = Phi
    result[:n, n:] = Gamma
    return result
