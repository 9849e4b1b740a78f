"""`falsify`: search for the admissible switching signal along which the loop grows fastest."""

from __future__ import annotations

import math
from dataclasses import replace

from deadtime.certificates.worst_case.candidates import candidates
from deadtime.certificates.worst_case.cycles import Cycle, Dwell
from deadtime.certificates.worst_case.instants import COARSE, polished, refined
from deadtime.certificates.worst_case.loop import Growth, SampledLoop
from deadtime.certificates.worst_case.witness import WorstCase, worst_case
from deadtime.checks import count, instance, positive
from deadtime.errors import ArgumentError
from deadtime.feedback import Feedback
from deadtime.laws import ExactPredictor, Law
from deadtime.laws.base import TableLaw, require_match
from deadtime.plant import SwitchedSystem
from deadtime.spectrum import LiftedLoop, aged_row
from deadtime.switching import SwitchingSignal

TRIED = 12  # cycles evaluated on the loop itself
POLISHED = 3  # of them, cycles whose switches leave the grid
SHORT = 20  # periods: in so short a cycle the offset matters much
OFFSETS = (0.25, 0.5, 0.75)
MOVES = 80  # cycles looked at to improve one, per sojourn
LONGER = 1.25
BETTER = 1e-6  # per period: by how much a cycle must beat a constant signal

Rated = tuple[Cycle, Growth]


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
        improved, looked = _improved(loop, dwell, tried.cycles, floor)
        evaluated, upper = evaluated + tried.evaluated + looked, tried.upper_estimate
        found = [*found, *improved]
    cycle, growth = _worst(found, loop)
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
            "foresees the signal or decides it by a rule, so no signal can be chosen against it."
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


def _improved(
    loop: SampledLoop, dwell: Dwell, cycles: list[Cycle], floor: float
) -> tuple[list[Rated], int]:
    """The cycles with their growth, the best of them improved off the grid.

    `floor` is a growth rate, 1/s, that is known; little is spent on cycles below it.
    """
    rated, evaluated = [], 0
    for cycle in cycles[:TRIED]:
        growth = loop.growth(cycle, COARSE)
        evaluated += 1
        if growth is not None:
            rated.append((cycle, growth))
    rated.sort(key=lambda pair: -pair[1].rate)
    starts = rated[:POLISHED]
    for cycle, _ in rated[:POLISHED]:
        if cycle.periods <= SHORT:
            turned = [replace(cycle, offset=offset) for offset in OFFSETS]
            starts += [(c, g) for c in turned if (g := loop.growth(c, COARSE)) is not None]
            evaluated += len(OFFSETS)
    for cycle, growth in starts:
        most, longest = MOVES * len(cycle.modes), math.inf
        if growth.rate < floor:  # it would grow longer and longer, towards the constant signal
            most, longest = most // 4, LONGER * cycle.periods
        better, faster, looked = polished(loop, dwell, cycle, growth, most, longest)
        rated.append((better, faster))
        evaluated += looked
    rated.sort(key=lambda pair: -pair[1].rate)
    if rated:
        most = MOVES * len(rated[0][0].modes)
        better, growth, looked = refined(loop, dwell, *rated[0], most)
        rated.insert(0, (better, growth))
        evaluated += looked
    return rated, evaluated


def _worst(found: list[Rated], loop: SampledLoop) -> Rated:
    """The fastest growth; a constant signal where a cycle is hardly faster."""
    constant = [pair for pair in found if pair[0].constant]
    best = max(constant, key=lambda pair: pair[1].rate, default=None)
    margin = BETTER / loop.window.step if best is not None else 0.0
    cycles = sorted((pair for pair in found if not pair[0].constant), key=lambda p: -p[1].rate)
    for cycle, growth in cycles:
        if best is not None and growth.rate <= best[1].rate + margin:
            break
        exact = loop.growth(cycle)
        if exact is not None and (best is None or exact.rate > best[1].rate + margin):
            best, margin = (cycle, exact), 0.0
    if best is None:
        raise ArgumentError("law gives a loop whose growth over cycles cannot be computed.")
    return best
