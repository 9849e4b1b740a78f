"""Maximum-likelihood estimates with noisy sensors, in open and in closed loop.

The likeliest noise is too small, like a variance divided by N instead of N − p, because the p
unknowns θ of the plant fit some of the noise. Restricted likelihood (Harville) integrates θ out by
Laplace's approximation and maximises over the noise η alone:

    log L(θ, η) − ½ log det F_θθ(η).

The gradient g of the second term hardly depends on η, the logarithms of deviations: for a single
regression it is p for every η. So log L + gᵀη is maximised instead, which gives N − p exactly.

**Closed loops**, in which inputs are little more than a function of the measurements. With noise v
of sensors, y_k = x_k + v_k, and one state, a period is

    y_{k+1} = Φ y_k + Γ₁ u_{k−N} + Γ₂ u_{k−N+1} + ε_k,    ε_k = w_k + v_{k+1} − Φ v_k.

ε_k is correlated with y_k, by −Φ V, and with its neighbours, so the best predictor uses y_k,
y_{k−1}, y_{k−2}, … with weights that decrease by the ratio of the filter. Where u_k = K y_k, an
input one or two periods old *is* such a measurement. In a model without sensor noise, a delay that
short lets B K act as a weight of the predictor. This maximum of the likelihood is higher than the
plant's own, has another B, often of the other sign, and white residuals.

With sensor noise among the unknowns it is no maximum any more. The delay then shows only in the
dependence of y on itself after D + h, by a share B K that noise may hide, and there may be many
maxima. So the likelihood is maximised in every cell of the delay, from several starts, and
intervals cover all plausible cells. Where these are most of the range, the log determines A + B K
only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.identification.delay_scan import DelayScan, largest_maximum
from deadtime.identification.estimate import Estimate
from deadtime.identification.intervals import (
    Peak,
    Spread,
    inverse,
    plausible_fall,
    require_identified,
    spread_of,
)
from deadtime.identification.levels import (
    at_zero,
    likelier_than_chance,
    near_zero,
    with_constant,
    without_level,
)
from deadtime.identification.likelihoods.likelihood import climb_within, maximise
from deadtime.identification.likelihoods.noisy_log import NoiseLevels, NoisyLog, SensorLikelihood
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import FisherMatrix, SensorMatrix, Square, Vector, Window
from deadtime.identification.scoring import Evaluate, Evaluation, Maximum, climb
from deadtime.identification.start import Start, cell_range
from deadtime.numerics.kernels import expect_many_calls

_ENOUGH = 10_000  # samples that suffice for the gradient g
_FEW = 4_000  # samples that locate the largest maximum
_LEAST = 2  # measurements per unknown
_FLOOR = 1e-9  # of the trace of W: least noise in every direction of a start
_STEP = 1e-3  # of a logarithm, for differences
_GAIN = 1e-4  # rise of log likelihood that ends a climb
_IDENTIFIED = 1.0  # information on a logarithm: noise uncertain by a factor above e stays fixed
_FEWEST = 3.0  # degrees of freedom: with 2 or less Student's distribution has no variance


def estimate_with_noise(recording: Recording, C: SensorMatrix, exact: Estimate) -> Estimate:
    """The estimate if sensors are noisy, from that without noise."""
    log, guesses = noisy_starts(recording, C, exact)
    some = replace(log, recording=recording.stretches(_FEW, recording.lag(log.bounds[1])))
    top, scan = largest_maximum(some, guesses)
    best, window = maximise(log, top.theta)
    smaller, kept = without_level(log, best.theta, best.information, np.linalg.pinv(C))
    if kept.size < best.theta.size:
        log, (best, window) = smaller, maximise(smaller, best.theta[kept])
    elif log.layout.constant and near_zero(recording):
        # Underestimated noise makes Wald's test reject too often: compare likelihoods instead.
        plain, kept = at_zero(log, best.theta.size)
        climbed = [best.theta[kept]]
        few, _ = at_zero(some, best.theta.size)
        top, beside = largest_maximum(few, [guess[kept] for guess in guesses], climbed)
        other, around = maximise(plain, top.theta)
        starts = log.starts(min(window[0], around[0]), max(window[1], around[1]))
        rise = log.value(best.theta, starts) - plain.value(other.theta, starts)
        if not likelier_than_chance(rise, best.theta.size - other.theta.size):
            log, best, window, scan = plain, other, around, beside
    start = start_with_scan(log, best, scan, some.recording.samples)
    return estimate_at(log, best, window, start, exact.spare)


def start_with_scan(log: NoisyLog, best: Maximum, scan: DelayScan, samples: int) -> Start:
    """A maximum with the log likelihood of each cell of a delay, from a scan of some samples."""
    theta, share = best.theta[: log.layout.size], log.recording.samples / samples
    return Start(theta, log.cells(theta), scan.first, scan.curves * share, log.acting.size)


def require_measured(log: NoisyLog, unknowns: int) -> None:
    """Refuse a log with too few measurements whose inputs are known for all delays searched."""
    each = zip(log.recording.parts, log.starts(*log.bounds), strict=True)
    known = sum(int(np.isfinite(part.output[~start]).sum()) for part, start in each)
    if known < _LEAST * unknowns:
        raise ArgumentError(
            f"log has {known} measurements whose inputs are known for all delays of up to "
            f"{log.bounds[1]:g} s, too few for {unknowns} unknowns: narrow delay=(low, high), "
            "--delay LOW HIGH, or log for longer, with fewer rows lost."
        )


def noisy_starts(
    recording: Recording, C: SensorMatrix, exact: Estimate
) -> tuple[NoisyLog, list[Vector]]:
    """The likelihood with noisy sensors, and starts."""
    expect_many_calls()
    layout, theta = exact.log.layout, exact.best.theta
    if recording.level is not None:
        theta, layout = with_constant(theta, layout, recording.level, np.linalg.pinv(C))
    of = exact.log
    log = NoisyLog(recording, layout, of.within, of.bounds, of.nodes, C)
    require_measured(log, layout.size)
    noises = first_noises(exact.disturbance.mean(axis=0), C, recording.step)
    return log, [log.join(theta, noise) for noise in noises]


def estimate_at(
    log: NoisyLog,
    best: Maximum,
    window: Window,
    start: Start,
    spare: Int[np.ndarray, " mode"] | None = None,
) -> Estimate:
    """The estimate at a maximum; `spare`: degrees of freedom of W, of measurements if None."""
    beyond = max(log.measured(log.starts(*window)) - log.free.size, 1)
    some = replace(log, recording=log.recording.stretches(_ENOUGH, log.recording.lag(window[1])))
    spread, theta = _spread(log, some, best, window, float(beyond))
    peak = Peak(log=log, best=best, window=window, spread=spread, start=start)
    own = np.full(log.layout.modes, beyond) if spare is None else spare
    if log.embedding is None:
        return estimate_of_sensors(peak, theta, log, own, ends=peak.ends_over_peaks())
    return estimate_of_sensors(peak, theta, log, own, of_outputs=log)


def estimate_of_sensors(
    peak: Peak,
    theta: Vector,
    along: NoisyLog,
    spare: Int[np.ndarray, " mode"],
    *,
    ends: Float[np.ndarray, "unknown 2"] | None = None,
    of_outputs: NoisyLog | None = None,
) -> Estimate:
    """The estimate at a peak with noisy sensors, its noise restricted in `theta`.

    along : the likelihood with modes known, those of the likeliest path if they were hidden
    """
    layout, noise = along.layout, along.noise(theta)
    white = noisy_residuals(along, theta, peak.window)
    return Estimate.at(
        peak,
        layout.plant(theta[: layout.size]),
        along.recording,
        white,
        None if of_outputs is None else 2 * layout.n * len(along.C),
        best=peak.best._replace(theta=theta),
        disturbance=np.tile(noise.W, (layout.modes, 1, 1)),
        noise=noise.deviation,
        noise_errors=variance_errors(along, theta, peak.spread.covariance),
        spare=spare,
        ends=ends,
        of_outputs=of_outputs,
    )


def _spread(
    log: NoisyLog, some: NoisyLog, best: Maximum, window: Window, most: float
) -> tuple[Spread, Vector]:
    """The covariance of all unknowns, and the vector with restricted noise.

    Known entries have variance 0, unidentified noise a very large one.
    """
    F, names, size, free = best.information, log.layout.names(), log.layout.size, log.free
    known = log.identified(best.theta, F)
    own, named = np.ix_(known, known), [names[a] for a in known if a < size]
    require_identified(F[own], named)
    less = restricted(log, some, best, window, most)
    of = spread_of(F[own], named, less.information[own], less.spare[known])
    covariance = np.zeros(F.shape)
    unidentified = np.setdiff1d(free, known)
    cross = F[np.ix_(unidentified, known)]
    beside = np.einsum("as,st,at->a", cross, inverse(F[own]), cross)
    least = 1e-12 * np.diagonal(F)[unidentified] + np.finfo(float).tiny
    covariance[unidentified, unidentified] = 1.0 / np.maximum(
        np.diagonal(F)[unidentified] - beside, least
    )
    covariance[own] = of.covariance
    reach, inflation = np.full(len(F), of.reach.min()), np.ones(len(F))
    reach[known], inflation[known] = of.reach, of.inflation
    return Spread(covariance, reach, inflation, less.spare), less.theta


def noisy_residuals(
    log: NoisyLog, theta: Vector, window: Window
) -> list[Float[np.ndarray, "sample p"]]:
    """The innovations of every part in standard deviations; NaN without a measurement."""
    e, s = log.residuals(theta, window)
    ends = np.cumsum([part.time.size for part in log.recording.parts])
    return np.split(e / np.sqrt(s), ends[:-1])


def first_noises(W: Square, C: SensorMatrix, step: float) -> list[NoiseLevels]:
    """Two guesses: noise W of periods is mostly the plant's, or mostly the sensors'."""
    floor = max(_FLOOR * float(np.trace(W)), np.finfo(float).tiny)
    W = W + floor * np.eye(len(W))
    added = np.sqrt(np.diagonal(C @ W @ C.T) * step)
    return [NoiseLevels(0.7 * W, 0.4 * added), NoiseLevels(0.1 * W, 0.7 * added)]


class Restricted(NamedTuple):
    """The unknowns with restricted noise, their information and degrees of freedom."""

    theta: Vector
    information: FisherMatrix
    spare: Vector


def restricted(
    log: NoisyLog, some: NoisyLog, best: Maximum, window: Window, most: float
) -> Restricted:
    """The maximum of the restricted likelihood with delays fixed, from that of the likelihood.

    some : part of the log, for derivatives of the information; most : bound of degrees of freedom
    """
    cells, size = log.cells(best.theta), log.layout.size
    evaluate, own = log.evaluate_in(*window)(cells), some.evaluate_in(*window)(cells)
    noise, unit = np.arange(size, log.size), log.unit(best.theta)[size:]
    identified = np.diagonal(best.information)[size:] * unit**2 > _IDENTIFIED
    moves = _moves(own, best.theta, noise[identified], unit[identified])[:, :size, :size]
    moves *= log.recording.samples / some.recording.samples
    free, C = log.free[log.free < size], np.zeros((size, size))
    C[np.ix_(free, free)] = inverse(best.information[np.ix_(free, free)])
    gradient = np.zeros(log.size)
    gradient[noise[identified]] = -0.5 * np.einsum("ab,cba->c", C, moves)

    def tilted(theta: np.ndarray) -> Evaluation:
        now, more = evaluate(theta), float(gradient @ (theta - best.theta))
        return Evaluation(now.value + more, now.score + gradient, now.information)

    low, high = log.limits
    still = np.concatenate((log.layout.delay_places, noise[~identified]))
    low[still], high[still] = best.theta[still], best.theta[still]
    after = climb(tilted, best.theta, low, high, gain=_GAIN, stride=log.stride)
    value = after.value - float(gradient @ (after.theta - best.theta))
    if not value > best.value - free.size:  # too much less likely to be a correction
        return Restricted(best.theta, best.information, np.full(log.size, most))
    fewer = np.sqrt(np.append(np.ones(size), _noise_shares(log, best.theta, after.theta)))
    F = after.information * fewer[:, None] * fewer
    slopes = np.zeros((size, moves.shape[0]))
    slopes[free] = -np.einsum("ab,cbd,da->ac", C, moves, C)[free] / np.diagonal(C)[free, None]
    error = np.linalg.pinv(F[np.ix_(noise[identified], noise[identified])])
    variance = np.einsum("ac,cd,ad->a", slopes, error, slopes)  # of the logarithms of variances
    spare = np.full(log.size, most)
    spare[:size] = np.maximum(2.0 / np.maximum(variance, 2.0 / most), min(_FEWEST, most))
    return Restricted(after.theta, F, spare)


def _moves(
    evaluate: Evaluate, theta: np.ndarray, places: np.ndarray, units: np.ndarray
) -> Float[np.ndarray, "place size size"]:
    """The derivatives of the information by unknowns of the noise."""
    now = evaluate(theta).information
    moves = np.empty((places.size, *now.shape))
    for row, (place, unit) in enumerate(zip(places, units, strict=True)):
        ahead = theta.copy()
        ahead[place] += _STEP * unit
        moves[row] = (evaluate(ahead).information - now) / (_STEP * unit)
    return moves


def _noise_shares(
    log: NoisyLog, likeliest: np.ndarray, theta: np.ndarray
) -> Float[np.ndarray, " noise"]:
    """(N − p)/N of every unknown of the noise: its variance before, over that after."""
    before, after = log.noise(likeliest), log.noise(theta)
    of_W = np.diagonal(before.W) / np.diagonal(after.W)
    return np.minimum(
        np.concatenate((of_W[log.places[0]], (before.deviation / after.deviation) ** 2)), 1.0
    )


def variance_errors(
    log: SensorLikelihood, vector: Vector, covariance: FisherMatrix
) -> Float[np.ndarray, " variance"]:
    """Standard errors of W_aa = Σ_b L_ab², mode by mode, and of sensors' variances.

    To second order in L_ab. Near 0 the log likelihood is a parabola in w = W_aa: there F, the
    information on log √w, nearly vanishes, but the error 2 w/√F does not.
    """
    size, (i, j), n = log.layout.size, log.places, log.layout.n
    C, L = covariance[size:, size:], log.root(vector)
    off = i != j
    slope = np.zeros((n + len(log.C), len(C)))
    slope[i, np.arange(i.size)] = 2.0 * np.where(off, L[i, j], L[i, j] ** 2)
    sensors = np.arange(len(log.C))
    slope[n + sensors, i.size + sensors] = 2.0 * log.noise(vector).deviation ** 2
    variance = np.einsum("va,ab,vb->v", slope, C, slope)
    for a in range(n):
        own = np.flatnonzero(off & (i == a))
        with np.errstate(over="ignore"):  # the variance of unidentified noise is huge
            variance[a] += 2.0 * float((C[np.ix_(own, own)] ** 2).sum())
    W, R = np.split(np.sqrt(variance), [n])
    return np.concatenate((np.tile(W, log.layout.modes), R))


def may_be_exact(exact: Estimate, noisy: Estimate) -> bool:
    """Whether measurements may be taken as exact: sensor noise may be 0, and intervals overlap.

    Otherwise the exact estimate is biased, and its intervals are far too narrow.
    """
    if not exact.tests.white or noisy.several.any():
        return False
    low = np.maximum(exact.intervals, noisy.intervals)[:, 0]
    high = np.minimum(exact.intervals, noisy.intervals)[:, 1]
    return bool((low <= high).all()) and all(least == 0.0 for least, _ in noisy.sensor_intervals)


_MANY = 40  # cells from which all starts are tried; others start from their neighbour's maximum
_LOOK = 2_000  # samples for a first pass over all cells
_CELL_GAIN = 1e-3  # rise of log likelihood that ends a climb in a cell
_SAME = 0.1  # a neighbour likelier by more than this is tried as a start


def estimate_in_loop(recording: Recording, C: SensorMatrix, exact: Estimate) -> Estimate:
    """The estimate if sensors are noisy, from maxima of the likelihood in every cell of a delay."""
    log, guesses = noisy_starts(recording, C, exact)
    bounds = log.bounds
    lag = recording.lag(bounds[1])
    some = replace(log, recording=recording.stretches(_LOOK, lag))
    theta, curves, vectors = guesses[0], [], []
    first, last = cell_range(recording.step, bounds, log.layout.m)
    every = np.arange(first, last + 1)
    for row in range(log.layout.delays):
        tops = _in_cells(some, guesses, row, every)
        if some.recording is not recording:
            tops = _anew(log, tops, row, every)
        values = np.array([top.value for top in tops])
        theta = tops[int(values.argmax())].theta
        guesses = [theta, *guesses]
        curves.append(values)
        vectors.append([top.theta for top in tops])
    best, window = maximise(log, theta, gain=_CELL_GAIN)
    log, kept = without_level(log, best.theta, best.information, np.linalg.pinv(log.C))
    if kept.size < best.theta.size:
        best, window = maximise(log, best.theta[kept], gain=_CELL_GAIN)
        vectors = [[vector[kept] for vector in each] for each in vectors]
    cells = log.cells(best.theta)
    for row, cell in enumerate(cells):  # the last climb, over kinks, may have reached higher
        own = log.evaluate_in(*bounds)(cells)(best.theta).value
        curves[row][cell - first] = max(curves[row][cell - first], own)
        vectors[row][cell - first] = best.theta
    identified = np.array(curves), log.acting.size, np.array(vectors)
    start = Start(best.theta[: log.layout.size], cells, first, *identified)
    return estimate_at(log, best, window, start)


def _in_cells(
    log: NoisyLog, guesses: list[np.ndarray], row: int, every: Int[np.ndarray, " cell"]
) -> list[Maximum]:
    """The likeliest vector with one delay in each of its cells."""
    evaluate_in, tops = log.evaluate_in(*log.bounds), []
    often = max(1, every.size // _MANY)
    for place, cell in enumerate(every.tolist()):
        near = [tops[-1].theta] if tops else []
        own = near if place % often else [*near, *guesses]
        tried = [_top(log, evaluate_in, theta, row, cell) for theta in own]
        tops.append(max(tried, key=lambda one: one.value))
    for place in range(every.size - 2, -1, -1):
        if tops[place + 1].value > tops[place].value + _SAME:
            again = _top(log, evaluate_in, tops[place + 1].theta, row, int(every[place]))
            tops[place] = max(tops[place], again, key=lambda one: one.value)
    return tops


def _anew(
    log: NoisyLog, tops: list[Maximum], row: int, every: Int[np.ndarray, " cell"]
) -> list[Maximum]:
    """The maxima over the whole log in the cells that a part of it shows to be plausible."""
    evaluate_in, values = log.evaluate_in(*log.bounds), np.array([one.value for one in tops])
    fall = values.max() - values
    near = np.flatnonzero(fall <= plausible_fall(log.layout, log.acting.size, every.size, 1.0))
    anew = {i: _top(log, evaluate_in, tops[i].theta, row, int(every[i])) for i in near.tolist()}
    most = max(one.value for one in anew.values())
    return [anew.get(i, one._replace(value=most - float(fall[i]))) for i, one in enumerate(tops)]


def _top(
    log: NoisyLog,
    evaluate_in: Callable[[np.ndarray], Evaluate],
    theta: np.ndarray,
    row: int,
    cell: int,
) -> Maximum:
    """The maximum near a vector with one delay in a given cell, the others in theirs."""
    cells, guess = log.cells(theta), theta
    if cells[row] != cell:
        guess, cells[row] = theta.copy(), cell
        guess[log.layout.at_delays][row] = (cell - 0.5) * log.recording.step
    return climb_within(log, evaluate_in(cells), guess, cells, _CELL_GAIN)
