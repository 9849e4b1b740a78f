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
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.feedback import Feedback
from deadtime.plant import SampledPlant, SwitchedSystem, Weight
from deadtime.spectrum import aged_row

_DONE = 1e-15  # of the cost: what the last block may add
BLOCKS = 4000  # of one delay each
_SHORTEST = 16  # periods


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
    from deadtime.numerics.exponential import energy_gramian
    from deadtime.synthesis.march import cost_of_run

    one, step = periods_of(plant, feedback, mode), feedback.step
    A, B = read_only(plant.A[mode]), read_only(plant.B[mode])
    Phi, Gamma, lags, F, G, block = one.Phi, one.Gamma, one.lags, one.F, one.G, one.block
    Q, R = (None, None) if weight is None else (weight.Q, weight.R)
    forms = np.stack([energy_gramian(A, B, length, Q) for length in one.lengths])
    total, growth = 0.0, -math.inf
    for x0 in np.eye(plant.states):
        cost, ratio = cost_of_run(Phi, Gamma, forms, lags, F, G, step, x0, block, blocks, _DONE, R)
        if math.isinf(cost):
            return cost, math.log(max(ratio, 1.0 + 1e-9)) / (2.0 * block * step)
        total += cost
        if ratio > 0.0:
            growth = max(growth, math.log(ratio) / (2.0 * block * step))
    return total / plant.states, growth


class HeldLoop(NamedTuple):
    """A loop with one mode held, as its compiled runs take it.

    Phi, Gamma, lags, lengths : of the pieces of a period
    F, G : the law's row; G (m, taps·m) has the oldest tap first
    block : periods that are run at a time, at least as many as inputs are remembered
    """

    Phi: Float[np.ndarray, "piece n n"]
    Gamma: Float[np.ndarray, "piece n m"]
    lags: Int[np.ndarray, "piece m"]
    lengths: list[float]
    F: Float[np.ndarray, "m n"]
    G: Float[np.ndarray, "m taps_m"]
    block: int


def periods_of(plant: SwitchedSystem, feedback: Feedback, mode: int) -> HeldLoop:
    """One mode of a plant under the row of a mode that has been held throughout."""
    pieces = SampledPlant(plant, feedback.step).pieces(mode)
    Phi, Gamma = np.stack([one.Phi for one in pieces]), np.stack([one.Gamma for one in pieces])
    lags = np.stack([piece.stretch.lag for piece in pieces])
    lengths = [piece.stretch.stop - piece.stretch.start for piece in pieces]
    row = aged_row(feedback, mode)
    F, G = np.ascontiguousarray(feedback.state_gain[row]), feedback.input_gain[row]
    taps, m, _ = G.shape
    G = np.array(G[::-1].transpose(1, 0, 2), order="C").reshape(m, taps * m)
    block = max(taps, int(lags.max()), _SHORTEST)
    return HeldLoop(Phi, Gamma, lags, lengths, F, G, block)
