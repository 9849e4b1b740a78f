"""Which signals, period and delays the options of `deadtime certify` and `verify` ask about."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from deadtime.base.errors import ArgumentError
from deadtime.cli.problems import numbers_of

if TYPE_CHECKING:
    from deadtime.problems import Problem
    from deadtime.problems.asked import AskedSignals
    from deadtime.switching import SignalClass
    from deadtime.switching.signal_class import Instants


def with_step(problem: Problem, step: float | None) -> Problem:
    """A problem at another period; modes that change at its samples may change between those."""
    from deadtime.base.checks import positive
    from deadtime.plant.sampling import snap

    if step is None:
        return problem
    kept = snap((problem.step or 0.0) / positive("step", step)).is_integer()
    return replace(problem, step=step, switches_at=problem.switches_at if kept else "anywhere")


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
    problem: Problem,
    dwell_time: str | None,
    maximum_dwell: str | None,
    chatter: int | None,
    **others: Any,
) -> tuple[AskedSignals, float]:
    """The signals and the period, in seconds, that a problem asks about.

    `others`: what problems do not know of signals, as `signals_of` takes it.
    """
    from deadtime.problems.asked import signals_of, step_of

    promised = problem.dwell_time is not None or problem.average_dwell_time is not None
    if dwell_time is None and not promised and problem.switching is not None:
        raise ArgumentError(
            f"the problem {problem.name!r} has a model of its switching, which promises no dwell "
            "time, and no [signal] that does: the shortest sojourn of one drawn signal says "
            "nothing of others. Give --dwell-time."
        )
    times = times_from("dwell-time", dwell_time), times_from("maximum-dwell", maximum_dwell)
    return signals_of(problem, problem.signal, *times, chatter, **others), step_of(problem)


def kept_by_search(
    problem: Problem,
    dwell_time: str | None,
    maximum_dwell: str | None,
    mode: int | None,
    chatter: int | None,
    at: Instants | None,
) -> SignalClass:
    """What a search for the least dwell time keeps: proportions, longest sojourns, switches."""
    from deadtime.margins.dwell_time import SHORT
    from deadtime.problems.asked import signals_of, step_of

    times = times_from("dwell-time", dwell_time), times_from("maximum-dwell", maximum_dwell)
    least, own = times[0], problem.constraint
    if least is None and mode is None and (own is None or len(set(own.dwell_time)) == 1):
        least = [SHORT * step_of(problem)]  # one for all modes says nothing of their proportions
    return signals_of(problem, problem.signal, least, times[1], chatter, at).signals
