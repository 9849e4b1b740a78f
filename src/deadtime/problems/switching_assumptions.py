"""The signals that a problem is asked about: the one source of dwell time and mean sojourn.

Certificates, the theorem's bound, Monte Carlo and reports all ask here, so that they speak of the
same signals, and each says where its number comes from.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from deadtime.base.checks import number, positive
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of, with_names
from deadtime.problems.problem import Problem
from deadtime.switching import Rule, SignalClass, SwitchingSignal
from deadtime.switching.constraint import SwitchingConstraint, one_or_each
from deadtime.switching.models.semi_markov import SemiMarkov
from deadtime.switching.models.sojourns import Fixed, ShiftedExponential
from deadtime.switching.signal import mean_or_twice
from deadtime.switching.signal_class import Instants

STEP = 0.01  # for problems whose loop is ideal, seconds
AS_ASKED = "as asked"


class SourcedTime(NamedTuple):
    """A number, seconds, and where it comes from."""

    value: float
    source: str


class AssumedSignals(NamedTuple):
    """The signals that a problem is asked about; `dwell` is the shortest dwell time of a mode."""

    dwell: SourcedTime
    signals: SignalClass

    def in_words(self, modes: Sequence[str], step: float) -> str:
        """The signals, by the names of the modes, and the sampling, in a sentence.

        Examples
        --------
        >>> import deadtime as dt
        >>> problem = dt.problems.paper()
        >>> signals_of(problem, problem.signal, mode_lag=2).in_words(problem.modes, 0.01)
        "Every signal that stays in each mode for at least 0.2 s (the problem's dwell time), \
switches at any time; sampling period 0.01 s; the mode is reported 2 periods late."
        """
        stays, switches = (with_names(one, modes) for one in self.signals.in_words(len(modes)))
        lag, lost = self.signals.mode_lag, self.signals.lost_samples
        late = f"; the mode is reported {number_of(lag, 'period')} late" * (lag > 0)
        late += f"; up to {number_of(lost, 'sample')} in a row may be lost" * (lost > 0)
        return (
            f"Every signal that {stays} ({self.dwell.source}), {switches}; sampling period "
            f"{step:g} s{late}."
        )


def step_of(problem: Problem, wanted: float | None = None) -> float:
    """The period wanted, or that of a problem, seconds; `STEP` where its loop is ideal."""
    return problem.step or STEP if wanted is None else positive("step", wanted)


def dwell_time_of(
    problem: Problem, signal: SwitchingSignal | Rule, wanted: float | None = None
) -> SourcedTime:
    """The dwell time that a problem is about.

    What somebody wanted to know about, if anything; else the problem's own; where it states none,
    that of the signal, down to whole periods: what holds for every signal with the shorter one
    holds for those with the longer one. A signal that never switches is taken to dwell for the
    problem's horizon. Where a model draws the signal, its source says that others may be shorter.

    Examples
    --------
    >>> import dataclasses, deadtime as dt
    >>> problem = dt.problems.paper()
    >>> dwell_time_of(problem, problem.signal)
    SourcedTime(value=0.2, source="the problem's dwell time")
    >>> unsaid = dataclasses.replace(problem, signals=dt.SignalClass())
    >>> dwell_time_of(unsaid, problem.signal)
    SourcedTime(value=0.2, source='the shortest sojourn of its signal')
    """
    if wanted is not None:
        return SourcedTime(number("dwell_time", wanted), AS_ASKED)
    if problem.dwell_time is not None:
        several = len(set(problem.limits.dwell_time)) > 1
        return SourcedTime(problem.dwell_time, "the problem's dwell time" + "s" * several)
    if isinstance(signal, Rule):
        raise ArgumentError(
            f"dwell_time of {problem.name!r} is not known, for a rule decides the mode by the "
            "state: give --dwell-time."
        )
    if not math.isfinite(signal.dwell_time):
        return SourcedTime(problem.horizon, "the horizon, since its signal never switches")
    step = step_of(problem)
    periods = math.floor(signal.dwell_time / step * (1.0 + 1e-9))
    dwell = round(periods * step, 12) if periods > 1 else signal.dwell_time
    if problem.switching is not None or problem.signals.chatter > 1:
        return SourcedTime(
            dwell, "the shortest sojourn of the one signal drawn; others may have shorter"
        )
    return SourcedTime(dwell, "the shortest sojourn of its signal")


def signals_of(
    problem: Problem,
    signal: SwitchingSignal | Rule,
    dwell_time: Sequence[float] | None = None,
    maximum_dwell: Sequence[float] | None = None,
    chatter: int | None = None,
    at: Instants | None = None,
    mode_lag: int = 0,
    lost_samples: int = 0,
) -> AssumedSignals:
    """The signals that a problem is about: its dwell time, and what else it promises of them.

    `dwell_time` and `maximum_dwell` are what somebody wanted instead, seconds: one, or one per
    mode. With a `chatter` above 1, the problem's by default, `dwell_time` is an average one. Modes
    change `at` the instants that the problem says, by default. Lags and losses are no part of it.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> signals_of(problem, problem.signal, maximum_dwell=[1.5]).signals.sentence(2)
    'for every switching signal whose sojourns last between 0.2 s and 1.5 s'
    """
    own, limits = problem.signals, problem.limits
    if dwell_time is None and own.chatter > 1:
        given = SourcedTime(limits.dwell_time[0], "the problem's average dwell time")
    else:
        given = dwell_time_of(problem, signal, min(dwell_time) if dwell_time else None)
    least = given.value if own.dwell_time is None else one_or_each(limits.dwell_time)
    most = one_or_each(limits.maximum_dwell)
    asked = SignalClass(
        least if dwell_time is None else one_or_all(dwell_time),
        most if maximum_dwell is None else one_or_all(maximum_dwell),
        None if limits.is_free else limits.transitions,
        own.at if at is None else at,
        mode_lag=mode_lag,
        lost_samples=lost_samples,
        chatter=own.chatter if chatter is None else chatter,
    )
    asked.limits(problem.plant.modes)  # refuses what does not fit them
    return AssumedSignals(given, asked)


def one_or_all(values: Any) -> Any:
    """A time that was given as the only one is that of every mode."""
    return values[0] if values is not None and len(values) == 1 else values


def random_model(allowed: SwitchingConstraint, mean_sojourn: float | None = None) -> SemiMarkov:
    """Sojourns of the dwell time and an exponential time, then any mode that may follow.

    Means of whole sojourns, before longer ones than `maximum_dwell` are left out, are
    `mean_sojourn`, or twice the dwell time of the mode.

    Raises
    ------
    ArgumentError
        If a mean is below a dwell time, or a mode leads nowhere.

    Examples
    --------
    >>> import numpy as np
    >>> from deadtime.switching import SignalClass
    >>> ring = SignalClass([0.2, 0.2, 0.5], transitions=np.roll(np.eye(3), 1, 1)).limits(3)
    >>> random_model(ring).sample(3.0, seed=1).dwell_time > 0.2
    True
    """
    ways, sojourns = allowed.transitions.astype(float), []
    for i, least in enumerate(allowed.dwell_time):
        mean = mean_or_twice(least, mean_sojourn)
        if not ways[i].any():
            raise ArgumentError(
                f"transitions[{i}] allows no switch, and random signals go on switching: allow one "
                f"from mode {i}."
            )
        if mean < least:
            raise ArgumentError(
                f"mean_sojourn must be at least dwell_time = {least:g} s of mode {i}, got {mean:g}."
            )
        sojourns.append(ShiftedExponential(least, mean - least) if mean > least else Fixed(least))
    table = ways / ways.sum(axis=1, keepdims=True)
    limited = len(allowed.lasting) < allowed.modes
    return SemiMarkov(sojourns, table, maximum_dwell=allowed.maximum_dwell if limited else None)


def mean_sojourn_of(problem: Problem, dwell: float, wanted: float | None = None) -> SourcedTime:
    """The mean sojourn that a problem is about, for signals with a dwell time.

    What somebody wanted; else the problem's. Twice the dwell time where the problem states none, or
    one that leaves no room above it.

    Examples
    --------
    >>> import deadtime as dt
    >>> mean_sojourn_of(dt.problems.paper(), 0.5)
    SourcedTime(value=1.0, source="twice the dwell time; the problem's, 0.4 s, is too short")
    """
    if wanted is not None:
        return SourcedTime(number("mean_sojourn", wanted), AS_ASKED)
    mean, twice = problem.mean_sojourn, mean_or_twice(dwell)
    if mean is None:
        return SourcedTime(twice, "twice the dwell time")
    if mean <= dwell:
        return SourcedTime(twice, f"twice the dwell time; the problem's, {mean:g} s, is too short")
    return SourcedTime(mean, "the problem's mean sojourn")
