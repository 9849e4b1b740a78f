"""Families of sojourn distributions, fitted to complete and censored sojourns.

With complete sojourns t and right-censored ones c, the likelihood is Π f(t) Π P(S > c). Estimates
of an end of the support (shifted exponential, uniform) are corrected for their bias, which moves
them off the extreme observation, so that no observation has density 0. Akaike's criterion is that
of the corrected distribution: with the end at the extreme observation the likelihood gains about
twice the criterion's penalty of a parameter.

Sojourns may be known to lie in (low, high]. With f the density and P(S > t) the survival function
of the distribution before truncation, the likelihood is then

    Π f(t)/m  Π (P(S > max(c, low)) − P(S > high))/m,    m = P(S > low) − P(S > high).

A fit without the limits would attribute the gap below `low` and the missing tail beyond `high` to
the shape of the distribution. The maximum is searched over the logarithms of the parameters, in
units of the mean sojourn. It may not exist: for evenly spread sojourns, or more of them towards
`high`, the likelihood of an exponential increases with its scale without end.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.switching.models.sojourns import Distribution, Fixed, Truncated, log_between

Parameters = dict[str, float]
EQUAL = 1e-6  # relative difference up to which sojourns count as equal


@dataclass(frozen=True, eq=False)
class Observed(Frozen):
    """Logged sojourns in one mode, seconds.

    Attributes
    ----------
    complete : (complete,) array
        Sojourns with both ends in the log, in ascending order.
    censored : (censored,) array
        Observed parts of sojourns without an end in the log, in ascending order.
    """

    complete: Float[np.ndarray, " complete"]
    censored: Float[np.ndarray, " censored"]

    @property
    def fixed(self) -> bool:
        """Whether all are consistent with one length, within 1e-6."""
        longest = self.complete.max()
        least = max(longest - self.complete.min(), self.censored.max(initial=0.0) - longest)
        return bool(least <= EQUAL * longest)


@dataclass(frozen=True, repr=False)
class Goodness:
    """The goodness of fit of a family to the logged sojourns of one mode.

    Attributes
    ----------
    family : str
        Name of the family.
    parameters : dict
        Names of scipy.stats; lengths are in seconds.
    complete, censored : int
        Number of complete and of censored sojourns.
    distance : float
        Kolmogorov–Smirnov distance: the largest difference between the Kaplan–Meier estimate and
        the fitted distribution function, up to the longest observation.
    p_value : float
        Asymptotic probability of a larger distance if the family is correct, with `complete`
        sojourns and none censored. Too large if few are censored, because the parameters are
        fitted to the same sojourns: a small value refutes the family, a large one does not prove
        it. Too small if most are censored: below 0.05 for 9 to 13 % of correct families.
    aic : float
        Akaike's criterion of the fitted distribution, 2 · parameters − 2 log likelihood; the
        least is the best.

    References
    ----------
    Lilliefors, "On the Kolmogorov–Smirnov test for the exponential distribution with mean
    unknown", JASA 64, 1969, on the p-value of fitted distributions.
    """

    family: str
    parameters: Parameters
    complete: int
    censored: int
    distance: float
    p_value: float
    aic: float

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value:.4g}" for name, value in self.parameters.items())
        return (
            f"Goodness({self.family}, {values}; {self.complete} complete, {self.censored} "
            f"censored, distance={self.distance:.3f}, p_value={self.p_value:.2g}, "
            f"aic={self.aic:.1f})"
        )


def estimate(family: str, observed: Observed) -> tuple[Distribution, Parameters, float] | None:
    """The fitted distribution, its parameters and its AIC; None if no fit exists."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        if family == "fixed":
            length = float(np.median(observed.complete))
            return (Fixed(length), {"length": length}, -np.inf) if observed.fixed else None
        from scipy import stats

        name, fit = FAMILIES[family]
        parameters = fit(getattr(stats, name), observed)
        if not np.isfinite(list(parameters.values())).all() or not parameters["scale"] > 0.0:
            return None
        dist = getattr(stats, name)(**parameters)
        likelihood = dist.logpdf(observed.complete).sum() + dist.logsf(observed.censored).sum()
        if not np.isfinite(likelihood):
            return None
    return dist, parameters, 2.0 * len(parameters) - 2.0 * float(likelihood)


def _exponential(_: Any, observed: Observed) -> Parameters:
    """Scale = Σ(t + c)/n."""
    total = observed.complete.sum() + observed.censored.sum()
    return {"scale": float(total / observed.complete.size)}


def _shifted_exponential(_: Any, observed: Observed) -> Parameters:
    """The likelihood is largest at loc = min t, scale = Σ(t − loc)⁺/n.

    Without censoring n/(n − 1) times this scale and loc − scale/n are unbiased (Epstein and Sobel
    1954, theorem 4). The least of r sojourns that last beyond loc is on average scale/r longer, so
    loc decreases by that, with r = n + #{c > loc}, to 0 at least. Under censoring 4 to 14 % of its
    bias remain, with the other sign: expon(0.3, 0.5), 60 sojourns, 18 or 6 of them complete.
    """
    n, least = observed.complete.size, observed.complete[0]
    cut = observed.censored[observed.censored > least]
    scale = ((observed.complete - least).sum() + (cut - least).sum()) / (n - 1)
    loc = max(0.0, least - scale / (n + cut.size))
    return {"loc": float(loc), "scale": float(scale)}


def _uniform(_: Any, observed: Observed) -> Parameters:
    """The likelihood is largest at low = min t and the least high ≥ max t that satisfies

        Σ_{c > low} (c − low)/(high − c) ≤ n.

    Its left side decreases with `high`, so there is at most one root. If `high` is not the root, it
    is moved outwards by (max t − low)/(n − 1); then `low` by (high − low)/r, r = n + #{c > low}, to
    0 at least. Without censoring that is unbiased. Under censoring `low` remains nearly so, and
    `high` does not: for 60 uniform sojourns on 0.2..1 s it is 0.02 s too low, with a deviation of
    0.05 s, if 24 are complete (censored at exponential times of mean 0.6 s), and 0.03 s with 0.2 s
    if 10 are (censored at 0.2..0.45 s). n − 1 for n above, a correction of second order and a
    posterior mean are better in some of these cases and worse in others.
    """
    n, least, top = observed.complete.size, observed.complete[0], observed.complete[-1]
    cut = observed.censored[observed.censored > least]

    def excess(end: float) -> float:
        return float(((cut - least) / (end - cut)).sum()) - n

    if cut.size and (cut[-1] >= top or excess(top) > 0.0):
        from scipy.optimize import brentq

        first = max(top, cut[-1] + 0.5 * (cut[-1] - least) / (n + 1))
        last = 1.000001 * (cut[-1] + (cut - least).sum() / n)
        high = float(brentq(excess, first, last))  # pyright: ignore[reportArgumentType]
    else:
        high = float(top + (top - least) / (n - 1))
    low = max(0.0, least - (high - least) / (n + cut.size))
    return {"loc": float(low), "scale": float(high - low)}


def _by_scipy(family: Any, observed: Observed) -> Parameters:
    """SciPy's maximum, with the location fixed at 0 and times in units of their mean."""
    from scipy.stats import CensoredData, FitError

    unit = observed.complete.mean()  # SciPy's search has absolute tolerances
    complete, censored = observed.complete / unit, observed.censored / unit
    data = CensoredData(complete, right=censored) if censored.size else complete
    try:
        shape, _, scale = family.fit(data, floc=0.0)
    except (FitError, FloatingPointError, ValueError):
        return {"scale": np.nan}
    return {family.shapes: float(shape), "scale": float(scale * unit)}


Fit = Callable[[Any, Observed], Parameters]

FAMILIES: dict[str, tuple[str, Fit]] = {
    "exponential": ("expon", _exponential),
    "shifted exponential": ("expon", _shifted_exponential),
    "gamma": ("gamma", _by_scipy),
    "weibull": ("weibull_min", _by_scipy),
    "uniform": ("uniform", _uniform),
    "lognormal": ("lognorm", _by_scipy),
}


FAMILIES_BETWEEN = ("exponential", "gamma", "weibull", "lognormal")
FARTHEST = 8.0  # largest |logarithm| of a parameter: beyond, the likelihood has no maximum
_LEAST_LOG = -600.0  # least log P(low < S ≤ high) of a gamma: SciPy's underflows at −708
_MISSED = 1e-9  # relative error of a limit that a logged sojourn may have


class _Member(NamedTuple):
    """A SciPy family with parameters, as a frozen distribution, which takes far longer to make."""

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
    """The truncated distribution, its parameters and its AIC; None if no fit exists.

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
    # A sojourn that is censored at the longest time is complete: it cannot have lasted longer.
    ended = observed.censored >= high * (1.0 - _MISSED)
    t = np.append(observed.complete, observed.censored[ended]) / unit
    c = np.maximum(observed.censored[~ended], low) / unit
    ends = np.array([low, high]) / unit

    def less_likely(logs: Float[np.ndarray, " parameter"]) -> float:
        # Nelder–Mead may walk to infinity where the likelihood has no maximum.
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
    likelihood = -best.fun - t.size * np.log(unit)  # densities are per unit
    aic = 2.0 * len(parameters) - 2.0 * float(likelihood)
    fitted = dist(**parameters)
    if family == "gamma" and float(log_between(fitted, np.array(low), high)) < _LEAST_LOG:
        return None
    return Truncated(fitted, low, high), parameters, aic


def require_between(mode: int, observed: Observed, low: float, high: float) -> None:
    """Refuse logs with a sojourn outside the limits."""
    shortest, longest = observed.complete[0], observed.complete[-1]
    longest = max(longest, observed.censored.max(initial=0.0))
    if shortest < low * (1.0 - _MISSED):
        raise ArgumentError(
            f"signals hold a sojourn of {shortest:g} s in mode {mode}, shorter than its dwell_time "
            f"of {low:g} s: lower dwell_time."
        )
    if longest > high * (1.0 + _MISSED):
        raise ArgumentError(
            f"signals hold a sojourn of {longest:g} s in mode {mode}, longer than its "
            f"maximum_dwell of {high:g} s: raise maximum_dwell."
        )


def require_family_between(name: str, family: str) -> None:
    """Refuse families that have the limits as parameters."""
    if family in ("shifted exponential", "uniform"):
        other = "'exponential'" if family == "shifted exponential" else "a distribution of your own"
        raise ArgumentError(
            f"{name} must not be {family!r} with dwell_time or maximum_dwell, which are its "
            f"parameters: take {other}."
        )


def _starts(family: str, observed: Observed, unit: float) -> list[np.ndarray]:
    """Initial logarithms of parameters: of the fit without truncation, and for twice its width."""
    plain = estimate(family, observed)
    count = 1 if family == "exponential" else 2
    values = np.ones(count) if plain is None else np.array(list(plain[1].values()))
    values[-1] /= 1.0 if plain is None else unit
    start = np.clip(np.log(values), 1.0 - FARTHEST, FARTHEST - 1.0)  # inside, for the simplex
    wide = start + np.log(2.0) * np.array([-1.0, 1.0])[-count:]
    return [start, wide]
