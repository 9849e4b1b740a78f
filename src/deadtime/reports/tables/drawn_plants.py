"""On how many of the plants that an uncertain one may be every law is stable."""

from __future__ import annotations

from typing import Any

from deadtime.base.errors import DeadtimeError
from deadtime.base.wording import as_rate
from deadtime.margins import DrawnStability, drawn_stability
from deadtime.margins.drawn_plants import has_rates
from deadtime.problems import Problem

HEADINGS = ("law, each mode held", "stable on", "slowest, 1/s")


def drawn_of(problem: Problem, step: float, seed: int = 0) -> dict[str, DrawnStability]:
    """Of every law that has growth rates; nothing where the file has no [uncertainty]."""
    found: dict[str, DrawnStability] = {}
    for name, law in problem.laws.items():
        if problem.uncertain is None or not has_rates(law):
            continue
        try:
            found[name] = drawn_stability(problem.uncertain, law, step, seed=seed)
        except DeadtimeError:  # a law that has no rates at this period
            continue
    return found


def drawn_rows(drawn: dict[str, DrawnStability]) -> list[tuple[str, ...]]:
    """Rows of the table, columns as in `HEADINGS`."""
    return [
        (name, f"{one.stable} of {len(one.growth)}", as_rate(float(one.growth.max())))
        for name, one in drawn.items()
    ]


def drawn_record(drawn: dict[str, DrawnStability]) -> dict[str, Any]:
    """The same for JSON."""
    return {
        name: {
            "plants": len(one.growth),
            "stable": one.stable,
            "slowest": float(one.growth.max()),
        }
        for name, one in drawn.items()
    }
