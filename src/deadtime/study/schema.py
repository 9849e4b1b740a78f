"""What a study file may say: the pydantic models behind it."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from deadtime.problem_file.imperfections import ImperfectionSection
from deadtime.problem_file.section import Section
from deadtime.study.sojourns import FAMILIES

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


def known(what: str, name: str, names: Sequence[str]) -> str:
    """The name, if it is one of the names; otherwise an error that proposes the nearest."""
    if name in names:
        return name
    near = difflib.get_close_matches(name, names, 1)
    advice = f"did you mean {near[0]!r}?" if near else f"it must be one of {', '.join(names)}"
    raise ValueError(f"{what} {name!r} is not known: {advice}")


def _family(name: str) -> str:
    return known("sojourn", name, tuple(FAMILIES))


def _listed(value: Any) -> Any:
    """One value as a list of one."""
    return value if isinstance(value, list) else [value]


def _distinct(values: list) -> list:
    """At least one value, and none twice."""
    if not values:
        raise ValueError("must hold at least one value: leave the key out for the default")
    for i, value in enumerate(values):
        if value in values[:i]:
            raise ValueError(f"holds {value!r} twice: list each value once")
    return values


List = (BeforeValidator(_listed), AfterValidator(_distinct))
Positives = Annotated[list[Positive], *List]


class GridSection(Section):
    """The axes of the grid: a list of values each, or a single one."""

    dwell_time: Positives = Field(description="τ_d: no sojourn is shorter, seconds.")
    distance: Annotated[list[NotNegative], *List] = Field(
        [1.0], description="α: the modes are α times as far from mode 0 as the problem's."
    )
    delay: Positives | None = Field(None, description="D, seconds; the problem's by default.")
    sojourn: Annotated[list[Annotated[str, AfterValidator(_family)]], *List] = Field(
        ["exponential"], description="Families of sojourn times, all of mean 2 τ_d."
    )
    step: Positives | None = Field(
        None, description="Sampling periods, seconds; the study's own by default."
    )


class StudyFile(Section):
    """A deadtime study."""

    title: str = ""
    problem: str = Field("paper", description="paper, three-mode, follower or a problem file.")
    poles: list[float | str] = Field(
        min_length=1, description='Closed-loop poles of every mode, 1/s; "-1+2j" is complex.'
    )
    laws: Annotated[list[str], AfterValidator(_distinct)] | None = Field(
        None, description="Laws to run, by name; the oracle always runs."
    )
    horizon: Positive | None = Field(None, description="Seconds; the problem's by default.")
    step: Positive | None = Field(None, description="Sampling period, s; the problem's by default.")
    scenarios: Annotated[int, Field(strict=True, ge=1)] = Field(
        200, description="Signals per cell of the grid."
    )
    seed: Annotated[int, Field(strict=True, ge=0)] = 0
    grid: GridSection
    imperfection: list[ImperfectionSection] = Field(
        [], description="Disturbances, sensors and actuators, after those of the problem."
    )
