"""Stability margin: the largest value of a parameter for which a loop is stable, in a bracket.

The search needs few certificates and few searches for growing signals. The growth of a constant
mode takes milliseconds, so bisection finds the value at which it begins; a proof is sought just
below. If switching destabilises the loop before, bisection with searches for witnesses continues
from there. If a proof fails, others are sought further down, in steps that double, then by
bisection. Stability need not be monotone in the value: constant modes are checked at a few values
below the proved end too, and if one grows the bracket moves below it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import as_floats, number, positive, reporter
from deadtime.base.errors import ArgumentError, DeadtimeError
from deadtime.base.frozen import Frozen
from deadtime.base.wording import rounded
from deadtime.feedback import Law
from deadtime.plant import SwitchedSystem
from deadtime.spectrum import growth_bounds, growth_rate, least_growth
from deadtime.switching import SignalClass
from deadtime.switching.constraint import PerMode
from deadtime.switching.signal_class import SignalOptions

if TYPE_CHECKING:
    from deadtime.certificates import Certificate, WorstCase

FLOOR = 1e-6  # of the interval: the narrowest gap that is searched
CHECKS = 9  # values below the proved end at which constant modes are checked
ROUNDS = 8  # how often the bracket may move below a mode that grows there


@dataclass(eq=False)
class Questions:
    """The three tests of a value, and the log of their answers.

    Attributes
    ----------
    grows : callable
        From a value to whether some constant mode provably grows: the cheap test.
    certify : callable
        From a value to a certificate (`.stable`, `.message`, `.witness`).
    falsify : callable
        From a value to the worst case found (`.grows`).
    answers : dict
        From each value tested to stable (True), unstable (False) or unknown (None).
    """

    grows: Callable[[float], bool]
    certify: Callable[[float], Any]
    falsify: Callable[[float], Any]
    answers: dict[float, bool | None] = field(default_factory=dict)

    def is_lost(self, value: float) -> bool:
        grows = self.grows(value)
        self._note(value, False if grows else None)
        return grows

    def proof(self, value: float) -> Any:
        certificate = self.certify(value)
        self._note(value, certificate.stable)
        return certificate

    def witness(self, value: float) -> Any | None:
        """A worst case that provably grows, if one is found."""
        worst = self.falsify(value)
        found = worst if worst.grows else None
        self._note(value, None if found is None else False)
        return found

    def _note(self, value: float, stable: bool | None) -> None:
        known = self.answers.get(value)
        self.answers[value] = stable if known is None else known


@dataclass(frozen=True, eq=False)
class Bracket:
    """The result of the search, with fields as in `StabilityMargin`."""

    certified: float
    certificate: Any
    refuted: float | None = None
    witness: Any | None = None
    open: tuple[float, str] | None = None  # the lowest value without an answer, and why
    again: tuple[float, ...] = ()  # values above `refuted` that are proved stable


def bracket(ask: Questions, low: float, high: float, ratio: float) -> Bracket:
    """Search [low, high] until refuted / certified ≤ ratio, or until nothing between is decided.

    Raises
    ------
    ArgumentError
        If `low` is not certified.
    """
    start = ask.proof(low)
    if start.stable is not True:
        raise ArgumentError(
            f"low = {low:g} must be certified stable, and is not: {start.message} Begin closer "
            "to a loop that is known to be stable."
        )
    search = _BracketSearch(ask, low, start, ratio, FLOOR * (high - low))
    found = search.below(high)
    for _ in range(ROUNDS):
        lower = search.loss_below(found)
        if lower is None:
            break
        found = replace(search.down_to(lower), again=(*found.again, found.certified))
    if found.refuted is not None and found.witness is None:
        found = replace(found, witness=ask.witness(found.refuted))
    return found


@dataclass(frozen=True, eq=False)
class _BracketSearch:
    ask: Questions
    low: float
    start: Any
    ratio: float
    floor: float

    def width(self, value: float) -> float:
        """Half the gap at which the search ends near a value: one half for each end."""
        return max(0.5 * (1.0 - 1.0 / self.ratio) * abs(value), self.floor)

    def below(self, high: float) -> Bracket:
        """The bracket when nothing is known about `high`."""
        if self.ask.is_lost(high):
            return self.down_to(high)
        witness = self.ask.witness(high)
        if witness is not None:
            return self.switching_bracket(high, witness)
        return self.proofs(high, self.ask.proof(high), None, None)

    def down_to(self, refuted: float) -> Bracket:
        """The bracket below a value at which a constant mode grows."""
        last, refuted, _ = self.bisect(refuted, None, lambda value: self.ask.is_lost(value) or None)
        if last == self.low:
            return Bracket(self.low, self.start, refuted)
        certificate = self.ask.proof(last)
        if certificate.stable is False:
            return self.switching_bracket(last, certificate.witness)
        return self.proofs(last, certificate, refuted, None)

    def switching_bracket(self, refuted: float, witness: Any) -> Bracket:
        """The bracket below a value at which some signal grows, though no constant one may."""
        last, refuted, witness = self.bisect(refuted, witness, self.ask.witness)
        if last == self.low:
            return Bracket(self.low, self.start, refuted, witness)
        return self.proofs(last, self.ask.proof(last), refuted, witness)

    def bisect(
        self, refuted: float, witness: Any, ask: Callable[[float], Any | None]
    ) -> tuple[float, float, Any]:
        """Neighbouring values: `ask` finds nothing at the first and a witness at the second."""
        last = self.low
        while refuted - last > self.width(refuted):
            middle = 0.5 * (last + refuted)
            found = ask(middle)
            if found is None:
                last = middle
            else:
                refuted, witness = middle, found
        return last, refuted, witness

    def proofs(
        self, value: float, certificate: Any, refuted: float | None, witness: Any
    ) -> Bracket:
        """The bracket from certificates at and below a value whose own certificate is known."""
        good, proof, bad, reason = self.low, self.start, None, ""
        gap = self.width(value)
        while True:
            if certificate.stable is True:
                good, proof = value, certificate
            elif certificate.stable is False:
                refuted, witness, bad = value, certificate.witness, None
            else:
                bad, reason = value, certificate.message
            ceiling = bad if bad is not None else refuted
            if ceiling is None:
                break
            # Above a value without an answer another gap lies open: half the width is left here.
            if ceiling - good <= (1.0 if bad is not None else 2.0) * self.width(ceiling):
                break
            if good > self.low or ceiling - gap <= self.low + self.floor:
                value = 0.5 * (good + ceiling)
            else:
                value, gap = ceiling - gap, 2.0 * gap
            certificate = self.ask.proof(value)
        return Bracket(good, proof, refuted, witness, None if bad is None else (bad, reason))

    def loss_below(self, found: Bracket) -> float | None:
        """The lowest of a few values below the proved end at which a constant mode grows."""
        if found.certified - self.low <= self.floor:
            return None
        values = np.linspace(self.low, found.certified, CHECKS + 2)[1:-1]
        return next((float(value) for value in values if self.ask.is_lost(float(value))), None)


Loop = tuple[SwitchedSystem, Law]


@dataclass(frozen=True, eq=False)
class StabilityMargin:
    """The largest value proved stable and the smallest refuted, by `stability_margin`.

    Attributes
    ----------
    certified : float
        The largest value for which the loop is certified for every admissible signal. Nothing
        is known between two values that were tried.
    refuted : float or None
        The smallest value with a signal along which the loop provably grows; None if none was
        found.
    ratio : float or None
        refuted / certified; infinite if certified ≤ 0, None if refuted is None.
    proven : bool
        Whether the certificate at `certified` is a proof.
    certificate : Certificate
        The certificate at `certified`. It proves stability, with no particular decay rate.
    witness : WorstCase or None
        The growing signal at `refuted`.
    message : str
        The bracket in a sentence or two, and the reason why it is no narrower.
    evaluations : tuple of (float, bool or None)
        Every value tried, in rising order, and the answer: None for neither proof nor signal.
    """

    certified: float
    refuted: float | None
    ratio: float | None
    proven: bool
    certificate: Certificate
    witness: WorstCase | None
    message: str
    evaluations: tuple[tuple[float, bool | None], ...]


def stability_margin(
    problem: Callable[[float], Loop],
    bounds: Sequence[float],
    dwell_time: PerMode | SignalClass,
    step: float = 0.01,
    ratio: float = 1.01,
    **signals: Unpack[SignalOptions],
) -> StabilityMargin:
    r"""Bracket the largest value for which a loop is stable under every admissible signal.

    The value is the argument of a function that returns a plant and a law; see the examples. For an
    error in the other direction pass ``lambda e: problem(-e)``.

    Parameters
    ----------
    problem : callable
        From a value to (plant, law); the law's model may differ from the plant.
    bounds : (low, high)
        The values to search between; the loop must be certified at `low`.
    dwell_time : float, one per mode, or SignalClass
        :math:`\tau_d > 0`, seconds: admissible signals stay in each mode at least so long; or their
        class.
    step : float
        Sampling period h > 0, seconds.
    ratio : float
        The search ends when refuted / certified ≤ ratio, or when nothing between is decided.
    **signals
        Further properties of the signals, as `certify` takes them. A mode with a `maximum_dwell`
        is never held, so its own growth refutes nothing.

    Returns
    -------
    StabilityMargin

    Raises
    ------
    ArgumentError
        If the loop cannot be certified at `low`, with the certificate's reason.

    Notes
    -----
    Bisection, which is cheap, finds where a constant mode that may last begins to grow; `certify`
    runs just below, and from there `falsify` and `certify`, a few seconds each, search downwards.
    Stability need not be monotone: constant modes are also checked at nine values below the
    certified one, and if one grows the bracket is the one below it.

    Examples
    --------
    Four parameters of interest. Each function returns the true plant and the law:

    >>> import deadtime as dt
    >>> plant, poles = dt.problems.paper().plant, [-1.0, -2.0]
    >>> law = dt.AveragedPredictor(plant, dt.place(plant, poles))
    >>> def distance(alpha):  # the modes alpha times as far apart, gains placed anew
    ...     apart = plant.apart(alpha)
    ...     return apart, dt.AveragedPredictor(apart, dt.place(apart, poles))
    >>> def delay(D):  # another delay, and the law knows it
    ...     late = dt.SwitchedSystem(plant.A, plant.B, D)
    ...     return late, dt.AveragedPredictor(late, law.gains)
    >>> def delay_error(e):  # the true delay is (1 + e) times the law's
    ...     return dt.SwitchedSystem(plant.A, plant.B, (1.0 + e) * plant.delay), law
    >>> def gain_error(e):  # the true input gain is (1 + e) times the law's
    ...     return dt.SwitchedSystem(plant.A, (1.0 + e) * plant.B, plant.delay), law
    """
    from deadtime.certificates import certify, falsify

    if len(bounds) != 2:
        raise ArgumentError(f"bounds must be two values (low, high), got {len(bounds)}.")
    low, high = (number(f"bounds[{i}]", value) for i, value in enumerate(bounds))
    if not low < high:
        raise ArgumentError(
            f"bounds must be (low, high) with low < high, got ({low:g}, {high:g}): to search "
            "downwards, make the problem a function of the change, as in lambda e: problem(-e)."
        )
    if not number("ratio", ratio) > 1.0:
        raise ArgumentError(f"ratio must be above 1, got {ratio:g}.")
    step, asked = positive("step", step), SignalClass.of(dwell_time, **signals)

    def loop(value: float) -> Loop:
        try:
            found = problem(value)
        except DeadtimeError as error:
            raise ArgumentError(f"problem has no answer at {value:g}: {error}") from error
        if not (isinstance(found, tuple) and len(found) == 2):
            raise ArgumentError(
                f"problem must return (plant, law), got {type(found).__name__} at {value:g}."
            )
        return found

    def grows(value: float) -> bool:
        plant, law = loop(value)
        return any(
            growth_rate(plant, law, mode, step) > least_growth(plant)
            and growth_bounds(plant, law, mode, step)[0] > 0.0
            for mode in asked.limits(plant.modes).lasting
        )

    questions = Questions(
        grows,
        lambda value: certify(*loop(value), asked, step, decay_rate=0.0),
        lambda value: falsify(*loop(value), asked, step),
    )
    found = bracket(questions, low, high, ratio)
    apart = None
    if found.refuted is not None:
        apart = found.refuted / found.certified if found.certified > 0.0 else float("inf")
    return StabilityMargin(
        certified=found.certified,
        refuted=found.refuted,
        ratio=apart,
        proven=found.certificate.proven,
        certificate=found.certificate,
        witness=found.witness,
        message=_message(found),
        evaluations=tuple(sorted(questions.answers.items())),
    )


def _message(found: Bracket) -> str:
    kind = "proved stable" if found.certificate.proven else "stable by numerical evidence"
    text = f"At {rounded(found.certified, 5)} {kind} for every admissible switching signal"
    if found.refuted is None:
        text += "; nothing higher was refuted."
        text += "" if found.open else " Look higher."
    else:
        text += f", at {rounded(found.refuted, 5, up=True)} not: a growing signal is known."
    if found.open is not None:
        text += f" No answer at {found.open[0]:.5g}: {found.open[1]}"
    if found.again:
        above = ", ".join(f"{value:.5g}" for value in sorted(found.again))
        text += f" Not monotone: certified above that again, at {above}."
    return text


@dataclass(frozen=True, eq=False)
class StabilityChart(Frozen):
    """Margins over the dwell time, for several laws (immutable).

    Attributes
    ----------
    bounds : (float, float)
        The values that were searched between.
    dwell_times : (times,) array
        Rising, seconds.
    margins : mapping
        From a law's name to its margins, one per dwell time: None where the loop could not be
        certified even at the low bound.
    reasons : mapping
        From (law, dwell time) to the reason, where a margin is None.
    """

    bounds: tuple[float, float]
    dwell_times: Float[np.ndarray, " times"]
    margins: Mapping[str, tuple[StabilityMargin | None, ...]]
    reasons: Mapping[tuple[str, float], str]

    def certified(self, law: str) -> Float[np.ndarray, " times"]:
        """The largest certified value per dwell time; NaN where nothing is certified."""
        margins = self.margins[law]
        return np.array([np.nan if margin is None else margin.certified for margin in margins])

    def refuted(self, law: str) -> Float[np.ndarray, " times"]:
        """The smallest refuted value per dwell time; NaN where nothing is refuted."""
        values = [None if margin is None else margin.refuted for margin in self.margins[law]]
        return np.array([np.nan if value is None else value for value in values])


def stability_chart(
    laws: Mapping[str, Callable[[float, float], Loop]],
    bounds: Sequence[float],
    dwell_times: Sequence[float],
    step: float = 0.01,
    ratio: float = 1.02,
    progress: Callable[[str], None] | None = None,
) -> StabilityChart:
    """A stability margin for each law at each dwell time, which `plot_chart` draws.

    Parameters
    ----------
    laws : mapping
        From a name to a function of (value, dwell time) that returns (plant, law); laws that
        know nothing of the dwell time ignore the second.
    bounds, step, ratio
        As `stability_margin` takes them.
    dwell_times : sequence of float
        Seconds, in any order.
    progress : callable, optional
        Called with a few words before each margin, ``len(laws) * len(dwell_times)`` times.

    Raises
    ------
    ArgumentError
        If there is no law or no dwell time.
    """
    progress = reporter("progress", progress)
    times = np.unique(as_floats("dwell_times", dwell_times, "(T,) seconds"))
    if not laws or not times.size:
        raise ArgumentError("laws and dwell_times must hold at least one entry each.")
    margins: dict[str, tuple[StabilityMargin | None, ...]] = {}
    reasons: dict[tuple[str, float], str] = {}
    for name, loop in laws.items():
        row: list[StabilityMargin | None] = []
        for time in times.tolist():
            progress(f"{name}, dwell time {time:g} s")
            try:
                of_value = lambda value, loop=loop, time=time: loop(value, time)  # noqa: E731
                row.append(stability_margin(of_value, bounds, time, step, ratio))
            except ArgumentError as error:
                row.append(None)
                reasons[name, time] = str(error)
        margins[name] = tuple(row)
    return StabilityChart((bounds[0], bounds[1]), times, margins, reasons)
