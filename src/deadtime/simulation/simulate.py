"""`simulate`: check the arguments, choose the loop, build the `Trajectory`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import count, instance, positive, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.feedback.law import require_match
from deadtime.imperfections import (
    ActuatorImperfection,
    Disturbance,
    Imperfection,
    SensorImperfection,
    Sizes,
    TimingImperfection,
    streams,
)
from deadtime.loop.received_samples import DrawnImperfections, Pairs, takes
from deadtime.plant import SwitchedSystem
from deadtime.plant.discretisation import TOLERANCE
from deadtime.simulation.digital import RunOutcome, run_table
from deadtime.simulation.forcing import Drawn
from deadtime.simulation.ideal.ideal_run import run_ideal
from deadtime.simulation.ideal.rule_march import run_ideal_rule
from deadtime.simulation.initial_input import InitialInput, input_function
from deadtime.simulation.online import ImperfectLaw, run_online
from deadtime.simulation.tracking import Followed
from deadtime.simulation.trajectory import Trajectory, belief_at, trajectory_of
from deadtime.simulation.truth import Grid, KnownTruth, RuleTruth
from deadtime.switching import Rule, SwitchingSignal
from deadtime.switching.rules.rule import as_rule

_MOST_SAMPLES = 1e8


def simulate(
    plant: SwitchedSystem,
    law: Law,
    signal: SwitchingSignal | Rule | Callable[[np.ndarray], int],
    x0: ArrayLike,
    horizon: float,
    step: float | None = 0.01,
    u0: InitialInput = None,
    times: ArrayLike | None = None,
    imperfections: Sequence[Imperfection] = (),
    seed: int = 0,
    predict: str = "applied",
) -> Trajectory:
    """Simulate a plant under a law.

    Run at a period, the law is computed from :math:`x(t_k)` and past inputs at :math:`t_k = k h`
    and held. Between samples, switches and arrivals of new inputs the plant is propagated by its
    matrix exponential, so the result is exact to round-off, wherever the switches fall and whatever
    the delay. With `step=None` the law is updated continuously; between the points where it is not
    analytic the loop is solved to high order.

    Parameters
    ----------
    plant : SwitchedSystem
        The true plant. The law has its own model, `law.plant`; delay and matrices may differ.
    law : Law
        The feedback law.
    signal : SwitchingSignal, HalfSpace, Polyhedra, QuadraticRegions or callable
        The plant's switching signal; or the rule by which the state decides the mode, which may be
        a function from a state of shape (n,) to a mode. `run.signal` is the resulting signal.
    x0 : array_like, shape (n,)
        State at time 0.
    horizon : float
        Length of the run, in seconds.
    step : float or None
        Sampling period h, in seconds; None for the ideal loop, the law updated continuously.
    u0 : optional
        Inputs before time 0: None for 0, a constant (scalar or shape (m,)), a function of time on
        :math:`[-D, 0)`, or held samples of shape (m, N), oldest first. D is the longer of the two
        delays; the digital loop samples a function and holds it, and N counts its periods; for the
        ideal loop N samples divide D evenly. `run.history` is one, too.
    times : array_like, shape (T,), optional
        Instants in [0, horizon] to report, instead of the samples. A run that ends early drops
        those past its end.
    imperfections : sequence of Imperfection
        Disturbances of the plant, and what sensors and actuators do, in this order
        (`deadtime.imperfections`); digital loop only. With sensors or actuators among them,
        `run.inputs` are the inputs applied, `run.commanded` the commands of the law and
        `run.measured` the measurements that it received. A law on outputs has these with or without
        imperfections, and `run.estimates`, its estimates of the state. A `BeliefPredictor` has
        `run.belief`, the probability of each mode.
    seed : int
        At least 0; of everything random in the imperfections.
    predict : "applied" or "commanded"
        Which past inputs the law receives, where the actuator changes them.

    Returns
    -------
    Trajectory
        A loop that diverges is a result: `run.diverged` is true and `run.message` says when. Where
        the vector fields of both modes point at a boundary, the plant slides along it, and
        `run.message` says how long. Where the rule is a function, which gives no boundary to slide
        along, or switches accumulate, the run ends, and `run.message` says that it was chattering.

    Raises
    ------
    ArgumentError
        If an argument is malformed, or the law and the plant do not belong together.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
    >>> run = dt.simulate(problem.plant, law, problem.signal, x0=[-1, 1], horizon=10)
    >>> run.states.shape, run.diverged
    ((2, 1001), False)
    """
    horizon = positive("horizon", horizon)
    instance("plant", plant, SwitchedSystem)
    instance("law", law, Law)
    require_match(plant, law)
    seed = count("seed", seed, 0)
    law = law.drawn(seed)
    if isinstance(signal, (list, tuple, np.ndarray)):
        raise ArgumentError(
            f"signal must be a SwitchingSignal or a rule, got a {type(signal).__name__}: modes "
            "need the times at which they begin, as in SwitchingSignal([0.0, 0.5], [0, 1])."
        )
    if isinstance(signal, SwitchingSignal):
        switching = signal.require_modes(plant.modes)
    else:
        switching = as_rule("signal", signal).require(plant)
    x0 = require_shape("x0", real_array("x0", x0, "(n,)", 1), (plant.states,), "(n,)")
    # Within |x| ≤ 1e100, where a run counts as diverged, whatever the norm of that many states is.
    if np.abs(x0).max() > 1e100 / x0.size:
        raise ArgumentError(
            f"x0 must be below 1e100, where a run counts as diverged, got {np.abs(x0).max():g}."
        )
    asked = None if times is None else _check_times(times, horizon)
    pairs = list(zip(imperfections, streams(imperfections, seed), strict=True))
    # An imperfection of two parts, a force and a sensor, is among both.
    disturbances = [(each, rng) for each, rng in pairs if isinstance(each, Disturbance)]
    at_samples = SensorImperfection, TimingImperfection, ActuatorImperfection
    others = [(each, rng) for each, rng in pairs if isinstance(each, at_samples)]
    if step is None:
        if imperfections:
            raise ArgumentError(
                "imperfections act at samples: give a step, the ideal loop has no samples."
            )
        outcome = _ideal(plant, law, switching, x0, horizon, u0)
    else:
        step = positive("step", step)
        require_steps(horizon, max(plant.longest_delay, law.plant.longest_delay), step)
        grid = Grid.of(plant, law, horizon, step, u0)
        outcome = _digital(plant, law, switching, x0, horizon, grid, others, predict, disturbances)
    end = horizon if outcome.end is None else outcome.end
    message = _message(outcome, end, horizon)
    given = plant, outcome.signal, law.gains, end, asked, outcome.diverged, message
    run = trajectory_of(outcome.record, *given)
    measured, commanded, estimates = (
        None if values is None else values.T for values in outcome.law_signals or (None,) * 3
    )
    return replace(
        run,
        measured=measured,
        commanded=commanded,
        estimates=estimates,
        belief=None if outcome.belief is None else belief_at(run, outcome.belief),
        followed=Followed.of(law),
    )


def _ideal(
    plant: SwitchedSystem,
    law: Law,
    switching: SwitchingSignal | Rule,
    x0: np.ndarray,
    horizon: float,
    u0: InitialInput,
) -> RunOutcome:
    """The ideal run."""
    delay = plant.longest_delay
    if horizon < TOLERANCE * delay:
        raise ArgumentError(
            f"horizon must be at least {TOLERANCE:.0e} of the delay = {delay:g} s, got "
            f"{horizon:g} s: are both in seconds? Lengthen it."
        )
    if not isinstance(switching, SwitchingSignal):
        return run_ideal_rule(plant, law, switching, x0, horizon, u0)
    forecast = law.ideal(switching, horizon)
    history = input_function(u0, plant.inputs, max(delay, law.plant.longest_delay))
    record, end = run_ideal(plant, forecast, switching, x0, horizon, history)
    return RunOutcome(record, switching, end, end is not None)


def _digital(
    plant: SwitchedSystem,
    law: Law,
    switching: SwitchingSignal | Rule,
    x0: np.ndarray,
    horizon: float,
    grid: Grid,
    others: Pairs,
    predict: str,
    disturbances: Drawn,
) -> RunOutcome:
    """The digital run: one kernel for a law with tables on a known signal, else period by period.

    A rule of the state and a law, sensor or actuator in Python have to be called at every sample.
    """
    measured = plant.states if law.outputs is None else law.outputs.shape[1]
    sizes = Sizes(plant.modes, measured, plant.inputs, grid.sampled.step)
    if disturbances or not isinstance(switching, SwitchingSignal):
        grid = replace(grid, sampled=grid.sampled.cut_alike())
    known = None
    if isinstance(switching, SwitchingSignal):
        known, truth = switching, KnownTruth(grid, switching, disturbances)
        tables = law.tables_along(sizes.step, known, grid.samples) if takes(others) else None
        if tables is not None and tables.bank is None:
            drawn = None
            if others:
                drawn = DrawnImperfections.of(others, sizes, grid.samples, predict)
            return run_table(law, tables, truth, x0, drawn)
    else:
        truth = RuleTruth(grid, switching, x0, disturbances)
    if not others and law.outputs is None:
        return run_online(law.online(sizes.step), truth, x0, horizon)
    update = law.online(sizes.step, known, None if known is None else grid.samples)
    imperfect = ImperfectLaw(update, sizes, others, predict, grid.samples, law.outputs)
    return run_online(imperfect, truth, x0, horizon)


def require_steps(horizon: float, delay: float, step: float) -> None:
    """Refuse steps of which the horizon or a delay holds too many, and horizons that hold none."""
    if horizon < TOLERANCE * step:
        raise ArgumentError(
            f"horizon must hold at least {TOLERANCE:.0e} of a step, got horizon = {horizon:g} s "
            f"and step = {step:g} s: are both in seconds? Lengthen the one or shorten the other."
        )
    if max(horizon, delay) / step > _MOST_SAMPLES:
        raise ArgumentError(
            f"step = {step:g} s is too short: horizon and delay must hold at most "
            f"{_MOST_SAMPLES:.0e} steps; lengthen it or shorten the horizon."
        )


def _check_times(times: ArrayLike, horizon: float) -> np.ndarray:
    """Increasing instants within the run."""
    asked = real_array("times", times, "(T,)", 1)
    if asked[0] < 0.0 or asked[-1] > horizon or (np.diff(asked) < 0.0).any():
        raise ArgumentError(
            f"times must increase within [0, horizon] = [0, {horizon:g}], got "
            f"{asked[0]:g} … {asked[-1]:g}."
        )
    return asked


def _message(outcome: RunOutcome, end: float, horizon: float) -> str:
    notes, signal = [], outcome.signal
    if outcome.diverged:
        notes.append(f"diverged: |x| left 1e100 after t = {end:g} s, where the run ends.")
    if signal.end < min(end, horizon):
        notes.append(
            f"the signal ends at {signal.end:g} s and was continued in mode {signal.modes[-1]}."
        )
    return " ".join([*notes, *filter(None, [outcome.note])])
