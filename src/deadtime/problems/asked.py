"""What a problem is asked about: the one source of its dwell time and mean sojourn, with words.

Certificates, the theorem's bound, Monte Carlo and reports all ask here, so that they speak of the
same signals, and each says where its number comes from.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from deadtime.base.checks import number
from deadtime.base.errors import ArgumentError
from deadtime.problems.problem import Problem
from deadtime.switching import Rule, SwitchingSignal
from deadtime.switching.random import mean_or_twice

STEP = 0.01  # for problems whose loop is ideal, seconds
_OPTION = "as asked"


class Given(NamedTuple):
    """A number, seconds, and where it comes from."""

    value: float
    source: str


def step_of(problem: Problem) -> float:
    """The sampling period of a problem, seconds; `STEP` where its loop is ideal."""
    return problem.step or STEP


def dwell_time_of(
    problem: Problem, signal: SwitchingSignal | Rule, wanted: float | None = None
) -> Given:
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
    Given(value=0.2, source="the problem's dwell time")
    >>> unsaid = dataclasses.replace(problem, dwell_time=None)
    >>> dwell_time_of(unsaid, problem.signal)
    Given(value=0.2, source='the shortest sojourn of its signal')
    """
    if wanted is not None:
        return Given(number("dwell_time", wanted), _OPTION)
    if problem.dwell_time is not None:
        return Given(problem.dwell_time, "the problem's dwell time")
    if isinstance(signal, Rule):
        raise ArgumentError(
            f"dwell_time of {problem.name!r} is not known, for a rule decides the mode by the "
            "state: give --dwell-time."
        )
    if not math.isfinite(signal.dwell_time):
        return Given(problem.horizon, "the horizon, since its signal never switches")
    step = step_of(problem)
    periods = math.floor(signal.dwell_time / step * (1.0 + 1e-9))
    dwell = round(periods * step, 12) if periods > 1 else signal.dwell_time
    if problem.switching is not None:
        return Given(dwell, "the shortest sojourn of the one signal drawn; others may have shorter")
    return Given(dwell, "the shortest sojourn of its signal")


def mean_sojourn_of(problem: Problem, dwell: float, wanted: float | None = None) -> Given:
    """The mean sojourn that a problem is about, for signals with a dwell time.

    What somebody wanted; else the problem's. Twice the dwell time where the problem states none, or
    one that leaves no room above it.

    Examples
    --------
    >>> import deadtime as dt
    >>> mean_sojourn_of(dt.problems.paper(), 0.5)
    Given(value=1.0, source="twice the dwell time; the problem's, 0.4 s, is too short")
    """
    if wanted is not None:
        return Given(number("mean_sojourn", wanted), _OPTION)
    mean, twice = problem.mean_sojourn, mean_or_twice(dwell)
    if mean is None:
        return Given(twice, "twice the dwell time")
    if mean <= dwell:
        return Given(twice, f"twice the dwell time; the problem's, {mean:g} s, is too short")
    return Given(mean, "the problem's mean sojourn")
