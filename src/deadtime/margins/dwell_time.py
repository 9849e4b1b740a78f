"""The least dwell time: how long modes have to last for a loop to be stable, in a bracket.

Signals with a longer dwell time are among those with a shorter one, so stability is lost once and
for all as it shrinks: in 1/τ_d this is the search of `bracket`. A growing signal refutes every
dwell time up to its own shortest sojourn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from deadtime.base.checks import instance, number, positive
from deadtime.base.errors import ArgumentError
from deadtime.certificates.clock import CLOCK_TOLERANCE, MOST_PERIODS
from deadtime.feedback import Law
from deadtime.feedback.law import require_match
from deadtime.feedback.recurrence import recurrence_of
from deadtime.margins.bracket import Bracket, Questions, bracket
from deadtime.plant import SwitchedSystem
from deadtime.spectrum import GROWS, growth_bounds, growth_rate

if TYPE_CHECKING:
    from deadtime.certificates import Certificate, WorstCase

SHORTEST = 1.0 + 2.0 * CLOCK_TOLERANCE  # periods: two switches in one are not described
CALM = 3.0  # time constants of the slowest mode: where proofs are sought first
DOUBLINGS = 6  # of that, before giving up
SAME = 1e-12  # of a dwell time, in 1/τ_d and back


@dataclass(frozen=True, eq=False)
class LeastDwellTime:
    """The shortest dwell time proved stable and the longest refuted, as `least_dwell_time` found.

    Attributes
    ----------
    certified : float or None
        Seconds: with this dwell time, and so with any longer one, the loop is certified for every
        admissible signal. None where no dwell time was certified.
    refuted : float or None
        Seconds: with this dwell time, and so with any shorter one, a signal is known that grows.
        Infinite where a constant mode grows; None if nothing was refuted.
    ratio : float or None
        certified / refuted; None where one of them is missing.
    proven : bool
        Whether the certificate is a proof.
    certificate : Certificate or None
        The certificate at `certified`. It asks for no particular decay rate.
    witness : WorstCase or None
        The growing signal at `refuted`.
    message : str
        The bracket in a sentence or two, and what kept it wide.
    evaluations : tuple of (float, bool or None)
        Every dwell time asked about, in rising order, and the answer: None where there is none.
    """

    certified: float | None
    refuted: float | None
    ratio: float | None
    proven: bool
    certificate: Certificate | None
    witness: WorstCase | None
    message: str
    evaluations: tuple[tuple[float, bool | None], ...]


def least_dwell_time(
    plant: SwitchedSystem, law: Law, step: float = 0.01, ratio: float = 1.01
) -> LeastDwellTime:
    """Bracket the least dwell time with which a loop is stable under every admissible signal.

    Parameters
    ----------
    plant : SwitchedSystem
        The truth, with two modes or more; the law has a model of its own.
    law : Law
        A law that is a table, or an `OutputFeedback` of one. One that relies on a dwell time keeps
        relying on its own.
    step : float
        Sampling period h > 0, seconds.
    ratio : float
        How close is close enough: the search ends when certified / refuted ≤ ratio, or when there
        is no answer between them.

    Raises
    ------
    ArgumentError
        If an argument is malformed, law and plant do not belong together, or the law is no table.

    Notes
    -----
    A few proofs and a few searches for growing signals: seconds for small loops, minutes for
    N = 100. Dwell times of a period or less are not asked about.

    Examples
    --------
    >>> import numpy as np, deadtime as dt
    >>> A = [[[0.0, 1.0], [-10.0, -1.0]], [[0.0, 1.0], [-0.1, -0.5]]]
    >>> plant = dt.SwitchedSystem(A, np.ones((2, 2, 1)), delay=0.3)
    >>> idle = dt.AveragedPredictor(plant, np.zeros((2, 1, 2)))
    >>> found = least_dwell_time(plant, idle, step=0.1, ratio=1.1)
    >>> 2.65 < found.refuted < 2.71 < found.certified < 3.0
    True
    """
    instance("plant", plant, SwitchedSystem)
    instance("law", law, Law)
    require_match(plant, law)
    step = positive("step", step)
    if plant.modes < 2:
        raise ArgumentError(
            "plant must have two modes or more, got one: without switches there is no dwell time. "
            "growth_rate says whether its loop is stable."
        )
    if law.foresees or recurrence_of(law, step) is None:
        raise ArgumentError(
            "law must be a table whose rows do not depend on the future, got "
            f"{type(law).__name__}: no dwell time of its loop can be certified."
        )
    if not number("ratio", ratio) > 1.0:
        raise ArgumentError(f"ratio must be above 1, got {ratio:g}.")
    questions = _questions(plant, law, step)
    shortest = SHORTEST * step
    worst = questions.falsify(1.0 / shortest)
    rates = [growth_rate(plant, law, mode, step) for mode in range(plant.modes)]
    mode = rates.index(max(rates))
    if rates[mode] > GROWS and growth_bounds(plant, law, mode, step)[0] > 0.0:
        message = (
            f"No dwell time is long enough: held in mode {mode} the loop grows at "
            f"{max(rates):+.4g} 1/s."
        )
        return LeastDwellTime(None, math.inf, None, False, None, worst, message, ())
    longest = _certified_dwell_time(questions, _calm(step, max(rates)), MOST_PERIODS * step)
    if longest is None:
        return _without_proof(questions, worst)
    grows = worst.growth_rate > GROWS and worst.proven
    lowest = _dwell_of(worst) if grows and math.isfinite(_dwell_of(worst)) else shortest
    return _in_seconds(bracket(questions, 1.0 / longest, 1.0 / lowest, ratio), questions)


def _questions(plant: SwitchedSystem, law: Law, step: float) -> Questions:
    """The questions of `bracket` about 1/τ_d; answers are remembered."""
    from deadtime.certificates import certify, falsify

    @cache
    def proof(frequency: float) -> Certificate:
        return certify(plant, law, 1.0 / frequency, step, decay_rate=0.0, search_signals=False)

    known: list[WorstCase] = []

    def worst(frequency: float) -> WorstCase:
        for found in known:
            if _dwell_of(found) * frequency >= 1.0 - SAME:
                return found
        found = falsify(plant, law, 1.0 / frequency, step)
        if found.growth_rate > GROWS and found.proven:
            known.append(found)
        return found

    return Questions(lambda _: False, proof, worst)


def _calm(step: float, slowest: float) -> float:
    """A dwell time after which not much is left of what a switch stirred up."""
    return max(4.0 * step, min(CALM / max(-slowest, 1e-9), 0.5 * MOST_PERIODS * step))


def _certified_dwell_time(questions: Questions, dwell_time: float, most: float) -> float | None:
    """A dwell time below `most` that is certified: this one, or up to 2^6 times as long."""
    for _ in range(DOUBLINGS + 1):
        if questions.proof(1.0 / dwell_time).stable:
            return dwell_time
        dwell_time = 2.0 * dwell_time
        if dwell_time >= most:
            break
    return None


def _without_proof(questions: Questions, worst: WorstCase) -> LeastDwellTime:
    refuted = _dwell_of(worst) if worst.growth_rate > GROWS and worst.proven else None
    evaluations = _evaluations(questions)
    reason = questions.proof(1.0 / evaluations[-1][0]).message
    return LeastDwellTime(
        None,
        refuted,
        None,
        False,
        None,
        worst if refuted is not None else None,
        f"No dwell time up to {evaluations[-1][0]:.4g} s was certified: {reason}",
        evaluations,
    )


def _in_seconds(found: Bracket, questions: Questions) -> LeastDwellTime:
    certified, refuted = 1.0 / found.certified, None
    text = f"Proved stable for every signal with a dwell time of {in_words(certified, up=True)} s"
    text += " or more"
    if found.witness is not None:
        refuted = _dwell_of(found.witness)
        text += f"; with {in_words(refuted)} s a growing signal is known."
    elif found.open is None:
        text += ": the shortest that can be described at this period."
    else:
        text += "; no shorter dwell time was refuted."
    if found.open is not None:
        text += f" No answer at {1.0 / found.open[0]:.5g} s: {found.open[1]}"
    return LeastDwellTime(
        certified,
        refuted,
        None if refuted is None else certified / refuted,
        found.certificate.proven,
        found.certificate,
        found.witness,
        text,
        _evaluations(questions),
    )


def in_words(dwell_time: float, *, up: bool = False) -> str:
    """Five digits, rounded to the side on which what is said of it stays true.

    Examples
    --------
    >>> in_words(2.00310371, up=True), in_words(1.77457964)
    ('2.0032', '1.7745')
    """
    if not math.isfinite(dwell_time):
        return "∞"
    unit = 10.0 ** (math.floor(math.log10(dwell_time)) - 4)
    whole = math.ceil if up else math.floor
    return f"{whole(dwell_time / unit) * unit:.5g}"


def _dwell_of(worst: WorstCase) -> float:
    """The longest dwell time with which a signal is admissible."""
    return math.inf if len(worst.modes) == 1 else float(min(worst.sojourns))


def _evaluations(questions: Questions) -> tuple[tuple[float, bool | None], ...]:
    return tuple(sorted((1.0 / value, answer) for value, answer in questions.answers.items()))
