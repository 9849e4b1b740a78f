"""The largest inputs: the worst case over initial states, or a level kept with a probability.

With one mode held and no inputs in the past every input is linear in the initial state,
u_k = M_k x(0), and held over its period, so the largest over samples is the largest over time. M_k
comes from n runs. Over a set of initial states the largest |u_k| is an exact closed form of each
row (`deadtime.synthesis.input_sources`).

For x(0) ~ N(0, X) the variance of every u_k is exact, σ_k² = M_k X M_kᵀ. The probability that |u_k|
stays below a level c at all k has no closed form, and lies between

    max(F_n(c²/max_k σ_k²), Π_k P(|u_k| ≤ c))    and    min_k P(|u_k| ≤ c),

with F_n the distribution of χ² with rank X degrees of freedom: within the ellipsoid of that size no
u_k exceeds c; the product is Šidák's inequality (Journal of the American Statistical Association
62, 626–633, 1967). With one state the bounds are equal.

For stationary noise see `deadtime.synthesis.input_sources`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from deadtime.base.checks import bound, positive
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.feedback import Feedback, Law
from deadtime.feedback.law import require_match
from deadtime.numerics.covariance import noise_covariance, square_root
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.spectrum import growth_rate, least_growth
from deadtime.spectrum.sampled_runs import LoopPeriods, forward
from deadtime.synthesis.design_measures import block_of, periods_of
from deadtime.synthesis.input_sources import InitialStates, StationaryNoise, level_of

Source = InitialStates | StationaryNoise
_DONE = 1e-6  # of the largest input: a block that stays below is the last
_GROWS = 1e9  # times the first inputs: the loop grows
_MOST = 200_000  # samples
_HALVINGS = 100


@dataclass(frozen=True, eq=False)
class InputPeak(Frozen):
    """The largest inputs of a loop with one mode held (immutable).

    Attributes
    ----------
    initial : InitialStates or StationaryNoise
        The initial states, or the noise.
    level : (modes, m)
        The bound of :math:`|u_j(t)|`: over a set its exact maximum; for a normal x(0) a level kept
        with at least the requested probability; under noise the level kept with that probability at
        any one instant. ∞ for an unstable mode.
    least : (modes, m)
        A lower bound of the least such level: for a normal x(0) below `level`, otherwise equal.
    time : (modes, m)
        The time of the largest value, s; NaN for an unstable mode, and under noise.
    """

    initial: Source
    level: Float[np.ndarray, "mode m"]
    least: Float[np.ndarray, "mode m"]
    time: Float[np.ndarray, "mode m"]


def input_peak(
    plant: SwitchedSystem, law: Law, step: float = 0.01, initial: Source | None = None
) -> InputPeak:
    r"""The largest value of each input, with each mode held and no inputs in the past.

    Parameters
    ----------
    plant : SwitchedSystem
        The true plant; the law has a model of its own.
    law : Law
        A law that is a table, and needs no preview.
    step : float
        Sampling period h, s.
    initial : InitialStates or StationaryNoise, optional
        The ball :math:`|x(0)| \le 1` by default; or the noise of a loop in its stationary state.

    Returns
    -------
    InputPeak
        From the samples until the inputs have fallen to 1e-6 of their largest; ∞ in a mode whose
        loop grows (`growth_rate`), even if its inputs are small at first or 0.

    Raises
    ------
    ArgumentError
        If the law is no table, or needs a preview of the signal; if sizes do not match.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], delay=0.2)
    >>> law = dt.SingleModePredictor(plant, [[[-2.0]]], 0)
    >>> found = input_peak(plant, law, 0.05, dt.InitialStates.ball(3.0))
    >>> float(found.level[0, 0].round(6)), float(found.time[0, 0])     # 2 e^0.2 · 3 at once
    (7.328417, 0.0)
    >>> noisy = input_peak(plant, law, 0.05, dt.StationaryNoise(process=0.1, probability=0.95))
    >>> float(noisy.level[0, 0].round(4))
    1.0984
    """
    require_match(plant, law)
    if law.why_not_run or law.observer is not None:
        raise ArgumentError(
            f"law must be a table that can run, got {type(law).__name__}: inputs are linear in "
            "x(0) only of such a law."
        )
    step, initial = positive("step", step), check_initial(initial, plant)
    table = law.digital(step)
    found = [
        _unbounded(plant)
        if growth_rate(plant, law, mode, step) > least_growth(plant)
        else mode_levels(plant, table, mode, initial)
        for mode in range(plant.modes)
    ]
    level, least, at = (np.array(part) for part in zip(*found, strict=True))
    moving = np.isfinite(level) & (initial.kind != "noise")
    time = np.where(moving, at * step, np.nan)
    return InputPeak(initial, level, least, time)


def check_initial(initial: Source | None, plant: SwitchedSystem) -> Source:
    """The initial states, by default the unit ball, or the noise; checked."""
    if initial is None:
        return InitialStates.ball()
    if not isinstance(initial, Source):
        raise ArgumentError(
            f"initial must be an InitialStates or a StationaryNoise, got {type(initial).__name__}."
        )
    initial.require_plant(plant)
    return initial


def limits_asked(
    plant: SwitchedSystem, input_limit: ArrayLike | None
) -> Float[np.ndarray, " m"] | None:
    """The limit of each |u_j|, (m,), checked; None for none."""
    if input_limit is None:
        return None
    limit = bound("input_limit", input_limit, plant.inputs)
    if not (limit > 0.0).all():
        raise ArgumentError(
            f"input_limit must be positive, in the inputs' units, got {limit.tolist()}: it says "
            "what |u| must stay below."
        )
    return limit


def largest_inputs(
    plant: SwitchedSystem, law: Law, step: float, initial: Source | None
) -> Float[np.ndarray, " m"]:
    """The level of every input, the largest over the modes."""
    table, initial = law.digital(step), check_initial(initial, plant)
    levels = [mode_levels(plant, table, mode, initial)[0] for mode in range(plant.modes)]
    return np.max(levels, axis=0)


def mode_levels(
    plant: SwitchedSystem, feedback: Feedback, mode: int, initial: Source
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """`InputPeak.level`, `.least` and the sample of the largest value, with one mode held.

    For a loop that decays: growth from below 1e-6 of the first inputs is not detected.
    """
    if isinstance(initial, StationaryNoise):
        variance = input_covariance(plant, feedback, mode, initial)
        if variance is None:
            return _unbounded(plant)
        level = level_of(np.sqrt(np.diag(variance)), initial.probability)
        return level, level, np.zeros(plant.inputs, np.int64)
    rows = input_rows(plant, feedback, mode)
    if rows is None:
        return _unbounded(plant)
    sizes = _sizes(rows, initial)
    at, most = sizes.argmax(axis=0), sizes.max(axis=0)
    if initial.kind != "normal":
        return most, most, at
    directions = int(np.linalg.matrix_rank(initial.size))
    pairs = [_spread_levels(column, directions, initial.probability) for column in sizes.T]
    level, least = (np.array(part) for part in zip(*pairs, strict=True))
    return level, least, at


def _unbounded(plant: SwitchedSystem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`mode_levels` of a mode that grows."""
    infinite = np.full(plant.inputs, math.inf)
    return infinite, infinite, np.zeros(plant.inputs, np.int64)


def _sizes(rows: Float[np.ndarray, "k m n"], initial: InitialStates) -> Float[np.ndarray, "k m"]:
    """The largest |u| over the set, or its standard deviation, for every sample and input."""
    if initial.kind == "ball":
        return initial.size * np.linalg.norm(rows, axis=2)
    if initial.kind == "box":
        return np.abs(rows) @ initial.size
    return np.linalg.norm(rows @ square_root(initial.size), axis=2)


def _spread_levels(sigma: np.ndarray, directions: int, part: float) -> tuple[float, float]:
    """A level kept with at least a probability, and a lower bound of it; see the module."""
    from scipy.special import chdtri, erf, erfinv

    most = float(sigma.max())
    least = most * math.sqrt(2.0) * float(erfinv(part))
    within = most * math.sqrt(float(chdtri(directions, 1.0 - part)))
    moving = sigma[sigma > _DONE * most]
    if not moving.size:
        return 0.0, 0.0
    low, high = least, within  # the level of Šidák's bound lies between, or `within` is lower
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        kept = np.log(erf(middle / (math.sqrt(2.0) * moving))).sum() >= math.log(part)
        low, high = (low, middle) if kept else (middle, high)
    return high, least


def input_covariance(
    plant: SwitchedSystem, feedback: Feedback, mode: int, noise: StationaryNoise
) -> Float[np.ndarray, "m m"] | None:
    """The stationary covariance of u under noise with one mode held; None if the loop grows."""
    W, V = noise.matrices(plant.states, mode)
    rows, errors = input_rows(plant, feedback, mode), error_rows(plant, feedback, mode)
    if rows is None or errors is None:
        return None
    Q = noise_covariance(plant.A[mode], W, feedback.step)
    parts = [np.einsum("kai,ij,kbj->ab", M, S, M) for M, S in ((rows, Q), (errors, V))]
    return parts[0] + parts[1]


def input_rows(
    plant: SwitchedSystem, feedback: Feedback, mode: int
) -> Float[np.ndarray, "k m n"] | None:
    """M_k of u_k = M_k x(0), until 1e-6 of the largest; None if they grow."""
    return _responses(periods_of(plant, feedback, mode), np.eye(plant.states))


def error_rows(
    plant: SwitchedSystem, feedback: Feedback, mode: int
) -> Float[np.ndarray, "k m n"] | None:
    """H_k of u_k = H_k v, v the error of the first sample, H_0 = F, until 1e-6 of the largest."""
    one = periods_of(plant, feedback, mode)
    period, F = SampledPlant(plant, feedback.step).period(mode), one.F[0]
    soon = sum(B for lag, B in zip(period.lags, period.Gamma, strict=True) if lag == 0)
    states = (soon @ F).T.copy() if np.ndim(soon) else np.zeros((plant.states, plant.states))
    later = _responses(one, states, F.T)
    return None if later is None else np.concatenate((F[None], later))


def _responses(
    one: LoopPeriods, states: Float[np.ndarray, "n n"], sent: Float[np.ndarray, "n m"] | None = None
) -> Float[np.ndarray, "k m n"] | None:
    """The inputs of runs from `states` with `sent` as the last input, until 1e-6 of the largest.

    None if they grow.
    """
    _, m, n = one.F.shape
    past, block = one.past, block_of(one)
    inputs, after = np.zeros((n, (past + block) * m)), np.empty((block, n))
    if sent is not None and past:
        inputs[:, (past - 1) * m : past * m] = sent
    blocks, size = [], 0.0
    largest = first = 0.0 if sent is None else float(np.abs(sent).max())
    for _ in range(-(-_MOST // block)):
        for x, row in zip(states, inputs, strict=True):
            forward(one, x, row, after)
        new = inputs[:, past * m :].reshape(n, block, m).transpose(1, 2, 0).copy()
        inputs[:, : past * m] = inputs[:, block * m :].copy()
        size = float(np.abs(new).max())
        first = first or size
        if not size < _GROWS * first and size > 0.0:
            return None
        blocks.append(new)
        largest = max(largest, size)
        # In the first block the input sent before may not have arrived.
        if size <= _DONE * largest and len(blocks) > 1:
            break
    else:  # slow: compare with the middle of the run
        if size >= np.abs(blocks[len(blocks) // 2]).max():
            return None
    return np.concatenate(blocks)
