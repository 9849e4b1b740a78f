"""Families of sojourn distributions, fitted by maximum likelihood to whole and cut-off sojourns.

With whole sojourns t and right-censored ones c, the likelihood is Π f(t) Π P(S > c). The
estimates of a start or an end of the support (shifted exponential, uniform) are corrected for
their bias, which moves them off the extreme observation, so that no observation has density 0;
Akaike's criterion is that of the uncorrected estimate, where the likelihood is largest.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.switching.sojourns import Distribution, Fixed

Parameters = dict[str, float]
EQUAL = 1e-6


@dataclass(frozen=True, eq=False)
class Observed:
    """What logs say about the sojourns in one mode, seconds.

    Attributes
    ----------
    complete : (complete,) array
        Sojourns seen from their beginning to their end, in ascending order.
    censored : (censored,) array
        How long the sojourns lasted whose end was not seen, in ascending order.
    """

    complete: Float[np.ndarray, " complete"]
    censored: Float[np.ndarray, " censored"]

    @property
    def fixed(self) -> bool:
        """Whether one length explains all of them, within 1e-6."""
        longest = self.complete.max()
        least = max(longest - self.complete.min(), self.censored.max(initial=0.0) - longest)
        return bool(least <= EQUAL * longest)


@dataclass(frozen=True, repr=False)
class Goodness:
    """How well a family fits the logged sojourns of one mode.

    Attributes
    ----------
    family : str
        Name of the family.
    parameters : dict
        What scipy.stats calls them; lengths are in seconds.
    complete, censored : int
        Number of sojourns seen to their end, and of those cut off by the end of a log.
    distance : float
        Kolmogorov and Smirnov's: the largest difference between the Kaplan–Meier estimate and
        the fitted distribution function, up to the longest observation.
    p_value : float
        Asymptotic probability of a larger distance if the family were right, as if there were
        `complete` sojourns and none cut off. Optimistic, because the parameters were fitted to
        the same sojourns: a small value refutes the family, a large one does not prove it.
    aic : float
        Akaike's criterion, 2 · parameters − 2 log likelihood; the least is the best.

    References
    ----------
    Lilliefors, "On the Kolmogorov–Smirnov test for the exponential distribution with mean
    unknown", JASA 64, 1969, on what fitting does to the p-value.
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
    """The fitted distribution, its parameters and its AIC; None where no fit exists."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        if family == "fixed":
            return _fixed(observed)
        from scipy import stats

        name, fit = FAMILIES[family]
        parameters, likelihood = fit(getattr(stats, name), observed)
        values = np.array([*parameters.values(), likelihood])
        if not np.isfinite(values).all() or not parameters["scale"] > 0.0:
            return None
        dist = getattr(stats, name)(**parameters)
    return dist, parameters, 2.0 * len(parameters) - 2.0 * likelihood


def _fixed(observed: Observed) -> tuple[Distribution, Parameters, float] | None:
    if not observed.fixed:
        return None
    length = float(np.median(observed.complete))
    return Fixed(length), {"length": length}, -np.inf


def _exponential(_: Any, observed: Observed) -> tuple[Parameters, float]:
    """Scale = Σ(t + c)/n."""
    n = observed.complete.size
    scale = (observed.complete.sum() + observed.censored.sum()) / n
    return {"scale": float(scale)}, float(-n * np.log(scale) - n)


def _shifted_exponential(_: Any, observed: Observed) -> tuple[Parameters, float]:
    """The likelihood is largest at loc = min t, scale = Σ(t − loc)⁺/n.

    Unbiased, when nothing is cut off, are n/(n − 1) times this scale and loc − scale/n (Epstein
    and Sobel 1954, theorem 4); loc stays ≥ 0.
    """
    n, loc = observed.complete.size, observed.complete[0]
    total = (observed.complete - loc).sum() + np.maximum(observed.censored - loc, 0.0).sum()
    likelihood = -n * np.log(total / n) - n
    scale = total / (n - 1)
    return {"loc": float(max(0.0, loc - scale / n)), "scale": float(scale)}, float(likelihood)


def _uniform(_: Any, observed: Observed) -> tuple[Parameters, float]:
    """The likelihood is largest at low = min t and the least high ≥ max t that satisfies

        Σ_{c > low} (c − low)/(high − c) ≤ n.

    Its left side falls with `high`: one root, at most. Unless it is the root, `high` is moved
    outwards by (max t − low)/(n − 1), as `low` always is, but not below 0: unbiased, when
    nothing is cut off.
    """
    n, low, top = observed.complete.size, observed.complete[0], observed.complete[-1]
    cut = observed.censored[observed.censored > low]

    def excess(end: float) -> float:
        return float(((cut - low) / (end - cut)).sum()) - n

    high, move = float(top), float(top - low) / (n - 1)
    if cut.size and (cut[-1] >= top or excess(top) > 0.0):
        from scipy.optimize import brentq

        least = max(top, cut[-1] + 0.5 * (cut[-1] - low) / (n + 1))
        most = 1.000001 * (cut[-1] + (cut - low).sum() / n)
        high = float(brentq(excess, least, most))  # pyright: ignore[reportArgumentType]
    likelihood = -n * np.log(high - low) + np.log((high - cut) / (high - low)).sum()
    high += move if high == top else 0.0
    low = max(0.0, low - move)
    return {"loc": float(low), "scale": float(high - low)}, float(likelihood)


def _by_scipy(family: Any, observed: Observed) -> tuple[Parameters, float]:
    """SciPy's maximum, with the origin held at 0 and times in units of their mean."""
    from scipy.stats import CensoredData, FitError

    unit = observed.complete.mean()
    complete, censored = observed.complete / unit, observed.censored / unit
    data = CensoredData(complete, right=censored) if censored.size else complete
    try:
        shape, _, scale = family.fit(data, floc=0.0)
    except (FitError, FloatingPointError, ValueError):
        return {"scale": np.nan}, np.nan
    parameters = {family.shapes: float(shape), "scale": float(scale * unit)}
    dist = family(**parameters)
    likelihood = dist.logpdf(observed.complete).sum() + dist.logsf(observed.censored).sum()
    return parameters, float(likelihood)


Fit = Callable[[Any, Observed], tuple[Parameters, float]]

FAMILIES: dict[str, tuple[str, Fit]] = {
    "exponential": ("expon", _exponential),
    "shifted exponential": ("expon", _shifted_exponential),
    "gamma": ("gamma", _by_scipy),
    "weibull": ("weibull_min", _by_scipy),
    "uniform": ("uniform", _uniform),
    "lognormal": ("lognorm", _by_scipy),
}
