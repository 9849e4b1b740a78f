"""Numbers of a problem that do not fit each other, as where a unit was mistaken.

Nothing here is wrong by itself, so nothing is refused: a sentence says what to look at.
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
        A sampling period to ask about instead of the problem's own, seconds.

    Examples
    --------
    >>> import dataclasses, deadtime as dt
    >>> problem = dataclasses.replace(dt.problems.paper(), step=1.5)
    >>> print(unit_checks_of(problem)[0])
    The step, 1.5 s, is longer than the dwell time, 0.2 s: modes come and go between two samples, \
and the law does not see them. Is it in seconds? Shorten it.
    """
    step = problem.step if step is None else step
    delay, horizon, found = problem.plant.delays.min(), problem.horizon, []
    if delay >= horizon:
        found.append(
            f"The delay, {delay:g} s, is not shorter than the horizon, {horizon:g} s: nothing that "
            "a law does reaches the plant in this run. Are both in seconds? Lengthen the horizon."
        )
    if step is not None and step >= horizon:
        found.append(
            f"The step, {step:g} s, is not shorter than the horizon, {horizon:g} s: the law acts "
            "once. Are both in seconds? Shorten the step."
        )
    stay, what = _stay(problem)
    if step is not None and step > stay:
        found.append(
            f"The step, {step:g} s, is longer than {what}, {stay:.4g} s: modes come and go "
            "between two samples, and the law does not see them. Is it in seconds? Shorten it."
        )
    return found


def disagreement_of(result: Comparison) -> list[str]:
    """That the spectrum and the runs in one mode tell growth rates that do not agree.

    Only where one of them says that the loop grows: a run that decays ends in round-off. A rate of
    0 is no figure to be near to.
    """
    names, lead = result.problem.modes, result.problem.laws[result.lead]
    if is_pushed(lead, ()):  # towards a reference: |x| says nothing of growth
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


def _stay(problem: Problem) -> tuple[float, str]:
    """How long modes are expected to last, infinite where nothing says it, and what that is.

    The dwell time stated, else that of the signal. A signal drawn from a model may have sojourns
    as short as they come: there it is the median.
    """
    signal = problem.signal
    if problem.dwell_time is not None:
        return problem.dwell_time, "the dwell time"
    if not isinstance(signal, SwitchingSignal) or signal.switches == 0:
        return math.inf, ""
    if problem.switching is None:
        return signal.dwell_time, "the dwell time"
    return float(np.median(np.diff(signal.times))), "half of the signal's sojourns"
