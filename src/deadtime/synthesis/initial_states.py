"""What is known of the state at the start: where it lies, or how it is spread.

Every input of a linear loop is a row r of the initial state, u = rᵀx(0), so the largest |u| over a
set, and the spread of u under a normal x(0), are closed forms:

    |x(0)| ≤ ρ                          ρ |r|
    x(0)ᵀ X⁻¹ x(0) ≤ 1                  √(rᵀ X r)
    |x_i(0)| ≤ b_i                      Σ_i |r_i| b_i
    x(0) ~ N(0, X)                      u ~ N(0, rᵀ X r)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, positive, read_only, real_array, share
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import weight_matrix

Kind = Literal["ball", "ellipsoid", "box", "normal"]


@dataclass(frozen=True, eq=False)
class InitialStates(Frozen):
    """The states that a loop may start from (immutable): a ball, a box, an ellipsoid, or a spread.

    Made by `ball`, `box`, `ellipsoid` and `normal`.

    Attributes
    ----------
    kind : "ball", "ellipsoid", "box" or "normal"
    size : (), (n,) or (n, n)
        The radius; the half widths; the matrix X of an ellipsoid, or of a normal distribution.
    probability : float
        With which an input is to stay below its level; 1 of a set.

    Examples
    --------
    >>> InitialStates.box([0.1, 2.0]).text
    'every |x(0)| ≤ (0.1, 2)'
    """

    kind: Kind
    size: Float[np.ndarray, ...]
    probability: float = 1.0

    @staticmethod
    def ball(radius: float = 1.0) -> InitialStates:
        """|x(0)| ≤ radius: for states in like units.

        Raises
        ------
        ArgumentError
            If the radius is not positive.
        """
        size = np.array(positive("radius", radius, "in the states' unit"))
        return InitialStates("ball", read_only(size).reshape(()))

    @staticmethod
    def box(half_widths: ArrayLike) -> InitialStates:
        """|x_i(0)| ≤ half_widths[i], each in the unit of its state.

        Raises
        ------
        ArgumentError
            If one is negative, or all are 0.
        """
        size = real_array("half_widths", half_widths, "(n,)", 1)
        if (size < 0.0).any() or not size.any():
            raise ArgumentError(
                f"half_widths must be 0 or more and not all 0, got {size.tolist()}."
            )
        return InitialStates("box", read_only(size))

    @staticmethod
    def ellipsoid(X: ArrayLike) -> InitialStates:
        """x(0)ᵀ X⁻¹ x(0) ≤ 1; a semidefinite X leaves directions out.

        Raises
        ------
        ArgumentError
            If X is no symmetric, positive semidefinite matrix other than 0.
        """
        return InitialStates("ellipsoid", _semidefinite("X", X))

    @staticmethod
    def normal(covariance: ArrayLike, probability: float = 0.99) -> InitialStates:
        """x(0) ~ N(0, covariance): inputs are to stay below their level with this probability.

        Parameters
        ----------
        covariance : array_like, shape (n, n) or (n,)
            A matrix, or its diagonal: the squares of the standard deviations.
        probability : float
            Above 0, below 1; of each input alone, over all of the run.

        Raises
        ------
        ArgumentError
            If the covariance is not symmetric and positive semidefinite, or is 0, or the
            probability is out of range.
        """
        part = share("probability", probability)
        return InitialStates("normal", _semidefinite("covariance", covariance), part)

    def require_plant(self, plant: SwitchedSystem) -> None:
        """Refuse a plant with another number of states."""
        if self.size.ndim and len(self.size) != plant.states:
            raise ArgumentError(
                f"initial must be of n = {plant.states} states, got a {self.kind} of "
                f"{len(self.size)}."
            )

    @property
    def text(self) -> str:
        """For sentences: "|u| stays below 25 for …"."""
        if self.kind == "ball":
            return f"every |x(0)| ≤ {self.size.item():g}"
        if self.kind == "box":
            widths = ", ".join(f"{width:g}" for width in self.size)
            return f"every |x(0)| ≤ ({widths})"
        if self.kind == "ellipsoid":
            return "every x(0) of the ellipsoid"
        return f"x(0) ~ N(0, X) with a probability of {self.probability:g} at least"


def _semidefinite(name: str, value: ArrayLike) -> Float[np.ndarray, "n n"]:
    form = "(n, n) or (n,)"
    ndim = as_floats(name, value, f"of shape {form}").ndim
    whole = real_array(name, value, form, 1 if ndim == 1 else 2)
    whole = np.diag(whole) if ndim == 1 else whole
    if not whole.any():
        raise ArgumentError(f"{name} must not be 0: nothing would move.")
    return read_only(weight_matrix(name, whole, len(whole), "n", strict=False))
