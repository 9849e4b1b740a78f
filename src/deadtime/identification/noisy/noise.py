"""From what a period adds to a noise of the plant, and to noise of the sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.identification.delay_intervals import delay_intervals
from deadtime.identification.estimate import Estimate
from deadtime.identification.intervals import Spread, inverse, require_seen, spread_of
from deadtime.identification.levels import (
    at_zero,
    likelier_than_chance,
    near_zero,
    with_constant,
    without_level,
)
from deadtime.identification.likelihoods.noisy_log import NoiseLevels, NoisyLog
from deadtime.identification.log.recording import Recording
from deadtime.identification.maximum import maximise
from deadtime.identification.noisy.largest import largest_maximum
from deadtime.identification.noisy.noise_intervals import variance_errors
from deadtime.identification.noisy.restricted import restricted
from deadtime.identification.over_peaks import ends_over_peaks
from deadtime.identification.residuals import judge_residuals
from deadtime.identification.scoring import Maximum
from deadtime.identification.start import Start
from deadtime.numerics.covariance import noise_covariances
from deadtime.numerics.kernels import expect_many_calls

_ENOUGH = 10_000  # samples that tell how noise is restricted
_FEW = 4_000  # samples that tell where the largest maximum is
_FLOOR = 1e-9  # of the variance of a period that W has in every direction, to start from


def continuous(
    A: Float[np.ndarray, "mode n n"], S: Float[np.ndarray, "mode n n"], step: float
) -> Float[np.ndarray, "mode n n"]:
    """W of which a period makes S = ∫₀^h e^{As} W e^{Aᵀs} ds, mode by mode, positive semidefinite.

    Examples
    --------
    >>> W = continuous(np.array([[[-1.0]]]), np.array([[[0.5 * (1.0 - np.exp(-0.4))]]]), 0.2)
    >>> W.round(12)
    array([[[1.]]])
    """
    result = np.empty(S.shape)
    for i, one in enumerate(A):
        W = np.linalg.lstsq(_images(one, step), S[i].ravel(), rcond=None)[0].reshape(one.shape)
        values, vectors = np.linalg.eigh(0.5 * (W + W.T))
        W = (vectors * np.maximum(values, 0.0)) @ vectors.T
        result[i] = 0.5 * (W + W.T)  # to the last bit, as who reads it makes it
    return result


def _images(A: Float[np.ndarray, "n n"], step: float) -> Float[np.ndarray, "nn nn"]:
    """From W to S, line by line, of a W that is symmetric."""
    n = len(A)
    units = np.eye(n * n).reshape(n * n, n, n)
    units = 0.5 * (units + units.transpose(0, 2, 1))
    S = noise_covariances(np.repeat(A[None], n * n, axis=0), units, np.full(n * n, step))
    return S.reshape(n * n, n * n).T


def intensity_errors(
    A: Float[np.ndarray, "mode n n"],
    W: Float[np.ndarray, "mode n n"],
    step: float,
    spare: Int[np.ndarray, " mode"],
) -> Float[np.ndarray, " variance"]:
    """The standard errors of the diagonals of W, mode by mode, from `spare` periods of each.

    W_aa is linear in S, Σ G_bc S_bc, and S is Wishart's: its variance is 2 tr(G S G S) / spare. A
    position has noise in S that its speed has brought there, and with it an error.

    Examples
    --------
    >>> A, W = np.array([[[0.0, 1.0], [0.0, 0.0]]]), np.array([np.diag([0.0, 3.0])])
    >>> (intensity_errors(A, W, 0.1, np.array([200])) * [1000.0, 1.0]).round(3)
    array([0.354, 0.3  ])
    """
    modes, n, _ = A.shape
    errors, S = np.empty((modes, n)), noise_covariances(A, W, np.full(modes, step))
    for i, one in enumerate(A):
        G = np.linalg.pinv(_images(one, step))[:: n + 1].reshape(n, n, n)
        GS = 0.5 * (G + G.transpose(0, 2, 1)) @ S[i]
        errors[i] = np.sqrt(2.0 * np.einsum("abc,acb->a", GS, GS) / spare[i])
    return errors.ravel()


def estimate_with_noise(
    recording: Recording,
    C: Float[np.ndarray, "p n"],
    exact: Estimate,
    within: bool,
    bounds: tuple[float, float],
) -> Estimate:
    """The estimate if sensors are noisy, from that without noise."""
    log, begins = begun_with_noise(recording, C, exact, within, bounds)
    some = replace(log, recording=recording.stretches(_FEW, recording.lag(bounds[1])))
    top, scan = largest_maximum(some, begins)
    best, window = maximise(log, top.theta)
    smaller, kept = without_level(log, best.theta, best.found.information, np.linalg.pinv(C))
    if kept.size < best.theta.size:
        log, (best, window) = smaller, maximise(smaller, best.theta[kept])
    elif log.layout.constant and near_zero(recording):
        # Noise that is told as less than it is makes Wald's test too sure.
        plain, kept = at_zero(log, best.theta.size)
        climbed = [best.theta[kept]]
        few, _ = at_zero(some, best.theta.size)
        top, beside = largest_maximum(few, [begin[kept] for begin in begins], climbed)
        other, around = maximise(plain, top.theta)
        starts = log.starts(min(window[0], around[0]), max(window[1], around[1]))
        rise = log.value(best.theta, starts) - plain.value(other.theta, starts)
        if not likelier_than_chance(rise, best.theta.size - other.theta.size):
            log, best, window, scan = plain, other, around, beside
    curves = scan.curves * (recording.samples / some.recording.samples)
    return estimated_of(log, best, window, start_beside(log, best, scan.first, curves), exact.spare)


def start_beside(
    log: NoisyLog, best: Maximum, first: int, curves: Float[np.ndarray, "delay cell"]
) -> Start:
    """A maximum, and how likely a scan says that each cell of a delay is beside it."""
    theta = best.theta[: log.layout.size]
    return Start(theta, log.cells(theta), first, curves, log.acting.size)


def begun_with_noise(
    recording: Recording,
    C: Float[np.ndarray, "p n"],
    exact: Estimate,
    within: bool,
    bounds: tuple[float, float],
) -> tuple[NoisyLog, list[Float[np.ndarray, " size"]]]:
    """The likelihood with noisy sensors, and vectors to climb from."""
    expect_many_calls()
    layout, theta = exact.log.layout, exact.best.theta
    if recording.level is not None:
        theta, layout = with_constant(theta, layout, recording.level, np.linalg.pinv(C))
    log = NoisyLog(recording, layout, within, bounds, exact.log.nodes, C)
    noises = first_noises(exact.disturbance.mean(axis=0), C, recording.step)
    return log, [log.join(theta, noise) for noise in noises]


def estimated_of(
    log: NoisyLog,
    best: Maximum,
    window: tuple[float, float],
    start: Start,
    spare: Int[np.ndarray, " mode"] | None = None,
) -> Estimate:
    """What there is to say of a maximum; `spare` periods of each mode, of measurements if None."""
    recording, layout, starts = log.recording, log.layout, log.starts(*window)
    beyond = max(log.measured(starts) - log.free.size, 1)
    lag = recording.lag(window[1])
    some = replace(log, recording=recording.stretches(_ENOUGH, lag))
    spread, theta = _spread(log, some, best, window, float(beyond))
    intervals, several = delay_intervals(log, best, window, spread, start)
    plant = layout.plant(theta[: layout.size])
    noise = log.noise(theta)
    white = noisy_residuals(log, theta, starts)
    chained = log.embedding is not None
    spent = 2 * layout.n * len(log.C) if chained else None
    return Estimate(
        log=log,
        best=best._replace(theta=theta),
        window=window,
        plant=plant,
        spread=spread,
        intervals=intervals,
        several=several,
        start=start,
        disturbance=np.tile(noise.W, (layout.modes, 1, 1)),
        noise=noise.deviation,
        noise_errors=variance_errors(log, theta, spread.covariance),
        spare=np.full(layout.modes, beyond) if spare is None else spare,
        tests=judge_residuals(white, recording, plant.longest_delay, spent),
        white=tuple(white),
        ends=None if chained else ends_over_peaks(log, best, spread, start),
        of_outputs=log if chained else None,
    )


def _spread(
    log: NoisyLog, some: NoisyLog, best: Maximum, window: tuple[float, float], most: float
) -> tuple[Spread, Float[np.ndarray, " size"]]:
    """Of all unknowns, and these with the noise restricted.

    What is known has no variance, noise that the log does not tell any.
    """
    F, names, size, free = best.found.information, log.layout.names(), log.layout.size, log.free
    seen = log.told(best.theta, F)
    own, named = np.ix_(seen, seen), [names[a] for a in seen if a < size]
    require_seen(F[own], named)
    less = restricted(log, some, best, window, most)
    of = spread_of(F[own], named, less.information[own], less.spare[seen])
    covariance = np.zeros(F.shape)
    untold = np.setdiff1d(free, seen)
    cross = F[np.ix_(untold, seen)]
    beside = np.einsum("as,st,at->a", cross, inverse(F[own]), cross)
    least = 1e-12 * np.diagonal(F)[untold] + np.finfo(float).tiny
    covariance[untold, untold] = 1.0 / np.maximum(np.diagonal(F)[untold] - beside, least)
    covariance[own] = of.covariance
    reach, inflation = np.full(len(F), of.reach.min()), np.ones(len(F))
    reach[seen], inflation[seen] = of.reach, of.inflation
    return Spread(covariance, reach, inflation, less.spare), less.theta


def noisy_residuals(
    log: NoisyLog, theta: Float[np.ndarray, " size"], starts: list[Bool[np.ndarray, " sample"]]
) -> list[Float[np.ndarray, "sample p"]]:
    """The innovations of every part, each over its deviation; NaN where there are none."""
    e, s = log.innovations(theta, starts)
    fresh = np.concatenate(starts)[:, None] | np.vstack(log.initial(starts))
    parts = log.recording.parts
    known = np.vstack([np.isfinite(part.output) for part in parts]) & ~fresh
    white = np.where(known, e / np.sqrt(s), np.nan)
    return np.split(white, np.cumsum([part.time.size for part in parts])[:-1])


def first_noises(
    W: Float[np.ndarray, "n n"], C: Float[np.ndarray, "p n"], step: float
) -> list[NoiseLevels]:
    """Two guesses: what a period adds, of W, is mostly the plant's, or mostly the sensors'."""
    floor = max(_FLOOR * float(np.trace(W)), np.finfo(float).tiny)
    W = W + floor * np.eye(len(W))
    added = np.sqrt(np.diagonal(C @ W @ C.T) * step)
    return [NoiseLevels(0.7 * W, 0.4 * added), NoiseLevels(0.1 * W, 0.7 * added)]
