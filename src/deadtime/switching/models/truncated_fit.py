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

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.switching.models.sojourn_families import FAMILIES, Observed, Parameters, estimate
from deadtime.switching.models.sojourns import Distribution
from deadtime.switching.models.truncation import Truncated, log_between

FAMILIES_BETWEEN = ("exponential", "gamma", "weibull", "lognormal")
FARTHEST = 8.0  # of the logarithm of a parameter: beyond, the likelihood has no maximum
LEAST = -600.0  # log P(S > low) of a gamma: SciPy takes it from P(S > low), which ends at e^−708
EQUAL = 1e-9  # of a limit, by which a logged sojourn may miss it


class _Member(NamedTuple):
    """A family of SciPy's at some parameters: what freezing it gives, which costs far more."""

    family: Any
    parameters: tuple[float, ...]

    def cdf(self, t: Any, /) -> Any:
        return self.family.cdf(t, *self.parameters)

    def logcdf(self, t: Any) -> Any:
        return self.family.logcdf(t, *self.parameters)

    def logsf(self, t: Any) -> Any:
        return self.family.logsf(t, *self.parameters)


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
    # One that was cut off at the longest time ended there: it cannot have lasted longer.
    ended = observed.censored >= high * (1.0 - EQUAL)
    t = np.append(observed.complete, observed.censored[ended]) / unit
    c = np.maximum(observed.censored[~ended], low) / unit
    ends = np.array([low, high]) / unit

    def less_likely(logs: Float[np.ndarray, " parameter"]) -> float:
        if np.abs(logs).max() > FARTHEST:
            return np.inf
        *shape, scale = np.exp(logs)
        member = _Member(dist, (*shape, 0.0, scale))
        mass = float(log_between(member, ends[0], ends[1]))
        seen = dist.logpdf(t, *member.parameters).sum() - t.size * mass
        cut = log_between(member, c, ends[1]).sum() - c.size * mass
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
    if family == "gamma" and float(log_between(dist(**parameters), np.array(low), high)) < LEAST:
        return None
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
