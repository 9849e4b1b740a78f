"""The table of costs: each law against the oracle, as HTML that a screen reader can read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from deadtime.app.page_run import ProblemOutcome
from deadtime.app.style import dash_of
from deadtime.base.wording import compact
from deadtime.plant.weight import text_of
from deadtime.reports.figures.colours import Look, looks_of
from deadtime.simulation.tracking import TRACKING_ERROR

_HEAD = (
    "<table class='costs'><caption>{caption}, and against the oracle{more}</caption>"
    "<thead><tr><th scope='col'>law</th><th scope='col'>{word}</th><th scope='col'>× oracle</th>"
    "<th scope='col'>settles (s)</th><th scope='col'>max |x|</th></tr></thead><tbody>"
)
_BORDERS = {"solid": "solid", "dashed": "dashed", "dashdot": "dashed", "dotted": "dotted"}
CSS = """
.costs { border-collapse: collapse; width: 100%; font-size: 0.9rem; color: inherit; }
.costs caption { text-align: left; font-size: 0.85rem; padding-bottom: 4px; }
.costs th, .costs td { text-align: right; padding: 3px 5px; white-space: nowrap; }
.costs th:first-child, .costs td:first-child { text-align: left; white-space: normal; }
.costs tbody tr { border-top: 1px solid rgba(128, 128, 128, 0.35); }
.costs .swatch { display: inline-block; width: 18px; margin-right: 5px; vertical-align: middle;
                 border-top-width: 3px; }
.costs .why { text-align: left; white-space: normal; opacity: 0.85; }
"""


def table_of(outcome: ProblemOutcome, laws: Sequence[str]) -> str:
    """The table; `laws` are all on offer, which share the colours.

    Full figures are in the `data-` attributes of the rows.
    """
    looks = looks_of([*laws, *outcome.runs])
    rows = [_row(outcome, law, looks[law]) for law in outcome.runs]
    for law, why in outcome.reasons.items():
        rows.append(
            f"<tr><td>{escape(law)}</td><td class='why' colspan='4'>{escape(why)}</td></tr>"
        )
    more = ", on estimates of the same observer" if outcome.observed else ""
    caption, word = f"Cost {text_of(outcome.problem.weight)}", "cost"
    if outcome.measure == "iae":
        caption, word = f"Tracking error {TRACKING_ERROR} over the whole run", TRACKING_ERROR
    head = _HEAD.format(caption=caption, word=word, more=more)
    return f"{head}{''.join(rows)}</tbody></table>"


def _row(outcome: ProblemOutcome, law: str, look: Look) -> str:
    metrics, ratio = outcome.metrics[law], outcome.ratio(law)
    colour = look.colour
    swatch = f"<span class='swatch' style='border-top-style: {_BORDERS[dash_of(look.dash)]}; " + (
        f"border-top-color: {colour}'></span>"
    )
    grows = outcome.runs[law].diverged or (ratio is not None and math.isinf(ratio))
    bar = 0.0 if ratio is None else 100.0 if grows else _bar(ratio)
    shade = f"background: linear-gradient(to right, {colour}55 {bar:.0f}%, transparent {bar:.0f}%)"
    relative = "–" if ratio is None else "grows" if grows else f"{compact(ratio)}"
    settling = outcome.endings[law].settling
    settles = "no" if not math.isfinite(settling) else f"{settling:.2f}"
    return (
        f"<tr data-law='{escape(law, quote=True)}' data-cost='{metrics['cost']!r}' "
        f"data-peak='{metrics['peak']!r}'><td>{swatch}{escape(law)}</td>"
        f"<td>{compact(metrics[outcome.measure])}</td><td style='{shade}'>{relative}</td>"
        f"<td>{settles}</td><td>{compact(metrics['peak'])}</td></tr>"
    )


def _bar(ratio: float) -> float:
    """Per cent of a cell, growing with the logarithm of the ratio: all of it at 1,000."""
    return min(100.0, 100.0 * math.log10(max(ratio, 1.02)) / 3.0)
