"""Stability margin: the largest value of anything for which a loop is stable, in a bracket."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Unpack

from deadtime.base.checks import number, positive
from deadtime.base.errors import ArgumentError, DeadtimeError
from deadtime.feedback import Law
from deadtime.margins.bracket import Bracket, Questions, bracket
from deadtime.plant import SwitchedSystem
from deadtime.spectrum import growth_bounds, growth_rate, least_growth
from deadtime.switching import SignalClass
from deadtime.switching.constraint import PerMode
from deadtime.switching.signal_class import SignalOptions

if TYPE_CHECKING:
    from deadtime.certificates import Certificate, WorstCase

Loop = tuple[SwitchedSystem, Law]


@dataclass(frozen=True, eq=False)
class StabilityMargin:
    """The largest value proved stable and the smallest refuted, as `stability_margin` found them.

    Attributes
    ----------
    certified : float
        The largest value for which the loop is certified for every admissible signal. Nothing
        is said about the values between two that were asked about.
    refuted : float or None
        The smallest value for which a signal was found along which the loop provably grows; None
        if none was.
    ratio : float or None
        refuted / certified; infinite where certified ≤ 0, None where refuted is None.
    proven : bool
        Whether the certificate at `certified` is a proof.
    certificate : Certificate
        The certificate at `certified`. It proves stability and asks for no particular rate.
    witness : WorstCase or None
        The growing signal at `refuted`.
    message : str
        The bracket in a sentence or two, and what kept it wide.
    evaluations : tuple of (float, bool or None)
        Every value asked about, in rising order, and the answer: None where there is none.
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
    """Bracket the largest value for which a loop is stable under every admissible signal.

    The value may be anything that a function turns into a plant and a law; see the examples.

    An error in the other direction is another function: ``lambda e: problem(-e)``.

    Parameters
    ----------
    problem : callable
        From a value to (plant, law); the law's model may differ from the plant.
    bounds : (low, high)
        The values to search between; the loop must be certified at `low`.
    dwell_time : float, one per mode, or SignalClass
        τ_d > 0, seconds: the signals are all those that stay in each mode at least so long; or all
        that is known of them.
    step : float
        Sampling period h > 0, seconds.
    ratio : float
        How close is close enough: the search ends when refuted / certified ≤ ratio, or when
        there is no answer between them.
    **signals
        Of the signals besides `dwell_time`, as `certify` takes them. A mode with a `maximum_dwell`
        is never held, so that its own growth refutes nothing.

    Raises
    ------
    ArgumentError
        If the loop cannot be certified at `low`, with the certificate's reason.

    Notes
    -----
    Where a constant mode that may last begins to grow is found by bisection, which is cheap;
    `certify` is asked just below, and what it refutes or cannot tell is followed down with
    `falsify` and `certify`, a few seconds each. Stability need not be monotone: constant modes are
    looked at for nine values below the certified one, too, and where one grows the bracket is the
    one below it.

    Examples
    --------
    Four values worth asking about. Each function returns the true plant and the law:

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
    asked = SignalClass.of(dwell_time, **signals)
    questions = _questions(problem, positive("step", step), asked)
    return _margin(bracket(questions, low, high, ratio), questions)


def _questions(problem: Callable[[float], Loop], step: float, signals: SignalClass) -> Questions:
    """The questions of `bracket` about a value."""
    from deadtime.certificates import certify, falsify

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
            for mode in signals.limits(plant.modes).lasting
        )

    return Questions(
        grows,
        lambda value: certify(*loop(value), signals, step, decay_rate=0.0),
        lambda value: falsify(*loop(value), signals, step),
    )


def _margin(found: Bracket, questions: Questions) -> StabilityMargin:
    ratio = None
    if found.refuted is not None:
        ratio = found.refuted / found.certified if found.certified > 0.0 else float("inf")
    return StabilityMargin(
        found.certified,
        found.refuted,
        ratio,
        found.certificate.proven,
        found.certificate,
        found.witness,
        _message(found),
        tuple(sorted(questions.answers.items())),
    )


def _message(found: Bracket) -> str:
    kind = "proved stable" if found.certificate.proven else "stable by numerical evidence"
    text = f"At {found.certified:.5g} {kind} for every admissible signal"
    if found.refuted is None:
        text += "; nothing higher was refuted."
        text += "" if found.open else " Look higher."
    else:
        text += f", at {found.refuted:.5g} not: a growing signal is known."
    if found.open is not None:
        text += f" No answer at {found.open[0]:.5g}: {found.open[1]}"
    if found.again:
        above = ", ".join(f"{value:.5g}" for value in sorted(found.again))
        text += f" Not monotone: certified above that again, at {above}."
    return text
