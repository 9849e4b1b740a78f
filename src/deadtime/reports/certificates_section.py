"""The report's section “Stable for every signal?”: certificates, witnesses, what was gained."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from deadtime.base.checks import reporter
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import file_name, with_names
from deadtime.laws import DelayedStateFeedback
from deadtime.problems import Problem
from deadtime.problems.comparison import Comparison, Progress
from deadtime.problems.switching_assumptions import signals_of, step_of
from deadtime.reports.tables.certificates import (
    HEADINGS,
    Judged,
    certificate_rows,
    certificate_sentences,
    judge,
    left_out,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class CertificatesSection:
    """What the section says (immutable).

    Attributes
    ----------
    dwell_time, step : float
        What the certificates are about, seconds.
    source : str
        Where the dwell time comes from.
    headings, rows, sentences
        The table of verdicts, and a sentence or two per law.
    statement, statement_of : tuple of str, str
        What is proved, and about which numbers: of the first certificate that is a proof; its law.
    figures : list of (name, caption, Figure)
    """

    dwell_time: float
    source: str
    step: float
    headings: tuple[str, ...]
    rows: list[tuple[str, ...]]
    sentences: list[str]
    statement: tuple[str, ...]
    statement_of: str
    figures: list[tuple[str, str, Figure]]


def steps_of_section(problem: Problem) -> int:
    """How often `certificates_section` reports progress."""
    return len(problem.laws) + 3


def certificates_section(
    result: Comparison, progress: Progress | None = None
) -> CertificatesSection:
    """Certify every law of a comparison for the dwell time of its signal.

    A signal that never switches is held to the horizon. The loop is the sampled one, at the
    problem's period, or at 0.01 s where the problem's loop is ideal.
    """
    progress, problem = reporter("progress", progress), result.problem
    ((dwell, source), signals), step = signals_of(problem, result.signal), step_of(problem)
    judged = judge(problem, signals, step, progress=progress)
    sentences = [
        *left_out(problem),
        *(with_names(one, problem.modes) for one in certificate_sentences(judged)),
    ]
    modes = problem.plant.modes
    if not signals.is_plain(modes):
        stays, switches = (with_names(one, problem.modes) for one in signals.in_words(modes))
        sentences.insert(0, f"Certificates are about every signal that {stays}, and {switches}.")
    figures = []
    reach = _tightness_figure(problem, dwell, step, progress)
    if reach is not None:
        sentences.append(reach[0])
        figures.append(reach[1])
    progress("drawing: worst signals")
    figures = [*_witness_figures(problem, judged), *figures]
    proofs = [
        (one.certificate.statement, one.law)
        for one in judged
        if one.certificate and one.certificate.proven
    ]
    statement, law = proofs[0] if proofs else ((), "")
    rows = certificate_rows(judged)
    return CertificatesSection(
        dwell, source, step, HEADINGS, rows, sentences, statement, law, figures
    )


def _witness_figures(problem: Problem, judged: list[Judged]) -> list[tuple[str, str, Figure]]:
    """A run of the worst signal of each law that is refuted, but of a baseline."""
    from deadtime.reports.figures.witness import plot_witness

    figures = []
    for one in judged:
        baseline = isinstance(problem.laws[one.law], DelayedStateFeedback)
        if one.stable is not False or one.worst is None or baseline:
            continue
        figures.append((
            f"witness-{file_name(one.law)}",
            f"A signal with the dwell time that the law “{one.law}” does not stabilise.",
            plot_witness(one.worst, f"Law: {one.law}", problem.modes),
        ))  # fmt: skip
    return figures


def _tightness_figure(
    problem: Problem, dwell: float, step: float, progress: Progress
) -> tuple[str, tuple[str, str, Figure]] | None:
    from deadtime.reports.figures.margins import plot_tightness
    from deadtime.reports.tightness import tightness

    try:
        found = tightness(
            problem, dwell, step, progress=lambda what: progress(f"certificates: {what}")
        )
    except ArgumentError:  # modes that do not differ
        progress("certificates: the theorem's reach")
        progress("certificates: between proof and witness")
        return None
    caption = (
        "How far apart modes and gains may be, as the modes are moved along their own difference, "
        "for the averaged law: what each certificate allows, and where a signal grows, if one was "
        "found. The theorem's ε* depends on the plant; it is that of modes as close as it allows."
    )
    figure = ("certificates-reach", caption, plot_tightness(found))
    return (found.message, figure) if len(found.reaches) > 1 else None
