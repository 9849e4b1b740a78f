"""`falsify`: search for the admissible switching signal along which the loop grows fastest."""

from __future__ import annotations

import math

import numpy as np

from deadtime.certificates.worst_case.candidates import candidates
from deadtime.certificates.worst_case.cycles import Cycle, Dwell
from deadtime.certificates.worst_case.loop import Growth, SampledLoop
from deadtime.certificates.worst_case.selection import Rated, improved, worst_of
from deadtime.certificates.worst_case.witness import WorstCase, worst_case
from deadtime.checks import count, instance, positive
from deadtime.errors import ArgumentError
from deadtime.feedback import Feedback
from deadtime.laws import ExactPredictor, Law
from deadtime.laws.base import TableLaw, require_match
from deadtime.plant import SwitchedSystem
from deadtime.spectrum import LiftedLoop, aged_row
from deadtime.switching import SwitchingSignal


def falsify(
    plant: SwitchedSystem,
    law: Law,
    dwell_time: float,
    step: float = 0.01,
    *,
    maximum_dwell: float | None = None,
    budget: int = 80_000,
) -> WorstCase:
    """The worst admissible switching signal found for a digital loop, and its growth rate.

    Admissible signals stay in every mode for at least the dwell time; constant ones are among
    them. What is found is a fact: the loop grows (or decays) at that rate along that signal. That
    no worse signal exists is not: `certify` is for that.

    Parameters
    ----------
    plant : SwitchedSystem
        The truth. The law has a model of its own, `law.plant`; delay and matrices may differ.
    law : Law
        A law that is a table and does not foresee the signal.
    dwell_time : float
        τ_d > 0, seconds, at least one period: the shortest sojourn.
    step : float
        Sampling period h, seconds.
    maximum_dwell : float, optional
        The longest sojourn, seconds; no mode may then last for ever (but for a plant of one mode).
    budget : int
        How many cycles and beginnings of cycles may be looked at on the compressed loop, about.

    Returns
    -------
    WorstCase
        The signal, its growth rate, and a run that shows it.

    Raises
    ------
    ArgumentError
        If the law and the plant do not belong together, the law is an oracle or no table, the
        dwell time is below one period, or `maximum_dwell` leaves no periodic signal.

    Notes
    -----
    Constant signals first, then cycles on the grid: branch and bound over words of sojourns on a
    compressed loop (`search`, `products`), the best evaluated on the loop itself by the spectral
    radius over a cycle (`loop`), then improved over switch instants off the grid (`instants`).
    Deterministic. N = 100 takes 1 to 2 seconds on one core, N = 1,000 about 5.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> worst = falsify(problem.plant, problem.laws["averaged"], dwell_time=0.2, step=0.05)
    >>> worst.message
    'The loop grows at +0.28 /s when mode 1 lasts for ever.'
    >>> worst.simulate(cycles=5).diverged
    False
    """
    feedback = _checked(plant, law, dwell_time, maximum_dwell, step)
    count("budget", budget)
    bounded = maximum_dwell is not None and plant.modes > 1
    dwell = Dwell.of(dwell_time, maximum_dwell if bounded else None, step)
    constants, loop = _constants(plant, feedback)
    found = [] if bounded else constants
    evaluated, upper = len(constants), None
    if plant.modes > 1:
        tried = candidates(loop, constants, dwell, budget)
        floor = -math.inf if bounded else max(growth.rate for _, growth in constants)
        better, looked = improved(loop, dwell, tried.cycles, floor)
        evaluated, upper = evaluated + tried.evaluated + looked, tried.upper_estimate
        found = [*found, *better]
    cycle, growth = worst_of(found, loop)
    return worst_case(loop, law, dwell_time, cycle, growth, evaluated, upper)


def _checked(
    plant: SwitchedSystem, law: Law, dwell_time: float, maximum_dwell: float | None, step: float
) -> Feedback:
    """The law's table, when the arguments belong together."""
    instance("plant", plant, SwitchedSystem)
    instance("law", law, Law)
    require_match(plant, law)
    if isinstance(law, ExactPredictor) or not isinstance(law, TableLaw):
        kind = type(law).__name__
        raise ArgumentError(
            f"law must be a table whose rows do not depend on the future, got {kind}: it "
            "foresees the signal, decides it by a rule or remembers an estimate, so no signal can "
            "be chosen against it."
        )
    step, dwell_time = positive("step", step), positive("dwell_time", dwell_time)
    if plant.modes > 1 and Dwell.of(dwell_time, None, step).least < 1.0:
        raise ArgumentError(
            f"dwell_time must be at least one period, got {dwell_time:g} s with step = {step:g} "
            "s: shorten the step, so that the law sees every mode."
        )
    if maximum_dwell is not None and positive("maximum_dwell", maximum_dwell) < dwell_time:
        raise ArgumentError(
            f"maximum_dwell must be at least dwell_time = {dwell_time:g} s, got "
            f"{maximum_dwell:g} s."
        )
    feedback = law.digital(step, SwitchingSignal.constant(0), 1)
    if feedback.context == "step":
        raise ArgumentError("law must have rows that do not depend on the step's index.")
    return feedback


def _constants(plant: SwitchedSystem, feedback: Feedback) -> tuple[list[Rated], SampledLoop]:
    """Every mode for ever, and the loop weighted by about the largest of these rates."""
    step = feedback.step
    rates = [
        LiftedLoop.of(plant, feedback, mode, aged_row(feedback, mode)).growth_rate(step)
        for mode in range(plant.modes)
    ]
    longest = max(plant.delay, feedback.taps * step)
    loop = SampledLoop.of(plant, feedback, max(*rates, -5.0 / longest))
    found = []
    for mode, rate in enumerate(rates):
        cycle = Cycle((mode,), (float(loop.held),))
        growth = loop.growth(cycle)
        vector = np.ones(loop.order, complex) if growth is None else growth.vector
        found.append((cycle, Growth(rate, vector)))
    return found, loop
