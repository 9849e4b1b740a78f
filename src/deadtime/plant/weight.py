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

from deadtime.base.checks import as_floats, brief, number, read_only, real_array
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
            part = getattr(self, name)
            part = part * np.eye(size) if part.ndim == 0 else part
            if part.shape != (size, size):
                raise ArgumentError(
                    f"{where}{name} must have shape ({letter}, {letter}) = {(size, size)}, got "
                    f"{part.shape}."
                )
            vars(whole)[name] = read_only(part)
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


def weight_matrix(name: str, value: ArrayLike, size: int, letter: str, strict: bool) -> np.ndarray:
    """A symmetric matrix (size, size), positive semidefinite or (`strict`) definite."""
    form = f"({letter}, {letter})"
    weight = real_array(name, value, form, 2)
    if weight.shape != (size, size):
        raise ArgumentError(f"{name} must have shape {form} = {(size, size)}, got {weight.shape}.")
    if not np.allclose(weight, weight.T, rtol=1e-12, atol=0.0):
        raise ArgumentError(f"{name} must be symmetric: pass ({name} + {name}.T) / 2.")
    eigenvalues = np.linalg.eigvalsh(weight)
    # A semidefinite matrix may have an eigenvalue below 0 by round-off.
    floor = 0.0 if strict else -1e-12 * max(1.0, abs(eigenvalues).max())
    if eigenvalues[0] < floor or (strict and eigenvalues[0] <= 0.0):
        kind = "positive definite" if strict else "positive semidefinite"
        raise ArgumentError(f"{name} must be {kind}, got an eigenvalue {eigenvalues[0]:.4g}.")
    return (weight + weight.T) / 2.0


def weight_part(name: str, value: ArrayLike, letter: str) -> np.ndarray:
    """A number unchanged; a diagonal or a matrix, positive semidefinite, as a matrix."""
    form = f"({letter}, {letter}), ({letter},) or ()"
    ndim = as_floats(name, value, f"of shape {form}").ndim
    if ndim not in (0, 1, 2):
        raise ArgumentError(f"{name} must have shape {form}, got {ndim} axes.")
    given = np.array([[number(name, value)]]) if ndim == 0 else real_array(name, value, form, ndim)
    whole = np.diag(given) if ndim == 1 else given
    whole = read_only(weight_matrix(name, whole, len(whole), letter, strict=False))
    return whole if ndim else whole.reshape(())


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
