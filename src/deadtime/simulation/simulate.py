"""`simulate`: check the arguments, run the digital loop, lay the result out."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from deadtime.checks import instance, positive, real_array, shaped
from deadtime.errors import ArgumentError
from deadtime.feedback import Feedback
from deadtime.laws.base import Law
from deadtime.plant import SwitchedSystem
from deadtime.simulation.ideal import IdealRecord, run_ideal
from deadtime.simulation.initial_input import InitialInput, held_samples, input_function
from deadtime.simulation.record import DigitalRecord, PhaseTable
from deadtime.simulation.trajectory import Trajectory, trajectory_of
from deadtime.steps import Cuts, Window, modes_at, snap
from deadtime.switching import SwitchingSignal

ModeAt = Callable[[np.ndarray], np.ndarray]
_MOST_SAMPLES = 1e8


def simulate(
    plant: SwitchedSystem,
    law: Law,
    signal: SwitchingSignal,
    x0: ArrayLike,
    horizon: float,
    step: float | None = 0.01,
    u0: InitialInput = None,
    times: ArrayLike | None = None,
) -> Trajectory:
    """Simulate a plant under a law.

    Run at a period, the law is computed from x(t_k) and past inputs at t_k = k·step and held.
    Between samples, switches and arrivals of new inputs the plant is propagated by its matrix
    exponential, so the result is exact to round-off, wherever the switches fall and whatever
    the delay. With `step=None` the law is updated continuously; between the points where it is
    not analytic the loop is solved by collocation of high order.

    Parameters
    ----------
    plant : SwitchedSystem
        The truth. The law has a model of its own, `law.plant`; delay and matrices may differ.
    law : Law
        The feedback law.
    signal : SwitchingSignal
        The plant's switching signal.
    x0 : array_like, shape (n,)
        State at time 0.
    horizon : float
        Length of the run, in seconds.
    step : float or None
        Sampling period h, in seconds; None for the ideal loop, the law updated continuously.
    u0 : optional
        Inputs before time 0: None for 0, a constant (scalar or shape (m,)), a function of time
        on [−D, 0), or held samples of shape (m, N), oldest first. D is the longer of the two
        delays; the digital loop samples a function and holds it, and N counts its periods; for
        the ideal loop N samples divide D evenly. `run.history` is one, too.
    times : array_like, shape (T,), optional
        Instants in [0, horizon] to report, instead of the samples.

    Returns
    -------
    Trajectory
        A loop that diverges is a result: `run.diverged`, and `run.message` says when.

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
    instance("signal", signal, SwitchingSignal)
    _require_match(plant, law)
    signal.require_modes(plant.modes)
    x0 = _initial_state(x0, plant.states)
    asked = None if times is None else _checked_times(times, horizon)
    if step is None:
        record, end, mode_at = _ideal(plant, law, signal, x0, horizon, u0)
    else:
        record, end, mode_at = _digital(plant, law, signal, x0, horizon, positive("step", step), u0)
    diverged = end is not None
    end = horizon if end is None else end
    message = _message(diverged, end, signal, horizon)
    return trajectory_of(record, plant, signal, mode_at, law.gains, end, asked, diverged, message)


def _ideal(
    plant: SwitchedSystem,
    law: Law,
    signal: SwitchingSignal,
    x0: np.ndarray,
    horizon: float,
    u0: InitialInput,
) -> tuple[IdealRecord, float | None, ModeAt]:
    """The ideal run, where it ended if it diverged, and σ."""
    longest = max(plant.delay, law.plant.delay)
    forecast = law.ideal(signal, horizon)
    history = input_function(u0, plant.inputs, longest)
    record, end = run_ideal(plant, forecast, signal, x0, horizon, history)
    # A time within round-off before a switch is at it, as in the record.
    return record, end, lambda time: signal(time + record.states.slack)


def _digital(
    plant: SwitchedSystem,
    law: Law,
    signal: SwitchingSignal,
    x0: np.ndarray,
    horizon: float,
    step: float,
    u0: InitialInput,
) -> tuple[DigitalRecord, float | None, ModeAt]:
    """The digital run, where it ended if it diverged, and σ with switches snapped to samples."""
    if max(horizon, plant.delay, law.plant.delay) / step > _MOST_SAMPLES:
        raise ArgumentError(
            f"step = {step:g} s is too short: horizon and delay must hold at most "
            f"{_MOST_SAMPLES:.0e} steps; lengthen it or shorten the horizon."
        )
    samples = math.floor(snap(horizon / step)) + 1
    feedback = law.digital(step, signal, samples)
    window = Window.of(plant.delay, step)
    past = max(window.count, feedback.taps)
    inputs = np.zeros((past + samples, plant.inputs))
    inputs[:past] = held_samples(u0, plant.inputs, past, step, max(plant.delay, law.plant.delay))

    cuts = Cuts.of(signal, window)
    table = PhaseTable.of(plant, window, cuts, samples + window.count - 1)

    def mode_at(time: np.ndarray) -> np.ndarray:
        return modes_at(signal, time, step)

    age = math.floor(snap(signal.initial_age / step))
    rows = feedback.rows(mode_at(np.arange(samples) * step), age)
    kept, states, at_phase = _run(table, window, feedback, rows, x0, inputs, past)
    record = DigitalRecord(
        plant, window, cuts, table, states, at_phase, inputs[: past + kept], past, kept
    )
    return record, (kept - 1) * step if kept < samples else None, mode_at


def _run(
    table: PhaseTable,
    window: Window,
    feedback: Feedback,
    rows: np.ndarray,
    x0: np.ndarray,
    inputs: np.ndarray,
    past: int,
) -> tuple[int, np.ndarray, np.ndarray]:
    """Call the compiled loop with the rows of the table laid out for it, oldest input first."""
    from deadtime.simulation.kernel import closed_loop

    contexts, taps, m, _ = feedback.input_gain.shape
    G = feedback.input_gain[:, ::-1].transpose(0, 2, 1, 3).reshape(contexts, m, taps * m)
    return closed_loop(
        table.index,
        table.Phi,
        table.Gamma,
        window.count,
        feedback.state_gain,
        np.ascontiguousarray(G),
        rows,
        x0,
        inputs,
        past,
    )


def _initial_state(x0: ArrayLike, n: int) -> np.ndarray:
    """x0 with its size checked, within the limit at which a run counts as diverged."""
    state = shaped("x0", real_array("x0", x0, "(n,)", 1), (n,), "(n,)")
    if np.abs(state).max() > 1e100 / n:
        raise ArgumentError(
            f"x0 must be below 1e100, where a run counts as diverged, got {np.abs(state).max():g}."
        )
    return state


def _require_match(plant: SwitchedSystem, law: Law) -> None:
    """Refuse a law whose model has other sizes than the plant."""
    for name in ("modes", "states", "inputs"):
        mine, its = getattr(plant, name), getattr(law.plant, name)
        if mine != its:
            raise ArgumentError(
                f"law must be made for a plant with {mine} {name}, got a law for {its}: "
                "delay and matrices of the law's model may differ from the plant's, sizes not."
            )


def _checked_times(times: ArrayLike, horizon: float) -> np.ndarray:
    """Increasing instants within the run."""
    asked = real_array("times", times, "(T,)", 1)
    if asked[0] < 0.0 or asked[-1] > horizon or (np.diff(asked) < 0.0).any():
        raise ArgumentError(
            f"times must increase within [0, horizon] = [0, {horizon:g}], got "
            f"{asked[0]:g} … {asked[-1]:g}."
        )
    return asked


def _message(diverged: bool, end: float, signal: SwitchingSignal, horizon: float) -> str:
    notes = []
    if diverged:
        notes.append(f"diverged: |x| left 1e100 after t = {end:g} s, where the run ends.")
    if signal.end < min(end, horizon):
        notes.append(
            f"the signal ends at {signal.end:g} s and was continued in mode {signal.modes[-1]}."
        )
    return " ".join(notes)
