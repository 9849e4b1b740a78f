"""Laws and plants as systems of python-control, which closes the loop with its own simulator.

Both are discrete `NonlinearIOSystem`s at the period h: the mode is an input of each. Their states
hold the inputs of the last N periods, the latest first, so a loop of the two starts with both
histories at zero. A law on outputs has its observer among its states, run by the same `Estimator`
as everywhere, and a reference is an input. Needs the extra `control`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import count, instance, positive, python_control
from deadtime.base.errors import ArgumentError
from deadtime.estimation.observer import output_matrices
from deadtime.feedback import Law
from deadtime.feedback.law import require_match
from deadtime.feedback.memory import Memory
from deadtime.feedback.table import age_after
from deadtime.loop.running_observer import RunningObserver
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.sampled_plant import acting_inputs
from deadtime.switching import SwitchingSignal

_DISTURBED = 1e-3  # `control.linearize` moves every input and state a little


def law_to_control(law: Law, step: float, *, name: str = "law") -> Any:
    r"""A law at a period as a discrete system of python-control, from x and the mode to u.

    .. math::

        u_k = F_c x_k + \sum_j G_{c,j} u_{k-j},
        \quad \text{states: } u_{k-1}, \dots, u_{k-N}, \text{ mode, age}

    An `OutputFeedback` has the input y instead of x and, with a servo, the reference r after the
    mode. Its states also hold, before the mode, the observer's z and the tracked outputs of the
    last sample.

    Parameters
    ----------
    law : Law
        A law that is a table, and not one that must know the future; or an `OutputFeedback` of one.
    step : float
        Sampling period h, s.
    name : str
        Of the system; its inputs are x[0], … or y[0], …, mode, r[0], …, its outputs u[0], ….

    Returns
    -------
    control.NonlinearIOSystem
        Its last two states are the mode sampled last and its age in samples: begin with −1 (none
        yet) and the age of the first mode, z with the first estimate, as `loop_to_control` does.

    Raises
    ------
    ArgumentError
        If the law is no table or needs the future signal.

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
    inner = law if law.observer is None else law.row_law
    if inner.why_not_run:
        raise ArgumentError(
            f"law must be a table that can run, or an OutputFeedback of one; {inner.why_not_run}."
        )
    step = positive("step", step)
    tables = law.tables_along(step, SwitchingSignal.constant(0), 1)
    assert tables is not None
    assert tables.feedback is not None
    table = tables.feedback
    observed = None if tables.memory is None else _Observed(tables.memory)
    m, G, modes = law.plant.inputs, table.latest_first, law.plant.modes
    past = table.taps if observed is None else max(table.taps, observed.past)
    kept = [] if observed is None else observed.states
    n = law.plant.states if law.outputs is None else law.outputs.shape[1]
    last = past * m + len(kept)

    def age_at(state: np.ndarray, mode: int) -> int:
        return age_after(round(state[last]), round(state[last + 1]), mode)

    def seen(state: np.ndarray, given: np.ndarray, mode: int) -> tuple[np.ndarray, np.ndarray]:
        """The vector that multiplies the rows, and the next state of the observer."""
        if observed is None:
            return given[:n], np.zeros(0)
        inputs = state[: past * m].reshape(past, m)
        return observed(state[past * m : last], inputs, round(state[last]), given, mode)

    def output(t: float, state: np.ndarray, given: np.ndarray, params: dict) -> np.ndarray:
        mode = _mode(given[n], modes)
        row = table.row(mode, age_at(state, mode))
        x, _ = seen(state, given, mode)
        return table.state_gain[row] @ x + G[row] @ state[: G.shape[2]]

    def update(t: float, state: np.ndarray, given: np.ndarray, params: dict) -> np.ndarray:
        u, mode = output(t, state, given, params), _mode(given[n], modes)
        _, now = seen(state, given, mode)
        return np.concatenate((u, state[: (past - 1) * m], now, [mode, age_at(state, mode)]))

    symbol, followed = ("x", []) if observed is None else ("y", observed.references)
    return control.NonlinearIOSystem(
        update,
        output,
        dt=table.step,
        inputs=[*_each(symbol, n), "mode", *followed],
        outputs=_each("u", m),
        states=[*_past(past, m), *kept, "mode", "age"],
        name=name,
    )


class _Observed:
    """The observer of a law as a function of its state.

    Attributes
    ----------
    past : how many past inputs it reads
    states : names of its states: z and the tracked outputs
    references : names of the references
    """

    def __init__(self, memory: Memory) -> None:
        self._running = observer = RunningObserver(memory)
        self.past, r = len(observer.ring), observer.before.size
        self.references = _each("r", r)
        self.states = _each("z", observer.z.size) + _each("tracked", r)

    def __call__(
        self,
        kept: Float[np.ndarray, " kept"],
        inputs: Float[np.ndarray, "past m"],
        before: int,
        given: Float[np.ndarray, " given"],
        mode: int,
    ) -> tuple[Float[np.ndarray, " z"], Float[np.ndarray, " kept"]]:
        """z at this sample, and the next state; `inputs` latest first, `before` the last mode."""
        observer, place = self._running, self.past - 1
        size, outputs = observer.z.size, observer.memory.sizes.p
        # python-control owns the state and may pass any: the observer is rebuilt from it.
        observer.load(
            {
                "z": kept[:size],
                "ring": inputs[: self.past][::-1],
                "counters": [int(before >= 0), place, max(before, 0)],
                "asked": inputs[0],
                "before": kept[size:],
            }
        )
        z = observer.update(inputs[0], given[:outputs], mode, given[outputs + 1 :])
        return z.copy(), np.concatenate((z, observer.before))


def plant_to_control(
    plant: SwitchedSystem, step: float, *, C: ArrayLike | None = None, name: str = "plant"
) -> Any:
    r"""A plant with its input delay at a period, exactly discretised: from u and the mode to x.

    The mode holds for a whole period, so switches fall on the grid; the delay need not. With a C,
    shape (p, n) or (modes, p, n), :math:`y = C_\sigma x` comes out after x.

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

    measured = None if C is None else output_matrices(C, plant)

    def output(t: float, state: np.ndarray, given: np.ndarray, params: dict) -> np.ndarray:
        if measured is None:
            return state[:n]
        return np.concatenate((state[:n], measured[_mode(given[m], plant.modes)] @ state[:n]))

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
        inputs=[*_each("u", m), "mode"],
        outputs=_each("x", n) + ([] if measured is None else _each("y", measured.shape[1])),
        states=[*_each("x", n), *_past(N, m)],
        name=name,
    )


def loop_to_control(
    plant: SwitchedSystem, law: Law, step: float, *, mode_age: int = 0
) -> tuple[Any, Float[np.ndarray, " state"]]:
    """The closed loop of a plant and a law, from the mode to x and u, and its initial state.

    Returns
    -------
    (control.InterconnectedSystem, array)
        Put :math:`x_0` into the first n entries of the array, and give both to
        `control.input_output_response`, with the modes at the samples as the input, and below them
        the reference of a law with a servo, row by row.

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
    one, other = plant_to_control(plant, step, C=law.outputs), law_to_control(law, step)
    inputs = other.input_labels[other.input_labels.index("mode") :]
    signals = [*one.output_labels[: plant.states], *other.output_labels]
    loop = control.interconnect(
        [one, other], inputs=inputs, outputs=signals, inplist=inputs, outlist=signals
    )
    initial = np.zeros(one.nstates + other.nstates)
    tables = law.tables_along(step, SwitchingSignal.constant(0), 1)
    if tables is not None and tables.memory is not None:
        z = one.nstates + other.state_labels.index("z[0]")
        initial[z : z + tables.memory.start.size] = tables.memory.start
    initial[-2:] = -1.0, count("mode_age", mode_age, 0)
    return loop, initial


def _mode(value: float, modes: int) -> int:
    mode = round(value)
    if not 0 <= mode < modes or abs(mode - value) > _DISTURBED:
        raise ArgumentError(f"mode must be in 0..{modes - 1} at every sample, got {value:g}.")
    return mode


def _each(symbol: str, size: int) -> list[str]:
    return [f"{symbol}[{i}]" for i in range(size)]


def _past(taps: int, m: int) -> list[str]:
    return [f"u[{i}] {j} ago" for j in range(1, taps + 1) for i in range(m)]
