"""Checks for wrong units: numbers of a problem that do not fit each other.

No number is wrong by itself, so nothing is refused; a sentence says what to check.
"""

from __future__ import annotations

import math

import numpy as np

from deadtime.base.wording import as_rate
from deadtime.problems.comparison import Comparison
from deadtime.problems.problem import Problem
from deadtime.simulation.outcome import is_pushed
from deadtime.spectrum import least_growth
from deadtime.switching import SwitchingSignal

_APART = 0.1  # relative: growth rates further apart do not agree


def unit_checks_of(problem: Problem, step: float | None = None) -> list[str]:
    """Sentences on a delay beyond the horizon, and on a step beyond that or the dwell time.

    Parameters
    ----------
    problem : Problem
        The setting.
    step : float, optional
        A sampling period instead of the problem's own, seconds.

    Examples
    --------
    >>> import dataclasses, deadtime as dt
    >>> problem = dataclasses.replace(dt.problems.paper(), step=1.5)
    >>> print(unit_checks_of(problem)[0])
    The step, 1.5 s, is longer than the dwell time, 0.2 s: modes come and go between two samples, \
and the law does not see them. Is it in seconds? Shorten it.
    """
    step = problem.step if step is None else step
    delay, horizon, sentences = problem.plant.delays.min(), problem.horizon, []
    if delay >= horizon:
        sentences.append(
            f"The delay, {delay:g} s, is not shorter than the horizon, {horizon:g} s: no "
            "computed input reaches the plant. Are both in seconds? Lengthen the horizon."
        )
    if step is not None and step >= horizon:
        sentences.append(
            f"The step, {step:g} s, is not shorter than the horizon, {horizon:g} s: the law acts "
            "once. Are both in seconds? Shorten the step."
        )
    sojourn, name = _sojourn(problem)
    if step is not None and step > sojourn:
        sentences.append(
            f"The step, {step:g} s, is longer than {name}, {sojourn:.4g} s: modes come and go "
            "between two samples, and the law does not see them. Is it in seconds? Shorten it."
        )
    return sentences


def disagreement_of(result: Comparison) -> list[str]:
    """A sentence if the growth rates of the spectrum and of a run in one mode disagree.

    Only if one of them is positive: a decaying run ends in round-off. Rates of 0 are left out:
    a relative difference from 0 means nothing.
    """
    names, lead = result.problem.modes, result.problem.laws[result.lead]
    if is_pushed(lead, ()):  # with a reference |x| says nothing about growth
        return []
    for name, exact, seen in zip(names, result.growth, result.measured, strict=True):
        size = max(abs(exact), abs(seen))
        both = math.isfinite(exact) and math.isfinite(seen)
        if (
            both
            and abs(exact) > least_growth(result.problem.plant)
            and max(exact, seen) > 0.0
            and abs(exact - seen) > _APART * size
        ):
            return [
                f"Held in {name} the run grows at {as_rate(seen)} /s, the loop at {as_rate(exact)} "
                "/s in the long run: the run is too short, or has too few samples, to show it. "
                "Lengthen the horizon, or shorten the step."
            ]
    return []


def _sojourn(problem: Problem) -> tuple[float, str]:
    """The expected sojourn, seconds, infinite if unknown, and its name.

    The dwell time stated, else that of the signal; of a signal drawn from a model, whose shortest
    sojourn may be any, the median sojourn.
    """
    signal = problem.signal
    if problem.dwell_time is not None:
        return problem.dwell_time, "the dwell time"
    if not isinstance(signal, SwitchingSignal) or signal.switches == 0:
        return math.inf, ""
    if problem.switching is None:
        return signal.dwell_time, "the dwell time"
    return float(np.median(np.diff(signal.times))), "half of the signal's sojourns"
