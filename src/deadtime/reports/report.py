"""The report of a comparison: figures, data, certificates; a page that opens with its verdict."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from deadtime.base.checks import reporter
from deadtime.base.errors import ArgumentError, InfeasibleError, SolverError
from deadtime.base.wording import file_name, file_names
from deadtime.plant.weight import text_of
from deadtime.problems import Problem
from deadtime.problems.comparison import Comparison, Progress, compare
from deadtime.problems.switching_assumptions import dwell_time_of, signals_of, step_of
from deadtime.reports import certificate_tables as tables, metrics
from deadtime.reports.audit import STEPS, audit
from deadtime.reports.figures.runs import all_laws, plot_signal, plot_verdict, plot_window
from deadtime.reports.metrics import metrics_of
from deadtime.reports.report_folder import PAGE, save_figure, write_metrics, write_page, writing
from deadtime.reports.verdict import headings_of, table, verdict
from deadtime.simulation.run_figure import plot_run
from deadtime.switching import SwitchingSignal


def steps_of_section(problem: Problem) -> int:
    """How often `certificates_section` reports progress."""
    return len(problem.laws) + 1


def certificates_section(result: Comparison, progress: Progress | None = None) -> dict[str, Any]:
    """Certify every law of a comparison for the dwell time of its signal; parts of the page.

    A signal that never switches is held to the horizon. The loop is the sampled one, at the
    problem's period, or at 0.01 s where the problem's loop is ideal. `figures` are (name, caption,
    Figure); `statement` says what is proved, of the first certificate that is a proof.
    """
    progress, problem = reporter("progress", progress), result.problem
    assumptions, step = signals_of(problem, result.signal), step_of(problem)
    judged = tables.judge(problem, assumptions.signals, step, progress=progress)
    sentences = tables.left_out(problem, assumptions.signals)
    sentences += tables.certificate_sentences(judged, problem)
    progress("drawing: worst signals")
    proofs = [
        (one.certificate.statement, one.law)
        for one in judged
        if one.certificate and one.certificate.proven
    ]
    statement, law = proofs[0] if proofs else ((), "")
    return {
        "about": assumptions.in_words(problem.modes, step),
        "headings": tables.HEADINGS,
        "rows": tables.certificate_rows(judged),
        "legend": tables.LEGEND,
        "sentences": sentences,
        "statement": statement,
        "statement_of": law,
        "figures": _witness_figures(problem, judged),
    }


def _witness_figures(
    problem: Problem, judged: list[tables.Judged]
) -> list[tuple[str, str, Figure]]:
    # Not of a baseline, which nobody expects to be stable.
    from deadtime.reports.figures.certificates import plot_witness

    figures, names = [], file_names(problem.laws)
    for one in judged:
        predicts = problem.laws[one.law].predicts
        if one.stable is not False or one.worst is None or not predicts:
            continue
        figures.append((
            f"witness-{names[one.law]}",
            f"A signal with the dwell time that the law “{one.law}” does not stabilise.",
            plot_witness(one.worst, f"Law: {one.law}", problem.modes),
        ))  # fmt: skip
    return figures


SCENARIOS = 1000


@dataclass(frozen=True, eq=False)
class Report:
    """The path of a report, its verdict and the comparison behind it."""

    path: Path
    sentences: list[str]
    comparison: Comparison


def figures_of(result: Comparison) -> Iterator[tuple[str, str, Figure]]:
    """The numbered figures in order: (file name, caption, figure).

    On the paper's example the first six are Figures 1 to 6 of the paper.
    """
    problem = result.problem
    signal, delay, end = result.signal, problem.plant.longest_delay, problem.horizon
    yield (
        "window",
        "Switching instants and modes in [t, t + D]: what the exact predictor must know at t.",
        plot_window(signal, delay, end, problem.modes),
    )
    given = isinstance(problem.signal, SwitchingSignal)
    whose = "every run" if given else f"the run under the law “{result.lead}”"
    yield (
        "signal",
        f"The switching signal of {whose}: active mode in blue, switching instants in black.",
        plot_signal(signal, end, problem.modes),
    )
    states, inputs = problem.curve_names
    names = file_names(problem.laws)
    for name, run in result.runs.items():
        if not _is_shown(problem, name):
            continue
        figure = plot_run(run, None, states, problem.modes, inputs)
        yield names[name], f"States, input and mode under the law “{name}”.", figure
    caption, figure = all_laws(result)
    yield "all-laws", caption, figure


def write_report(
    problem: Problem,
    folder: str | Path,
    progress: Progress | None = None,
    command: str = "",
    certificates: bool = True,
) -> Report:
    """Run every law of a problem and write the report into a folder.

    Writes index.html (self-contained), figures/ (PNG and SVG), data/ (a CSV file per run) and
    metrics.json; files of the same names are replaced, others are left alone.

    Parameters
    ----------
    problem : Problem
        The setting.
    folder : path
        Made if it does not exist.
    progress : callable, optional
        Called with a few words before each piece of work, `steps_of(problem, certificates)` times.
    command : str
        How to make the report again, for its last line.
    certificates : bool
        Whether to ask, for every law, if it stabilises every signal: the slowest part.

    Raises
    ------
    ArgumentError
        If the folder cannot be written.
    """
    folder, progress = Path(folder), reporter("progress", progress)
    with writing(folder) as place:
        sentences, result = _write(problem, place, progress, command, certificates)
    return Report(folder / PAGE, sentences, result)


def _is_shown(problem: Problem, law: str) -> bool:
    """Whether a law has a figure of its own: all but a baseline that others are held against."""
    return len(problem.laws) == 1 or problem.laws[law].predicts


def steps_of(problem: Problem, certificates: bool = True) -> int:
    """How often `write_report` reports progress."""
    shown = sum(_is_shown(problem, name) for name in problem.laws)
    audited = STEPS + 1 if problem.constants else 0
    drawn = len(problem.laws) + problem.plant.modes + shown
    return drawn + 7 + audited + (steps_of_section(problem) if certificates else 0)


def _write(
    problem: Problem, folder: Path, progress: Progress, command: str, certificates: bool
) -> tuple[list[str], Comparison]:
    result = compare(problem, progress)
    sentences = [*verdict(result), *tables.delay_sentence(problem)]
    progress("drawing: verdict")
    caption = "The same law with and without switching."
    picture = save_figure(plot_verdict(result), folder, "verdict", caption)
    images = []
    for number, (name, caption, figure) in enumerate(figures_of(result), 1):
        progress(f"drawing: {name}")
        images.append(save_figure(figure, folder, f"figure-{number}-{name}", caption))
    audited = _audit(problem, folder, progress)
    progress("computing: constants")
    constants = _constants(result)
    certified = None
    if certificates:
        certified = certificates_section(result, progress)
        certified["figures"] = [
            save_figure(figure, folder, name, caption)
            for name, caption, figure in certified["figures"]
        ]
    progress("writing: data")
    for number, (name, run) in enumerate(result.runs.items(), 1):
        path = folder / "data" / f"{number}-{file_name(name)}.csv"
        run.to_csv(path, problem.states, problem.inputs, problem.tracked)
    write_metrics(metrics_of(result), folder)
    progress("writing: report")
    write_page(
        folder,
        "report.html.j2",
        **_setting(problem),
        sentences=sentences,
        picture=picture,
        headings=headings_of(result),
        rows=table(result),
        tracking=metrics.tracking_of_runs(result),
        tracking_headings=metrics.HEADINGS,
        never=metrics.LEGEND,
        figures=images,
        audited=audited,
        constants=constants,
        certified=certified,
        command=f" with “{command}”" if command else "",
    )
    return sentences, result


def _audit(problem: Problem, folder: Path, progress: Progress) -> dict[str, Any] | None:
    """Claims and figure of the audit, for the problem that a paper makes claims about."""
    if not problem.constants:
        return None
    from deadtime.reports.figures.audit import plot_claims

    claims = audit(problem, SCENARIOS, progress=progress)
    progress("drawing: audit-claims")
    caption = "On how many random signals each claim holds."
    image = save_figure(plot_claims(claims), folder, "audit-claims", caption)
    return {"claims": claims, "figure": image, "scenarios": SCENARIOS}


def _constants(result: Comparison) -> dict[str, Any]:
    """The theorem's constants in three forms, or why there are none."""
    problem = result.problem
    dwell_time, source = dwell_time_of(problem, result.signal)
    try:
        bounds = tables.bounds_of(problem, dwell_time)
    except (ArgumentError, InfeasibleError, SolverError) as error:
        return {"rows": [], "sentence": tables.theorem_refusal(error), "published": False}
    return {
        "headings": tables.bound_headings(bounds, problem.constants),
        "rows": tables.bound_rows(bounds, problem.constants),
        "sentence": tables.bound_sentence(bounds),
        "published": bool(problem.constants),
        "dwell_time": dwell_time,
        "source": source,
    }


def _matrix(array: np.ndarray) -> str:
    rows = ["[" + ", ".join(f"{v:.6g}" for v in row) + "]" for row in np.atleast_2d(array)]
    return (rows[0] if len(rows) == 1 else "[" + ", ".join(rows) + "]").replace("-", "−")


def _setting(problem: Problem) -> dict[str, Any]:
    plant = problem.plant
    return {
        "problem": problem,
        "plant": plant,
        "one_signal": isinstance(problem.signal, SwitchingSignal),
        "cost": text_of(problem.weight),
        "published": [
            (row.name, _matrix(row.printed), _matrix(row.computed)) for row in problem.published
        ],
        "x0": _matrix(problem.x0),
        "u0": _matrix(np.atleast_1d(problem.u0)) if np.any(problem.u0) else "",
        "matrices": [
            (name, _matrix(plant.A[i]), _matrix(plant.B[i]), _matrix(problem.gains[i]))
            for i, name in enumerate(problem.modes)
        ],
    }
