"""The cost of a run, ∫ xᵀQx + uᵀRu, and its weights.

Functions that measure or minimise a cost take a `Weight` as `weight`; None stands for the identity,
∫|x|² + |u|², whose integrals are always computed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import (
    as_floats,
    brief,
    number,
    read_only,
    real_array,
    require_semidefinite,
    require_shape,
)
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.base.json_records import record
from deadtime.plant import SwitchedSystem

PLAIN = "∫|x|² + |u|²"
_MOST = 3  # rows of a matrix that a label shows in full


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Weight(Frozen):
    r"""The weights of the cost :math:`\int x^T Q x + u^T R u \, dt` (immutable).

    Parameters
    ----------
    Q : array_like, shape (n, n), (n,) or a number
        Weight of the states: a symmetric, positive semidefinite matrix; its diagonal; or a number
        that multiplies the identity.
    R : array_like, shape (m, m), (m,) or a number
        Weight of the inputs, likewise. Laws and gains that minimise the cost need a definite R.

    Raises
    ------
    ArgumentError
        If Q or R has another shape or is not symmetric and semidefinite, or if both are 0.

    Examples
    --------
    >>> import deadtime as dt
    >>> run = dt.problems.paper().simulate("averaged")
    >>> plain, costly = run.metrics(), run.metrics(dt.Weight([1, 1], 10))
    >>> bool(np.isclose(costly["cost"], plain["ise"] + 10 * plain["energy"]))
    True
    """

    Q: Float[np.ndarray, ...]
    R: Float[np.ndarray, ...]

    def __init__(self, Q: ArrayLike = 1.0, R: ArrayLike = 1.0) -> None:
        parts = {"Q": weight_part("Q", Q, "n"), "R": weight_part("R", R, "m")}
        if not any(part.any() for part in parts.values()):
            raise ArgumentError("Q and R must not both be 0: every run would cost the same.")
        vars(self).update(parts)

    def __repr__(self) -> str:
        return f"Weight(Q={self.Q.tolist()}, R={self.R.tolist()})"

    @property
    def text(self) -> str:
        """The cost for labels and headings.

        Examples
        --------
        >>> Weight([4, 1], 0.1).text
        '∫xᵀQx + uᵀRu, Q = diag(4, 1), R = 0.1'
        """
        return f"∫xᵀQx + uᵀRu, Q = {_text_of(self.Q)}, R = {_text_of(self.R)}"

    def of(self, plant: SwitchedSystem, where: str = "weight.") -> Weight:
        """This weight with matrices of the plant's sizes; `where` precedes names in messages.

        Raises
        ------
        ArgumentError
            If Q or R has another size.
        """
        whole = Weight.__new__(Weight)
        for name, letter, size in (("Q", "n", plant.states), ("R", "m", plant.inputs)):
            vars(whole)[name] = weight_matrix(f"{where}{name}", getattr(self, name), size, letter)
        return whole


def weight_of(weight: object, plant: SwitchedSystem) -> Weight | None:
    """A weight with matrices of the plant's sizes; None for the identity.

    Examples
    --------
    >>> import deadtime as dt
    >>> weight_of(Weight([1, 1], [[1]]), dt.problems.paper().plant) is None
    True
    """
    if weight is None:
        return None
    if not isinstance(weight, Weight):
        raise ArgumentError(
            f"weight must be a Weight(Q, R), got {brief(weight)}, a {type(weight).__name__}."
        )
    whole = weight.of(plant)
    plain = all(np.array_equal(part, np.eye(len(part))) for part in (whole.Q, whole.R))
    return None if plain else whole


def text_of(weight: Weight | None) -> str:
    """The cost for labels and headings."""
    return PLAIN if weight is None else weight.text


def record_of(weight: Weight | None) -> dict[str, dict[str, list]]:
    """The weight for JSON; an empty record for the identity."""
    return {} if weight is None else {"weight": record(weight, "Q", "R")}


def costs(
    integrals: Callable[[Weight | None], tuple[float, float]], weight: Weight | None
) -> dict[str, float]:
    """∫|x|² (ise), ∫|u|² (energy) and the cost, from a function of a weight that has both parts.

    Examples
    --------
    >>> import deadtime as dt
    >>> costs(lambda weight: (3.0, 2.0) if weight is None else (1.0, 0.5), dt.Weight(2, 3))
    {'ise': 3.0, 'energy': 2.0, 'cost': 1.5}
    """
    ise, energy = integrals(None)
    states, inputs = (ise, energy) if weight is None else integrals(weight)
    return {"ise": ise, "energy": energy, "cost": states + inputs}


def weight_part(
    name: str, value: ArrayLike, letter: str, strict: bool = False
) -> Float[np.ndarray, ...]:
    """A weight or covariance: a number unchanged, a diagonal or a matrix as a symmetric matrix.

    It is positive semidefinite, or definite if `strict`.
    """
    form = f"({letter}, {letter}), ({letter},) or ()"
    given = as_floats(name, value, f"of shape {form}")
    if given.ndim > 2:
        raise ArgumentError(
            f"{name} must have shape {form}, got {given.shape}: give one matrix, not one per mode."
        )
    if given.ndim == 0:  # messages about a number name no entry
        whole = np.array([[number(name, given)]])
    else:
        whole = real_array(name, given, form, given.ndim)
    whole = np.diag(whole) if given.ndim == 1 else whole
    whole = require_shape(name, whole, (len(whole),) * 2, f"({letter}, {letter})")
    # Symmetric to the last bit: a filter that is stored and restored must not drift.
    whole = read_only(require_semidefinite(name, whole, strict=strict))
    return whole if given.ndim else whole.reshape(())


def weight_matrix(
    name: str, value: ArrayLike, size: int, letter: str, strict: bool = False
) -> Float[np.ndarray, "size size"]:
    """A symmetric matrix, positive semidefinite or (`strict`) definite.

    A number multiplies the identity, and (size,) is a diagonal.

    Examples
    --------
    >>> weight_matrix("Q", 2.0, 2, "n").tolist()
    [[2.0, 0.0], [0.0, 2.0]]
    """
    part = weight_part(name, value, letter, strict)
    whole = read_only(part * np.eye(size)) if part.ndim == 0 else part
    return require_shape(name, whole, (size, size), f"({letter}, {letter})")


def intensities(name: str, value: ArrayLike, modes: int, n: int) -> Float[np.ndarray, "*mode n n"]:
    """W as `weight_matrix` checks it, or one such matrix for each mode if they differ."""
    W = intensity_part(name, value)
    if W.ndim < 3:
        return weight_matrix(name, W, n, "n")
    require_shape(name, W, (modes, n, n), "(modes, n, n)")
    # Equal ones as one: filters then need one covariance for each mode, not for each pair.
    return read_only(W[0]) if (W[0] == W).all() else W


def intensity_part(name: str, value: ArrayLike) -> Float[np.ndarray, ...]:
    """W as `weight_part` checks it, or one such matrix for each mode."""
    given = as_floats(name, value, "of shape (modes, n, n), (n, n), (n,) or ()")
    if given.ndim != 3:
        return weight_part(name, given, "n")
    given = real_array(name, given, "(modes, n, n)", 3)
    return read_only(
        np.stack([weight_part(f"{name}[{mode}]", W, "n") for mode, W in enumerate(given)])
    )


def _text_of(part: np.ndarray) -> str:
    if part.size == 1:
        return f"{part.item():g}"
    diagonal = np.diag(part)
    if np.array_equal(part, diagonal[0] * np.eye(len(part))):
        return "I" if diagonal[0] == 1.0 else f"{diagonal[0]:g} I"
    if len(part) > _MOST:
        return f"a {len(part)} × {len(part)} matrix"
    if np.array_equal(part, np.diag(diagonal)):
        return f"diag({', '.join(f'{value:g}' for value in diagonal)})"
    return f"[{', '.join('[' + ', '.join(f'{v:g}' for v in row) + ']' for row in part)}]"
