"""Families fitted to sojourns that are known to last between a shortest and a longest time.

Of a distribution with density f and survival P(S > t) only sojourns in (low, high] occur. With
whole sojourns t, and c those whose end was not seen, the likelihood is

    Π f(t)/m  Π (P(S > max(c, low)) − P(S > high))/m,    m = P(S > low) − P(S > high).

A fit that does not know of the limits takes the gap below `low`, and the missing tail beyond
`high`, for the shape of the distribution: the parameters are then those of another one. The maximum
is sought over the logarithms of the parameters, in units of the mean sojourn. There may be none:
sojourns that are spread evenly, or crowd towards `high`, are best described by an exponential of
endless scale.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.switching.models.families import FAMILIES, Observed, Parameters, estimate
from deadtime.switching.models.sojourns import Distribution
from deadtime.switching.models.truncation import Truncated

FAMILIES_BETWEEN = ("exponential", "gamma", "weibull", "lognormal")
FARTHEST = 8.0  # of the logarithm of a parameter: beyond, the likelihood has no maximum
EQUAL = 1e-9  # of a limit, by which a logged sojourn may miss it


def estimate_between(
    family: str, observed: Observed, low: float, high: float
) -> tuple[Distribution, Parameters, float] | None:
    """The fitted distribution, its parameters and its AIC; None where no fit exists.

    Parameters
    ----------
    family : str
        One of `FAMILIES_BETWEEN`, or "fixed".
    observed : Observed
        Sojourns of one mode, seconds.
    low, high : float
        The shortest and the longest sojourn, seconds; `high` may be inf.

    Examples
    --------
    >>> from scipy.stats import expon
    >>> t = 0.2 + expon.ppf((np.arange(400) + 0.5) / 400 * expon.cdf(1.0))  # scale 1, 0.2 to 1.2 s
    >>> _, parameters, _ = estimate_between("exponential", Observed(t, np.zeros(0)), 0.2, 1.2)
    >>> round(parameters["scale"], 2)
    1.0
    """
    if family == "fixed":
        return estimate(family, observed)
    from scipy import stats
    from scipy.optimize import minimize

    name, _ = FAMILIES[family]
    dist = getattr(stats, name)
    unit = float(observed.complete.mean())
    t, c = observed.complete / unit, np.maximum(observed.censored, low) / unit
    ends = np.array([low, high]) / unit

    def less_likely(logs: Float[np.ndarray, " parameter"]) -> float:
        if np.abs(logs).max() > FARTHEST:
            return np.inf
        *shape, scale = np.exp(logs)
        given = {"loc": 0.0, "scale": scale}
        mass = _log_between(dist, ends[:1], ends[1], shape, given)[0]
        seen = dist.logpdf(t, *shape, **given).sum() - t.size * mass
        cut = _log_between(dist, c, ends[1], shape, given).sum() - c.size * mass
        value = -float(seen + cut)
        return value if np.isfinite(value) else np.inf

    with np.errstate(all="ignore"):
        options = {"xatol": 1e-9, "fatol": 1e-11, "maxiter": 4000, "maxfev": 4000}
        found = [
            minimize(less_likely, start, method="Nelder-Mead", options=options)
            for start in _starts(family, observed, unit)
        ]
    best = min(found, key=lambda one: one.fun)
    if not np.isfinite(best.fun) or np.abs(best.x).max() > FARTHEST - 0.5:
        return None
    *shape, scale = np.exp(best.x).tolist()
    names = [*filter(None, (dist.shapes or "").split(", ")), "scale"]
    parameters = dict(zip(names, [*shape, scale * unit], strict=True))
    likelihood = -best.fun - t.size * np.log(unit)
    aic = 2.0 * len(parameters) - 2.0 * float(likelihood)
    return Truncated(dist(**parameters), low, high), parameters, aic


def require_between(mode: int, observed: Observed, low: float, high: float) -> None:
    """Refuse logs with a sojourn that cannot be."""
    shortest, longest = observed.complete[0], observed.complete[-1]
    longest = max(longest, observed.censored.max(initial=0.0))
    if shortest < low * (1.0 - EQUAL):
        raise ArgumentError(
            f"signals hold a sojourn of {shortest:g} s in mode {mode}, shorter than its dwell_time "
            f"of {low:g} s: lower dwell_time."
        )
    if longest > high * (1.0 + EQUAL):
        raise ArgumentError(
            f"signals hold a sojourn of {longest:g} s in mode {mode}, longer than its "
            f"maximum_dwell of {high:g} s: raise maximum_dwell."
        )


def require_family_between(name: str, family: str) -> None:
    """Refuse families whose ends are their parameters."""
    if family in ("shifted exponential", "uniform"):
        other = "'exponential'" if family == "shifted exponential" else "a distribution of your own"
        raise ArgumentError(
            f"{name} must not be {family!r} with dwell_time or maximum_dwell, which say where it "
            f"begins and ends: take {other}."
        )


def _starts(family: str, observed: Observed, unit: float) -> list[np.ndarray]:
    """Logarithms of parameters: those of the whole family, and others twice as wide."""
    plain = estimate(family, observed)
    count = 1 if family == "exponential" else 2
    values = np.ones(count) if plain is None else np.array(list(plain[1].values()))
    values[-1] /= 1.0 if plain is None else unit
    start = np.clip(np.log(values), 1.0 - FARTHEST, FARTHEST - 1.0)
    wide = start + np.log(2.0) * np.array([-1.0, 1.0])[-count:]
    return [start, wide]


def _log_between(
    dist: Any, low: Float[np.ndarray, " t"], high: float, shape: Any, given: dict[str, float]
) -> Float[np.ndarray, " t"]:
    """log P(low < S ≤ high), of the smaller of survival and distribution: neither cancels."""
    if np.isinf(high):
        return dist.logsf(low, *shape, **given)
    if dist.cdf(high, *shape, **given) < 0.5:
        large, small = dist.logcdf(high, *shape, **given), dist.logcdf(low, *shape, **given)
    else:
        large, small = dist.logsf(low, *shape, **given), dist.logsf(high, *shape, **given)
    return large + np.log(-np.expm1(np.minimum(small - large, 0.0)))
