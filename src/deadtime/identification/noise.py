"""From what a period adds to a noise of the plant, and to noise of the sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from deadtime.identification.estimate import Estimate
from deadtime.identification.intervals import delay_intervals, spread_of
from deadtime.identification.maximum import maximise
from deadtime.identification.noisy import Noise, NoisyLog
from deadtime.identification.recording import Part, Recording
from deadtime.identification.residuals import judge_residuals
from deadtime.numerics.covariance import noise_covariances
from deadtime.numerics.kernels import expect_many_calls
from deadtime.plant import SwitchedSystem

_ENOUGH = 10_000  # samples that tell which of two beginnings is the better one
_STRETCHES = 10
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
    n = A.shape[1]
    result = np.empty(S.shape)
    for i, one in enumerate(A):
        images = []
        for place in range(n * n):
            unit = np.zeros((n, n))
            unit.flat[place] = 1.0
            unit = 0.5 * (unit + unit.T)
            images.append(noise_covariances(one[None], unit, np.array([step]))[0].ravel())
        W = np.linalg.lstsq(np.array(images).T, S[i].ravel(), rcond=None)[0].reshape(n, n)
        values, vectors = np.linalg.eigh(0.5 * (W + W.T))
        result[i] = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return result


def estimate_with_noise(
    recording: Recording,
    C: Float[np.ndarray, "p n"],
    exact: Estimate,
    within: bool,
    bounds: tuple[float, float],
) -> Estimate:
    """The estimate if sensors are noisy, from that without noise."""
    expect_many_calls()
    layout, n = exact.log.layout, C.shape[1]
    unit = np.sqrt(np.diagonal(exact.spread.covariance))
    unit = np.concatenate((unit, np.ones(n * (n + 1) // 2 + len(C))))
    log = NoisyLog(recording, layout, C, within, bounds, unit, exact.log.nodes)
    W = exact.disturbance.mean(axis=0)
    starts = [log.join(exact.best.theta, noise) for noise in first_noises(W, C, recording.step)]
    lag = int(np.ceil(exact.window[1] / recording.step)) + 1
    some = replace(log, recording=stretches(recording, _ENOUGH, lag), _acting={})
    tried = [maximise(some, start, window=exact.window) for start in starts]
    theta = max(tried, key=lambda one: one[0].found.value)[0].theta
    best, window = maximise(log, theta)
    names = layout.names()
    observations = sum(int(np.isfinite(part.output).sum()) for part in recording.parts)
    spare = max(observations - best.theta.size, 1)
    F = best.found.information
    known, every = F * (spare / observations), np.full(best.theta.size, float(spare))
    spread = spread_of(F, names, known, every)
    intervals, several = delay_intervals(log, best, window, spread, exact.start)
    A, B, delays = layout.split(best.theta[: layout.size])
    noise = log.noise(best.theta)
    white = noisy_residuals(log, best.theta, log.starts(*window))
    return Estimate(
        log,
        best,
        window,
        SwitchedSystem(A, B, delays),
        spread,
        intervals,
        several,
        exact.start,
        np.tile(noise.W, (layout.modes, 1, 1)),
        noise.deviation,
        exact.spare,
        judge_residuals(white, recording, float(delays.max())),
        tuple(white),
    )


def noisy_residuals(
    log: NoisyLog, theta: Float[np.ndarray, " size"], starts: list[Bool[np.ndarray, " sample"]]
) -> list[Float[np.ndarray, "sample p"]]:
    """The innovations of every part, each over its deviation; NaN where there are none."""
    e, s = log.innovations(theta, starts)
    fresh, parts = np.concatenate(starts), log.recording.parts
    known = np.vstack([np.isfinite(part.output) for part in parts]) & ~fresh[:, None]
    white = np.where(known, e / np.sqrt(s), np.nan)
    return np.split(white, np.cumsum([part.time.size for part in parts])[:-1])


def stretches(recording: Recording, most: int, lag: int) -> Recording:
    """The recording, or of a longer one stretches from all over it, of about `most` samples.

    Each has `lag` samples more, in which not all that acts is known.
    """
    if recording.samples <= 2 * most:
        return recording
    parts, share = [], most / recording.samples
    for part in recording.parts:
        count = max(1, round(_STRETCHES * part.time.size / recording.samples))
        for rows in np.array_split(np.arange(part.time.size), count):
            own = rows[: max(2, int(np.ceil(share * rows.size)) + lag)]
            parts.append(Part(*(column[own] for column in part)))
    return recording._replace(parts=tuple(parts))


def first_noises(
    W: Float[np.ndarray, "n n"], C: Float[np.ndarray, "p n"], step: float
) -> list[Noise]:
    """Two guesses: what a period adds, of W, is mostly the plant's, or mostly the sensors'."""
    floor = max(_FLOOR * float(np.trace(W)), np.finfo(float).tiny)
    W = W + floor * np.eye(len(W))
    added = np.sqrt(np.diagonal(C @ W @ C.T) * step)
    return [Noise(0.7 * W, 0.4 * added), Noise(0.1 * W, 0.7 * added)]
