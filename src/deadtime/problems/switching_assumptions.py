"""Assumptions on the switching signals of a problem: dwell time and mean sojourn, with sources.

Certificates, the theorem's bound, Monte Carlo and reports all take the signals from here.
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
AS_GIVEN = "as given"


class SourcedTime(NamedTuple):
    """A number, seconds, and where it comes from."""

    value: float
    source: str


class AssumedSignals(NamedTuple):
    """The signals of a problem; `dwell` is the shortest dwell time of a mode."""

    dwell: SourcedTime
    signals: SignalClass

    def in_words(self, modes: Sequence[str], step: float) -> str:
        """A sentence on the signals, with the names of the modes, and on the sampling.

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
        if len(modes) == 1:
            return f"The plant has one mode; sampling period {step:g} s{late}."
        return (
            f"Every signal that {stays} ({self.dwell.source}), {switches}; sampling period "
            f"{step:g} s{late}."
        )


def step_of(problem: Problem, given: float | None = None) -> float:
    """The given period, or that of a problem, seconds; `STEP` where its loop is ideal."""
    return problem.step or STEP if given is None else positive("step", given)


def dwell_time_of(
    problem: Problem, signal: SwitchingSignal | Rule, given: float | None = None
) -> SourcedTime:
    """The dwell time of a problem's signals, with its source.

    The given one; else the problem's; else that of its signal, rounded down to whole periods, since
    a proof for a shorter dwell time covers longer ones. A signal that never switches dwells for the
    horizon. Where a model draws the signal, the source warns that others may dwell shorter.

    Examples
    --------
    >>> import dataclasses, deadtime as dt
    >>> problem = dt.problems.paper()
    >>> dwell_time_of(problem, problem.signal)
    SourcedTime(value=0.2, source="the problem's dwell time")
    >>> unstated = dataclasses.replace(problem, signals=dt.SignalClass())
    >>> dwell_time_of(unstated, problem.signal)
    SourcedTime(value=0.2, source='the shortest sojourn of its signal')
    """
    if given is not None:
        return SourcedTime(number("dwell_time", given), AS_GIVEN)
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
    periods = math.floor(signal.dwell_time / step * (1.0 + 1e-9))  # 1e-9: round-off
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
    """The signals of a problem: dwell times, longest sojourns, transitions, and instants.

    `dwell_time` and `maximum_dwell` replace the problem's, seconds: one, or one per mode. With a
    `chatter` above 1, the problem's by default, `dwell_time` is an average one. `at` is by default
    as in the problem, which states no `mode_lag` and no `lost_samples`.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> signals_of(problem, problem.signal, maximum_dwell=[1.5]).signals.sentence(2)
    'for every switching signal whose sojourns last between 0.2 s and 1.5 s'
    """
    own, limits = problem.signals, problem.limits
    if dwell_time is None and own.chatter > 1:
        dwell = SourcedTime(limits.dwell_time[0], "the problem's average dwell time")
    else:
        dwell = dwell_time_of(problem, signal, min(dwell_time) if dwell_time else None)
    least = dwell.value if own.dwell_time is None else one_or_each(limits.dwell_time)
    most = one_or_each(limits.maximum_dwell)
    signals = SignalClass(
        least if dwell_time is None else one_or_all(dwell_time),
        most if maximum_dwell is None else one_or_all(maximum_dwell),
        None if limits.is_free else limits.transitions,
        own.at if at is None else at,
        mode_lag=mode_lag,
        lost_samples=lost_samples,
        chatter=own.chatter if chatter is None else chatter,
    )
    signals.limits(problem.plant.modes)  # refuses values that do not fit the modes
    return AssumedSignals(dwell, signals)


def one_or_all(values: Any) -> Any:
    """The number if there is one alone, which is for every mode; else the list."""
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


def mean_sojourn_of(problem: Problem, dwell: float, given: float | None = None) -> SourcedTime:
    """The mean sojourn of a problem's signals with a dwell time, with its source.

    The given one; else the problem's; twice the dwell time where the problem states no longer one.

    Examples
    --------
    >>> import deadtime as dt
    >>> mean_sojourn_of(dt.problems.paper(), 0.5)
    SourcedTime(value=1.0, source="twice the dwell time; the problem's, 0.4 s, is too short")
    """
    if given is not None:
        return SourcedTime(number("mean_sojourn", given), AS_GIVEN)
    mean, twice = problem.mean_sojourn, mean_or_twice(dwell)
    if mean is None:
        return SourcedTime(twice, "twice the dwell time")
    if mean <= dwell:
        return SourcedTime(twice, f"twice the dwell time; the problem's, {mean:g} s, is too short")
    return SourcedTime(mean, "the problem's mean sojourn")
