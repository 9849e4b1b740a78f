"""Sojourns from uniform numbers, many at once: inverse survival functions, mode by mode.

A sojourn of mode i that is drawn with the number u in (0, 1) is the time that a sojourn exceeds
with probability u:

    P(S_i > t) = u,    t = a_i − b_i log u for a shifted exponential or a fixed sojourn (b_i = 0)

and what the distribution's own `isf` says otherwise, or `ppf` at 1 − u, or a search where it has
no formula for either.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.switching.models.sojourns import Distribution, Fixed, ShiftedExponential, log_survival


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
        """Those of one distribution per mode; each distinct one is asked once for all its modes."""
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
    if isinstance(dist, ShiftedExponential):
        return dist.loc, dist.scale
    family = type(getattr(dist, "dist", None))
    if family.__name__ != "expon_gen" or not family.__module__.startswith("scipy.stats"):
        return None
    given = dict(zip(("loc", "scale"), getattr(dist, "args", ()), strict=False))
    given |= getattr(dist, "kwds", {})
    return float(given.get("loc", 0.0)), float(given.get("scale", 1.0))


def _inverse(name: str, dist: Distribution) -> tuple[str, Callable]:
    """The inverse survival function of a distribution, and its name in messages."""
    isf, ppf = (getattr(dist, word, None) for word in ("isf", "ppf"))
    if _is_searched(dist) or not (callable(isf) or callable(ppf)):
        return f"{name}.sf", partial(_search, dist)
    if callable(isf):
        return f"{name}.isf", isf
    assert ppf is not None
    return f"{name}.ppf", lambda u: ppf(1.0 - u)  # exact for multiples of 2⁻⁵³


def _is_searched(dist: Distribution) -> bool:
    """Whether it is one of scipy's without a formula of its own, whose `isf` is slow.

    Scipy inverts their cdf by a root search for each number, some milliseconds long.

    Examples
    --------
    >>> from scipy.stats import foldnorm, gamma
    >>> _is_searched(gamma(2.0)), _is_searched(foldnorm(1.0))
    (False, True)
    """
    if not type(dist).__module__.startswith("scipy.stats"):
        return False
    from scipy.stats import rv_continuous

    family = getattr(dist, "dist", None)
    return isinstance(family, rv_continuous) and all(
        getattr(type(family), word) is getattr(rv_continuous, word) for word in ("_ppf", "_isf")
    )


def _search(dist: Distribution, u: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The least doubles that sojourns exceed with a probability of at most u, by bisection.

    Examples
    --------
    >>> _search(Fixed(0.3), np.array([0.2, 0.9]))
    array([0.3, 0.3])
    """
    level, most = np.log(u), np.ones(u.size)
    while (short := (log_survival(dist, most) > level) & (most < np.inf)).any():
        most[short] *= 2.0
    # Doubles ≥ 0 have the order of their bits read as integers.
    low, high = np.zeros(u.size, np.int64), most.view(np.int64)
    while (high - low > 1).any():
        middle = low + (high - low) // 2
        longer = log_survival(dist, middle.view(np.float64)) > level
        low, high = np.where(longer, middle, low), np.where(longer, high, middle)
    return high.view(np.float64)


def _invert(name: str, inverse: Callable, u: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    with np.errstate(all="ignore"):
        drawn = np.asarray(inverse(u), dtype=np.float64)
    if drawn.shape != u.shape:
        raise ArgumentError(f"{name} must return shape {u.shape} for that of u, got {drawn.shape}.")
    if not drawn.min(initial=0.0) >= 0.0:
        raise ArgumentError(f"{name} must return numbers ≥ 0, in s, got {drawn.min():g}.")
    return drawn
