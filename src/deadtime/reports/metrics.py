"""Metrics of runs for tables and JSON, and how well a reference is followed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from deadtime.base.json_records import plain, record
from deadtime.base.version import __version__
from deadtime.base.wording import compact
from deadtime.plant.discretisation import TOLERANCE
from deadtime.plant.weight import Weight, record_of, text_of
from deadtime.problems import Problem
from deadtime.problems.comparison import Comparison, ProblemRuns
from deadtime.simulation import Trajectory
from deadtime.simulation.outcome import events_of
from deadtime.simulation.tracking import TRACKING, TRACKING_ERROR

if TYPE_CHECKING:
    import xarray as xr


HEADINGS = ("law", "rise, s", "settling, s", "overshoot, %", "undershoot, %", "IAE", "steady error")
NEVER, SETTLES = "–", "settling, s"
LEGEND = f"{NEVER}: not settled within the time shown"
_NAMES = ("RiseTime", "SettlingTime", "Overshoot", "Undershoot", "IAE", "SteadyStateError")


def measure_title(measure: str, weight: Weight | None) -> str:
    """The heading of a table of the measure that ranks the laws, or of ∫|x|²."""
    if measure == "iae":
        return f"{TRACKING_ERROR} over the whole run"
    return f"Cost, {text_of(weight)}" if measure == "cost" else "∫|x|²"


def settling_text(time: float) -> str:
    """When a run settles, for tables; a dash where it does not."""
    return f"{time:.2f}" if math.isfinite(time) else NEVER


def heading_of(problem: Problem, output: int) -> str:
    """Which step the table of an output is about.

    Examples
    --------
    >>> import dataclasses, deadtime as dt
    >>> problem = dataclasses.replace(dt.problems.paper(), tracked=("angle (rad)",))
    >>> heading_of(problem, 0)
    'angle (rad) after the last step of its reference'
    """
    return f"{problem.tracked[output]} after the last step of its reference"


def tracking_of_runs(result: ProblemRuns) -> list[tuple[str, list[list[str]]]]:
    """For every tracked output a heading and a row for each law, of its last step.

    The window ends at the next event, which the heading of the first law's names.
    """
    problem, tables = result.problem, []
    for output in range(len(problem.tracked)):
        heading, rows = heading_of(problem, output), []
        for name, run in result.runs.items():
            if run.followed is None:
                continue
            since = run.followed.changes(run.end, output)[-1]
            until = _next_event(problem, run, since)
            info = run.step_info(output, until=until)
            if until is not None and not rows:
                event = "switch" if until in run.signal.times else "event"
                heading += f", at {since:g} s, until the next {event}, at {until:.4g} s"
            rows.append(_row(name, [info[key] for key in _NAMES]))
        tables.append((heading, rows))
    return tables


def _next_event(problem: Problem, run: Trajectory, since: float) -> float | None:
    """When something else happens than a step at a time; None where nothing does."""
    later = (t for t in events_of(run, problem.imperfections) if t > since + TOLERANCE * run.end)
    return next(later, None)


def rows_of_many(data: xr.Dataset, output: int) -> list[list[str]]:
    """The medians over scenarios, law by law."""
    return [
        _row(law, [_median(data[name].sel(law=law, output=output).values) for name in _NAMES])
        for law in data["law"].values.tolist()
    ]


def record_of_many(problem: Problem, data: xr.Dataset) -> dict[str, Any]:
    """The medians for JSON, by output and law; nothing where nothing is tracked."""
    if not problem.tracked:
        return {}
    rows = {
        name: {
            law: {key: _median(data[key].sel(law=law, output=i).values) for key in TRACKING}
            for law in data["law"].values.tolist()
        }
        for i, name in enumerate(problem.tracked)
    }
    return {"tracking": rows}


def record_of_run(problem: Problem, run: Trajectory) -> dict[str, Any]:
    """All steps of an output's own reference, by output; nothing where a run tracks nothing."""
    followed = run.followed
    if followed is None:
        return {}
    return {
        "tracking": {
            name: [
                {"since": since, "until": until, **run.step_info(i, since, until)}
                for since in followed.changes(run.end, i)
                for until in [_next_event(problem, run, since)]
            ]
            for i, name in enumerate(problem.tracked)
        }
    }


def _median(values: np.ndarray) -> float:
    """The lower median: ∞ counts as a value, NaN (no step in this scenario) does not."""
    # No interpolation: between a time and ∞ (never settled) it would be ∞.
    some = values[~np.isnan(values)]
    return float(np.sort(some)[(some.size - 1) // 2]) if some.size else math.nan


def _row(law: str, figures: Sequence[float]) -> list[str]:
    return [law, *map(_figure, figures)]


def _figure(value: float) -> str:
    """A figure with its sign; a time that never comes is a dash."""
    if not math.isfinite(value):
        return "no step" if math.isnan(value) else NEVER
    return f"−{compact(-value)}" if value < 0.0 else compact(value)


def metrics_of(result: Comparison) -> dict[str, Any]:
    """The figures of a comparison for JSON."""
    laws = {}
    for name, row in result.metrics.items():
        ending = result.outcomes[name]
        # A run settles where it comes to rest, which need not be 0.
        ends = {"outcome": ending.kind, "settling_time": ending.settling, "rest": ending.rest}
        run = result.runs[name]
        end = record(run, "diverged", "message")
        laws[name] = {**row, **ends, **end, **record_of_run(result.problem, run)}
    return plain({
        "problem": result.problem.name,
        "version": __version__,
        **record_of(result.problem.weight),
        "laws": laws,
        "growth_without_switching": dict(zip(result.problem.modes, result.growth, strict=True)),
    })  # fmt: skip
