"""Families of sojourn times that compare: all at least τ_d, all with mean 2 τ_d."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

TAIL = 2.5  # the Lomax distribution's shape: finite variance, infinite third moment

# Name: (what to say of it, how a problem file writes it for τ_d), in the order of maps.
FAMILIES: Mapping[str, tuple[str, Callable[[float], Any]]] = {
    "exponential": (
        "τ_d plus an exponential time of mean τ_d",
        lambda time: {"distribution": "expon", "loc": time, "scale": time},
    ),
    "uniform": (
        "uniform between τ_d and 3 τ_d",
        lambda time: {"distribution": "uniform", "loc": time, "scale": 2.0 * time},
    ),
    "heavy-tailed": (
        f"τ_d plus a Lomax (Pareto II) time of mean τ_d and shape {TAIL:g}, whose variance is "
        "finite, 5 times that of the exponential, and whose third moment is not",
        lambda time: {
            "distribution": "lomax",
            "c": TAIL,
            "loc": time,
            "scale": (TAIL - 1.0) * time,
        },
    ),
    "fixed": (
        "always 2 τ_d, so that with two modes the future is known",
        lambda time: 2.0 * time,
    ),
}


def sojourn_section(family: str, dwell_time: float) -> Any:
    """The sojourn times of a family at a dwell time, as [switching] of a problem file has them.

    Examples
    --------
    >>> sojourn_section("uniform", 0.4)
    {'distribution': 'uniform', 'loc': 0.4, 'scale': 0.8}
    >>> sojourn_section("fixed", 0.4)
    0.8
    """
    return FAMILIES[family][1](dwell_time)
