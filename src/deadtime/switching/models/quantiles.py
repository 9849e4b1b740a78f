"""Sojourns from uniform numbers, many at once: inverse survival functions, mode by mode.

A sojourn of mode i that is drawn with the number u in (0, 1) is the time that a sojourn exceeds
with probability u:

    P(S_i > t) = u,    t = a_i − b_i log u for a shifted exponential or a fixed sojourn (b_i = 0)

and what the distribution's own `isf` says otherwise, or `ppf` at 1 − u.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.switching.models.sojourns import Distribution, Fixed, describe


def drawable(dist: Distribution) -> bool:
    """Whether a sojourn can be computed from one uniform number without a search.

    Examples
    --------
    >>> from scipy.stats import exponnorm, gamma
    >>> drawable(Fixed(0.5)), drawable(gamma(2.0)), drawable(exponnorm(2.0))
    (True, True, False)
    """
    if isinstance(dist, Fixed):
        return True
    if not any(callable(getattr(dist, word, None)) for word in ("isf", "ppf")):
        return False
    family = getattr(dist, "dist", None)
    if not type(dist).__module__.startswith("scipy.stats"):
        return True
    from scipy.stats import rv_continuous

    # Without a formula of its own, scipy inverts cdf by a root search for each number.
    searched = isinstance(family, rv_continuous) and all(
        getattr(type(family), word, None) is getattr(rv_continuous, word, None)
        for word in ("_ppf", "_isf")
    )
    return not searched


def require_drawable(sojourn: Sequence[Distribution]) -> None:
    """Refuse sojourns that cannot be computed from uniform numbers."""
    for i, dist in enumerate(sojourn):
        if not drawable(dist):
            raise ArgumentError(
                f"sojourn[{i}] must have an inverse survival function isf(u), or ppf(u), that "
                f"needs no root search, got {describe(dist)}: use model.sample(horizon, seed), or "
                "another distribution."
            )


@dataclass(frozen=True, eq=False)
class Quantiles(Frozen):
    """The inverse survival functions of all modes.

    Attributes
    ----------
    shift, scale : (mode,) arrays
        a_i and b_i, seconds, for modes with a formula; 0 for the others. An infinite scale is a
        mode that is never left.
    others : tuple of (name, function, modes)
        The other modes by distribution: its name in messages, its `isf`, and which modes have it.
    """

    shift: Float[np.ndarray, " mode"]
    scale: Float[np.ndarray, " mode"]
    others: tuple[tuple[str, Callable, np.ndarray], ...] = ()

    @classmethod
    def of(cls, sojourn: Sequence[Distribution]) -> Quantiles:
        """Those of one distribution per mode; each distinct one is asked once for all its modes.

        Raises
        ------
        ArgumentError
            If a distribution is not `drawable`.
        """
        require_drawable(sojourn)
        shift, scale = np.zeros(len(sojourn)), np.zeros(len(sojourn))
        others: dict[int, tuple[str, Callable, np.ndarray]] = {}
        for i, dist in enumerate(sojourn):
            formula = _formula(dist)
            if formula is not None:
                shift[i], scale[i] = formula
                continue
            new = np.zeros(len(sojourn), dtype=bool)
            others.setdefault(id(dist), (*_inverse(f"sojourn[{i}]", dist), new))[2][i] = True
        return cls(shift, scale, tuple(others.values()))

    def __call__(
        self, modes: Int[np.ndarray, "scenario jump"], u: Float[np.ndarray, "scenario jump"]
    ) -> Float[np.ndarray, "scenario jump"]:
        """The sojourns in `modes`, seconds, for the numbers u in (0, 1)."""
        if len(self.others) == 1 and self.others[0][2].all():
            name, inverse, _ = self.others[0]
            return _invert(name, inverse, u.ravel()).reshape(u.shape)
        result = np.log(u)
        result *= -self.scale[modes]
        result += self.shift[modes]
        for name, inverse, holds in self.others:
            here = holds[modes]
            if here.any():
                result[here] = _invert(name, inverse, u[here])
        return result


def _formula(dist: Distribution) -> tuple[float, float] | None:
    """(a, b) of t = a − b log u, where that is the inverse survival function."""
    if isinstance(dist, Fixed):
        return dist.length, 0.0
    family = type(getattr(dist, "dist", None))
    if family.__name__ != "expon_gen" or not family.__module__.startswith("scipy.stats"):
        return None
    given = dict(zip(("loc", "scale"), getattr(dist, "args", ()), strict=False))
    given |= getattr(dist, "kwds", {})
    return float(given.get("loc", 0.0)), float(given.get("scale", 1.0))


def _inverse(name: str, dist: Distribution) -> tuple[str, Callable]:
    """The inverse survival function of a distribution, and its name in messages."""
    if callable(isf := getattr(dist, "isf", None)):
        return f"{name}.isf", isf
    ppf = getattr(dist, "ppf")  # noqa: B009  # not in the protocol, as few need it
    return f"{name}.ppf", lambda u: ppf(1.0 - u)  # exact for multiples of 2⁻⁵³


def _invert(name: str, inverse: Callable, u: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    with np.errstate(all="ignore"):
        drawn = np.asarray(inverse(u), dtype=np.float64)
    if drawn.shape != u.shape:
        raise ArgumentError(f"{name} must return shape {u.shape} for that of u, got {drawn.shape}.")
    if not drawn.min(initial=0.0) >= 0.0:
        raise ArgumentError(f"{name} must return numbers ≥ 0, in s, got {drawn.min():g}.")
    return drawn
