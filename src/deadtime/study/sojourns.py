"""Families of sojourn times that compare: all at least τ_d, all with mean 2 τ_d."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from deadtime.switching.sojourns import Distribution

TAIL = 2.5  # the Lomax distribution's shape: finite variance, infinite third moment


def _exponential(dwell_time: float) -> Distribution:
    from scipy import stats

    return stats.expon(loc=dwell_time, scale=dwell_time)


def _uniform(dwell_time: float) -> Distribution:
    from scipy import stats

    return stats.uniform(loc=dwell_time, scale=2.0 * dwell_time)


def _heavy_tailed(dwell_time: float) -> Distribution:
    from scipy import stats

    return stats.lomax(TAIL, loc=dwell_time, scale=(TAIL - 1.0) * dwell_time)


def _fixed(dwell_time: float) -> float:
    return 2.0 * dwell_time


# Name: (what to say of it, how to make it from τ_d), in the order of maps.
FAMILIES: Mapping[str, tuple[str, Callable[[float], Any]]] = {
    "exponential": ("τ_d plus an exponential time of mean τ_d", _exponential),
    "uniform": ("uniform between τ_d and 3 τ_d", _uniform),
    "heavy-tailed": (
        f"τ_d plus a Lomax (Pareto II) time of mean τ_d and shape {TAIL:g}, whose variance is "
        "finite, 5 times that of the exponential, and whose third moment is not",
        _heavy_tailed,
    ),
    "fixed": ("always 2 τ_d, so that with two modes the future is known", _fixed),
}


def sojourn_of(family: str, dwell_time: float) -> Distribution | float:
    """The sojourn times of a family at a dwell time, as `SemiMarkov` takes them.

    Examples
    --------
    >>> [float(sojourn_of(name, 0.4).mean().round(12)) for name in list(FAMILIES)[:3]]
    [0.8, 0.8, 0.8]
    >>> sojourn_of("fixed", 0.4)
    0.8
    """
    return FAMILIES[family][1](dwell_time)
