"""The step response of a loop with one mode held, exact at samples.

A loop that tracks outputs starts at rest and has a reference of 1 for one of them from time 0 on.
Any other has a constant disturbance of 1 at one of the plant's inputs, after the delay,

    dx/dt = A x + b_j + B u(t − D).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import index, positive
from deadtime.base.frozen import Frozen
from deadtime.estimation import OutputFeedback
from deadtime.feedback import Law
from deadtime.imperfections import StepDisturbance
from deadtime.plant import SwitchedSystem
from deadtime.simulation import simulate
from deadtime.simulation.tracking import RISE, SETTLED, step_info
from deadtime.spectrum import growth_rate
from deadtime.switching import SwitchingSignal

_SETTLED = 10.0  # time constants of the slowest motion: the default horizon
_ENOUGH = 4.0  # time constants, after which the last value is the steady state to 2 %
_MOST = 5_000  # samples
_LEFT = 1e-3  # of the peak: a response that ends below has returned to 0


@dataclass(frozen=True, eq=False)
class StepResponse(Frozen):
    """The step response of a loop (immutable).

    Attributes
    ----------
    mode : int
    time : (T,)
        Seconds.
    response : (T,)
        The tracked output; without tracking, the measured state or output.
    tracks : bool
        Whether the step is in the reference; otherwise it is an input disturbance.
    growth : float
        The loop's growth rate, 1/s.
    """

    mode: int
    time: Float[np.ndarray, " T"]
    response: Float[np.ndarray, " T"]
    tracks: bool
    growth: float

    @property
    def info(self) -> dict[str, float] | None:
        """The numbers of python-control's `step_info`, by its names and definitions; times in s.

        The last value is the steady state. If that is 0, as with integral action against an input
        disturbance, there are the peak and the time after which 2 % of it are left. None for a loop
        that grows, or has not settled by the end (four time constants): give a longer horizon.
        """
        if self.growth * self.time[-1] > -_ENOUGH:
            return None
        time, y, last = self.time, self.response, float(self.response[-1])
        size = np.abs(y)
        peak = float(size.max())
        if abs(last) <= _LEFT * peak:
            far = np.flatnonzero(size > SETTLED * peak)
            settled = {"SettlingTime": float(time[far[-1] + 1 if far.size else 0])}
            rest = {"Peak": peak, "PeakTime": float(time[size.argmax()]), "SteadyStateValue": 0.0}
            return settled | rest
        found = step_info(time, y, np.full(time.size, last))
        del found["SteadyStateError"], found["IAE"]
        risen = y[np.argmax(y / last >= RISE[1]) :]
        found |= {"SettlingMin": risen.min(), "SettlingMax": risen.max()}
        return {name: float(value) for name, value in found.items()}


def step_response(
    plant: SwitchedSystem,
    law: Law,
    mode: int,
    step: float = 0.01,
    *,
    channel: int = 0,
    output: int = 0,
    horizon: float | None = None,
) -> StepResponse:
    """The step response of a loop with one mode held.

    Parameters
    ----------
    plant : SwitchedSystem
        The true plant; the law has a model of its own.
    law : Law
        With a servo its reference steps, otherwise an input disturbance does.
    mode : int
    step : float
        Sampling period h, s.
    channel : int
        The reference, or the input, that steps.
    output : int
        Without tracking: the measured state or output that is returned. With tracking it is the
        output whose reference steps.
    horizon : float, optional
        Seconds; by default ten time constants of the slowest motion and twice the delay, of 5,000
        samples at most.

    Returns
    -------
    StepResponse
        Of that mode, at samples.

    Raises
    ------
    ArgumentError
        If mode, channel or output is out of range, or step or horizon is not positive.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], delay=0.2)
    >>> law = dt.SingleModePredictor(plant, dt.place(plant, [-1.0]), 0)
    >>> found = step_response(plant, law, 0)
    >>> round(found.info["SteadyStateValue"], 3), found.info["Overshoot"]
    (1.443, 0.0)
    """
    index("mode", mode, plant.modes)
    step, growth = positive("step", step), growth_rate(plant, law, mode, step)
    if horizon is None:
        slowest = min(_SETTLED / abs(growth) if growth else math.inf, _MOST * step)
        horizon = step * min(math.ceil((slowest + 2.0 * plant.longest_delay) / step), _MOST)
    signal, pushes, rows = SwitchingSignal.constant(mode), [], np.eye(plant.states)
    tracks = law.servo is not None
    if law.observer is not None:
        rows = law.observer.C[mode][:, : plant.states]
        if law.servo is not None:
            rows, output = law.servo.tracked @ rows, channel
    if tracks:
        index("channel", channel, len(rows))
    else:
        index("channel", channel, plant.inputs)
        index("output", output, len(rows))
        pushes = [StepDisturbance(plant.B[mode][:, channel])]
    loop, x0, horizon = law, np.zeros(plant.states), positive("horizon", horizon)
    if law.observer is not None:  # at rest, nothing estimated
        follows = {}
        if law.servo is not None:
            reference = np.eye(len(law.servo.tracked))[channel]
            follows = {"servo": law.servo, "reference": reference}
        loop = OutputFeedback(law.row_law, law.observer, **follows)
    run = simulate(plant, loop, signal, x0, horizon, step, imperfections=pushes)
    return StepResponse(mode, run.time, rows[output] @ run.states, tracks, growth)
