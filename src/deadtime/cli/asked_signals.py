"""Which signals, period and delays the options of `deadtime certify` and `verify` ask about."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from deadtime.base.errors import ArgumentError
from deadtime.cli.problems import numbers_of

if TYPE_CHECKING:
    from deadtime.problems import Problem
    from deadtime.problems.asked import Signals


def with_step(problem: Problem, step: float | None) -> Problem:
    from deadtime.base.checks import positive

    return problem if step is None else replace(problem, step=positive("step", step))


def delays_from(text: str) -> float | list[float] | list[list[float]]:
    """Delays as a problem file writes them: a number, or lists in brackets."""
    import json

    try:
        value = json.loads(text)
    except ValueError:
        value = None
    if isinstance(value, bool) or not isinstance(value, (int, float, list)):
        raise ArgumentError(
            f"--delays must be two numbers, or two lists such as [0.3,0.1], got {text!r}: leave "
            "out spaces, or quote each list."
        )
    return value


def times_from(name: str, text: str | None) -> list[float] | None:
    """Seconds with commas between them."""
    return None if text is None else numbers_of(name, text)


def signals_and_step(
    problem: Problem, dwell_time: str | None, maximum_dwell: str | None, chatter: int | None
) -> tuple[Signals, float]:
    """The signals and the period, in seconds, that a problem asks about."""
    from deadtime.problems.asked import signals_of, step_of

    promised = problem.dwell_time is not None or problem.average_dwell_time is not None
    if dwell_time is None and not promised and problem.switching is not None:
        raise ArgumentError(
            f"the problem {problem.name!r} has a model of its switching, which promises no dwell "
            "time, and no [signal] that does: the shortest sojourn of one drawn signal says "
            "nothing of others. Give --dwell-time."
        )
    times = times_from("dwell-time", dwell_time), times_from("maximum-dwell", maximum_dwell)
    return signals_of(problem, problem.signal, *times, chatter), step_of(problem)


def kept_by_search(
    problem: Problem,
    dwell_time: str | None,
    maximum_dwell: str | None,
    mode: int | None,
    chatter: int | None,
) -> dict[str, Any]:
    """What a search for the least dwell time keeps: proportions, longest sojourns, switches."""
    from deadtime.problems.asked import one_or_all, signals_of

    times = times_from("dwell-time", dwell_time), times_from("maximum-dwell", maximum_dwell)
    if mode is not None or dwell_time is not None:
        found = signals_of(problem, problem.signal, *times, chatter).options
        return found if mode is None else found | {"mode": mode}
    found = {} if problem.constraint is None else problem.constraint.options
    if not isinstance(found.get("dwell_time"), tuple):
        found.pop("dwell_time", None)  # one for all modes says nothing of their proportions
    if times[1] is not None:
        found["maximum_dwell"] = one_or_all(times[1])
    average = problem.average_dwell_time
    if chatter is None and average is not None:
        chatter = average[1]
    if chatter is not None:
        found["chatter"] = chatter
    return found
