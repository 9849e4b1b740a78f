"""The longest mode detection delay (mode lag) that a loop tolerates, proved and refuted.

Stability need not be monotone in the lag. So each lag has its own proof, and the bracket is about
the lags that were tried.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Unpack

from deadtime.base.checks import count, positive
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of
from deadtime.feedback import Law
from deadtime.feedback.law import require_match
from deadtime.feedback.recurrence import recurrence_of
from deadtime.plant import SwitchedSystem
from deadtime.plant.discretisation import snap
from deadtime.switching import SignalClass
from deadtime.switching.constraint import PerMode
from deadtime.switching.signal_class import SignalOptions

if TYPE_CHECKING:
    from deadtime.certificates import Certificate, WorstCase

DELAYS = 2.0  # the longest lag that is tried, in sums of the delay and the longest dwell time


@dataclass(frozen=True, eq=False)
class LongestModeLag:
    """The mode detection delays that a loop tolerates, in periods, by `longest_mode_lag`.

    Attributes
    ----------
    certified : int or None
        With this lag, and with every shorter one that was tried, the loop is proved stable for
        every admissible signal. None if it is not proved even without a lag.
    refuted : int or None
        The shortest lag tried with which a growing signal is known.
    step : float
        The period, seconds.
    reads_mode : bool
        Whether the law reads the mode; if not, no lag has an effect, and `certified` is the longest
        lag that was allowed.
    certificate : Certificate or None
        The proof at `certified`, of no particular decay rate.
    witness : WorstCase or None
        The growing signal at `refuted`.
    message : str
        The same in a sentence or two.
    evaluations : tuple of (int, bool or None)
        Every lag tried, ascending, and the answer: None for neither proof nor growing signal.
    """

    certified: int | None
    refuted: int | None
    step: float
    reads_mode: bool
    certificate: Certificate | None
    witness: WorstCase | None
    message: str
    evaluations: tuple[tuple[int, bool | None], ...]

    @property
    def certified_seconds(self) -> float | None:
        """`certified`, in seconds."""
        return None if self.certified is None else self.certified * self.step

    @property
    def refuted_seconds(self) -> float | None:
        """`refuted`, in seconds."""
        return None if self.refuted is None else self.refuted * self.step


def longest_mode_lag(
    plant: SwitchedSystem,
    law: Law,
    dwell_time: PerMode | SignalClass,
    step: float = 0.01,
    *,
    upto: int | None = None,
    **signals: Unpack[SignalOptions],
) -> LongestModeLag:
    """The longest mode detection delay proved stable, and the shortest refuted.

    Parameters
    ----------
    plant : SwitchedSystem
        The true plant.
    law : Law
        A law that is a table, as `certify` takes it.
    dwell_time : float, one per mode, or SignalClass
        Shortest sojourn, seconds; or the class of admissible signals.
    step : float
        Sampling period h > 0, seconds.
    upto : int, optional
        The longest lag to try, in periods; by default twice the sum of the delay and the longest
        dwell time.
    **signals
        Further properties of the signals, as `certify` takes them, without `mode_lag`, which is
        sought, and `lost_samples`.

    Returns
    -------
    LongestModeLag

    Raises
    ------
    ArgumentError
        If an argument is malformed, law and plant do not belong together, or the law is no table.

    Notes
    -----
    Lags 0, 1, 2, 4, … are tried until one is not proved, then bisection: `certified` + 1 was tried
    and not proved. Likewise for growing signals. A few certificates (`certify`) and a few searches
    (`falsify`).

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.problems.paper().plant.apart(0.5)
    >>> gains, model = dt.place(plant, [-1.0, -2.0]), dt.Markov([[0.0, 1.0], [1.0, 0.0]])
    >>> law = dt.ExpectedPredictor(plant, gains, model)
    >>> found = longest_mode_lag(plant, law, dwell_time=0.5, step=0.25)
    >>> found.certified, found.refuted, found.certified_seconds
    (1, 2, 0.25)
    """
    require_match(plant, law)
    step = positive("step", step)
    sought = SignalClass.of(dwell_time, **signals)
    limits = sought.limits(plant.modes)
    if sought.mode_lag or sought.lost_samples:
        raise ArgumentError(
            "mode_lag is what is sought, and lost_samples tell the mode late by themselves: leave "
            f"them out, got mode_lag = {sought.mode_lag}, lost_samples = {sought.lost_samples}."
        )
    table = None if law.needs_preview else recurrence_of(law, step)
    if table is None:
        raise ArgumentError(
            "law must be a table whose rows do not depend on the future, got "
            f"{type(law).__name__}: no lag of its mode can be certified."
        )
    ahead = max(plant.longest_delay, table.taps * step) + max(limits.dwell_time)
    most = round(snap(DELAYS * ahead / step))
    most = most if upto is None else count("upto", upto)
    asked = _LagQuestions(plant, law, sought, step)
    if plant.modes == 1 or table.context == "none":
        proof, text = asked.proof(0), "The law does not read the mode, so that no lag of it matters"
        text += "; without one the loop is proved stable." if proof.stable else f". {proof.message}"
        answers = tuple(asked.answers.items())
        certified, proof = (most, proof) if proof.stable else (None, None)
        return LongestModeLag(certified, None, step, False, proof, None, text, answers)
    certified, beyond = _edge(lambda lag: asked.proof(lag).stable is True, most)
    if certified is None:
        refuted = 0 if asked.worst(0).grows else None
        return _result(asked, None, refuted, step, most)
    refuted = None
    if beyond is not None:
        _, more = _edge(lambda lag: not asked.worst(beyond + lag).grows, most - beyond)
        refuted = None if more is None else beyond + more
    return _result(asked, certified, refuted, step, most)


def _edge(holds: Callable[[int], bool], most: int) -> tuple[int | None, int | None]:
    """Two successive numbers: `holds` is true at the first and false at the second.

    By doubling and bisection, of a condition that need not be monotone. The first is None if it is
    false at 0, the second if it is true at every number tried up to `most`.

    Examples
    --------
    >>> _edge(lambda k: k < 7, 20), _edge(lambda k: True, 20), _edge(lambda k: False, 20)
    ((6, 7), (20, None), (None, 0))
    """
    if not holds(0):
        return None, 0
    good, stride = 0, 1
    while good < most:
        tried = min(good + stride, most)
        if not holds(tried):
            bad = tried
            break
        good, stride = tried, 2 * stride
    else:
        return good, None
    while bad - good > 1:
        middle = (good + bad) // 2
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good, bad


class _LagQuestions:
    """Certificates and worst signals by lag, each computed once."""

    def __init__(self, plant: SwitchedSystem, law: Law, signals: SignalClass, step: float) -> None:
        from deadtime.certificates import certify, falsify

        self.answers: dict[int, bool | None] = {}

        @cache
        def proof(lag: int) -> Certificate:
            late = replace(signals, mode_lag=lag)
            found = certify(plant, law, late, step, decay_rate=0.0, search_signals=False)
            self.answers[lag] = found.stable
            return found

        @cache
        def worst(lag: int) -> WorstCase:
            found = falsify(plant, law, replace(signals, mode_lag=lag), step)
            self.answers[lag] = False if found.grows else self.answers.get(lag)
            return found

        self.proof, self.worst = proof, worst


def _result(
    asked: _LagQuestions, certified: int | None, refuted: int | None, step: float, most: int
) -> LongestModeLag:
    proof = None if certified is None else asked.proof(certified)
    witness = None if refuted is None else asked.worst(refuted)
    if certified is None:
        text = f"Not proved even if the mode is reported at once: {asked.proof(0).message}"
    else:
        text = f"Proved stable with the mode reported {_in_words(certified, step)} late"
    if certified == most:
        text += ", the longest lag that was asked about"
    if refuted is not None:
        text += f"; with {_in_words(refuted, step)} a growing signal is known."
    elif certified is not None:
        text += "." if certified == most else "; no longer lag was refuted."
    answers = tuple(sorted(asked.answers.items()))
    return LongestModeLag(certified, refuted, step, True, proof, witness, text, answers)


def _in_words(lag: int, step: float) -> str:
    return f"{number_of(lag, 'period')} ({lag * step:.4g} s)"
