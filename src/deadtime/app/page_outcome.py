"""The outcome of a problem on a page: a run of every chosen law, costs as HTML, samples as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from deadtime.app.draft_facts import longest_delay, shortest_delay
from deadtime.base.errors import ArgumentError, DeadtimeError
from deadtime.base.wording import compact
from deadtime.estimation import OutputFeedback
from deadtime.feedback import Law
from deadtime.laws import ExactPredictor
from deadtime.problems import Problem
from deadtime.problems.comparison import ending
from deadtime.problems.file.load import build_what_can
from deadtime.problems.law_registry import QUICK
from deadtime.problems.unit_checks import unit_checks_of
from deadtime.reports.figures.colours import Look, looks_of
from deadtime.reports.metrics import measure_title
from deadtime.simulation import Trajectory
from deadtime.simulation.outcome import Outcome as Ending, why_untested
from deadtime.simulation.tracking import TRACKING_ERROR, measure_of
from deadtime.simulation.trajectory import numbered_columns
from deadtime.switching import SwitchingSignal

DASHES = ("solid", "dashed", "dashdot", "dotted")


def dash_of(place: int) -> str:
    """The dash that figures give the same number."""
    return DASHES[place % len(DASHES)]


MOST_SAMPLES = 20_000
MOST_TAPS = 2_000
MOST_STATES, MOST_INPUTS, MOST_MODES, MOST_LAWS = 12, 6, 12, 16
_WORST = 1e9  # a ratio of costs beyond which a run just grows


@dataclass(frozen=True, eq=False)
class ProblemOutcome:
    """The runs of a problem's laws, and the oracle's measure (immutable).

    Attributes
    ----------
    problem : Problem
    runs : mapping
        A run per law, by name.
    reasons : mapping
        Why the other laws that were asked for could not run.
    oracle : float or None
        The measure of the law that knows the signal in advance, and measures what the
        others measure; None where no signal is known in advance.
    """

    problem: Problem
    runs: Mapping[str, Trajectory]
    reasons: Mapping[str, str]
    oracle: float | None

    @property
    def signal(self) -> SwitchingSignal:
        """The switching signal; what the first run made of it where a rule decides."""
        return next(iter(self.runs.values())).signal

    @property
    def observed(self) -> bool:
        """Whether the laws measure outputs; the oracle then has their observer."""
        return any(law.observer is not None for law in self.problem.laws.values())

    @cached_property
    def metrics(self) -> dict[str, dict[str, float]]:
        """`Trajectory.metrics` of every run, at the problem's cost."""
        return {name: run.metrics(self.problem.weight) for name, run in self.runs.items()}

    @property
    def measure(self) -> str:
        """The metric by which the laws are ranked."""
        return measure_of(run.followed for run in self.runs.values())

    @cached_property
    def endings(self) -> dict[str, Ending]:
        """How every run ends."""
        return {name: ending(self.problem, name, run) for name, run in self.runs.items()}

    @cached_property
    def notes(self) -> list[str]:
        """Sentences on a signal that tests nothing, and on numbers that do not fit each other."""
        law, run = next(iter(self.runs.items()))
        said = why_untested(run, self.endings[law])
        return [*([said] if said else []), *unit_checks_of(self.problem)]

    def ratio(self, law: str) -> float | None:
        """A law's measure over the oracle's; infinite for a run that grew without end."""
        if self.oracle is None or not self.oracle > 0.0:
            return None
        ratio = self.metrics[law][self.measure] / self.oracle
        return ratio if not self.runs[law].diverged and ratio < _WORST else float("inf")


def require_size(draft: Mapping[str, Any]) -> None:
    """Refuse a problem that a page could not keep up with, before anything of it is built."""
    plant, run = draft["plant"], draft["run"]
    step, sizes = run.get("step", 0.01), []
    if isinstance(step, (int, float)) and step > 0.0:
        sizes = [
            ("run.horizon", run["horizon"] / step, MOST_SAMPLES, "periods"),
            ("plant.delay", longest_delay(draft) / step, MOST_TAPS, "periods"),
        ]
    elif step == "ideal" and (shortest := shortest_delay(draft)) > 0.0:
        sizes = [("run.horizon", run["horizon"] / shortest, MOST_TAPS, "delays")]
    columns = len(plant["B"][0][0]) if plant["B"] and plant["B"][0] else 0
    sizes += [
        ("plant.A", len(plant["A"]), MOST_MODES, "modes"),
        ("plant.A", len(plant["A"][0]) if plant["A"] else 0, MOST_STATES, "states"),
        ("plant.B", columns, MOST_INPUTS, "inputs"),
        ("law", len(draft.get("law", [])), MOST_LAWS, "laws"),
        ("imperfection", len(draft.get("imperfection", [])), MOST_LAWS, "imperfections"),
    ]
    for name, size, most, unit in sizes:
        if not size <= most:
            raise ArgumentError(
                f"{name} makes {size:,.0f} {unit}, the explorer takes at most {most:,}: use "
                "`deadtime simulate` for larger ones."
            )


def run_draft(draft: Mapping[str, Any], source: Path) -> ProblemOutcome:
    """Run every law of a problem file that can be built, and the oracle.

    Raises
    ------
    ArgumentError
        If the problem is too large for a page, or does not hold together.
    """
    require_size(draft)
    draft, reasons = _affordable(draft)
    names = [law.get("name") or law["kind"] for law in draft.get("law", [])]
    _, problem, failed = build_what_can(draft, source)
    reasons |= {names[i]: why for i, why in failed.items()}
    runs, fault = {}, None
    for name in problem.laws:
        try:
            runs[name] = problem.simulate(name)
        except DeadtimeError as error:
            reasons[name], fault = str(error), ArgumentError(f"{name}: {error}")
    if not runs and fault is not None:
        raise fault
    return ProblemOutcome(problem, runs, reasons, _oracle_measure(problem, runs))


def _affordable(draft: Mapping[str, Any]) -> tuple[Mapping[str, Any], dict[str, str]]:
    """The problem without the laws that would keep a page waiting, and why they do not run."""
    step = draft["run"].get("step", 0.01)
    taps = longest_delay(draft) / step if isinstance(step, (int, float)) and step > 0.0 else 0.0
    dear = [law for law in draft.get("law", []) if taps > QUICK.get(law["kind"], taps)]
    if not dear:
        return draft, {}
    if len(dear) == len(draft["law"]):
        raise ArgumentError(
            f"a delay of {taps:.0f} periods is too long for this law on a page: lengthen h, or use "
            "`deadtime simulate`."
        )
    why = f"takes long where the delay is above {min(QUICK.values())} periods: lengthen h"
    kept = [law for law in draft["law"] if law not in dear]
    return {**draft, "law": kept}, {law.get("name") or law["kind"]: why for law in dear}


def _oracle_measure(problem: Problem, runs: Mapping[str, Trajectory]) -> float | None:
    """The oracle's measure: of the run there is, or of one more."""
    measure = measure_of(run.followed for run in runs.values())
    if not isinstance(problem.signal, SwitchingSignal):
        return None
    for name, law in problem.laws.items():
        if law.foresees and name in runs:
            return runs[name].metrics(problem.weight)[measure]
    try:
        run = problem.run(_oracle(problem))
    except ArgumentError:
        return None
    return run.metrics(problem.weight).get(measure)


def _oracle(problem: Problem) -> Law:
    """The law that knows the signal; on the estimates of the others' observer, if they have one."""
    plant, gains = problem.model or problem.plant, problem.gains
    first: Any = next((one for one in problem.laws.values() if one.observer is not None), None)
    followed = {}
    if first is not None and first.servo is not None and first.law.gains is not None:
        plant, gains = first.law.plant, first.law.gains
        followed = {"servo": first.servo, "reference": first.reference}
    law = ExactPredictor(plant, gains, allow_unstable=True)
    if first is None:
        return law
    begun = {"estimate": first.estimate, "covariance": first.covariance}
    return OutputFeedback(law, first.observer, **begun, **followed)


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
    caption = measure_title(outcome.measure, outcome.problem.weight)
    word = TRACKING_ERROR if outcome.measure == "iae" else "cost"
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


def csv_of(runs: Mapping[str, Trajectory]) -> str:
    """Time, mode, and the states, inputs and mismatch of every law, full precision.

    Of laws that follow a reference also y and r. Columns are named as those of `Trajectory.to_csv`,
    behind the law's name; a run that ended early leaves its cells empty from there on.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> csv_of({"mean": problem.simulate("mean")}).splitlines()[0]
    'time,mode,mean: x[0],mean: x[1],mean: u[0],mean: w[0]'
    """
    longest = max(runs.values(), key=lambda run: run.time.size)
    columns: dict[str, np.ndarray] = {"time": longest.time, "mode": longest.mode}
    for law, run in runs.items():
        signals = {"x": run.states, "u": run.inputs, "w": run.mismatch}
        rows = numbered_columns(signals | {"y": run.tracked, "r": run.reference})
        columns |= {f"{law}: {name}": row for name, row in rows.items()}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for i in range(longest.time.size):
        writer.writerow([row[i].item() if i < row.size else "" for row in columns.values()])
    return text.getvalue()
