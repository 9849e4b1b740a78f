"""Factorised rows in the form that costs least per period.

The factorisation G_{c,j} = H_c S^{j−1} Γ_s leaves the basis open: H T, T⁻¹ S T, T⁻¹ Γ_s is the
same table. In the basis of its eigenvectors S is diagonal, or has 2 × 2 blocks for pairs of complex
ones, which saves most of the work. Whether a basis is good enough is not guessed from its
condition but measured: the taps that it gives are compared with the table's own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Factor, Feedback

ACCURACY = 2e-13  # of the largest entry of a tap
_MOST_ROWS, _MOST_ORDER = 4, 48  # beyond, dense rows cost less than straight-line code


class WindowForm(NamedTuple):
    """Factorised taps for a window of `length` = N − 1 inputs, and the last tap.

    out : H (rows, m, q);  transition : the blocks of S, (q / size, size, size);
    enter : Γ_s (q, m);  last : G_N (rows, m, m);
    ahead : S^{W−1−i} Γ_s (W, q, m);  behind : H S^r (W, rows, m, q);
    """

    out: Float[np.ndarray, "row m q"]
    transition: Float[np.ndarray, "block size size"]
    enter: Float[np.ndarray, "q m"]
    last: Float[np.ndarray, "row m m"]
    ahead: Float[np.ndarray, "W q m"]
    behind: Float[np.ndarray, "W row m q"]


def window_form(feedback: Feedback) -> WindowForm | None:
    """The cheapest form whose taps are those of the table to 2e-13; None if there is none.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> form = window_form(problem.laws["averaged"].digital(0.01))
    >>> form.transition.shape[1], form.out.shape, form.ahead.shape
    (1, (1, 1, 4), (99, 4, 1))
    """
    rows, taps, m, _ = feedback.input_gain.shape
    if feedback.context not in ("none", "mode") or rows > _MOST_ROWS:
        return None
    if taps == 1 or not feedback.input_gain.any():
        last = feedback.input_gain[:, -1]
        nothing = Factor(np.zeros((rows, m, 1)), np.zeros((1, 1)), np.zeros((1, m)), last)
        return _form(nothing, 1, 1)
    factor = feedback.factor
    if factor is None or factor.S.shape[0] > _MOST_ORDER:
        return None
    for candidate, size in _candidates(factor):
        form = _form(candidate, size, taps - 1)
        if _fits(form, feedback):
            return form
    return None


def _candidates(factor: Factor) -> list[tuple[Factor, int]]:
    """The factorisation in other bases, and the size of the blocks that S has there."""
    found = []
    modal = _modal(factor)
    if modal is not None:
        found.append(modal)
    S, q = factor.S, factor.S.shape[0]
    sizes = [size for size in range(1, q + 1) if q % size == 0]
    size = next(s for s in sizes if not (S * (1.0 - _blocks_of_ones(q, s))).any())
    return [*found, (factor, size)]


def _blocks_of_ones(q: int, size: int) -> np.ndarray:
    return np.kron(np.eye(q // size), np.ones((size, size)))


def _modal(factor: Factor) -> tuple[Factor, int] | None:
    """In real eigenvectors of S: real parts and imaginary parts for complex pairs."""
    values, vectors = np.linalg.eig(factor.S)
    real, imaginary = np.real(vectors), np.imag(vectors)
    single, pairs = np.flatnonzero(np.imag(values) == 0.0), np.flatnonzero(np.imag(values) > 0.0)
    if pairs.size == 0:
        size, basis = 1, real
    elif single.size % 2 == 0:
        size = 2
        columns = [real[:, single], *(np.stack((real[:, p], imaginary[:, p]), 1) for p in pairs)]
        basis = np.column_stack(columns)
    else:
        return None
    try:
        inverse = np.linalg.inv(basis)
    except np.linalg.LinAlgError:
        return None
    S = inverse @ factor.S @ basis
    S = S * _blocks_of_ones(S.shape[0], size)
    return Factor(factor.H @ basis, S, inverse @ factor.input, factor.last), size


def _form(factor: Factor, size: int, length: int) -> WindowForm:
    q = factor.S.shape[0]
    ahead, behind = np.empty((length, *factor.input.shape)), np.empty((length, *factor.H.shape))
    column, row = factor.input, factor.H
    for i in range(length):
        ahead[length - 1 - i], behind[i] = column, row
        column, row = factor.S @ column, row @ factor.S
    blocks = [factor.S[i : i + size, i : i + size] for i in range(0, q, size)]
    return WindowForm(factor.H, np.array(blocks), factor.input, factor.last, ahead, behind)


def _fits(form: WindowForm, feedback: Feedback) -> bool:
    """Whether the form's taps are the table's, forwards, and across the two blocks."""
    taps = feedback.input_gain
    W = taps.shape[1] - 1
    forwards = np.einsum("cmq,jqp->cjmp", form.out, form.ahead[::-1])
    backwards = np.einsum("jcmq,qp->cjmp", form.behind, form.enter)
    scale = np.abs(taps[:, :W]).max(axis=(0, 2, 3))[None, :, None, None]
    for found in (forwards, backwards):
        error = np.abs(found - taps[:, :W])
        if not np.isfinite(found).all() or (error > ACCURACY * scale).any():
            return False
    return True
