"""The outcome of a problem on a page: a run of every chosen law, costs as HTML, samples as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
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
from deadtime.problems.comparison import ProblemRuns
from deadtime.problems.file.load import build_what_can
from deadtime.problems.law_registry import QUICK
from deadtime.problems.unit_checks import unit_checks_of
from deadtime.reports.figures.colours import Look, looks_of
from deadtime.reports.metrics import SETTLES, measure_title, settling_text
from deadtime.reports.report_folder import render
from deadtime.simulation import Trajectory
from deadtime.simulation.outcome import why_untested
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
class ProblemOutcome(ProblemRuns):
    """The runs of a problem's laws, and the measure of the oracle (immutable).

    `oracle` is None where no signal is known in advance.
    """

    oracle: float | None

    @property
    def observed(self) -> bool:
        """Whether the laws measure outputs; the oracle then has their observer."""
        return any(law.observer is not None for law in self.problem.laws.values())

    @cached_property
    def notes(self) -> list[str]:
        """Sentences on a signal that tests nothing, and on numbers that do not fit each other."""
        untested = why_untested(self.runs[self.lead], self.outcomes[self.lead])
        return [*([untested] if untested else []), *unit_checks_of(self.problem)]

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
    laws = [law for law in draft["law"] if law not in dear]
    return {**draft, "law": laws}, {law.get("name") or law["kind"]: why for law in dear}


def _oracle_measure(problem: Problem, runs: Mapping[str, Trajectory]) -> float | None:
    """The oracle's measure: of the run there is, or of one more."""
    measure = measure_of(run.followed for run in runs.values())
    if not isinstance(problem.signal, SwitchingSignal):
        return None
    for name, law in problem.laws.items():
        if law.needs_preview and name in runs:
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
    initial = {"estimate": first.estimate, "covariance": first.covariance}
    return OutputFeedback(law, first.observer, **initial, **followed)


_BORDERS = {"solid": "solid", "dashed": "dashed", "dashdot": "dashed", "dotted": "dotted"}


def table_of(outcome: ProblemOutcome, laws: Sequence[str]) -> str:
    """The table; `laws` are all on offer, which share the colours.

    Full figures are in the `data-` attributes of the rows.
    """
    looks = looks_of([*laws, *outcome.runs])
    title = measure_title(outcome.measure, outcome.problem.weight)
    more = ", on estimates of the same observer" if outcome.observed else ""
    word = TRACKING_ERROR if outcome.measure == "iae" else "cost"
    return render(
        "costs.html.j2",
        caption=f"{title}, and against the oracle{more}",
        headings=("law", word, "/ oracle", SETTLES, "max |x|"),
        rows=[_row(outcome, law, looks[law]) for law in outcome.runs],
        reasons=outcome.reasons,
    )


def _row(outcome: ProblemOutcome, law: str, look: Look) -> dict[str, Any]:
    metrics, ratio = outcome.metrics[law], outcome.ratio(law)
    grows = outcome.runs[law].diverged or (ratio is not None and math.isinf(ratio))
    return {
        "law": law,
        "cost": metrics["cost"],
        "peak": metrics["peak"],
        "border": _BORDERS[dash_of(look.dash)],
        "colour": look.colour,
        "bar": 0.0 if ratio is None else 100.0 if grows else _bar(ratio),
        "measure": compact(metrics[outcome.measure]),
        "relative": "–" if ratio is None else "grows" if grows else compact(ratio),
        "others": (settling_text(outcome.outcomes[law].settling), compact(metrics["peak"])),
    }


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
