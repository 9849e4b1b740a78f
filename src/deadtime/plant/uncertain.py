"""A plant with the covariance of its parameters, such as an identified one, and its ellipsoid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import (
    correlations,
    count as whole_number,
    instance,
    read_only,
    real_array,
    require_semidefinite,
    share,
)
from deadtime.base.errors import ArgumentError
from deadtime.plant.plant_set import PlantSet, PlantUncertainty, Polytope
from deadtime.plant.switched_system import SwitchedSystem

_SHORTEST = 1e-3  # of the most likely delay: no random plant has a shorter one
_OUTWARD = 1.0 + 1e-9  # so that rounding excludes no plant
_DIGITS = 1e-6  # error of a correlation that the digits of a file may cause
_ROUNDED = 1e-10  # relative round-off of an ellipsoid's axes


@dataclass(frozen=True, eq=False)
class Ellipsoid(PlantSet):
    """The plants [A B] + Σ z_i axes_i with |z| ≤ 1 about the one vertex (immutable).

    `axes` (d, modes, n, n + m) are the half axes, d ≥ 1.
    """

    kind: ClassVar[str] = "ellipsoid"
    keys: ClassVar[tuple[str, ...]] = ("axes",)
    products: ClassVar[int] = 30

    axes: Float[np.ndarray, "d mode n nm"]

    @property
    def directions(self) -> Float[np.ndarray, "d mode n nm"]:
        return self.axes

    @property
    def in_words(self) -> tuple[str, str]:
        return (
            f"any plant in the ellipsoid about the given one, of {len(self.axes)} half axes in the "
            "entries of A and B (constant within each period)"
        ), f"an ellipsoid of {len(self.axes)} axes"

    def with_inputs(self, count: int) -> Ellipsoid:
        n = self.A.shape[2]
        return replace(self, B=self.B[..., :count], axes=self.axes[..., : n + count])

    def misfit(self) -> str:
        fits = len(self.A) == 1 and self.axes.ndim == 4 and len(self.axes)
        return "" if fits else "axes are those of several vertices, or none"

    def covers(self, other: PlantSet) -> bool:
        have, want = (axes.reshape(len(axes), -1) for axes in (self.axes, other.directions))
        unit = np.abs(have).max(axis=0)
        if want[:, unit == 0.0].any():
            return False
        have, want = have[:, unit > 0.0] / unit[unit > 0.0], want[:, unit > 0.0] / unit[unit > 0.0]
        # Axes `want` = part · have lie in the ellipsoid of `have` if and only if |part|₂ ≤ 1.
        part = want @ np.linalg.pinv(have, rcond=_ROUNDED)
        near = bool(np.abs(want - part @ have).max() <= _ROUNDED)
        return near and bool(np.linalg.norm(part, 2) <= 1.0 + 0.5e-9)


@dataclass(frozen=True, eq=False, init=False, repr=False)
class UncertainPlant(PlantUncertainty):
    r"""A plant with the covariance of its matrices and delays (immutable).

    The parameters :math:`\theta` are normally distributed about those of `plant`: the entries of
    :math:`A_0`, row by row, of :math:`A_1, \dots`, then of :math:`B_0, \dots`, then the delays, one
    per input, or mode by mode if the modes have different delays.

    Parameters
    ----------
    plant : SwitchedSystem
        The most likely plant.
    covariance : array_like, shape (size, size)
        Covariance of :math:`\theta`, symmetric and positive semidefinite.

    Raises
    ------
    ArgumentError
        If the covariance has another size, or is not symmetric and positive semidefinite.

    Examples
    --------
    >>> import deadtime as dt, numpy as np
    >>> plant = dt.SwitchedSystem([[[-1.0]]], [[[2.0]]], delay=0.3)
    >>> known = dt.UncertainPlant(plant, np.diag([0.1, 0.1, 0.01]) ** 2)
    >>> len(known.draw(50)), known.axes().shape
    (50, (2, 1, 1, 2))
    """

    in_words: ClassVar[tuple[str, str]] = "in their ellipsoid of 95 %", "intervals of 95 %"
    file_keys: ClassVar[dict[str, tuple[str, Any, str]]] = {
        "covariance": (
            "(size, size)",
            [[1e-4]],
            "Of all entries of A, row by row and mode by mode, then of B, then of the delays, one "
            "per input, or mode by mode where each has its own.",
        )
    }

    plant: SwitchedSystem
    covariance: Float[np.ndarray, "size size"]

    def __init__(self, plant: SwitchedSystem, covariance: ArrayLike) -> None:
        instance("plant", plant, SwitchedSystem)
        given = real_array("covariance", covariance, "(size, size)", 2)
        entries = plant.A.size + plant.B.size
        sizes = sorted({entries + plant.inputs, entries + plant.delays.size})
        if given.shape not in [(size, size) for size in sizes]:
            raise ArgumentError(
                f"covariance must have as many rows and columns as A, B and the delays have "
                f"entries, {' or '.join(map(str, sizes))}, got {given.shape}."
            )
        given = require_semidefinite("covariance", given, _DIGITS)
        if given.shape[0] == sizes[0] < sizes[-1] and (plant.delays[0] != plant.delays).any():
            raise ArgumentError(
                f"covariance must have {sizes[-1]} rows and columns, one of every mode's delays, "
                f"for modes have delays of their own; got {given.shape}."
            )
        vars(self).update(plant=plant, covariance=read_only(given))

    def draw(self, count: int, seed: int = 0) -> tuple[SwitchedSystem, ...]:
        """Random plants; delays are at least 0.001 of the most likely ones.

        Parameters
        ----------
        count : int
            Number of plants.
        seed : int
            Seed of the random numbers.

        Returns
        -------
        tuple of SwitchedSystem
        """
        how_many = whole_number("count", count)
        rng = np.random.default_rng(whole_number("seed", seed, least=0))
        root = _root(self.covariance)
        z = rng.standard_normal((how_many, root.shape[1]))
        return tuple(self._at(shift) for shift in z @ root.T)

    def axes(self, level: float = 0.95) -> Float[np.ndarray, "d mode n nm"]:
        r"""Half axes of the confidence ellipsoid of A and B.

        With probability `level`, :math:`A` and :math:`B` lie in

        .. math::

            \Big\{ [\hat A\ \hat B] + \sum_i z_i\, \text{axes}_i : |z| \le 1 \Big\}
            = \big\{ \theta :
            (\theta - \hat\theta)^T \Sigma^{-1} (\theta - \hat\theta) \le r^2 \big\}

        with :math:`\Sigma` their covariance and :math:`r^2` the quantile of :math:`\chi^2` with
        :math:`d = \text{rank}\, \Sigma` degrees of freedom. `certify` proves a loop stable for all
        plants in it.

        Parameters
        ----------
        level : float
            Confidence level, between 0 and 1.

        Returns
        -------
        (d, modes, n, n + m) array
            The half axes as changes of [A B].

        Examples
        --------
        >>> import deadtime as dt, numpy as np
        >>> plant = dt.SwitchedSystem([[[-1.0]]], [[[2.0]]], delay=0.3)
        >>> dt.UncertainPlant(plant, np.diag([0.1, 0.2, 0.01]) ** 2).axes().shape
        (2, 1, 1, 2)
        """
        from scipy.stats import chi2

        plant, n, m = self.plant, self.plant.states, self.plant.inputs
        level, entries = share("level", level), plant.A.size + plant.B.size
        arms = _root(self.covariance[:entries, :entries]).T
        arms *= float(np.sqrt(chi2.ppf(level, max(len(arms), 1))))
        of_A, of_B = np.split(arms * _OUTWARD, [plant.A.size], axis=1)
        parts = of_A.reshape(-1, plant.modes, n, n), of_B.reshape(-1, plant.modes, n, m)
        return np.concatenate(parts, axis=3)

    def plant_set(self, level: float = 0.95) -> PlantSet:
        """The confidence ellipsoid of A and B; only `plant` if they are certain.

        Parameters
        ----------
        level : float
            Confidence level, between 0 and 1.

        Returns
        -------
        PlantSet
            An ellipsoid with the half axes `axes`, or a polytope of one plant.
        """
        axes, centre = self.axes(level), Polytope.of([self.plant])
        return Ellipsoid(centre.A, centre.B, axes) if len(axes) else centre

    def delay_range(self, level: float = 0.95) -> tuple[Any, Any] | None:
        """The confidence interval of each delay.

        Parameters
        ----------
        level : float
            Confidence level of each interval, between 0 and 1.

        Returns
        -------
        (low, high) or None
            Seconds, as `certify` takes them: two numbers for a plant with one delay, else two
            (modes, m) arrays. None if the delays are certain.
        """
        from scipy.stats import norm

        plant, entries = self.plant, self.plant.A.size + self.plant.B.size
        errors = np.sqrt(np.diagonal(self.covariance)[entries:])
        if not errors.any():
            return None
        half = float(norm.ppf(0.5 + 0.5 * share("level", level))) * errors * _OUTWARD
        half = np.broadcast_to(half.reshape(-1, plant.inputs), plant.delays.shape)
        low = np.maximum(plant.delays - half, _SHORTEST * plant.delays)
        high = plant.delays + half
        # Equal delays with errors of their own have different intervals.
        if plant.has_one_delay and len(errors) == 1:
            return float(low[0, 0]), float(high[0, 0])
        return low, high

    def _at(self, shift: np.ndarray) -> SwitchedSystem:
        """The plant with the parameters θ̂ + shift."""
        plant = self.plant
        of_A, of_B, of_D = np.split(shift, [plant.A.size, plant.A.size + plant.B.size])
        delays = plant.delays + of_D.reshape(-1, plant.inputs)
        return plant.like(
            plant.A + of_A.reshape(plant.A.shape),
            plant.B + of_B.reshape(plant.B.shape),
            np.maximum(delays, _SHORTEST * plant.delays),
        )

    def __repr__(self) -> str:
        return f"UncertainPlant({self.plant!r}, {len(self.covariance)} entries)"


def _root(covariance: np.ndarray) -> Float[np.ndarray, "size d"]:
    """L of Σ = L Lᵀ, a column per uncertain direction."""
    # Of the correlations, so that the rank does not depend on the units of the parameters.
    values, vectors = np.linalg.eigh(correlations(covariance))
    uncertain = values > len(values) * np.finfo(float).eps
    unit = np.sqrt(np.diagonal(covariance))
    return unit[:, None] * vectors[:, uncertain] * np.sqrt(values[uncertain])
