"""Distributions that a problem file names: those of scipy.stats, with their parameters."""

from __future__ import annotations

from typing import Any

from pydantic import ConfigDict, Field

from deadtime.base.errors import ArgumentError
from deadtime.problems.toml.sections import Section


class DistributionSection(Section):
    """A distribution of scipy.stats by its name there, with its parameters."""

    model_config = ConfigDict(extra="allow", strict=False, title=None)

    __pydantic_extra__: dict[str, float]  # pyright: ignore[reportIncompatibleVariableOverride]

    distribution: str = Field(description='Name in scipy.stats, such as "expon" or "gamma".')


def frozen(name: str, given: DistributionSection) -> Any:
    """The frozen scipy.stats distribution that a section names."""
    from scipy import stats

    kind = getattr(stats, given.distribution, None)
    if not isinstance(kind, stats.rv_continuous | stats.rv_discrete):
        raise ArgumentError(
            f"{name}: distribution must be the name of one in scipy.stats, such as expon, "
            f"gamma, weibull_min, uniform, got {given.distribution!r}."
        )
    try:
        return kind(**(given.model_extra or {}))
    except TypeError:
        shapes = kind.shapes.split(", ") if kind.shapes else []
        known = ", ".join([*shapes, "loc", "scale"])
        raise ArgumentError(
            f"{name}: {given.distribution} takes the parameters {known}, got "
            f"{sorted(given.model_extra or {})}."
        ) from None
