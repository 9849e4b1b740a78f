"""`falsify`: search for the admissible switching signal along which the loop grows fastest."""

from __future__ import annotations

import math
from typing import Unpack

import numpy as np

from deadtime.base.checks import count, instance, positive
from deadtime.base.errors import ArgumentError
from deadtime.certificates.worst_case.candidates import candidates
from deadtime.certificates.worst_case.cycle_growth import Growth, SampledLoop
from deadtime.certificates.worst_case.cycles import Admissible, Cycle, Dwell
from deadtime.certificates.worst_case.run_search import RunLoop, worst_in_runs
from deadtime.certificates.worst_case.witness import WorstCase, worst_case
from deadtime.certificates.worst_case.worst_cycle import Rated, improve, with_losses, worst_of
from deadtime.feedback import Feedback, Law
from deadtime.feedback.law import require_match
from deadtime.feedback.recurrence import recurrence_of, same_outputs, with_lost_rows
from deadtime.plant import SwitchedSystem
from deadtime.spectrum import aged_row, constant_growth, with_memory
from deadtime.switching import SignalClass
from deadtime.switching.constraint import PerMode
from deadtime.switching.signal_class import SignalOptions


def falsify(
    plant: SwitchedSystem,
    law: Law,
    dwell_time: PerMode | SignalClass,
    step: float = 0.01,
    *,
    budget: int = 80_000,
    **signals: Unpack[SignalOptions],
) -> WorstCase:
    r"""The worst admissible switching signal found for a digital loop, and its growth rate.

    Admissible signals stay in every mode for at least the dwell time, as the controller's clock
    measures it; constant signals are included. `WorstCase.proven` says whether growth along the
    signal is proved; if not, and some constant mode provably grows, that mode is the result. A
    worse signal may exist: bounds over all signals are for `certify`.

    Parameters
    ----------
    plant : SwitchedSystem
        The plant. The law has a model of its own, `law.plant`; delay and matrices may differ.
    law : Law
        A law that needs no preview of the signal. For a law that is no table growth is measured in
        runs, to about 1 % of 1/D if the slowest motion dominates, and never proved. An
        `OutputFeedback` of a table is a table with a state, its estimate and sums, at a reference
        of 0.
    dwell_time : float, one per mode, or SignalClass
        :math:`\tau_d > 0`, seconds, at least one period unless modes change at samples only: the
        shortest sojourn; or the class of signals. With an average dwell time the search covers the
        signals whose every sojourn is that long.
    step : float
        Sampling period h, seconds.
    budget : int
        About the number of cycles, partial ones included, evaluated on the compressed loop; for a
        law that is no table, 400 times the number of runs.
    **signals
        Further options of the signals, as `certify` takes them. A mode with a `maximum_dwell` is
        never constant (except in a plant of one mode). `lost_samples` needs a law that is a table;
        the search then also chooses the lost samples.

    Returns
    -------
    WorstCase
        The signal, its growth rate, and a run that shows it.

    Raises
    ------
    ArgumentError
        If the law and the plant do not belong together, the law is an oracle, the dwell time is
        below one period, `clock_tolerance` is out of range, or `maximum_dwell` leaves no periodic
        signal.

    Notes
    -----
    Constant signals first, then cycles on the grid: branch and bound over words of sojourns on a
    compressed loop (`word_search`, `products`), the best evaluated on the loop itself by the
    spectral radius over a cycle (`cycle_growth`), then improved off the grid (`worst_cycle`).
    Growth is proved afterwards (`growth_proof`). Deterministic.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> worst = falsify(problem.plant, problem.laws["averaged"], dwell_time=0.2, step=0.05)
    >>> worst.message
    'The loop grows at +0.28 /s when mode 1 is constant.'
    >>> worst.simulate(cycles=5).diverged
    False
    """
    instance("plant", plant, SwitchedSystem)
    instance("law", law, Law)
    require_match(plant, law)
    if law.needs_preview:
        raise ArgumentError(
            f"law must not depend on the future, got {type(law).__name__}: it needs a preview of "
            "the signal, so none can be chosen against it."
        )
    step = positive("step", step)
    asked = SignalClass.of(dwell_time, **signals)
    least = min(asked.at_period(plant.modes, step, with_longest=False).dwell_time)
    several = plant.modes > 1
    if several and asked.at == "anywhere" and Dwell.of(least, math.inf, step).least < 1.0:
        raise ArgumentError(
            f"dwell_time must be at least one period, got {least:g} s with step = {step:g} s: "
            "shorten the step, so that the law sees every mode."
        )
    count("budget", budget)
    cycles = Admissible.of(asked, plant.modes, step)
    feedback = None if asked.mode_lag and not same_outputs(law) else recurrence_of(law, step)
    if feedback is not None and feedback.context == "step":
        raise ArgumentError("law must have rows that do not depend on the step's index.")
    if feedback is None and asked.lost_samples:
        raise ArgumentError(
            f"lost_samples needs a law that is a table, got {type(law).__name__}: run it with "
            "imperfections.Dropout, or leave lost_samples out."
        )
    if feedback is None:
        return worst_in_runs(RunLoop(plant, law, asked, step), cycles, budget)
    lag = asked.mode_lag if several and feedback.context != "none" else 0
    constants, loop = _constants(with_memory(plant, feedback), feedback, lag)
    known = [constants[mode] for mode in cycles.lasting]
    evaluated = len(constants)
    if cycles.recurring:
        words, rings, tried = candidates(loop, constants, cycles, budget)
        floor = max((growth.rate for _, growth in known), default=-math.inf)
        better, looked = improve(loop, cycles, words, rings, floor)
        evaluated, known = evaluated + tried + looked, [*known, *better]
    if asked.lost_samples:
        loop = SampledLoop.of(loop.plant, with_lost_rows(law, feedback), loop.shift)
        better, looked = with_losses(loop, known, asked.lost_samples)
        known, evaluated = [*known, *better], evaluated + looked
    about = plant, law, asked
    result = worst_case(loop, *about, *worst_of(known, loop), evaluated)
    if result.proven or result.growth_rate <= 0.0:
        return result
    # Growth that is not proved gives way to a constant mode with a proof.
    constant = [rated for rated in known if rated[0].constant and rated[1].rate > 0.0]
    for rated in sorted(constant, key=lambda rated: -rated[1].rate):
        other = worst_case(loop, *about, *rated, evaluated)
        if other.proven:
            return other
    return result


def _constants(
    plant: SwitchedSystem, feedback: Feedback, lag: int
) -> tuple[list[Rated], SampledLoop]:
    """The constant modes, and the loop weighted by about the largest of their rates."""
    step = feedback.step
    rates = [
        constant_growth(plant, feedback, mode, aged_row(feedback, mode))
        for mode in range(plant.modes)
    ]
    longest = max(plant.longest_delay, feedback.taps * step)
    loop = SampledLoop.of(plant, feedback, max(*rates, -5.0 / longest), lag)
    constants = []
    for mode, rate in enumerate(rates):
        cycle = Cycle((mode,), (float(loop.past),))
        growth = loop.growth(cycle)
        vector = np.ones(loop.order, complex) if growth is None else growth.vector
        constants.append((cycle, Growth(rate, vector)))
    return constants, loop
