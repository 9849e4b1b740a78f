"""Certificates of a problem's laws, and the theorem's constants, as rows, sentences and JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from operator import call
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from deadtime.base.checks import positive, reporter
from deadtime.base.errors import ArgumentError, SolverError
from deadtime.base.json_records import record
from deadtime.base.threads import in_order
from deadtime.base.wording import as_rate, compact, number_of, rounded, sentence_of, with_names
from deadtime.certificates import TheoremBound, theorem_bound
from deadtime.certificates.proof.delays import Delays
from deadtime.certificates.theorem.bound import stated_forms
from deadtime.imperfections import Dropout, ModeDelay
from deadtime.plant.plant_set import PlantUncertainty
from deadtime.plant.switched_system import check_delays
from deadtime.problems import Problem
from deadtime.switching import SignalClass

if TYPE_CHECKING:
    from deadtime.certificates import Certificate, WorstCase
    from deadtime.margins.delay import DelayMargin


# In two lines, so that a table fits into 80 columns.
HEADINGS = (
    "law", "stability", "proved\ndecay, 1/s", "proof", "slowest decay\nfound, 1/s",
    "stable for true\ndelay, s",
)  # fmt: skip
LEGEND = (
    "Stability: yes, for every such signal; no, |x| grows along one of them; no answer, neither "
    "was found. Proved decay: every run falls at least this fast. Proof: yes, of stability; "
    "witness, of a signal along which |x| grows; both with all rounding errors included. Slowest "
    "decay found: along the worst signal found; below 0, |x| grows. Stable for true delay: if the "
    "mode never changes; of several delays, their common change."
)


@dataclass(frozen=True, eq=False)
class Judged:
    """The answers about one law: certificate, worst signal, delay margin.

    Attributes
    ----------
    law : str
    certificate : Certificate or None
        None where the question could not be put; `reason` says why.
    worst : WorstCase or None
        The worst signal found; None where none could be searched for.
    margin : DelayMargin or None
        The true delays with which every constant mode is stable.
    reason : str
        Why something is missing; empty otherwise.
    """

    law: str
    certificate: Certificate | None
    worst: WorstCase | None
    margin: DelayMargin | None
    reason: str = ""

    @property
    def stable(self) -> bool | None:
        """The certificate's answer; None where there is none."""
        return None if self.certificate is None else self.certificate.stable


def judge(
    problem: Problem,
    signals: SignalClass,
    step: float,
    laws: Sequence[str] | None = None,
    decay_rate: float | None = None,
    progress: Callable[[str], None] | None = None,
    delays: tuple[ArrayLike, ArrayLike] | None = None,
    trying: Callable[[str], None] | None = None,
    uncertain: bool = False,
) -> list[Judged]:
    """Certificate, worst signal and delay margin of each law of a problem.

    Parameters
    ----------
    problem : Problem
        Its signal is not read.
    signals : SignalClass
        Worst signals keep an average dwell time in every sojourn.
    step : float
        Sampling period, seconds.
    laws : sequence of str, optional
        Names of laws; all by default.
    decay_rate : float, optional
        The rate to certify, 1/s; as `certify` chooses by default.
    progress : callable, optional
        Called with a few words after each law's certificate.
    delays : (low, high), optional
        Ranges of the true delays, as `certify` takes them.
    trying : callable, optional
        Called with a few words whenever something else is tried for one of the laws, from the
        thread that tries it.
    uncertain : bool
        Whether to certify all plants that the problem's [uncertainty] leaves open.

    Raises
    ------
    ArgumentError
        If a law is not there, a time is not positive or delays do not fit the plant. A law that
        cannot be certified is a result with a reason.
    """
    from deadtime.certificates import certify

    plant = problem.plant if not uncertain else uncertain_plant(problem)
    step = positive("step", step)
    for end in delays or ():
        check_delays(end, problem.plant.delays.shape, "delays")
    progress, trying = reporter("progress", progress), reporter("trying", trying)
    names = list(problem.laws) if laws is None else list(laws)
    for name in names:
        problem.law(name)
    ranges = plant.delay_range() if isinstance(plant, PlantUncertainty) and not delays else delays
    try:
        Delays.of(ranges, problem.plant, step, problem.inputs)
    except ArgumentError as error:  # of every law, and here the inputs have names
        return [Judged(name, None, None, None, str(error)) for name in names]
    certified: dict[str, Future[Certificate]] = {name: Future() for name in names}

    def prove(name: str) -> None:
        law = problem.laws[name]
        try:
            certificate = certify(
                plant,
                law,
                signals,
                step,
                decay_rate=decay_rate,
                delays=delays,
                progress=lambda what: trying(f"{name}: {what}"),
            )
            certified[name].set_result(certificate)
        except BaseException as error:
            certified[name].set_exception(error)

    def search(name: str) -> Judged:
        return _judge(problem, name, certified[name], signals, step)

    # A solver leaves Python to the other threads, a search for signals does not: the solver of the
    # law that takes longest works beside the searches of the others.
    proofs, searches = ([partial(work, name) for name in names] for work in (prove, search))
    answers = in_order(call, [*proofs, *searches])
    for name in names:
        next(answers)
        progress(f"certified: {name}")
    return list(answers)


def uncertain_plant(problem: Problem) -> PlantUncertainty:
    """The plants that the problem's [uncertainty] leaves open."""
    if problem.uncertain is None:
        raise ArgumentError(
            f"the problem {problem.name!r} has no [uncertainty], as `deadtime identify` writes it: "
            "without it only its one plant can be certified."
        )
    return problem.uncertain


def plants_in_words(problem: Problem, uncertain: bool, delays: object = None) -> list[str]:
    """The plants that an answer covers, where the file leaves some open."""
    if problem.uncertain is None:
        return []
    if uncertain:
        where, ranges = problem.uncertain.in_words
        return [
            f"Every plant of [uncertainty]: A and B {where}, delays in their "
            f"{ranges if delays is None else 'ranges of --delays'}."
        ]
    return ["For the estimated plant alone; --uncertain covers every plant of [uncertainty]."]


def _judge(
    problem: Problem, name: str, certified: Future[Certificate], signals: SignalClass, step: float
) -> Judged:
    """The worst signal and the delay margin beside a certificate, which is waited for."""
    from deadtime.certificates import falsify
    from deadtime.margins.delay import constant_delay_margin
    from deadtime.spectrum.held_mode_checks import why_left_out

    plant, law = problem.plant, problem.laws[name]
    try:
        certificate = certified.result()
    except ArgumentError as error:
        return Judged(name, None, None, None, str(error))
    worst, margin, reason = certificate.witness, None, ""
    try:
        if worst is None and certificate.stable:
            worst = falsify(plant, law, signals, step)
        too_long = why_left_out("delay margin", plant, law, step)
        if too_long:
            return Judged(name, certificate, worst, None, sentence_of(too_long))
        margin = constant_delay_margin(plant, law, step)
    except ArgumentError as error:
        reason = "" if certificate.stable is None else str(error)
    return Judged(name, certificate, worst, margin, reason)


def certificate_rows(judged: Sequence[Judged]) -> list[tuple[str, ...]]:
    """Rows of the table of certificates, columns as in `HEADINGS`."""
    rows = []
    for one in judged:
        rate = one.certificate and one.certificate.decay_rate
        decay = "–" if rate is None else rounded(rate) if rate else "> 0"
        slowest = -math.inf if one.worst is None else -one.worst.growth_rate
        rows.append((
            one.law,
            {True: "yes", False: "no", None: "no answer"}[one.stable],
            decay,
            {True: "yes", False: "witness", None: "–"}[one.stable],
            as_rate(slowest) if math.isfinite(slowest) else "–",
            margin_text(one.margin),
        ))  # fmt: skip
    return rows


def without_imperfections(problem: Problem, signals: SignalClass | None = None) -> list[str]:
    """The imperfections of a problem that a certificate for these signals does not cover."""
    return [
        words
        for one, words in zip(problem.imperfections, problem.imperfections_in_words, strict=True)
        if signals is None
        or not (
            (isinstance(one, ModeDelay) and one.periods == signals.mode_lag)
            or (isinstance(one, Dropout) and signals.lost_samples)
        )
    ]


def left_out(problem: Problem, signals: SignalClass | None = None) -> list[str]:
    """Sentences on the imperfections of a problem that certificates for these signals leave out.

    Examples
    --------
    >>> import deadtime as dt
    >>> from dataclasses import replace
    >>> from deadtime.imperfections import Dropout
    >>> left_out(replace(dt.problems.paper(), imperfections=(Dropout(0.1),)))
    ['Not covered: dropout (probability 0.1). Certificates are about the loop without it.']
    """
    sentences, missing = [], without_imperfections(problem, signals)
    if missing:
        them = "it" if len(missing) == 1 else "them"
        named = ", ".join(missing)
        sentences.append(f"Not covered: {named}. Certificates are about the loop without {them}.")
    # A drawn loss may be longer than any number of samples, so it is covered under this condition.
    drawn = [
        words
        for one, words in zip(problem.imperfections, problem.imperfections_in_words, strict=True)
        if isinstance(one, Dropout)
    ]
    if drawn and signals is not None and signals.lost_samples:
        row = number_of(signals.lost_samples, "sample")
        are = "is" if signals.lost_samples == 1 else "are"
        sentences.append(f"Covered while at most {row} in a row {are} lost: {', '.join(drawn)}.")
    return sentences


def certificate_sentences(judged: Sequence[Judged], problem: Problem) -> list[str]:
    """A sentence or two per law: the certificate's own words, or why there is none."""
    texts = []
    for one in judged:
        answer = "" if one.certificate is None else f"{one.certificate.message} "
        answer = f"{answer}{one.reason}".rstrip()
        texts.append(f"{one.law}: {with_names(answer, problem.modes)}")
    return texts


def summary_of(judged: Sequence[Judged]) -> str:
    """One sentence: which laws are stable for every signal, and which are not.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> summary_of([SimpleNamespace(law="mean", stable=True)])
    'Stable for every such signal: mean.'
    """
    kinds = {True: "Stable for every such signal", False: "Not stable", None: "No answer"}
    groups = (
        (text, [one.law for one in judged if one.stable is kind]) for kind, text in kinds.items()
    )
    return " ".join(f"{text}: {', '.join(laws)}." for text, laws in groups if laws)


def certificate_record(judged: Sequence[Judged]) -> dict[str, dict[str, Any]]:
    """Certificates, worst signals and delay margins for JSON."""
    from deadtime.certificates import Certificate

    answer = ("stable", "decay_rate", "proven", "message", "statement")
    worst = ("growth_rate", "proven", "modes", "sojourns", "phase", "message")
    return {
        one.law: {
            **record(one.certificate or Certificate(None, one.reason), *answer),
            "worst_signal": one.worst and record(one.worst, *worst),
            "delay_margin": one.margin and record(one.margin, "lower", "upper", "message"),
        }
        for one in judged
    }


def margin_text(margin: DelayMargin | None) -> str:
    """The true delays that are allowed, for a table; of several, their common error.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> margin_text(SimpleNamespace(lower=0.98651, upper=1.01349, differ=False))
    '0.9866 to 1.013'
    >>> margin_text(SimpleNamespace(lower=0.0, upper=float("inf"), differ=False))
    'any'
    >>> margin_text(SimpleNamespace(lower=0.25, upper=0.75, nominal=0.5, differ=True))
    '−0.25 to +0.25'
    >>> margin_text(SimpleNamespace(lower=0.1, upper=float("inf"), nominal=0.5, differ=True))
    'from −0.4'
    """
    if margin is None:
        return "–"
    if margin.lower is None or margin.upper is None:
        return "none"
    if margin.differ:
        ends = margin.nominal - margin.lower, margin.upper - margin.nominal
        low, high = (sign + rounded(x, 4) for sign, x in zip("−+", ends, strict=True))
    else:
        low, high = rounded(margin.lower, 4, up=True), rounded(margin.upper, 4)
    if margin.lower == 0.0:
        return f"up to {high}" if math.isfinite(margin.upper) else "any"
    return f"{low} to {high}" if math.isfinite(margin.upper) else f"from {low}"


def delay_sentence(problem: Problem) -> list[str]:
    """The delay margin of the problem's first law, or that it was left out since it takes long.

    Nothing where it does not exist.
    """
    from deadtime.margins.delay import constant_delay_margin
    from deadtime.spectrum.held_mode_checks import why_left_out

    name, law = next(iter(problem.laws.items()))
    too_long = why_left_out("delay margin", problem.plant, law, problem.step)
    if too_long:
        return [sentence_of(too_long)]
    try:
        margin = constant_delay_margin(problem.plant, law, problem.step)
    except ArgumentError:
        return []
    but = f", without {', '.join(problem.imperfections_in_words)}," if problem.imperfections else ""
    return [f"Under the law “{name}”{but} {with_names(margin.message, problem.modes)}."]


def bound_headings(
    bounds: Mapping[str, TheoremBound], published: Mapping[str, float] | None = None
) -> tuple[str, ...]:
    """Headings of the columns of `bound_rows`."""
    headings = ("constant", *("as printed" if form == "printed" else form for form in bounds))
    return (*headings, "figure in the text") if published else headings


def bounds_of(problem: Problem, dwell_time: float) -> dict[str, TheoremBound]:
    """The bound in those of its forms that the delays allow: printed, corrected, sharp."""
    if problem.tracked:
        raise ArgumentError(
            "laws of a [servo] follow a reference, and the theorem is about those that bring the "
            "state to 0: leave [servo] out, and give [gains] for the states alone."
        )
    forms = stated_forms(problem.plant) or ("sharp",)
    return {
        form: theorem_bound(problem.plant, problem.gains, dwell_time, form=form) for form in forms
    }


def theorem_refusal(error: Exception) -> str:
    """Why there are no constants of the theorem: it does not apply, or a solver failed."""
    if isinstance(error, SolverError):
        return f"The theorem's constants were not computed: {error}"
    return f"The theorem does not apply: {error}"


def bound_rows(
    bounds: Mapping[str, TheoremBound], published: Mapping[str, float] | None = None
) -> list[tuple[str, ...]]:
    """Rows (quantity, a value per form), and a column of published figures if any.

    Examples
    --------
    >>> import deadtime as dt
    >>> rows = bound_rows(bounds_of(dt.problems.paper(), 0.2), dt.problems.paper().constants)
    >>> rows[0]
    ('distance ε', '0.7895', '0.7895', '0.7895', '0.7895')
    """

    def large(name: str, log_name: str):
        def write(bound: TheoremBound) -> str:
            value, logarithm = getattr(bound, name), getattr(bound, log_name)
            if value is None:
                return "–"
            return compact(value) if 0.0 < value < float("inf") else f"10^{logarithm:.1f}"

        return write

    def proved(rate: float) -> str:  # to the digits of `compact`
        return compact(float(rounded(rate, 3 if rate >= 1e-3 else 2)))

    quantities = {
        "distance ε": lambda bound: f"{bound.epsilon:.4g}",
        "allowed distance ε*": large("epsilon_star", "log10_epsilon_star"),
        "ν₁": large("nu1", "log10_nu1"),
        "ν₂": large("nu2", "log10_nu2"),
        "κ": large("kappa", "log10_kappa"),
        "b": lambda bound: "–" if bound.b is None else compact(bound.b),
        "δ₁(ε)": lambda bound: compact(bound.delta1(bound.epsilon)),
        "δ₂(ε)": lambda bound: compact(bound.delta2(bound.epsilon)),
        "μ, 1/s": lambda bound: "–" if bound.mu is None else compact(bound.mu),
        "ρ": large("rho", "log10_rho"),
        "ξ, 1/s": lambda bound: "–" if bound.xi is None else proved(bound.xi),
        "ε < ε*": lambda bound: "yes" if bound.holds else "no",
    }
    rows = []
    for name, write in quantities.items():
        row = (name, *(write(bound) for bound in bounds.values()))
        if published:
            row += (f"{published[name]:.4g}" if name in published else "",)
        rows.append(row)
    return rows


def bound_sentence(bounds: Mapping[str, TheoremBound]) -> str:
    """Whether the theorem proves the loop at hand stable, and how much the sharp form gains."""
    sharp, printed, ratio = bounds["sharp"], bounds.get("printed"), ""
    if printed is not None:
        gained = sharp.log10_epsilon_star - printed.log10_epsilon_star
        ratio = (
            f" The sharp form allows 10^{gained:.1f} times the distance that the printed one does."
        )
    if sharp.holds and sharp.xi is not None:
        return (
            f"The theorem proves this loop stable, updated continuously: |x| decays at least as "
            f"e^(−{rounded(sharp.xi, 2)} t), for every signal with the dwell time.{ratio}"
        )
    return (
        f"The theorem says nothing about this loop: its modes and gains differ by ε = "
        f"{compact(sharp.epsilon)}, and even the sharp form allows {compact(sharp.epsilon_star)}."
        f"{ratio}"
    )


def bounds_record(bounds: Mapping[str, TheoremBound]) -> dict[str, dict[str, Any]]:
    """The constants for JSON, which knows no infinity: their logarithms are always there."""
    names = ("epsilon", "epsilon_star", "nu1", "nu2", "kappa", "b", "mu", "rho", "xi")
    logs = [f"log10_{name}" for name in ("epsilon_star", "nu1", "nu2", "kappa", "rho")]
    fields = (*names, *logs, "holds", "message")
    return {form: record(bound, *fields) for form, bound in bounds.items()}
