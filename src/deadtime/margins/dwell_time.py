"""The least dwell time with which a loop is stable, in a bracket.

Signals with a longer dwell time are among those with a shorter one, so stability is lost once and
for all as the dwell time shrinks: in 1/τ_d this is the search of `bracket`. A growing signal
refutes every dwell time up to its own shortest sojourn. Both hold for a dwell time per mode, if all
shrink in proportion or one of them alone (`DwellShape`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Unpack

from deadtime.base.checks import index, number, positive
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import rounded
from deadtime.feedback import Law
from deadtime.feedback.law import require_match
from deadtime.feedback.recurrence import recurrence_of
from deadtime.margins.stability import Bracket, Questions, bracket
from deadtime.plant import SwitchedSystem
from deadtime.spectrum import growth_bounds, growth_rate, least_growth
from deadtime.switching import SignalClass
from deadtime.switching.constraint import PerMode, SwitchingConstraint, one_or_each
from deadtime.switching.signal_class import CLOCK_TOLERANCE, MOST_PERIODS, SignalOptions

if TYPE_CHECKING:
    from deadtime.certificates import Certificate, WorstCase

SHORTEST = 1.0 + 2.0 * CLOCK_TOLERANCE  # periods: certificates allow one switch in a period
AT_SAMPLES = 1.0 - 1e-10  # periods, where modes change at samples only
SHORT = 1e-9  # periods: a dwell time that stands for "any"
CALM = 3.0  # time constants of the slowest mode: the first dwell time that is certified
DOUBLINGS = 6  # of that, before the search ends without a proof
SAME = 1e-12  # relative: round-off of a dwell time converted to 1/τ_d and back
MOST_ROUNDED = MOST_PERIODS * (1.0 - 1e-9)  # of the longest dwell time, which round-off may miss


@dataclass(frozen=True)
class DwellShape:
    """Dwell times of all modes as functions of one time T: T times a weight, or fixed.

    Attributes
    ----------
    weights : tuple of float, one per mode
        Dwell times over T, the least of them 1; 0 where the dwell time is fixed.
    signals : SignalClass
        The properties of the signals that stay; with a chatter above 1 T is an average dwell time.
    limits : SwitchingConstraint
        The longest sojourns, the switches, and the dwell times that are fixed.
    mode : int or None
        The only mode whose dwell time changes, if not all change.

    Examples
    --------
    >>> shape = DwellShape.of(3, SignalClass([0.25, 0.75, 0.5], maximum_dwell=[2.0, 3.0, 4.0]))
    >>> shape.dwell_times(0.5), shape.longest
    ((0.5, 1.5, 1.0), 1.0)
    >>> DwellShape.of(3, SignalClass([0.25, 0.75, 0.5]), mode=1).dwell_times(0.125)
    (0.25, 0.125, 0.5)
    """

    weights: tuple[float, ...]
    signals: SignalClass
    limits: SwitchingConstraint
    mode: int | None = None

    @classmethod
    def of(cls, modes: int, signals: SignalClass, mode: int | None = None) -> DwellShape:
        """Dwell times in proportion to those of a class of signals, or that of one mode alone."""
        limits = signals.limits(modes)
        if mode is not None and signals.chatter > 1:
            raise ArgumentError(
                "chatter above 1 asks about one average dwell time for all modes: leave out mode."
            )
        if mode is None:
            least = min(limits.dwell_time)
            return cls(tuple(time / least for time in limits.dwell_time), signals, limits)
        mode = index("mode", mode, modes)
        return cls(tuple(float(i == mode) for i in range(modes)), signals, limits, mode)

    @property
    def longest(self) -> float:
        """The longest T, seconds; beyond it a dwell time would exceed its longest sojourn."""
        pairs = zip(self.weights, self.limits.maximum_dwell, strict=True)
        return min(most / weight for weight, most in pairs if weight)

    def dwell_times(self, time: float) -> tuple[float, ...]:
        """The dwell time of every mode at T, seconds."""
        return tuple(
            min(time * weight, most) if weight else fixed
            for weight, most, fixed in zip(
                self.weights, self.limits.maximum_dwell, self.limits.dwell_time, strict=True
            )
        )

    def at(self, time: float) -> SignalClass:
        """The admissible signals at T."""
        return replace(self.signals, dwell_time=one_or_each(self.dwell_times(time)))

    def admits(self, worst: WorstCase) -> float:
        """The longest T with which a signal is admissible, seconds; inf if every T admits it."""
        if len(worst.modes) == 1:
            return math.inf
        visits = zip(worst.modes, worst.sojourns, strict=True)
        times = (lasts / self.weights[mode] for mode, lasts in visits if self.weights[mode])
        return float(min(times, default=math.inf))

    @property
    def alike(self) -> bool:
        """Whether all modes have the same dwell time."""
        return self.mode is None and len(set(self.weights)) == 1


@dataclass(frozen=True, eq=False)
class LeastDwellTime:
    """The shortest dwell time proved stable and the longest refuted, by `least_dwell_time`.

    Attributes
    ----------
    certified : float or None
        Seconds: with this dwell time, and so with any longer one, the loop is certified for every
        admissible signal. If dwell times differ between modes, the shortest; of `mode`, its own.
        None if no dwell time was certified.
    refuted : float or None
        Seconds, likewise: with this dwell time, and so with any shorter one, a growing signal is
        known. Infinite if no dwell time is long enough; None if nothing was refuted.
    ratio : float or None
        certified / refuted; None if one of them is missing.
    proven : bool
        Whether the certificate is a proof.
    certificate : Certificate or None
        The certificate at `certified`, of no particular decay rate.
    witness : WorstCase or None
        The growing signal at `refuted`.
    message : str
        The bracket in a sentence or two, and the reason why it is no narrower.
    evaluations : tuple of (float, bool or None)
        Every dwell time tried, in rising order, and the answer: None for neither proof nor signal.
    certified_each, refuted_each : tuple of float, one per mode, or None
        The dwell times of every mode at `certified` and at `refuted`, seconds.
    """

    certified: float | None
    refuted: float | None
    ratio: float | None
    proven: bool
    certificate: Certificate | None
    witness: WorstCase | None
    message: str
    evaluations: tuple[tuple[float, bool | None], ...]
    certified_each: tuple[float, ...] | None = None
    refuted_each: tuple[float, ...] | None = None


def least_dwell_time(
    plant: SwitchedSystem,
    law: Law,
    step: float = 0.01,
    ratio: float = 1.01,
    *,
    dwell_time: PerMode | SignalClass | None = None,
    mode: int | None = None,
    **signals: Unpack[SignalOptions],
) -> LeastDwellTime:
    """Bracket the least dwell time with which a loop is stable under every admissible signal.

    Parameters
    ----------
    plant : SwitchedSystem
        The true plant, with two modes or more; the law has a model of its own.
    law : Law
        A law that is a table, or an `OutputFeedback` of one. The dwell time that a law assumes does
        not change.
    step : float
        Sampling period h > 0, seconds.
    ratio : float
        The search ends when certified / refuted ≤ ratio, or when there is no answer between them.
    dwell_time : float, one per mode, or SignalClass, optional
        The dwell times of the modes, seconds; the search scales all by one factor. By default all
        modes have the same.
    mode : int, optional
        Search the dwell time of this mode alone; the others keep their `dwell_time`.
    **signals
        Further properties of the signals, as `certify` takes them; they stay. A mode with a
        `maximum_dwell` is never held; with `chatter` above 1 the least *average* dwell time is
        sought, and signals that keep it in every sojourn refute it.

    Returns
    -------
    LeastDwellTime

    Raises
    ------
    ArgumentError
        If an argument is malformed, law and plant do not belong together, the law is no table, or
        `maximum_dwell` leaves no room above a period.

    Notes
    -----
    A few proofs and a few searches for growing signals: seconds for small loops, minutes for
    N = 100. Dwell times of a period or less are not tried; if the mode changes at samples only,
    none below a period.

    Examples
    --------
    >>> import numpy as np, deadtime as dt
    >>> A = [[[0.0, 1.0], [-10.0, -1.0]], [[0.0, 1.0], [-0.1, -0.5]]]
    >>> plant = dt.SwitchedSystem(A, np.ones((2, 2, 1)), delay=0.3)
    >>> idle = dt.AveragedPredictor(plant, np.zeros((2, 1, 2)))
    >>> found = least_dwell_time(plant, idle, step=0.1, ratio=1.1)
    >>> 2.65 < found.refuted < 2.71 < found.certified < 3.0
    True
    >>> slow = least_dwell_time(plant, idle, step=0.1, ratio=1.1, dwell_time=[4.0, 1.0], mode=1)
    >>> slow.certified_each[0], slow.certified < found.certified
    (4.0, True)
    """
    require_match(plant, law)
    step = positive("step", step)
    if plant.modes < 2:
        raise ArgumentError(
            "plant must have two modes or more, got one: without switches there is no dwell time. "
            "growth_rate says whether its loop is stable."
        )
    if law.needs_preview or recurrence_of(law, step) is None:
        raise ArgumentError(
            "law must be a table whose rows do not depend on the future, got "
            f"{type(law).__name__}: no dwell time of its loop can be certified."
        )
    if not number("ratio", ratio) > 1.0:
        raise ArgumentError(f"ratio must be above 1, got {ratio:g}.")
    if mode is not None and dwell_time is None:
        raise ArgumentError(
            "dwell_time must be given with mode: the dwell times that the other modes keep."
        )
    least = SHORT * step if dwell_time is None else dwell_time  # any: only proportions count
    shape = DwellShape.of(plant.modes, SignalClass.of(least, **signals), mode)
    shortest = (SHORTEST if shape.signals.at == "anywhere" else AT_SAMPLES) * step
    if shape.longest <= shortest:
        raise ArgumentError(
            f"maximum_dwell must leave room above a period of {step:g} s, and dwell times up to "
            f"{shape.longest:g} s do not: raise it, or shorten the step."
        )
    questions = _questions(plant, law, step, shape)
    worst = questions.falsify(1.0 / shortest)
    rates = {i: growth_rate(plant, law, i, step) for i in shape.limits.lasting}
    slowest = max(rates.values(), default=-math.inf)
    for i, rate in rates.items():
        if rate == slowest > least_growth(plant) and growth_bounds(plant, law, i, step)[0] > 0.0:
            message = (
                f"No dwell time is long enough: held in mode {i} the loop grows at {rate:+.4g} 1/s."
            )
            return _uncertified(math.inf, worst, message)
    if worst.grows and len(worst.modes) > 1 and math.isinf(shape.admits(worst)):
        message = f"No dwell time of mode {shape.mode} is long enough: {worst.message}"
        return _uncertified(math.inf, worst, message)
    most = min(shape.longest, MOST_ROUNDED * step / max(shape.weights) / shape.signals.chatter)
    # After a few time constants the transient of a switch has decayed: a proof is likely there.
    calm = max(4.0 * step, min(CALM / max(-slowest, 1e-9), 0.5 * MOST_PERIODS * step))
    longest = _certified_dwell_time(questions, min(calm if rates else 0.5 * most, most), most)
    if longest is None:
        return _without_proof(questions, worst, shape)
    lowest = shape.admits(worst) if worst.grows and math.isfinite(shape.admits(worst)) else shortest
    return _in_seconds(bracket(questions, 1.0 / longest, 1.0 / lowest, ratio), questions, shape)


def _questions(plant: SwitchedSystem, law: Law, step: float, shape: DwellShape) -> Questions:
    """The questions of `bracket` about 1/T; certificates and witnesses are kept."""
    from deadtime.certificates import certify, falsify

    @cache
    def proof(frequency: float) -> Certificate:
        signals = shape.at(1.0 / frequency)
        return certify(plant, law, signals, step, decay_rate=0.0, search_signals=False)

    known: list[WorstCase] = []

    def worst(frequency: float) -> WorstCase:
        for found in known:
            if shape.admits(found) * frequency >= 1.0 - SAME:
                return found
        found = falsify(plant, law, shape.at(1.0 / frequency), step)
        if found.grows:
            known.append(found)
        return found

    return Questions(lambda _: False, proof, worst)


def _certified_dwell_time(questions: Questions, dwell_time: float, most: float) -> float | None:
    """A dwell time of `most` or less that is certified: this one, or up to 2^6 times as long."""
    for _ in range(DOUBLINGS + 1):
        if questions.proof(1.0 / dwell_time).stable:
            return dwell_time
        if dwell_time >= most:
            break
        dwell_time = min(2.0 * dwell_time, most)
    return None


def _without_proof(questions: Questions, worst: WorstCase, shape: DwellShape) -> LeastDwellTime:
    evaluations = _evaluations(questions)
    reason = questions.proof(min(questions.answers)).message  # cached: the longest that was tried
    each = _each(evaluations[-1][0], shape)
    found = f"No {_of(shape)} up to {each} s was certified: {reason}"
    if not worst.grows:
        return _uncertified(None, None, found, evaluations)
    refuted = shape.admits(worst)
    return _uncertified(refuted, worst, found, evaluations, shape.dwell_times(refuted))


def _uncertified(
    refuted: float | None,
    witness: WorstCase | None,
    message: str,
    evaluations: tuple[tuple[float, bool | None], ...] = (),
    refuted_each: tuple[float, ...] | None = None,
) -> LeastDwellTime:
    return LeastDwellTime(
        certified=None,
        refuted=refuted,
        ratio=None,
        proven=False,
        certificate=None,
        witness=witness,
        message=message,
        evaluations=evaluations,
        refuted_each=refuted_each,
    )


def _in_seconds(found: Bracket, questions: Questions, shape: DwellShape) -> LeastDwellTime:
    certified, refuted = 1.0 / found.certified, None
    proved = _each(certified, shape, up=True)
    text = f"Proved stable for every signal with {_of(shape, 'a')} of {proved} s or more"
    if shape.signals.at == "samples":
        text += ", of modes that change at samples only"
    if found.witness is not None:
        refuted = shape.admits(found.witness)
        text += f"; with {_each(refuted, shape)} s a growing signal is known."
    elif found.open is None:
        text += ": the shortest that can be described at this period."
    else:
        text += "; no shorter dwell time was refuted."
    if found.open is not None:
        text += f" No answer at {_each(1.0 / found.open[0], shape)} s: {found.open[1]}"
    return LeastDwellTime(
        certified=certified,
        refuted=refuted,
        ratio=None if refuted is None else certified / refuted,
        proven=found.certificate.proven,
        certificate=found.certificate,
        witness=found.witness,
        message=text,
        evaluations=_evaluations(questions),
        certified_each=shape.dwell_times(certified),
        refuted_each=None if refuted is None else shape.dwell_times(refuted),
    )


def _of(shape: DwellShape, article: str = "") -> str:
    if shape.signals.chatter > 1:
        return f"{article and article + 'n '}average dwell time"
    article = article and article + " "
    if shape.mode is not None:
        return f"{article}dwell time in mode {shape.mode}"
    return f"{article}dwell time" + ("" if shape.alike else " in each mode")


def _each(time: float, shape: DwellShape, *, up: bool = False) -> str:
    times = shape.dwell_times(time) if shape.mode is None else (time,)
    times = times[:1] if shape.alike else times
    return ", ".join(rounded(one, 5, up=up) for one in times)


def _evaluations(questions: Questions) -> tuple[tuple[float, bool | None], ...]:
    return tuple(sorted((1.0 / value, answer) for value, answer in questions.answers.items()))
