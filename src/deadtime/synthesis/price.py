"""What a loop costs: ∫ xᵀQx + uᵀRu, the mean over initial states on the unit sphere.

With one mode held, z_k = (x_k, u_{k−1}, …, u_{k−W}) follows z_{k+1} = L z_k, the lifted loop of
`deadtime.spectrum`, and what a period costs is a quadratic form zᵀ S z: the Gramians of
`numerics.exponential` give ∫xᵀQx over the pieces of the period, the held input h u_kᵀR u_k. So

    ∫₀^∞ xᵀQx + uᵀRu dt = z₀ᵀ X z₀,    X = S + Lᵀ X L.

Only the block X_xx is wanted, whose trace over n is the mean over |x₀| = 1 without inputs in the
past: that is n runs, summed period by period until nothing more comes, which costs less than the
Lyapunov equation of order n + W m. No quadrature, so it is exact to round-off.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.feedback import Feedback
from deadtime.plant import SampledPlant, SwitchedSystem, Weight
from deadtime.spectrum import aged_row
from deadtime.spectrum.sampled_runs import LoopPeriods, cost_of_run

_DONE = 1e-15  # of the cost: what the last block may add
BLOCKS = 4000  # of one delay each
_SHORTEST = 16  # periods
LARGEST = 1e60  # cost: beyond, the loop grows


def cost_and_growth(
    plant: SwitchedSystem,
    feedback: Feedback,
    mode: int,
    blocks: int = BLOCKS,
    weight: Weight | None = None,
) -> tuple[float, float]:
    """The cost, ∞ if unstable; and how fast the loop grows, about, 1/s: negative where it decays.

    After so many `blocks` of one delay the rest is taken for a geometric series.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[-1.0]]], [[[1.0]]], delay=0.2)
    >>> idle = dt.DelayedStateFeedback(plant, [[[0.0]]]).digital(0.1)
    >>> round(cost_and_growth(plant, idle, 0)[0], 12)                     # ∫ e^{−2t} dt
    0.5
    """
    one, step = periods_of(plant, feedback, mode), feedback.step
    block, n, m = block_of(one), plant.states, plant.inputs
    lags, form = _form(plant, step, mode, weight)
    line, states = np.empty((one.past + block) * m), np.empty((block, n))
    run, total, growth = (line, states, np.empty(len(form)), blocks, _DONE, LARGEST), 0.0, -math.inf
    for x0 in np.eye(n):
        cost, ratio = cost_of_run(one, form, lags, x0, *run)
        if math.isinf(cost):
            return cost, math.log(max(ratio, 1.0 + 1e-9)) / (2.0 * block * step)
        total += cost
        if ratio > 0.0:
            growth = max(growth, math.log(ratio) / (2.0 * block * step))
    return total / n, growth


def _form(
    plant: SwitchedSystem, step: float, mode: int, weight: Weight | None
) -> tuple[Int[np.ndarray, " lag"], Float[np.ndarray, "z z"]]:
    """The lags of a period, and S with ∫xᵀQx + uᵀRu over it = zᵀ S z, z = (x_k, u_{k−lags[0]}, …).

    The part of u is that of the input sent in the period: what follows is all of them.
    """
    from deadtime.numerics.exponential import energy_gramian

    pieces, (n, m) = SampledPlant(plant, step).pieces(mode), plant.B.shape[1:]
    A, B = read_only(plant.A[mode]), read_only(plant.B[mode])
    Q, R = (None, np.eye(m)) if weight is None else (weight.Q, weight.R)
    lags = np.unique(np.append(np.concatenate([one.stretch.lag for one in pieces]), 0))
    X, form = np.eye(n, n + lags.size * m), np.zeros((n + lags.size * m,) * 2)
    form[n : n + m, n : n + m] = step * R  # lag 0 comes first
    for Phi, Gamma, (start, stop, lag) in pieces:
        U = np.zeros((m, len(form)))
        U[np.arange(m), n + np.searchsorted(lags, lag) * m + np.arange(m)] = 1.0
        z = np.vstack((X, U))
        form += z.T @ energy_gramian(A, B, stop - start, Q) @ z
        X = Phi @ X + Gamma @ U
    return lags, form


def periods_of(plant: SwitchedSystem, feedback: Feedback, mode: int) -> LoopPeriods:
    """One mode of a plant under the row of a mode that has been held throughout."""
    pieces = SampledPlant(plant, feedback.step).pieces(mode)
    return LoopPeriods.held(pieces, feedback, aged_row(feedback, mode))


def block_of(one: LoopPeriods) -> int:
    """Periods that are run at a time, at least as many as inputs are remembered."""
    return max(one.past, _SHORTEST)
