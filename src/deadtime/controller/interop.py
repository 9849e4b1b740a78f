"""Laws and plants as systems of python-control, which closes the loop with its own simulator.

Both are discrete `NonlinearIOSystem`s at the period h: the mode is an input of each. Their states
hold the inputs of the last N periods, the latest first, so a loop of the two starts with both
histories at zero. Needs the extra `control`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import count, instance, positive
from deadtime.base.errors import ArgumentError
from deadtime.base.libraries import python_control
from deadtime.feedback import Law
from deadtime.feedback.law import TableLaw, require_match
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.sampled_plant import acting_inputs

_DISTURBED = 1e-3  # `control.linearize` moves every input and state a little


def law_to_control(law: Law, step: float, *, name: str = "law") -> Any:
    """A law at a period as a discrete system of python-control, from x and the mode to u.

        u_k = F_c x_k + Σ_j G_{c,j} u_{k−j},    states: u_{k−1}, …, u_{k−N}, mode, age

    Parameters
    ----------
    law : Law
        A law that is a table, and not one that must know the future.
    step : float
        Sampling period h, s.
    name : str
        Of the system; its inputs are x[0], …, mode, its outputs u[0], ….

    Returns
    -------
    control.NonlinearIOSystem
        Its last two states are the mode sampled last and its age in samples: begin with −1 (none
        yet) and the age of the first mode, as `loop_to_control` does.

    Raises
    ------
    ArgumentError
        If the law is no table or must know the future.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
    >>> system = law_to_control(law, 0.25)
    >>> system.nstates, system.input_labels, system.output_labels
    (6, ['x[0]', 'x[1]', 'mode'], ['u[0]'])
    """
    control = python_control("systems of python-control")

    instance("law", law, Law)
    if not isinstance(law, TableLaw) or law.foresees:
        why = "foresees the signal" if isinstance(law, TableLaw) else "is no table of the state"
        raise ArgumentError(f"law must be a table that can run; {type(law).__name__} {why}.")
    table = law.digital(positive("step", step))
    taps, m, G = table.taps, law.plant.inputs, table.latest_first
    n, modes, last = law.plant.states, law.plant.modes, taps * m

    def age_at(state: np.ndarray, mode: int) -> int:
        before, age = round(state[last]), round(state[last + 1])
        return age if before < 0 else age + 1 if before == mode else 0

    def output(t: float, state: np.ndarray, given: np.ndarray, params: dict) -> np.ndarray:
        mode = _mode(given[n], modes)
        row = table.row(mode, age_at(state, mode))
        return table.state_gain[row] @ given[:n] + G[row] @ state[:last]

    def update(t: float, state: np.ndarray, given: np.ndarray, params: dict) -> np.ndarray:
        u, mode = output(t, state, given, params), _mode(given[n], modes)
        return np.concatenate((u, state[: last - m], [mode, age_at(state, mode)]))

    return control.NonlinearIOSystem(
        update,
        output,
        dt=table.step,
        inputs=[*(f"x[{i}]" for i in range(n)), "mode"],
        outputs=[f"u[{i}]" for i in range(m)],
        states=[*_past(taps, m), "mode", "age"],
        name=name,
    )


def plant_to_control(plant: SwitchedSystem, step: float, *, name: str = "plant") -> Any:
    """A plant with its input delay at a period, exactly discretised: from u and the mode to x.

    The mode holds for a whole period, so switches fall on the grid; the delay need not.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant_to_control(dt.problems.paper().plant, 0.3).nstates
    6
    """
    control = python_control("systems of python-control")

    instance("plant", plant, SwitchedSystem)
    sampled = SampledPlant(plant, positive("step", step))
    n, m, N = plant.states, plant.inputs, sampled.longest_lag
    pieces = [sampled.pieces(i) for i in range(plant.modes)]

    def output(t: float, state: np.ndarray, given: np.ndarray, params: dict) -> np.ndarray:
        return state[:n]

    def update(t: float, state: np.ndarray, given: np.ndarray, params: dict) -> np.ndarray:
        i, u = _mode(given[m], plant.modes), given[:m]
        inputs = np.concatenate((u, state[n:])).reshape(N + 1, m)  # u_k, …, u_{k−N}
        x = state[:n]
        for piece in pieces[i]:
            x = piece.Phi @ x + piece.Gamma @ acting_inputs(piece.stretch.lag, inputs)
        return np.concatenate((x, inputs[:N].ravel()))

    return control.NonlinearIOSystem(
        update,
        output,
        dt=sampled.step,
        inputs=[*(f"u[{i}]" for i in range(m)), "mode"],
        outputs=[f"x[{i}]" for i in range(n)],
        states=[*(f"x[{i}]" for i in range(n)), *_past(N, m)],
        name=name,
    )


def loop_to_control(
    plant: SwitchedSystem, law: Law, step: float, *, mode_age: int = 0
) -> tuple[Any, Float[np.ndarray, " state"]]:
    """The closed loop of a plant and a law, from the mode to x and u, and its initial state.

    Returns
    -------
    (control.InterconnectedSystem, array)
        Put x₀ into the first n entries of the array, and give both to
        `control.input_output_response`, with the modes at the samples as the input.

    Examples
    --------
    >>> import control, numpy as np, deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
    >>> loop, initial = loop_to_control(problem.plant, law, 0.1)
    >>> initial[:2] = -1.0, 1.0
    >>> times = 0.1 * np.arange(41)
    >>> found = control.input_output_response(loop, times, np.zeros(41), initial)
    >>> signal = dt.SwitchingSignal.constant(0)
    >>> run = dt.simulate(problem.plant, law, signal, [-1.0, 1.0], 4.0, step=0.1)
    >>> bool(np.abs(found.outputs[:2] - run.states).max() < 1e-10)
    True
    """
    control = python_control("systems of python-control")

    instance("plant", plant, SwitchedSystem)
    instance("law", law, Law)
    require_match(plant, law)
    one, other = plant_to_control(plant, step), law_to_control(law, step)
    signals = [*one.output_labels, *other.output_labels]
    loop = control.interconnect(
        [one, other], inputs=["mode"], outputs=signals, inplist=["mode"], outlist=signals
    )
    initial = np.zeros(one.nstates + other.nstates)
    initial[-2:] = -1.0, count("mode_age", mode_age, 0)
    return loop, initial


def _mode(value: float, modes: int) -> int:
    mode = round(value)
    if not 0 <= mode < modes or abs(mode - value) > _DISTURBED:
        raise ArgumentError(f"mode must be in 0..{modes - 1} at every sample, got {value:g}.")
    return mode


def _past(taps: int, m: int) -> list[str]:
    return [f"u[{i}] {j} ago" for j in range(1, taps + 1) for i in range(m)]
