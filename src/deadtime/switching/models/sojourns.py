"""Sojourn times in one mode: which distributions are accepted, and how they are read.

A distribution is anything with vectorised `cdf(t)`, and `sf(t)` or `logsf(t)`, such as those that
scipy.stats freezes. Times are in seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import positive
from deadtime.base.errors import ArgumentError


@runtime_checkable
class Distribution(Protocol):
    """What a sojourn's distribution must offer, beside `sf` or `logsf`."""

    def cdf(self, x: Any, /) -> Any:
        """P(S ≤ x)."""
        ...


@dataclass(frozen=True)
class Fixed:
    """A sojourn that always has the same length, in seconds."""

    length: float

    def cdf(self, t: ArrayLike) -> np.ndarray:
        """P(S ≤ t)."""
        return np.where(np.asarray(t) >= self.length, 1.0, 0.0)

    def sf(self, t: ArrayLike) -> np.ndarray:
        """P(S > t)."""
        return np.where(np.asarray(t) >= self.length, 0.0, 1.0)

    def logsf(self, t: ArrayLike) -> np.ndarray:
        """log P(S > t)."""
        return np.where(np.asarray(t) >= self.length, -np.inf, 0.0)

    def mean(self) -> float:
        """The length."""
        return self.length

    def __repr__(self) -> str:
        return f"{self.length:g}"


@dataclass(frozen=True)
class ShiftedExponential:
    """`scipy.stats.expon(loc, scale)`, of times above 0, without SciPy.

    Examples
    --------
    >>> from scipy.stats import expon
    >>> bool(np.isclose(ShiftedExponential(0.3, 0.5).cdf(0.7), expon(loc=0.3, scale=0.5).cdf(0.7)))
    True
    """

    loc: float
    scale: float

    def cdf(self, t: ArrayLike) -> np.ndarray:
        """P(S ≤ t)."""
        return np.asarray(-np.expm1(self.logsf(t)))

    def sf(self, t: ArrayLike) -> np.ndarray:
        """P(S > t)."""
        return np.asarray(np.exp(self.logsf(t)))

    def logsf(self, t: ArrayLike) -> np.ndarray:
        """log P(S > t)."""
        return np.asarray(
            np.minimum(0.0, (self.loc - np.asarray(t, dtype=np.float64)) / self.scale)
        )

    def mean(self) -> float:
        """The mean, seconds."""
        return self.loc + self.scale

    def __repr__(self) -> str:
        return f"expon(loc={_short(self.loc)}, scale={_short(self.scale)})"


def check_sojourn(name: str, value: object) -> Distribution:
    """A distribution of positive times; a number stands for a fixed sojourn."""
    if isinstance(value, (Real, np.number)) and not isinstance(value, bool):
        return Fixed(positive(name, value))
    if hasattr(value, "freeze"):
        kind = getattr(value, "name", None) or "distribution"
        shapes = [s.strip() for s in (getattr(value, "shapes", None) or "").split(",") if s]
        words = shapes if hasattr(value, "pmf") else [*shapes, "scale"]
        call = ", ".join(f"{word}=…" for word in words)
        raise ArgumentError(
            f"{name} must be a frozen distribution, got {kind} without its parameters: freeze "
            f"it: {kind}({call})."
            if words
            else f"{name} must be a frozen distribution, got one that is not: call it, …()."
        )
    usable = callable(getattr(value, "cdf", None))
    if not usable or not (hasattr(value, "sf") or hasattr(value, "logsf")):
        raise ArgumentError(
            f"{name} must be a positive number of seconds or a frozen scipy.stats distribution "
            f"(an object with cdf, and sf or logsf), got {type(value).__name__}."
        )
    dist: Distribution = value  # pyright: ignore[reportAssignmentType]
    at_zero = np.asarray(dist.cdf(0.0), dtype=np.float64)
    if at_zero.ndim:
        raise ArgumentError(
            f"{name} must be one distribution, got {describe(dist)}, an array of {at_zero.size}: "
            "give a list with one distribution per mode."
        )
    if np.isnan(at_zero):
        raise ArgumentError(
            f"{name} must have valid parameters, got {describe(dist)} with cdf(0) = nan."
        )
    if at_zero > 0.0:
        raise ArgumentError(
            f"{name} must be positive with probability 1, got {describe(dist)} with "
            f"P(sojourn ≤ 0) = {at_zero:.3g}: use a distribution on (0, ∞) such as gamma, "
            "weibull_min, lognorm or truncnorm."
        )
    return dist


def check_sojourns(sojourn: object, modes: int | None) -> tuple[Distribution, ...]:
    """One distribution per mode."""
    if not isinstance(sojourn, (list, tuple, np.ndarray)):
        return (check_sojourn("sojourn", sojourn),) * (modes or 2)
    if modes is not None and len(sojourn) != modes:
        raise ArgumentError(
            f"sojourn must have one entry per mode, {modes}, got {len(sojourn)}: a single "
            "distribution, not in a list, holds for all modes."
        )
    if len(sojourn) < 2:
        raise ArgumentError(
            f"sojourn must be given for at least two modes, got {len(sojourn)}: a signal that "
            "never switches is SwitchingSignal.constant(mode)."
        )
    return tuple(check_sojourn(f"sojourn[{i}]", value) for i, value in enumerate(sojourn))


def describe(dist: object) -> str:
    """A frozen scipy distribution as its call, such as ``gamma(a=2, scale=0.5)``.

    Examples
    --------
    >>> from scipy.stats import gamma
    >>> describe(gamma(2.0, scale=1 / 3)), describe(Fixed(0.5))
    ('gamma(2, scale=0.333)', '0.5')
    """
    family = getattr(getattr(dist, "dist", None), "name", None)
    if family is None:
        return repr(dist)
    words = [_short(value) for value in getattr(dist, "args", ())]
    words += [f"{key}={_short(value)}" for key, value in getattr(dist, "kwds", {}).items()]
    return f"{family}({', '.join(words)})"


def toml_text(dist: Any) -> str:
    """A sojourn as a problem file states it: seconds, or a distribution with its parameters.

    Examples
    --------
    >>> from scipy.stats import gamma
    >>> toml_text(gamma(2.0, scale=0.5)), toml_text(Fixed(0.5))
    ('{ distribution = "gamma", a = 2.0, scale = 0.5 }', '0.5')
    """
    if isinstance(dist, Fixed):
        return repr(float(dist.length))
    if isinstance(dist, ShiftedExponential):
        name, given = "expon", {"loc": dist.loc, "scale": dist.scale}
    elif isinstance(name := getattr(getattr(dist, "dist", None), "name", None), str):
        keys = [*filter(None, (dist.dist.shapes or "").split(", ")), "loc", "scale"]
        given = dict(zip(keys, dist.args, strict=False)) | dist.kwds
    else:
        raise ArgumentError(
            f"sojourn {describe(dist)} has no name in scipy.stats, so no problem file can state "
            "it: take a frozen distribution of scipy.stats."
        )
    words = "".join(f", {key} = {float(value)!r}" for key, value in given.items())
    return f'{{ distribution = "{name}"{words} }}'


def _short(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, (Real, np.number)) else str(value)


def log_survival(dist: Distribution, t: Float[np.ndarray, ...]) -> Float[np.ndarray, ...]:
    """log P(S > t)."""
    with np.errstate(all="ignore"):
        if hasattr(dist, "logsf"):
            return np.asarray(dist.logsf(t), dtype=np.float64)  # pyright: ignore
        return np.log(np.asarray(dist.sf(t), dtype=np.float64))  # pyright: ignore


def survival(dist: Distribution, t: float) -> float:
    """P(S > t)."""
    return float(np.exp(log_survival(dist, np.array(t))))


def mean_sojourn(dist: Distribution) -> float:
    """E[S] = ∫₀^∞ P(S > t) dt, seconds."""
    if hasattr(dist, "mean"):
        return float(dist.mean())  # pyright: ignore[reportAttributeAccessIssue]
    from scipy.integrate import quad

    return float(quad(lambda t: survival(dist, t), 0.0, np.inf, limit=200)[0])
