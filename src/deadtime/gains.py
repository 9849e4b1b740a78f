"""Gains for every mode, in the paper's sign: u = +K x.

python-control's and SciPy's own functions give u = −K x; here A_i + B_i K_i has the poles.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.checks import real_array
from deadtime.errors import ArgumentError
from deadtime.plant import SwitchedSystem


def place(
    plant: SwitchedSystem, poles: ArrayLike | Sequence[ArrayLike]
) -> Float[np.ndarray, "mode m n"]:
    """Gains that place the poles of A_i + B_i K_i.

    Parameters
    ----------
    plant : SwitchedSystem
        The plant; every mode must be controllable.
    poles : array_like, shape (n,) or (modes, n)
        Poles for all modes, or one list per mode, in 1/s; complex ones with their conjugates.

    Returns
    -------
    (modes, m, n) array
        K of u = +K x. With several inputs the gains are chosen for robustness (SciPy's
        `place_poles`).

    Raises
    ------
    ArgumentError
        If a mode is not controllable, a pole is repeated more often than the rank of B, a
        complex pole lacks its conjugate, or the placement fails its own check.

    Examples
    --------
    >>> import deadtime as dt
    >>> dt.place(dt.problems.paper().plant, [-1, -2]).round(4)
    array([[[-12.    ,  -6.    ]],
    <BLANKLINE>
           [[-12.6961,  -6.3725]]])
    """
    wanted = _pole_lists(poles, plant.modes, plant.states)
    return np.stack([_place_mode(plant, i, wanted[i]) for i in range(plant.modes)])


def _pole_lists(poles: ArrayLike | Sequence[ArrayLike], modes: int, n: int) -> np.ndarray:
    """One list of n poles per mode, (modes, n) complex, each closed under conjugation."""
    try:
        given = np.asarray(poles, dtype=np.complex128)
    except (TypeError, ValueError):
        raise ArgumentError(
            f"poles must be {n} numbers, or one list of {n} per mode, got {poles!r}."
        ) from None
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


def _place_mode(plant: SwitchedSystem, i: int, poles: np.ndarray) -> np.ndarray:
    from scipy.signal import place_poles

    A, B = plant.A[i], plant.B[i]
    require_controllable(A, B, i)
    rank = int(np.linalg.matrix_rank(B))
    for pole in np.unique(poles):
        times = int(np.sum(poles == pole))
        if times > rank:
            raise ArgumentError(
                f"poles of mode {i}: {pole:g} is repeated {times} times, but only rank B = "
                f"{rank} equal poles can be placed: move them apart a little."
            )
    try:
        with warnings.catch_warnings():
            # It warns when its search for robust gains stops early; the answer is checked below.
            warnings.simplefilter("ignore", UserWarning)
            balanced, inputs, t, c = _balanced(A, B)
            wanted = poles if np.iscomplex(poles).any() else np.real(poles)
            result: Any = place_poles(balanced, inputs, wanted)
    except ValueError as error:
        raise ArgumentError(
            f"poles of mode {i} could not be placed ({error}): move them apart or closer to "
            "those of the plant."
        ) from None
    K = -np.real(result.gain_matrix)
    if K.shape[0] == 1:
        K = _refined(balanced, inputs, K, poles)
    _require_poles(balanced + inputs @ K, poles, i)
    return c[:, None] * K / t


def _refined(A: np.ndarray, B: np.ndarray, K: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """K corrected for one input, where the characteristic polynomial is affine in K."""
    unit = float(np.abs(poles).max()) or 1.0

    def coefficients(gain: np.ndarray) -> np.ndarray:
        return np.poly(np.linalg.eigvals(A + B @ gain) / unit)[1:].real

    asked, here = np.poly(poles / unit)[1:].real, coefficients(K)
    size = max(1.0, float(np.abs(K).max()))
    slopes = [coefficients(K + size * row) - here for row in np.eye(A.shape[0])[:, None, :]]
    try:
        change = np.linalg.solve(np.stack(slopes, axis=1), asked - here) * size
    except np.linalg.LinAlgError:
        return K
    better = K + change
    return better if np.abs(coefficients(better) - asked).max() < np.abs(here - asked).max() else K


def _require_poles(closed: np.ndarray, poles: np.ndarray, i: int) -> None:
    """Put the answer back: the closed loop has the characteristic polynomial that was asked for.

    Its coefficients are compared, in units in which the largest pole is 1: unlike the
    eigenvalues themselves they are well conditioned when poles nearly coincide.
    """
    unit = max(float(np.abs(poles).max()), np.finfo(float).tiny)
    asked = np.poly(poles / unit)
    error = np.abs(np.poly(np.linalg.eigvals(closed) / unit) - asked).max() / np.abs(asked).max()
    if not error <= 1e-6:
        raise ArgumentError(
            f"poles of mode {i} could not be placed accurately (error {error:.1e} in the "
            "characteristic polynomial): move them apart or closer to those of the plant."
        )


def require_controllable(A: np.ndarray, B: np.ndarray, i: int) -> None:
    """Refuse a mode whose controllability matrix [B, AB, …] lacks rank.

    The rank is that of a staircase: an orthonormal basis of range B, extended by A times its
    newest directions until nothing new comes. States are balanced and inputs normalised first,
    so that the answer does not depend on units.
    """
    n = A.shape[0]
    balanced, fresh, _, _ = _balanced(A, B)
    size = max(np.linalg.norm(balanced, 2), np.finfo(float).tiny)
    basis = np.zeros((n, 0))
    while fresh.size and basis.shape[1] < n:
        for _ in range(2):
            fresh = fresh - basis @ (basis.T @ fresh)
        U, values, _ = np.linalg.svd(fresh, full_matrices=False)
        new = U[:, values > 1e-12]
        basis = np.hstack((basis, new))
        fresh = balanced @ new / size
    if basis.shape[1] < n:
        powers = " ".join(["B", "AB", *(f"A^{k}B" for k in range(2, n))][:n])
        raise ArgumentError(
            f"mode {i} is not controllable: rank [{powers}] = {basis.shape[1]} < {n}: "
            "no gain can move all its poles."
        )


def _balanced(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, ...]:
    """A and B in units in which A is balanced and B's columns have length 1, and those units.

    With units t of the states and c of the inputs, A/t·t and B·c/t are returned.
    """
    from scipy.linalg import matrix_balance

    balanced, (t, _) = matrix_balance(A, permute=False, separate=True)
    fresh = B / t[:, None]
    c = 1.0 / np.maximum(np.linalg.norm(fresh, axis=0), np.finfo(float).tiny)
    return balanced, fresh * c, t, c


def lqr(plant: SwitchedSystem, Q: ArrayLike, R: ArrayLike) -> Float[np.ndarray, "mode m n"]:
    """Gains that minimise ∫ xᵀQx + uᵀRu in each mode, its delay and switching aside.

    Parameters
    ----------
    plant : SwitchedSystem
        The plant.
    Q : array_like, shape (n, n)
        State weight, symmetric, positive semidefinite.
    R : array_like, shape (m, m)
        Input weight, symmetric, positive definite.

    Returns
    -------
    (modes, m, n) array
        K of u = +K x.

    Raises
    ------
    ArgumentError
        If a weight is not symmetric or not definite, or a mode has no stabilising solution.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[0.0]], [[1.0]]], [[[1.0]], [[1.0]]], delay=1.0)
    >>> dt.lqr(plant, Q=[[1.0]], R=[[1.0]]).ravel().round(4)      # −1 and −(1 + √2)
    array([-1.    , -2.4142])
    """
    Q = weight_matrix("Q", Q, plant.states, "n", strict=False)
    R = weight_matrix("R", R, plant.inputs, "m", strict=True)
    return np.stack([_lqr_mode(plant, i, Q, R) for i in range(plant.modes)])


def weight_matrix(name: str, value: ArrayLike, size: int, letter: str, strict: bool) -> np.ndarray:
    """A symmetric weight of a quadratic cost, positive semidefinite or (`strict`) definite."""
    form = f"({letter}, {letter})"
    weight = real_array(name, value, form, 2)
    if weight.shape != (size, size):
        raise ArgumentError(f"{name} must have shape {form} = {(size, size)}, got {weight.shape}.")
    if not np.allclose(weight, weight.T, rtol=1e-12, atol=0.0):
        raise ArgumentError(f"{name} must be symmetric: pass ({name} + {name}.T) / 2.")
    eigenvalues = np.linalg.eigvalsh(weight)
    floor = 0.0 if strict else -1e-12 * max(1.0, abs(eigenvalues).max())
    if eigenvalues[0] < floor or (strict and eigenvalues[0] <= 0.0):
        kind = "positive definite" if strict else "positive semidefinite"
        raise ArgumentError(f"{name} must be {kind}, got an eigenvalue {eigenvalues[0]:.4g}.")
    return (weight + weight.T) / 2.0


def _lqr_mode(plant: SwitchedSystem, i: int, Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    from scipy.linalg import solve_continuous_are

    A, B = plant.A[i], plant.B[i]
    try:
        X = solve_continuous_are(A, B, Q, R)
    except ValueError:  # LinAlgError among them
        X = np.full_like(A, np.nan)
    K = -np.linalg.solve(R, B.T @ X)
    residual = np.linalg.norm(A.T @ X + X @ A + X @ B @ K + Q)
    size = np.linalg.norm(Q) + 2.0 * np.linalg.norm(A) * np.linalg.norm(X)
    stable = np.isfinite(K).all() and np.linalg.eigvals(A + B @ K).real.max() < 0.0
    if not stable or residual > 1e-8 * size:
        raise ArgumentError(
            f"mode {i} has no stabilising LQR gain: it must be stabilisable, and Q must weigh "
            "its unstable and undamped states."
        )
    return K
