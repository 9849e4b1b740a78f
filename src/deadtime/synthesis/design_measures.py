"""Fast measures of a design for a search: estimated margin, cost and growth.

The cost is ∫ xᵀQx + uᵀRu, the mean over initial states on the unit sphere.

With one mode held, z_k = (x_k, u_{k−1}, …, u_{k−W}) follows z_{k+1} = L z_k, the lifted loop of
`deadtime.spectrum`, and the cost of a period is a quadratic form zᵀ S z: the Gramians of
`numerics.exponential` give ∫xᵀQx over the pieces of the period, the held input h u_kᵀR u_k. So

    ∫₀^∞ xᵀQx + uᵀRu dt = z₀ᵀ X z₀,    X = S + Lᵀ X L.

Only the block X_xx is needed, whose trace over n is the mean over |x₀| = 1 without inputs in the
past: n runs, summed period by period until the sum converges, cost less than the Lyapunov equation
of order n + W m. Without quadrature the result is exact to round-off.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.feedback import Feedback, Law
from deadtime.numerics.small_matrices import decompose
from deadtime.plant import SampledPlant, SwitchedSystem, Weight
from deadtime.plant.pieces import Piece
from deadtime.spectrum import LiftedLoop, aged_row
from deadtime.spectrum.digital_response import DigitalResponse
from deadtime.spectrum.sampled_runs import LoopPeriods, cost_of_run

_LOW, _FINE = 0.02, 0.25  # rad, of delay × frequency: the lowest, and the largest distance
_FEW = 160
_STARTS, _NEWTON, _CONVERGED = 24, 12, 1e-6
_NEAREST = 0.6  # of a start's |δ|: a lower bound of that of its solution, by experience
_HIGH = -0.2  # of log|λ|: the least peak that may reach 0 at another delay


def estimated_margin(plant: SwitchedSystem, feedback: Feedback, mode: int) -> float:
    """The smallest relative error of the delay that destabilises a mode that is stable without.

    Several delays change by the same time, relative to the shortest.

    At the limit of stability det(M − r p) = 0 (`spectrum.response`). Far below the Nyquist
    frequency a delay longer by δ multiplies the delay line p by e^{−iωδ}, so each eigenvalue λ(ω)
    of M⁻¹ r p with |λ| = 1 requires ωδ = arg λ, modulo 2π. Crossings of |λ| = 1 come from a grid of
    frequencies and start Newton's method for det Δ(ω, D + δ) = 0 with the exact p. Two crossings
    between neighbouring points of the grid are missed; `margins.crossing` misses none.
    """
    response = DigitalResponse.of(plant, feedback, mode)
    delay = plant.shortest_delay
    omega = frequencies(plant.longest_delay, response.highest)
    z, _ = response.free(omega)
    M, _ = response.law(omega)
    p, _, _ = response.delay_line(omega, np.full(omega.size, delay))
    r = np.linalg.solve(z.transpose(0, 2, 1), response.F.T).transpose(0, 2, 1)  # F (zI − Φ)⁻¹
    loop = np.linalg.solve(M, r @ p)
    values = loop[:, :, 0] if loop.shape[1] == 1 else np.linalg.eigvals(loop)
    values = np.take_along_axis(values, np.argsort(np.abs(values), axis=1), axis=1)
    w, away, sure = _starts(omega, values)
    best, batch = math.inf, 0
    while batch < w.size and _NEAREST * abs(away[batch]) < best:
        some = slice(batch, batch + _STARTS)
        found = _refine(response, w[some], away[some], sure[some], delay)
        best, batch = min(best, found), batch + _STARTS
    return best / delay


def frequencies(delay: float, highest: float) -> np.ndarray:
    """Logarithmic at low frequencies, then even, close enough for the phase of the delay."""
    low = np.geomspace(_LOW / delay, highest, _FEW, endpoint=False)
    even = np.arange(_FINE / delay, highest, _FINE / delay)
    return np.unique(np.concatenate((low, even)))


def _starts(omega: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies at which |λ| crosses 1 or peaks near it, their δ of both signs, s, nearest first.

    The third array is True at crossings: there δ is a fallback if Newton's method fails.
    """
    level = np.log(np.maximum(np.abs(values), 1e-300))
    angle = np.angle(values)
    rows, columns = np.nonzero(np.sign(level[1:]) != np.sign(level[:-1]))
    before, after = level[rows, columns], level[rows + 1, columns]
    part = before / (before - after)
    turn = np.angle(np.exp(1j * (angle[rows + 1, columns] - angle[rows, columns])))
    w = omega[rows] + part * np.diff(omega)[rows]
    at = angle[rows, columns] + part * turn
    inner = level[1:-1]
    peak = (inner >= level[:-2]) & (inner >= level[2:]) & (inner > _HIGH)
    rows, columns = np.nonzero(peak)
    sure = np.arange(w.size + rows.size) < w.size
    w = np.concatenate((w, omega[rows + 1]))
    at = np.concatenate((at, angle[rows + 1, columns]))
    longer = np.mod(at, 2.0 * np.pi) / w
    away = np.concatenate((longer, longer - 2.0 * np.pi / w))
    order = np.argsort(np.abs(away))
    return np.tile(w, 2)[order], away[order], np.tile(sure, 2)[order]


def _refine(
    response: DigitalResponse, w: np.ndarray, away: np.ndarray, sure: np.ndarray, delay: float
) -> float:
    """The smallest |δ| after Newton's method from every start; unrefined where it fails."""
    start, sign = np.where(sure, np.abs(away), np.inf), np.sign(away)
    d = delay + away
    able = d > 0.0
    w, d, start, sign = w[able], d[able], start[able], sign[able]
    best, alive = start.copy(), np.arange(w.size)
    for _ in range(_NEWTON):
        if alive.size == 0:
            break
        now = decompose(*response.matrix(w[alive], d[alive]))
        # 1 + a dω + b dD = 0: with b divided out, the imaginary part has no dD.
        a, b = now.slope(0), now.slope(1)
        with np.errstate(divide="ignore", invalid="ignore"):
            dw = -np.imag(1.0 / b) / np.imag(a / b)
            dd = -np.real(1.0 / b) - dw * np.real(a / b)
        step = np.maximum(np.abs(dw) / w[alive], np.abs(dd) / delay)
        near = (step < 0.3) & (d[alive] + dd > 0.0)
        alive, step = alive[near], step[near]
        w[alive] += dw[near]
        d[alive] += dd[near]
        moved = sign[alive] * (d[alive] - delay)
        done = (step < _CONVERGED) & (moved > 0.0) & (moved < 2.0 * start[alive])
        best[alive[done]] = moved[done]
        alive = alive[step >= _CONVERGED]
    return float(best.min()) if best.size else math.inf


_DONE = 1e-15  # of the cost: a block that adds less is the last
BLOCKS = 4000  # of one delay each
_SHORTEST = 16  # periods of a block
LARGEST = 1e60  # a larger cost is that of a loop that grows


def cost_and_growth(
    plant: SwitchedSystem,
    feedback: Feedback,
    mode: int,
    blocks: int = BLOCKS,
    weight: Weight | None = None,
) -> tuple[float, float]:
    """The cost, ∞ if unstable, and about the growth rate, 1/s, negative for a loop that decays.

    After `blocks` blocks of one delay the rest is summed as a geometric series.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[-1.0]]], [[[1.0]]], delay=0.2)
    >>> idle = dt.DelayedStateFeedback(plant, [[[0.0]]]).digital(0.1)
    >>> round(cost_and_growth(plant, idle, 0)[0], 12)                     # ∫ e^{−2t} dt
    0.5
    """
    pieces, step = SampledPlant(plant, feedback.step).pieces(mode), feedback.step
    one = LoopPeriods.held(pieces, feedback, aged_row(feedback, mode))
    block, n, m = block_of(one), plant.states, plant.inputs
    lags, form = _form(plant, pieces, step, mode, weight)
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
    plant: SwitchedSystem, pieces: tuple[Piece, ...], step: float, mode: int, weight: Weight | None
) -> tuple[Int[np.ndarray, " lag"], Float[np.ndarray, "z z"]]:
    """The lags of a period, and S with ∫xᵀQx + uᵀRu over it = zᵀ S z, z = (x_k, u_{k−lags[0]}, …).

    The term of u is that of the input computed in the period; each input counts once.
    """
    from deadtime.numerics.exponential import gramian

    n, m = plant.B.shape[1:]
    A, B = read_only(plant.A[mode]), read_only(plant.B[mode])
    Q, R = (plant.identity, np.eye(m)) if weight is None else (weight.Q, weight.R)
    lags = np.unique(np.append(np.concatenate([one.stretch.lag for one in pieces]), 0))
    X, form = np.eye(n, n + lags.size * m), np.zeros((n + lags.size * m,) * 2)
    form[n : n + m, n : n + m] = step * R  # lag 0 comes first
    for Phi, Gamma, (start, stop, lag) in pieces:
        U = np.zeros((m, len(form)))
        U[np.arange(m), n + np.searchsorted(lags, lag) * m + np.arange(m)] = 1.0
        z = np.vstack((X, U))
        form += z.T @ gramian(A, B, stop - start, Q) @ z
        X = Phi @ X + Gamma @ U
    return lags, form


def periods_of(plant: SwitchedSystem, feedback: Feedback, mode: int) -> LoopPeriods:
    """A period of one mode under the row of a mode held throughout."""
    pieces = SampledPlant(plant, feedback.step).pieces(mode)
    return LoopPeriods.held(pieces, feedback, aged_row(feedback, mode))


def block_of(one: LoopPeriods) -> int:
    """Periods that are run at a time, at least the past inputs of a period."""
    return max(one.past, _SHORTEST)


_DENSE = 150  # order up to which computing all eigenvalues is as fast as Arnoldi's method
WIDEST = 9.0  # relative: larger margins count as equal


def assess(
    plant: SwitchedSystem,
    law: Law,
    step: float,
    blocks: int = BLOCKS,
    exact: bool = False,
    weight: Weight | None = None,
) -> tuple[float, float, float]:
    """Estimated relative margin, cost, and the growth rate of the fastest growing mode, 1/s.

    With `exact` the growth rate comes from the lifted loop; otherwise from the run of the cost,
    which is inaccurate for complex poles, and for a slow pole with a small residue.
    """
    from deadtime.switching import SwitchingSignal

    costs, margin, growth = [], math.inf, -math.inf
    for mode in range(plant.modes):
        table = law.digital(step, SwitchingSignal.constant(mode), 1)
        cost, grows = cost_and_growth(plant, table, mode, blocks, weight)
        if exact and math.isfinite(cost):
            row = aged_row(table, mode)
            grows = LiftedLoop.of(plant, table, mode, row).growth_rate(step, _DENSE)
        costs.append(cost)
        growth = max(growth, grows)
        if math.isinf(cost):
            margin = 0.0
        elif margin > 0.0:
            margin = min(margin, WIDEST, estimated_margin(plant, table, mode))
    return margin, sum(costs) / len(costs), growth
