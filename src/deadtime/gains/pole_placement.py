"""Pole placement for one pair (A, B), for gains and observers, with checks of the result."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import brief, require_unmasked
from deadtime.base.errors import ArgumentError

_LARGEST = 1e150  # squares of larger numbers overflow
_RUNAWAY = 2.0**40  # ratio of states' units beyond which balancing has diverged


def pole_lists(poles: ArrayLike | Sequence[ArrayLike], modes: int, n: int) -> np.ndarray:
    """One list of n poles per mode, (modes, n) complex, each closed under conjugation."""
    require_unmasked("poles", poles)
    wanted = f"poles must be {n} numbers, or one list of {n} per mode, got {brief(poles)}."
    try:
        if np.asarray(poles).dtype.kind in "US":  # NumPy would read some of them
            wanted += " Write a complex pole as -4+2j and its conjugate as -4-2j, without quotes."
            raise TypeError
        given = np.asarray(poles, dtype=np.complex128)
    except (TypeError, ValueError, OverflowError):
        raise ArgumentError(wanted) from None
    if given.shape == (n,):
        given = np.tile(given, (modes, 1))
    if given.shape != (modes, n):
        raise ArgumentError(
            f"poles must have shape (n,) = ({n},) or (modes, n) = ({modes}, {n}), "
            f"got {given.shape}."
        )
    if not np.isfinite(given).all():
        raise ArgumentError("poles must be finite, got NaN or infinity.")
    for i, row in enumerate(given):
        for pole in row[row.imag != 0.0]:
            if np.sum(row == pole) != np.sum(row == pole.conjugate()):
                raise ArgumentError(
                    f"poles of mode {i} must come in conjugate pairs, but {pole:g} lacks "
                    f"{pole.conjugate():g}."
                )
    return given


def place_pair(
    A: Float[np.ndarray, "n n"],
    B: Float[np.ndarray, "n m"],
    poles: np.ndarray,
    i: int,
    letter: str = "B",
    given: np.ndarray | None = None,
) -> Float[np.ndarray, "m n"]:
    """K with the poles of A + B K, for a controllable pair; the result is checked.

    Messages name the mode `i`, the matrix B by `letter`, and the poles by `given` if they are
    transformed ones.
    """
    rank = int(np.linalg.matrix_rank(B))
    for pole, name in zip(poles, poles if given is None else given, strict=True):
        times = int(np.sum(poles == pole))
        if times > rank:
            raise ArgumentError(
                f"poles of mode {i}: {name:g} is repeated {times} times, but only rank {letter} = "
                f"{rank} equal poles can be placed: move them apart a little."
            )
    if max(np.abs(A).max(), np.abs(B).max()) > _LARGEST:
        raise ArgumentError(
            f"poles of mode {i} could not be placed: the plant's numbers are too large, or too far "
            "apart, to compute with: use other units."
        )
    try:
        balanced, inputs, t, c = _balance(A, B)
        place = _place_one_input if inputs.shape[1] == 1 else _place_robustly
        K = place(balanced, inputs, poles)
    except ValueError as error:  # which LinAlgError is
        raise ArgumentError(
            f"poles of mode {i} could not be placed ({error}): move them apart or closer to "
            "those of the plant."
        ) from None
    _require_poles(balanced + inputs @ K, poles, i)
    return c[:, None] * K / t


def _place_robustly(A: np.ndarray, B: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """K for several inputs, with well conditioned eigenvectors."""
    from scipy.signal import place_poles

    with warnings.catch_warnings():
        # It warns when its search for robust gains stops early; the result is checked below.
        warnings.simplefilter("ignore", UserWarning)
        wanted = poles if np.iscomplex(poles).any() else np.real(poles)
        result: Any = place_poles(A, B, wanted)
    return -np.real(result.gain_matrix)


def _place_one_input(A: np.ndarray, B: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """K (1, n) for one input: (A − p I) x + B g = 0 gives K x = g for every pole p."""
    pairs = A - poles[:, None, None] * np.eye(len(A))
    pairs = np.concatenate((pairs, np.broadcast_to(B, (len(poles), *B.shape))), axis=2)
    null = np.linalg.svd(pairs)[2][:, -1].conj()
    # Nearly equal poles have nearly the same null vectors: a rough K will do to refine.
    K = np.linalg.lstsq(null[:, :-1], null[:, -1])[0].real[None]
    return _refine(A, B, K, poles)


def _refine(A: np.ndarray, B: np.ndarray, K: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """K corrected for one input, where the characteristic polynomial is affine in K."""
    unit = float(np.abs(poles).max()) or 1.0

    def coefficients(gain: np.ndarray) -> np.ndarray:
        return np.poly(np.linalg.eigvals(A + B @ gain) / unit)[1:].real

    target, here = np.poly(poles / unit)[1:].real, coefficients(K)
    size = max(1.0, float(np.abs(K).max()))  # affine: any size is exact but for round-off
    slopes = [coefficients(K + size * row) - here for row in np.eye(A.shape[0])[:, None, :]]
    try:
        change = np.linalg.solve(np.stack(slopes, axis=1), target - here) * size
    except np.linalg.LinAlgError:
        return K
    better = K + change
    gained = np.abs(coefficients(better) - target).max() < np.abs(here - target).max()
    return better if gained else K


def _require_poles(closed: np.ndarray, poles: np.ndarray, i: int) -> None:
    """Check the characteristic polynomial of the closed loop.

    Coefficients are compared in units in which the largest pole is 1: unlike the eigenvalues they
    are well conditioned for nearly equal poles.
    """
    unit = max(float(np.abs(poles).max()), np.finfo(float).tiny)
    target = np.poly(poles / unit)
    error = np.abs(np.poly(np.linalg.eigvals(closed) / unit) - target).max() / np.abs(target).max()
    if not error <= 1e-6:  # NaN is refused, too
        raise ArgumentError(
            f"poles of mode {i} could not be placed accurately (error {error:.1e} in the "
            "characteristic polynomial): move them apart or closer to those of the plant."
        )


def reachable(A: Float[np.ndarray, "n n"], B: Float[np.ndarray, "n m"]) -> int:
    """The rank of the controllability matrix [B, AB, …].

    Computed by the staircase algorithm: an orthonormal basis of range B, extended by A times its
    newest directions until there are no new ones. States are balanced and inputs normalised first,
    so that the rank does not depend on units.
    """
    n = A.shape[0]
    balanced, fresh, _, _ = _balance(A, B)
    size = max(np.linalg.norm(balanced, 2), np.finfo(float).tiny)
    basis = np.zeros((n, 0))
    while fresh.size and basis.shape[1] < n:
        for _ in range(2):  # Gram and Schmidt's method loses orthogonality in one pass
            fresh = fresh - basis @ (basis.T @ fresh)
        U, values, _ = np.linalg.svd(fresh, full_matrices=False)
        new = U[:, values > 1e-12]
        basis = np.hstack((basis, new))
        fresh = balanced @ new / size
    return basis.shape[1]


def unseen_pole(A: Float[np.ndarray, "n n"], C: Float[np.ndarray, "p n"]) -> complex | None:
    """An undetectable pole of A: unstable and unobservable by C (Popov, Belevitch, Hautus test)."""
    n = len(A)
    if reachable(A.T, C.T) == n:
        return None
    size = max(float(np.linalg.norm(A, 2)), np.finfo(float).tiny)
    rows = C / np.maximum(np.linalg.norm(C, axis=1, keepdims=True), np.finfo(float).tiny)
    for value in np.linalg.eigvals(A):
        pencil = np.vstack(((A - value * np.eye(n)) / size, rows))
        hidden = np.linalg.svd(pencil, compute_uv=False)[-1] < 1e-9
        if hidden and value.real >= -1e-12 * size:
            return value
    return None


def require_controllable(A: np.ndarray, B: np.ndarray, i: int) -> None:
    """Refuse a mode whose controllability matrix [B, AB, …] lacks rank."""
    n, rank = A.shape[0], reachable(A, B)
    if rank < n:
        powers = " ".join(["B", "AB", *(f"A^{k}B" for k in range(2, n))][:n])
        raise ArgumentError(
            f"mode {i} is not controllable: rank [{powers}] = {rank} < {n}: "
            "no gain can move all its poles."
        )


def _balance(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, ...]:
    """A·t/t[:, None] and B·c/t[:, None], with t and c: A is balanced, columns of B have norm 1."""
    t = _units_of(A)
    balanced = A * t / t[:, None]
    fresh = B / t[:, None]
    c = 1.0 / np.maximum(np.linalg.norm(fresh, axis=0), np.finfo(float).tiny)
    return balanced, fresh * c, t, c


def _units_of(A: np.ndarray) -> np.ndarray:
    """Units of the states in which A is balanced.

    Balancing diverges for a reducible A, as with a sum of errors that has no effect on the plant:
    it scales the coupling down until round-off hides it. Then each strongly connected component is
    balanced separately.
    """
    from deadtime.numerics.exponential import balance

    t = balance(A)
    if t.max() < _RUNAWAY * t.min():
        return t
    from scipy.sparse.csgraph import connected_components

    count, group = connected_components(A != 0.0, connection="strong")
    if count > 1:
        t = np.ones(len(A))
        for i in range(count):
            own = np.flatnonzero(group == i)
            t[own] = balance(A[np.ix_(own, own)])
    return t
