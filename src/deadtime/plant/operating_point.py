"""Where a plant rests, where that is not 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import real_array
from deadtime.base.frozen import Frozen


@dataclass(frozen=True, eq=False, init=False)
class OperatingPoint(Frozen):
    """The state x₀ and the input u₀ that a plant's states and inputs are deviations from.

        dx/dt = A_σ (x − x₀) + B_σ (u(t − D) − u₀)

    Parameters
    ----------
    x : array_like, shape (n,)
        In the units of the states.
    u : array_like, shape (m,)
        In the units of the inputs.

    Examples
    --------
    >>> OperatingPoint([30.0, 25.0], [45.0]).in_words(("level", "heat"), ("valve",))
    'level = 30, heat = 25 with valve = 45'
    """

    x: Float[np.ndarray, " n"]
    u: Float[np.ndarray, " m"]

    def __init__(self, x: ArrayLike, u: ArrayLike) -> None:
        object.__setattr__(self, "x", real_array("x", x, "(n,)", 1))
        object.__setattr__(self, "u", real_array("u", u, "(m,)", 1))
        self.__post_init__()

    def in_words(self, states: tuple[str, ...], inputs: tuple[str, ...]) -> str:
        """States and inputs by their names."""
        each = zip((*states, *inputs), (*self.x.tolist(), *self.u.tolist()), strict=True)
        said = [f"{name} = {value:.4g}" for name, value in each]
        return f"{', '.join(said[: self.x.size])} with {', '.join(said[self.x.size :])}"
