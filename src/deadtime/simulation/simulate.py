"""`simulate`: check the arguments, run the digital loop, lay the result out."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from deadtime.checks import positive, real_array, shaped
from deadtime.errors import ArgumentError
from deadtime.laws.base import Law
from deadtime.plant import SwitchedSystem
from deadtime.simulation.record import DigitalRecord, PhaseTable
from deadtime.simulation.trajectory import Trajectory, trajectory_of
from deadtime.steps import Cuts, Window, modes_at, snap
from deadtime.switching import SwitchingSignal

InitialInput = ArrayLike | Callable[[float], ArrayLike] | None


def simulate(
    plant: SwitchedSystem,
    law: Law,
    signal: SwitchingSignal,
    x0: ArrayLike,
    horizon: float,
    step: float = 0.01,
    u0: InitialInput = None,
    times: ArrayLike | None = None,
) -> Trajectory:
    """Simulate a plant under a law run at a period, exactly.

    The law is computed from x(t_k) and past inputs at t_k = k·step and held. Between samples,
    switches and arrivals of new inputs the plant is propagated by its matrix exponential, so
    the result is exact to round-off, wherever the switches fall and whatever the delay.

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
    step : float
        Sampling period h, in seconds.
    u0 : optional
        Inputs before time 0: None for 0, a constant (scalar or shape (m,)), a function of time
        on [−D, 0) that is sampled and held, or held samples of shape (m, N), oldest first, N
        periods of the longer of the two delays.
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
    horizon, step = positive("horizon", horizon), positive("step", step)
    _require_match(plant, law)
    signal.require_modes(plant.modes)
    x0 = _initial_state(x0, plant.states)
    asked = None if times is None else _checked_times(times, horizon)

    samples = math.floor(snap(horizon / step)) + 1
    feedback = law.digital(step, signal, samples)
    window = Window.of(plant.delay, step)
    past = max(window.count, feedback.taps)
    inputs = np.zeros((past + samples, plant.inputs))
    inputs[:past] = _history(u0, plant.inputs, past, step, max(plant.delay, law.plant.delay))

    cuts = Cuts.of(signal, window)
    table = PhaseTable.of(plant, window, cuts, samples + window.count - 1)

    def mode_at(time: np.ndarray) -> np.ndarray:
        return modes_at(signal, time, step)

    rows = feedback.rows(mode_at(np.arange(samples) * step))
    kept, states, at_phase = _run(table, window, feedback, rows, x0, inputs, past)
    record = DigitalRecord(
        plant, window, cuts, table, states, at_phase, inputs[: past + kept], past, kept
    )
    diverged = kept < samples
    end = (kept - 1) * step if diverged else horizon
    message = _message(diverged, end, signal, horizon)
    if asked is not None:
        asked = asked[asked <= end]
    return trajectory_of(record, end, mode_at, law.gains, asked, diverged, message)


def _run(table, window, feedback, rows, x0, inputs, past):
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


def _history(u0: InitialInput, m: int, past: int, step: float, delay: float) -> np.ndarray:
    """The `past` inputs held before time 0, (past, m), oldest first."""
    if u0 is None:
        return np.zeros((past, m))
    if callable(u0):
        values = [
            real_array("u0", np.atleast_1d(u0(max(-j * step, -delay))), "(m,) at every time", 1)
            for j in range(past, 0, -1)
        ]
        return np.stack([shaped("u0", v, (m,), "(m,) at every time") for v in values])
    if np.ndim(_regular(u0)) == 2:
        held = real_array("u0", u0, "(m, N)", 2)
        if held.shape != (m, past):
            raise ArgumentError(
                f"u0 must hold (m, N) = ({m}, {past}) samples, oldest first, one per period of "
                f"the longer delay {delay:g} s, got {held.shape}."
            )
        return held.T
    constant = real_array("u0", np.atleast_1d(_regular(u0)), "(m,)", 1)
    return np.tile(shaped("u0", constant, (m,), "(m,)"), (past, 1))


def _regular(value: ArrayLike) -> np.ndarray:
    """`value` as an array, refused when its rows have different lengths."""
    try:
        return np.asarray(value)
    except ValueError:
        raise ArgumentError(
            "u0 must be a number, (m,), (m, N) or a function, got rows of different lengths."
        ) from None


def _message(diverged: bool, end: float, signal: SwitchingSignal, horizon: float) -> str:
    notes = []
    if diverged:
        notes.append(f"diverged: |x| left 1e100 after t = {end:g} s, where the run ends.")
    if signal.end < min(end, horizon):
        notes.append(
            f"the signal ends at {signal.end:g} s and was continued in mode {signal.modes[-1]}."
        )
    return " ".join(notes)
