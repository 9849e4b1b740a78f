"""Distributions of sojourn times, seconds.

A distribution is an object with vectorised `cdf(t)`, and `sf(t)` or `logsf(t)`, such as a frozen
distribution of scipy.stats. It may be truncated to an interval.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from numbers import Real
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import positive
from deadtime.base.errors import ArgumentError


@runtime_checkable
class Distribution(Protocol):
    """The interface of a sojourn distribution, which has `sf` or `logsf`, too."""

    def cdf(self, x: Any, /) -> Any:
        """P(S ≤ x)."""
        ...


@dataclass(frozen=True)
class Fixed:
    """A sojourn of constant length, seconds."""

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
    """`scipy.stats.expon(loc, scale)` for times above 0, without importing SciPy.

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


def in_words(dist: Distribution) -> str:
    """A distribution of sojourns in words, with its mean.

    Examples
    --------
    >>> from scipy.stats import gamma
    >>> in_words(ShiftedExponential(0.2, 0.3)), in_words(gamma(2.0)), in_words(Fixed(0.5))
    ('0.2 s plus exponential, mean 0.5 s', 'gamma, mean 2 s', '0.5 s')
    """
    if isinstance(dist, Fixed):
        return f"{dist.length:g} s"
    family = getattr(getattr(dist, "dist", None), "name", "") or describe(dist)
    shift = 0.0
    if isinstance(dist, ShiftedExponential):
        family, shift = "expon", dist.loc
    elif parse := getattr(getattr(dist, "dist", None), "_parse_args", None):
        _, shift, _ = parse(*getattr(dist, "args", ()), **getattr(dist, "kwds", {}))
    family = {"expon": "exponential", "weibull_min": "Weibull", "lognorm": "log-normal"}.get(
        family, family
    )
    return f"{f'{shift:g} s plus ' if shift else ''}{family}, mean {mean_sojourn(dist):.3g} s"


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
    """A sojourn in a problem file: seconds, or a distribution with its parameters.

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


SHORTEST = 1e-9  # seconds: stands for no dwell time in files, where dwell times are positive
ROUND_OFF = 1e-12  # relative difference of a multiple of a period from a limit


@dataclass(frozen=True)
class Truncated:
    """A distribution of sojourns, truncated to (low, high] seconds.

        P(S > t | low < S ≤ high) = P(t < S ≤ high)/P(low < S ≤ high)

    Both are computed as logarithms, as they underflow if `low` is far in the tail.

    Examples
    --------
    >>> from scipy.stats import expon
    >>> short = Truncated(expon(scale=0.5), 0.2, 1.0)
    >>> short.sf([0.1, 0.2, 1.0]).tolist(), short.cdf(0.1).item()
    ([1.0, 1.0, 0.0], 0.0)
    """

    dist: Distribution
    low: float
    high: float
    _mass: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        mass = log_between(self.dist, np.array(self.low), self.high)
        object.__setattr__(self, "_mass", float(mass))

    def sf(self, t: ArrayLike) -> np.ndarray:
        """P(S > t)."""
        return np.asarray(np.exp(self.logsf(t)))

    def cdf(self, t: ArrayLike) -> np.ndarray:
        """P(S ≤ t)."""
        return np.asarray(0.0 - np.expm1(self.logsf(t)))

    def logsf(self, t: ArrayLike) -> np.ndarray:
        """log P(S > t)."""
        t = np.asarray(t, dtype=np.float64)
        rest = log_between(self.dist, np.clip(t, self.low, self.high), self.high) - self._mass
        early, over = t <= self.low * (1.0 + ROUND_OFF), t >= self.high * (1.0 - ROUND_OFF)
        return np.where(early, 0.0, np.where(over, -np.inf, np.minimum(rest, 0.0)))

    def mean(self) -> float:
        """E[S] = low + ∫ P(S > t) dt from low to high, seconds."""
        from scipy.integrate import quad

        return self.low + float(
            quad(lambda t: float(self.sf(t)), self.low, self.high, limit=200)[0]
        )

    def __repr__(self) -> str:
        return f"{describe(self.dist)} in [{self.low:g}, {self.high:g}] s"


def log_between(
    dist: Distribution, low: Float[np.ndarray, ...], high: float
) -> Float[np.ndarray, ...]:
    """log P(low < S ≤ high) as a difference of the smaller of P(S > t) and P(S ≤ t).

    The larger one would cancel.

    Examples
    --------
    >>> from scipy.stats import expon
    >>> log_between(expon(scale=0.01), np.array([10.0, 20.0]), np.inf).round(6).tolist()
    [-1000.0, -2000.0]
    """
    if np.isinf(high):
        return log_survival(dist, low)
    with np.errstate(all="ignore"):
        below = float(dist.cdf(high)) < 0.5
        logs = _log_distribution if below else log_survival
        one, other = logs(dist, low), logs(dist, np.array(high))
        large, small = (other, one) if below else (one, other)
        return large + np.log(-np.expm1(np.minimum(small - large, 0.0)))


def _log_distribution(dist: Distribution, t: Float[np.ndarray, ...]) -> Float[np.ndarray, ...]:
    logcdf: Any = getattr(dist, "logcdf", None)
    return np.asarray(np.log(dist.cdf(t)) if logcdf is None else logcdf(t), dtype=np.float64)


def truncate(name: str, dist: Distribution, low: float, high: float) -> Distribution:
    """The distribution truncated to an interval, unchanged if it lies in there.

    Raises
    ------
    ArgumentError
        If no sojourn lies in the interval.
    """
    if isinstance(dist, Fixed):
        if not low * (1.0 - 1e-9) <= dist.length <= high * (1.0 + 1e-9):
            raise _none(name, dist, low, high)
        return dist
    start = survival(dist, low)
    stop = 0.0 if np.isinf(high) else survival(dist, high)
    if not np.isfinite(log_between(dist, np.array(low), high)):
        raise _none(name, dist, low, high)
    return dist if start == 1.0 and stop == 0.0 else Truncated(dist, low, high)


def limits(dist: Distribution) -> tuple[float, float]:
    """The shortest and the longest sojourn that a problem file can state."""
    if isinstance(dist, Truncated):
        return max(dist.low, SHORTEST), dist.high
    return (dist.length, dist.length) if isinstance(dist, Fixed) else (SHORTEST, np.inf)


def _none(name: str, dist: Distribution, low: float, high: float) -> ArgumentError:
    return ArgumentError(
        f"{name} = {describe(dist)} has no sojourn between dwell_time = {low:g} s and "
        f"maximum_dwell = {high:g} s: change one of them."
    )
