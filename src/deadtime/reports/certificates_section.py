"""The report's section “Stable for every signal?”: certificates, witnesses, and how far they reach.

The theorem as printed, corrected and sharp, the lifted loop and a witness are put on one axis, the
distance ε between modes and gains, equation (5), as the modes are moved apart along their own
difference: A_0 + α(A_i − A_0), B alike. A form of the theorem reaches the ε at which
ε(α) = ε*(α); the bracket of `stability_margin` ends at a proof and at a witness.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from deadtime.base.checks import reporter
from deadtime.base.errors import ArgumentError, InfeasibleError, SolverError
from deadtime.base.wording import file_name, with_names
from deadtime.certificates import theorem_bound
from deadtime.certificates.theorem.bound import stated_forms
from deadtime.certificates.theorem.constants import distance
from deadtime.gains import place
from deadtime.laws import AveragedPredictor, DelayedStateFeedback
from deadtime.margins import StabilityMargin, stability_margin
from deadtime.plant import SwitchedSystem
from deadtime.problems import Problem
from deadtime.problems.comparison import Comparison, Progress
from deadtime.problems.switching_assumptions import signals_of, step_of
from deadtime.reports.certificate_tables import (
    HEADINGS,
    Judged,
    certificate_rows,
    certificate_sentences,
    judge,
    left_out,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


TINY = 1e-6  # below this α everything is linear in α, and computed at this α
LOW = 0.01  # the α at which the search for a margin starts
MOST = 8.0  # the largest α that is searched
ROUNDS = 6  # of the fixed point for ε(α) = ε*(α); it converges in two or three


@dataclass(frozen=True, eq=False)
class Reach:
    """How far one certificate reaches.

    Attributes
    ----------
    name : str
    log10_distance : float
        log₁₀ of ε there.
    alpha : float
        α there, 0.0 if it underflows.
    stable : bool
        False for the witness: at this distance the loop is not stable.
    """

    name: str
    log10_distance: float
    alpha: float
    stable: bool = True


@dataclass(frozen=True, eq=False)
class Tightness:
    """What `tightness` found.

    Attributes
    ----------
    reaches : tuple of Reach
        In rising order of what they reach; shorter where something has no answer.
    own : float
        ε of the problem itself, α = 1.
    margin : StabilityMargin or None
        The bracket that ends in the last two.
    message : str
        What was gained, or why something is missing.
    """

    reaches: tuple[Reach, ...]
    own: float
    margin: StabilityMargin | None
    message: str


def move_modes(problem: Problem, alpha: float) -> tuple[SwitchedSystem, np.ndarray]:
    """The plant with its modes α times as far apart, and gains (modes, m, n) for it.

    Gains that place the same poles in every mode, one input, are placed anew; others move along
    their own difference, K_0 + α(K_i − K_0).

    Examples
    --------
    >>> import deadtime as dt
    >>> plant, gains = move_modes(dt.problems.paper(), 0.5)
    >>> plant.A[1].tolist(), gains[1].round(3).tolist()
    ([[2.15, 1.05], [0.025, 1.1]], [[-12.351, -6.188]])
    """
    plant, K = problem.plant, problem.gains
    apart = plant.apart(alpha)
    poles = np.sort_complex(np.linalg.eigvals(plant.A + plant.B @ K))
    common = np.allclose(poles, poles[0], rtol=1e-6, atol=1e-9)
    if plant.inputs == 1 and common:
        return apart, place(apart, poles[0])
    return apart, K[0] + alpha * (K - K[0])


def tightness(
    problem: Problem,
    dwell_time: float,
    step: float = 0.01,
    ratio: float = 1.01,
    progress: Callable[[str], None] | None = None,
) -> Tightness:
    """How far the theorem's three forms, the lifted certificate and a witness reach.

    The theorem is about the ideal loop, certificate and witness are about the loop sampled at
    `step`, all with the averaged law.

    Parameters
    ----------
    problem : Problem
        At least two modes that differ; its signal and laws are not read.
    dwell_time, step : float
        Seconds.
    ratio : float
        As `stability_margin` takes it.
    progress : callable, optional
        Called with a few words, twice.

    Raises
    ------
    ArgumentError
        If the modes do not differ.
    """
    own = distance(problem.plant, problem.gains)
    if own == 0.0 or problem.plant.modes == 1:
        raise ArgumentError("modes of the problem must differ: they are all the same.")
    reaches, missing = [], []
    progress = reporter("progress", progress)
    progress("the theorem's reach")
    forms = stated_forms(problem.plant)
    if not forms:
        missing = ["The theorem has no form for delays that differ between modes."]
    for form in forms:
        try:
            reaches.append(reach_of(problem, dwell_time, form))
        except (ArgumentError, InfeasibleError) as error:
            missing = [f"The theorem does not apply: {error}"]
        except SolverError as error:
            missing = [f"The theorem's constants were not computed: {error}"]
    progress("between proof and witness")
    margin = None
    try:
        margin = _margin(problem, dwell_time, step, ratio)
    except ArgumentError as error:
        missing.append(f"There is no bracket between proof and witness: {error}")
    if margin is not None:
        name = "lifted loop, proved"
        if margin.refuted is None:
            name += " (at least)"
            missing.append(
                f"No signal that grows was found up to {MOST:g} times the distance of the modes, "
                "where the search ended."
            )
        reaches.append(_at(problem, name, margin.certified))
        if margin.refuted is not None:
            reaches.append(_at(problem, "a signal that grows", margin.refuted, stable=False))
    return Tightness(tuple(reaches), own, margin, " ".join([*_improvements(reaches), *missing]))


def reach_of(problem: Problem, dwell_time: float, form: str) -> Reach:
    """The fixed point of ε(α) = ε*(α) along the modes' own difference, α ≤ 1."""
    log_alpha, log_star = math.log10(TINY), 0.0
    for _ in range(ROUNDS):
        alpha = min(max(10.0**log_alpha, TINY), 1.0)
        plant, gains = move_modes(problem, alpha)
        bound = theorem_bound(plant, gains, dwell_time, form=form)
        log_star = bound.log10_epsilon_star
        before, log_alpha = log_alpha, log_star - math.log10(bound.epsilon / alpha)
        if abs(log_alpha - before) < 1e-4 or 10.0 ** max(log_alpha, before) < TINY:
            break
    words = {"printed": "theorem as printed", "corrected": "corrected", "sharp": "sharp"}
    return Reach(words[form], log_star, 10.0**log_alpha)


def _margin(problem: Problem, dwell_time: float, step: float, ratio: float) -> StabilityMargin:
    """The bracket for α."""

    def loop(alpha: float) -> tuple[SwitchedSystem, AveragedPredictor]:
        plant, gains = move_modes(problem, alpha)
        return plant, AveragedPredictor(plant, gains, allow_unstable=True)

    return stability_margin(loop, (LOW, MOST), dwell_time, step, ratio)


def _at(problem: Problem, name: str, alpha: float, stable: bool = True) -> Reach:
    return Reach(name, math.log10(distance(*move_modes(problem, alpha))), alpha, stable)


def _times(log10: float) -> str:
    """A factor in a sentence."""
    return f"× {10.0**log10:.3g}" if log10 < 3.0 else f"× 10^{log10:.1f}"


def _improvements(reaches: list[Reach]) -> list[str]:
    """What the steps gain, in a sentence."""
    good = [reach for reach in reaches if reach.stable]
    if len(good) < 2:
        return []
    gains = "; ".join(
        f"{after.name} {_times(after.log10_distance - before.log10_distance)}"
        for before, after in pairwise(good)
        if after.log10_distance - before.log10_distance >= 0.05
    )
    text = f"Distances allowed, each as a multiple of the one before: {gains}."
    if reaches[-1].stable:
        return [text]
    left = 10.0 ** (reaches[-1].log10_distance - good[-1].log10_distance) - 1.0
    return [f"{text} From the last proof to a signal that grows it is {100.0 * left:.2g} %."]


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
    from deadtime.reports.figures.certificates import plot_witness

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
    from deadtime.reports.figures.certificates import plot_tightness

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
