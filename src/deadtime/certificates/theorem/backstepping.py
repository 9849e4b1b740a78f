"""The paper's backstepping transformation, target system and Lyapunov functional, along runs.

With P(θ) = x(θ + D) the transformation W(θ) = U(θ) − K_σ(θ+D) P(θ) turns the loop into the target
system dX/dt = (A_σ + B_σ K_σ) X + B_σ W(t − D): W is the law's mismatch with the exact predictor
feedback. Everything here uses the plant's true signal, the future included.

References
----------
arXiv 2503.08446, Lemmas 2.4 and 2.5, equations (14) to (19), (64), (65).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.gains.state_feedback import check_gains
from deadtime.numerics.polynomials import gauss
from deadtime.plant import SwitchedSystem
from deadtime.simulation import Trajectory
from deadtime.simulation.ideal.ideal_run import NODES, IdealRecord
from deadtime.simulation.ideal.segments import Piecewise, merge, subdivide
from deadtime.simulation.initial_input import InputHistory
from deadtime.switching import SwitchingSignal


@dataclass(frozen=True, eq=False)
class Backstepping(Frozen):
    """The backstepping transformation at a time t, between U and W over a delay, given X(t).

    Parameters
    ----------
    plant : SwitchedSystem
        The plant.
    gains : (modes, m, n) array
        :math:`K_i` of :math:`u = +K_i x`.
    signal : SwitchingSignal
        The plant's signal, known up to t + D.
    time : float
        t, in seconds.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> run = dt.simulate(problem.plant, problem.laws["oracle"], problem.signal, [-1, 1], 4, None)
    >>> change = Backstepping(problem.plant, problem.gains, problem.signal, run.end)
    >>> W = change.direct(run.states[:, -1], run.history)
    >>> bool(abs(W(np.linspace(-0.9, 0, 50))).max() < 1e-10)      # the oracle has no mismatch
    True
    """

    plant: SwitchedSystem
    gains: Float[np.ndarray, "mode m n"]
    signal: SwitchingSignal
    time: float

    def __post_init__(self) -> None:
        check_gains(self.plant, self.gains, allow_unstable=True)
        self.signal.require_modes(self.plant.modes)
        super().__post_init__()

    def direct(self, x: Float[np.ndarray, " n"], u: InputHistory) -> Piecewise:
        """W on [−D, 0] (times relative to t) from X(t) and U: equations (10), (14)."""
        values, edges, K, P = self._flow(x, u, closed=False)
        return Piecewise(edges, values - np.einsum("sij,skj->ski", K, P))

    def inverse(self, x: Float[np.ndarray, " n"], w: InputHistory) -> Piecewise:
        """U on [−D, 0] (times relative to t) from X(t) and W: equations (18), (19)."""
        values, edges, K, P = self._flow(x, w, closed=True)
        return Piecewise(edges, values + np.einsum("sij,skj->ski", K, P))

    def _flow(
        self, x: np.ndarray, drive: InputHistory, closed: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The drive, segments, K and x(θ + D) at the support nodes.

        The state obeys dP/dθ = A P + B drive, or (A + B K) P + B drive when `closed`.
        """
        from deadtime.simulation.ideal.collocation import solve_alone

        plant, delay = self.plant, self.plant.delay
        require_shape("x", x, (plant.states,), "(n,)")
        nodes = gauss(NODES)
        switches = self.signal.times - self.time - delay
        closed_loop = read_only(plant.A + plant.B @ self.gains)
        rate = float(max(np.linalg.norm(M, 2) for M in (*plant.A, *closed_loop)))
        edges = merge(np.concatenate((switches, drive.jumps)), -delay, 0.0)
        # At most 1.5 time constants of the fastest matrix, for which NODES points are enough.
        edges = subdivide(edges, min(1.5 / max(rate, np.finfo(float).tiny), delay))
        middles = (edges[:-1] + edges[1:]) / 2.0
        modes = self.signal(middles + self.time + delay)
        values = drive.on(edges, nodes)
        flow = closed_loop if closed else plant.A
        states, start = np.empty((modes.size, NODES + 2, plant.states)), np.array(x, float)
        for g, mode in enumerate(modes):
            states[g] = solve_alone(
                flow[mode],
                plant.B[mode],
                start,
                np.ascontiguousarray(values[g, 1:-1]),
                edges[g + 1] - edges[g],
                nodes,
            )
            start = states[g, -1]
        return values, edges, self.gains[modes], states


def mismatch_at(
    run: Trajectory, gains: Float[np.ndarray, "mode m n"], times: Float[np.ndarray, " T"]
) -> Float[np.ndarray, "T m"]:
    r"""The mismatch along an ideal run, at times from −D to its end.

    :math:`U(\theta) - K_{\sigma(\theta+D)} x(\theta + D)`."""
    ahead = times + run.plant.delay
    x, K = run.record.states_at(ahead), gains[_modes(run, ahead)]
    return run.record.inputs_at(times) - np.einsum("kij,kj->ki", K, x)


def target_rate(
    run: Trajectory, gains: Float[np.ndarray, "mode m n"], times: Float[np.ndarray, " T"]
) -> Float[np.ndarray, "T n"]:
    r"""The rate of change of X in the target system (15).

    :math:`\dot X = (A_\sigma + B_\sigma K_\sigma) X + B_\sigma W(t - D)`."""
    plant, mode, x = run.plant, _modes(run, times), run.record.states_at(times)
    closed = plant.A[mode] + plant.B[mode] @ gains[mode]
    # W(t − D) with the mode at t itself: (t − D) + D may round to the other side of a switch.
    w = run.record.inputs_at(times - plant.delay) - np.einsum("kij,kj->ki", gains[mode], x)
    return np.einsum("kij,kj->ki", closed, x) + np.einsum("kij,kj->ki", plant.B[mode], w)


def _modes(run: Trajectory, times: np.ndarray) -> np.ndarray:
    """σ; a time within round-off before a switch counts as the switch, as in the run's record."""
    return run.signal(times + _record(run).states.slack)


def _record(run: Trajectory) -> IdealRecord:
    """The record of an ideal run; an ArgumentError for a digital one."""
    if not isinstance(run.record, IdealRecord):
        raise ArgumentError("run must be an ideal one: simulate with step=None.")
    return run.record


def lyapunov_functional(
    run: Trajectory,
    gains: Float[np.ndarray, "mode m n"],
    P: Float[np.ndarray, "n n"],
    b: float,
    times: Float[np.ndarray, " T"],
) -> Float[np.ndarray, " T"]:
    r"""The Lyapunov functional along an ideal run: equation (64).

    :math:`V(t) = X^T P X + b \int_{t-D}^{t} e^{\theta + D - t} |W(\theta)|^2 d\theta`."""
    x = run.record.states_at(times)
    return np.einsum("ki,ij,kj->k", x, P, x) + b * _weighted_integrals(run, gains, times)


def lyapunov_derivative(
    run: Trajectory,
    gains: Float[np.ndarray, "mode m n"],
    P: Float[np.ndarray, "n n"],
    b: float,
    times: Float[np.ndarray, " T"],
) -> Float[np.ndarray, " T"]:
    r"""dV/dt along an ideal run, exact: (65) before any inequality is applied to it.

    .. math::

        X^T (H^T P + P H) X + 2 X^T P B W(t - D)
        + b e^D |W(t)|^2
        - b |W(t - D)|^2
        - b \int_{t-D}^{t} e^{\theta + D - t} |W(\theta)|^2 d\theta

    with :math:`H = A_\sigma + B_\sigma K_\sigma`; a right derivative where :math:`W` jumps.
    """
    delay = run.plant.delay
    x, slope = run.record.states_at(times), target_rate(run, gains, times)
    now, then = (np.sum(mismatch_at(run, gains, t) ** 2, axis=1) for t in (times, times - delay))
    inside = _weighted_integrals(run, gains, times)
    return 2.0 * np.einsum("ki,ij,kj->k", x, P, slope) + b * (np.exp(delay) * now - then - inside)


def _weighted_integrals(run: Trajectory, gains: np.ndarray, times: np.ndarray) -> np.ndarray:
    """∫ e^{θ+D−t} |W(θ)|² dθ over [t − D, t] at each time, by Gauss quadrature on segments."""
    record = _record(run)
    delay, nodes = run.plant.delay, gauss(NODES)
    breaks = np.concatenate((record.inputs.edges, record.states.edges - delay))
    result = np.empty(times.size)
    for k, t in enumerate(times):
        edges = merge(breaks, t - delay, t)
        lengths = np.diff(edges)
        theta = (edges[:-1, None] + lengths[:, None] * nodes.points).ravel()
        square = np.sum(mismatch_at(run, gains, theta) ** 2, axis=1) * np.exp(theta + delay - t)
        result[k] = np.sum((lengths[:, None] * nodes.weights).ravel() * square)
    return result
