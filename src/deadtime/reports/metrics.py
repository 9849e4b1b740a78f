"""The figures of a comparison, as reports and commands write them; nothing is drawn here."""

from __future__ import annotations

from typing import Any

from deadtime.base.json_records import plain, record
from deadtime.base.version import __version__
from deadtime.plant.weight import record_of
from deadtime.problems.comparison import Comparison
from deadtime.reports.tables.tracking import record_of_run


def metrics_of(result: Comparison) -> dict[str, Any]:
    """The figures of a comparison for JSON."""
    laws = {}
    for name, row in result.metrics.items():
        ending = result.outcomes[name]
        # A run settles where it comes to rest, which need not be 0.
        ends = {"outcome": ending.kind, "settling_time": ending.settling, "rest": ending.rest}
        run = result.runs[name]
        told = record(run, "diverged", "message")
        laws[name] = {**row, **ends, **told, **record_of_run(result.problem, run)}
    return plain({
        "problem": result.problem.name,
        "version": __version__,
        **record_of(result.problem.weight),
        "laws": laws,
        "growth_without_switching": dict(zip(result.problem.modes, result.growth, strict=True)),
    })  # fmt: skip
