"""The schema of a study file: the pydantic models behind it."""

from __future__ import annotations

import difflib
from collections.abc import Hashable, Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, create_model

from deadtime.problems.file.schema import CostSection, ImperfectionEntry
from deadtime.problems.imperfection_registry import SWEPT, ImperfectionAxis
from deadtime.problems.toml.sections import Count, First, NotNegative, Poles, Section
from deadtime.scenarios.dataset import METRICS
from deadtime.scenarios.sweeps.axes import FAMILIES

MOST_VALUES = 5000  # of an axis

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
AboveMinusOne = Annotated[float, Field(gt=-1.0, allow_inf_nan=False)]


def require_known(what: str, name: str, names: Sequence[str]) -> str:
    """The name, if it is one of the names; otherwise an error that proposes the nearest."""
    if name in names:
        return name
    near = difflib.get_close_matches(name, names, 1)
    advice = f"did you mean {near[0]!r}?" if near else f"it must be one of {', '.join(names)}"
    raise ValueError(f"{what} {name!r} is not known: {advice}")


def _family(name: str) -> str:
    return require_known("sojourn", name, tuple(FAMILIES))


def _metric(name: str) -> str:
    return require_known("metric", name, tuple(METRICS))


def _as_list(value: Any) -> Any:
    """One value as a list of one."""
    return value if isinstance(value, list) else [value]


def distinct(values: list) -> list:
    """At least one value, and none twice."""
    if not values:
        raise ValueError("must hold at least one value: leave the key out for the default")
    if len(values) > MOST_VALUES:
        raise ValueError(f"holds more than {MOST_VALUES:,} values: list fewer")
    seen: set[Hashable] = set()
    for value in values:
        same = value if isinstance(value, Hashable) else repr(value)
        if same in seen:
            raise ValueError(f"holds {value!r:.80} twice: list each value once")
        seen.add(same)
    return values


List = (First(), BeforeValidator(_as_list), AfterValidator(distinct))
Positives = Annotated[list[Positive], *List]
NotNegatives = Annotated[list[NotNegative], *List]
Errors = Annotated[list[AboveMinusOne], *List]
Counts = Annotated[list[Count], *List]
Families = Annotated[list[Annotated[str, AfterValidator(_family)]], *List]
Metrics = Annotated[list[Annotated[str, AfterValidator(_metric)]], *List]


class _PlainAxes(Section):
    """Axes other than imperfections."""

    model_config = ConfigDict(extra="allow", strict=False, title=None)

    distance: NotNegatives | None = Field(
        None, description="α: the modes are α times as far from mode 0 as the problem's."
    )
    delay: Positives | None = Field(None, description="D, seconds.")
    speed: Positives | None = Field(None, description="Poles are moved from 0 by this factor.")
    step: Positives | None = Field(None, description="Sampling periods, seconds.")
    horizon: Positives | None = Field(None, description="Length of a run, seconds.")
    start: Positives | None = Field(None, description="x(0) is the problem's times this.")
    delay_error: Errors | None = Field(
        None, description="The true delay is 1 + this times the delay that laws assume."
    )
    gain_error: Errors | None = Field(
        None, description="The true B is 1 + this times the B that laws assume."
    )
    sojourn: Families | None = Field(None, description="Families of sojourns, of mean 2 τ_d.")
    dwell_time: Positives | None = Field(None, description="τ_d: no sojourn is shorter, seconds.")


def _axis(axis: ImperfectionAxis) -> tuple[Any, Any]:
    """The field of an imperfection: its type, and the description that editors show."""
    values: Any = Annotated[list[axis.values], *List]
    return values | None, Field(None, description=axis.description)


_IMPERFECT: dict[str, Any] = {name: _axis(swept.axis) for name, swept in SWEPT.items()}
_ImperfectionAxes: Any = create_model("_ImperfectionAxes", __base__=_PlainAxes, **_IMPERFECT)


class GridSection(_ImperfectionAxes):
    """The axes of the grid: a list of values each, or a single one.

    Beside these, paths into the problem file, such as law.averaged.low_pass.
    """

    seed: Counts | None = Field(None, description="Seeds of the signals, instead of the study's.")


class StudyFile(Section):
    """A deadtime study."""

    title: str = ""
    problem: str = Field("paper", description="paper, three-mode, follower or a problem file.")
    poles: Poles | None = Field(
        None,
        min_length=1,
        description='Closed-loop poles of every mode, 1/s; "-1+2j" is complex. Gains are placed in '
        "every cell, and the laws of the study run; without, the problem's own gains and laws.",
    )
    laws: Annotated[list[str], AfterValidator(distinct)] | None = Field(
        None, description="Laws to run, by name; with poles, the oracle always runs."
    )
    horizon: Positive | None = Field(None, description="Seconds; the problem's by default.")
    step: Positive | None = Field(None, description="Sampling period, s; the problem's by default.")
    scenarios: Annotated[int, Field(strict=True, ge=1)] = Field(
        200, description="Signals per cell of the grid."
    )
    seed: Annotated[int, Field(strict=True, ge=0)] = 0
    metrics: Metrics = Field(list(METRICS), description="What to keep of every run.")
    grid: GridSection
    cost: CostSection | None = Field(
        None, description="What laws are compared by, instead of the problem's [cost]."
    )
    imperfection: list[ImperfectionEntry] = Field(
        [], description="Disturbances, sensors and actuators, after those of the problem."
    )
