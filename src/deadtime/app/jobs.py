"""The work that pages leave to other processes: plain data in, plain data out."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np

from deadtime.app.documents import Document, complaint, open_upload
from deadtime.app.page_outcome import run_draft
from deadtime.app.uploaded_log import Columns, LogRequest, Tell, look_at, open_log, report_of
from deadtime.base.errors import ArgumentError
from deadtime.certificates import falsify
from deadtime.feedback import Law
from deadtime.margins import stability_margin
from deadtime.plant import SwitchedSystem
from deadtime.problems import Problem
from deadtime.problems.comparison import held_growth
from deadtime.problems.file.load import build_what_can
from deadtime.problems.toml import SectionError
from deadtime.reports.identification_report import Picture
from deadtime.scenarios.sweeps.axes import AXES
from deadtime.switching import SignalClass

RATIO = 1.02  # of the values between which a margin of the chart lies
_BUDGET = 20_000  # cycles that the search for the worst signal looks at


def try_upload(name: str, content: bytes) -> tuple[Document, float]:
    """Open what came through a browser and run it; seconds of this process for the second run.

    The first run compiles what none before it has called. Time that others take from this process
    is not the problem's fault, so it does not count.
    Reading is done here too: there are texts whose reading alone never ends.
    """
    with tempfile.TemporaryDirectory() as folder:
        document = open_upload(name, content, Path(folder))
    return document, _seconds(document)


def _seconds(document: Document) -> float:
    """Run a document twice; seconds of this process for the second run."""
    try:
        run_draft(document.draft, document.source)
    except SectionError as error:
        raise complaint(document, error) from None
    began = time.process_time()
    run_draft(document.draft, document.source)
    return time.process_time() - began


def look_at_log(name: str, content: bytes) -> Columns:
    """The columns of a log that came through a browser."""
    with tempfile.TemporaryDirectory() as folder:
        return look_at(name, content, Path(folder))


def try_log(
    name: str, content: bytes, request: LogRequest, tell: Tell = lambda _: None
) -> tuple[Picture, bytes]:
    """The plant of a log that came through a browser.

    The plant, with the seconds of a run of its problem, is reported through `tell` before the slow
    part: the likelihood over the delays, which is returned with the report.
    """
    with tempfile.TemporaryDirectory() as folder:
        plant, fit = open_log(name, content, Path(folder), request, tell)
    tell("running the laws")
    tell((plant, _seconds(plant.document)))
    tell("drawing how likely every delay is")
    return report_of(fit, plant, request.command(name))


def worst_signal(
    draft: Mapping[str, Any], source: Path, law: str, dwell_time: float
) -> dict[str, Any]:
    """The worst admissible signal of a law: its switches up to the horizon, its growth, 1/s."""
    problem, chosen = _problem(draft, source, law)
    signals = SignalClass(dwell_time, at=problem.signals.at)
    worst = falsify(problem.plant, chosen, signals, step=_step(problem), budget=_BUDGET)
    cycles = int(np.ceil(problem.horizon / worst.length)) + 1
    signal = worst.simulate(cycles).signal
    inside = signal.times < problem.horizon
    return {
        "times": signal.times[inside].tolist(),
        "modes": signal.modes[inside].tolist(),
        "at": problem.signals.at,
        "growth_rate": worst.growth_rate,
        "message": worst.message,
    }


def lifted_order(problem: Problem) -> int:
    """States and inputs in flight of a digital loop; 0 for an ideal one."""
    plant, step = problem.plant, problem.step
    longest = plant.delays.max(axis=0).tolist()
    return plant.states + sum(0 if step is None else math.ceil(delay / step) for delay in longest)


def growth_rates(problem: Problem, law: str) -> list[float]:
    """Growth of a law's loop with each mode held, 1/s; none where that is not defined."""
    chosen = problem.laws.get(law)
    if chosen is None or problem.step is None:
        return []
    return list(held_growth(problem, chosen))


def growth_elsewhere(draft: Mapping[str, Any], source: Path, law: str) -> list[float]:
    """`growth_rates` of a problem as plain data."""
    return growth_rates(_problem(draft, source, law)[0], law)


def margin(
    draft: Mapping[str, Any], source: Path, law: str, bounds: tuple[float, float], dwell_time: float
) -> tuple[float, float, str]:
    """Mode distances up to which a law is certified, and from which on it is refuted, or NaN.

    And why there is no answer at this dwell time, or an empty text. `draft` is that of the
    distance 1; a law that uses a dwell time gets this one.
    """

    def problem_at(distance: float) -> tuple[SwitchedSystem, Law]:
        values = {"distance": distance}
        if any(one.get("dwell_time") is not None for one in draft.get("law", [])):
            values["dwell_time"] = dwell_time
        moved = deepcopy(dict(draft))
        for name, value in values.items():
            AXES[name].write(moved, value)
        problem, chosen = _problem(moved, source, law)
        return problem.plant, chosen

    problem, _ = _problem(draft, source, law)
    step, signals = _step(problem), SignalClass(dwell_time, at=problem.signals.at)
    try:
        bracket = stability_margin(problem_at, bounds, signals, step=step, ratio=RATIO)
    except ArgumentError as error:
        return math.nan, math.nan, str(error)
    refuted = math.nan if bracket.refuted is None else float(bracket.refuted)
    return float(bracket.certified), refuted, ""


def _problem(draft: Mapping[str, Any], source: Path, law: str) -> tuple[Problem, Law]:
    _, problem, _ = build_what_can(draft, source)
    return problem, problem.law(law)


def _step(problem: Problem) -> float:
    if problem.step is None:
        raise ArgumentError("an ideal loop has no samples: give the law a period for this.")
    return problem.step
