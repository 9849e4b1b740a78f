"""The ideal loop: the law updated continuously, solved segment by segment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Forecast, Functional
from deadtime.feedback.table import require_finite_gains
from deadtime.numerics.polynomials import gauss
from deadtime.plant import SwitchedSystem, Weight
from deadtime.simulation.ideal.segments import NODES, Piecewise, segments_of
from deadtime.simulation.initial_input import InputHistory
from deadtime.switching import SwitchingSignal

_SAMPLES = 1001


@dataclass(frozen=True, eq=False)
class IdealRecord:
    """One ideal run: state and input as polynomials on segments.

    Attributes
    ----------
    states : Piecewise
        x from 0 until the plant reads inputs after the end of the run.
    inputs : Piecewise
        u from the longest delay before 0 to the end of the run.
    """

    plant: SwitchedSystem
    states: Piecewise
    inputs: Piecewise
    held: ClassVar[bool] = False

    @property
    def last(self) -> float:
        """The last time at which x is known, seconds."""
        return float(self.states.edges[-1])

    @property
    def slack(self) -> float:
        """Seconds before a switch within which a time counts as at it."""
        return self.states.slack

    def grid(self, end: float) -> Float[np.ndarray, " T"]:
        """The instants that a run reports by default: 1001, uniform."""
        return np.linspace(0.0, end, _SAMPLES)

    def states_at(self, times: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T n"]:
        """x at any times from 0 to the end of the run plus the delay."""
        return self.states(times)

    def ahead_of(self, times: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T n"]:
        """x a delay after any times of the run; infinite where it has left the limit."""
        later, last = times + self.plant.delay, self.states.edges[-1]
        x = self.states(np.minimum(later, last))
        return np.where((later <= last + 1e-9)[:, None], x, np.inf)

    def inputs_at(self, times: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T m"]:
        """u (right limits) at any times up to the end of the run, those before 0 included."""
        return self.inputs(times)

    def integrals(self, end: float, weight: Weight | None = None) -> tuple[float, float]:
        """∫xᵀQx and ∫uᵀRu over [0, end], by Gauss quadrature on the segments."""
        Q, R = (None, None) if weight is None else (weight.Q, weight.R)
        return self.states.form_integral(0.0, end, Q), self.inputs.form_integral(0.0, end, R)

    def history(self, end: float) -> InputHistory:
        """The inputs in flight at `end`, as the `u0` of a run that goes on from there."""
        edges = self.inputs.edges
        jumps = edges[(edges > end + edges[0]) & (edges < end)] - end
        return InputHistory(lambda s: self.inputs(s + end), jumps)


class SegmentPlant(NamedTuple):
    """The plant, for the compiled march."""

    A: np.ndarray
    B: np.ndarray
    delays: np.ndarray


class Segments(NamedTuple):
    """The segments, for the compiled march: the run begins with segment `begin`, u ends with
    segment `stop`; the plant's mode on each, and the inputs sent (segments, p + 2, m).
    """

    edges: np.ndarray
    begin: int
    stop: int
    mode: np.ndarray
    inputs: np.ndarray


def run_ideal(
    plant: SwitchedSystem,
    law: Functional | Forecast,
    signal: SwitchingSignal,
    x0: Float[np.ndarray, " n"],
    horizon: float,
    history: InputHistory,
) -> tuple[IdealRecord, float | None]:
    """Solve the loop on [0, horizon]; return the record, and the time of its end if it diverged."""
    from deadtime.simulation.ideal.branch_march import ReadsAgain

    require_finite_gains(law.settled.F)
    try:
        return _solve(plant, law, signal, x0, horizon, history, rereads=False)
    except ReadsAgain:
        return _solve(plant, law, signal, x0, horizon, history, rereads=True)


def _solve(
    plant: SwitchedSystem,
    law: Functional | Forecast,
    signal: SwitchingSignal,
    x0: Float[np.ndarray, " n"],
    horizon: float,
    history: InputHistory,
    rereads: bool,
) -> tuple[IdealRecord, float | None]:
    """The run on one choice of segments."""
    nodes = gauss(NODES)
    edges, begin = segments_of(plant, law, signal, horizon, history, rereads)
    middles = (edges[:-1] + edges[1:]) / 2.0
    # One segment more than the run: u at its end is a right limit.
    stop = int(np.searchsorted(edges, horizon * (1.0 - 1e-15))) + 1
    inputs = np.zeros((middles.size, NODES + 2, plant.inputs))
    inputs[:begin] = history.on(edges[: begin + 1], nodes)
    run = np.maximum(middles, 0.0)
    line = Segments(edges, begin, stop, signal(run), inputs)
    moving = SegmentPlant(plant.A, plant.B, plant.delays)
    if isinstance(law, Forecast):
        from deadtime.simulation.ideal.branch_march import march_branches

        states, done = march_branches(moving, line, law, x0, nodes, rereads)
    else:
        from deadtime.simulation.ideal.collocation import march_windows, windows_of

        states, done = march_windows(moving, line, windows_of(law, middles), x0, nodes)
    # The states of the delay line's last inputs may leave the limit after the run's end.
    end = float(edges[done]) if done < stop else None
    kept = done if end is not None else stop
    return (
        IdealRecord(
            plant,
            Piecewise(edges[begin : done + 1], states[begin:done]),
            Piecewise(edges[: kept + 1], inputs[:kept]),
        ),
        end,
    )
