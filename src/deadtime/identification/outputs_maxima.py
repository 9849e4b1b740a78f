"""Maxima of the likelihood of outputs alone: starts, and other delays with the same samples.

**Other delays** explain the same samples where inputs act on all states of an output. An input u
that stays for a period from t = 0 on makes, with a delay D,

    y(k h) = C (G(k h − D) − G(k h − D − h)) b,    G(t) = ∫₀ᵗ e^{As} ds,  0 before t = 0,

and evenly spaced rows depend on b and D through this pulse alone. With D in (N − 1) h … N h it
follows from y(N h) and the state at (N + 1) h, which is e^{A(N h − D)} G(h) b. Another delay D' of
the same cell has the same state there with b' = e^{A(D' − D)} b, so for one output only

    C G(N h − D') b' = C G(N h − D) b

remains, one equation for one number. For a double integrator with b = (β, 1) it is a parabola, and
D' = D − 2 β: b' = (−β, 1), the zero of opposite sign. So a zero at z can be distinguished from one
at −z if 2/|z| exceeds the rest of the cell, or if rows are unevenly spaced.

Delays with similar pulses, for the best b', are searched on a grid of three cells.

**Starts.** Derivatives of outputs are found by a smoother without a plant, and taken as measured.
Each output is the first of a chain of integrators, the last of which is driven by white noise: the
spline with the likeliest stiffness (Wahba, J. Royal Statistical Society B 40(3), 1978).

A second start is A of the chains from past outputs, independent of the delays. Outputs q periods
apart replace the states x of `Embedding`,

    z_k = (y_j,k, y_j,k−q, …, y_j,k−(n_j−1)q),    all outputs j,
    z_{k+q} = M z_k + what inputs add, linear in all those since row k − (n_j − 1) q − lag.

One row of M for each output is unknown. Both z_k and z_{k+q} have sensor noise, so after inputs are
regressed out, the rows follow from total least squares (Golub and Van Loan, SIAM J. Numerical
Analysis 17(6), 1980), which is consistent if the plant has no noise. It needs neither B nor delays.
log M / (q h) is A in the states z, and the rows C_j A^a, a < n_j, transform it to the chains. Fast
poles need a small q, slow ones a large one, which reduces the effect of noise.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.delay_scan import attributed_to_sensors, scan_delays
from deadtime.identification.estimate import Estimate
from deadtime.identification.likelihoods.likelihood import maximise
from deadtime.identification.likelihoods.noisy_log import Embedding, NoiseLevels, NoisyLog
from deadtime.identification.likelihoods.switched_filter import (
    FilterPeriods,
    Places,
    Sensors,
    SwitchedKalmanFilter,
)
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import Layout, Square, Squares, Vector, Window
from deadtime.identification.sampling import differences_of
from deadtime.identification.start import matrix_logarithm, start_of
from deadtime.identification.transition import plain_transitions

_PARTS = 32  # of a period
_SAME = 2.0  # standard errors, and parts of a period: a delay so near is no other one


def equivalent_delays(log: NoisyLog, theta: Vector) -> list[np.ndarray]:
    """Vectors with another delay and other weights, of nearly the same pulses; none if uneven."""
    shape, layout, h = log.embedding, log.layout, log.recording.step
    assert shape is not None
    if not (shape.zeros and shape.upper.size and log.recording.even):
        return []
    A, B, D = layout.split(theta[: layout.size])
    of, vectors = layout.spread(np.arange(layout.delays)), []
    for row in range(layout.delays):
        entries = np.argwhere(of == row)
        i, j = entries[0]
        lowest = h * (np.floor(D[i, j] / h) - 1.0)
        grid = np.unique(np.clip(lowest + h / _PARTS * np.arange(3 * _PARTS + 1), *log.bounds))
        with np.errstate(all="ignore"):
            given = entries, float(D[i, j]), grid, shape.C, h, log.sampling.hold
            misfit, weights = _pulse_misfits(A, B, *given)
        inner = np.flatnonzero((misfit[1:-1] < misfit[:-2]) & (misfit[1:-1] <= misfit[2:])) + 1
        for place in inner[np.abs(grid[inner] - D[i, j]) > _SAME * h / _PARTS]:
            changed, other = B.copy(), D.copy()
            for (a, b), weight in zip(entries, weights, strict=True):
                changed[a, :, b], other[a, b] = weight[place], grid[place]
            vector = theta.copy()
            vector[: layout.size] = layout.join(A, changed, other)
            vectors.append(vector)
    return vectors


def _pulse_misfits(
    A: np.ndarray,
    B: np.ndarray,
    entries: np.ndarray,
    D: float,
    grid: np.ndarray,
    C: np.ndarray,
    step: float,
    hold: int,
) -> tuple[Float[np.ndarray, " grid"], list[Float[np.ndarray, "grid n"]]]:
    """By how much the nearest pulse of every delay misses that of D, and its weights per entry."""
    first = int(grid[0] / step) - hold
    k = np.arange(first, first + 2 * A.shape[1] + 6 + hold)
    misfit, weights = np.zeros(grid.size), []
    for i, j in entries:
        target = _pulses(A[i], np.array([D]), k, C, step, hold)[0] @ B[i, :, j]
        pulses = _pulses(A[i], grid, k, C, step, hold)
        finite = np.isfinite(pulses).all(axis=(1, 2), keepdims=True)
        own = np.linalg.pinv(np.where(finite, pulses, 0.0), 1e-12) @ target
        misfit += ((np.einsum("gkn,gn->gk", pulses, own) - target) ** 2).sum(axis=1)
        weights.append(own)
    return misfit, weights


def _pulses(
    A: np.ndarray, delays: np.ndarray, k: np.ndarray, C: np.ndarray, step: float, hold: int
) -> Float[np.ndarray, "delay kp n"]:
    """The outputs at samples k of a single 1 in row 0, for every delay, by the weights b.

    Held, that is a pulse of a period; linear, a triangle about row 0, from the row before on.
    """
    changes = np.arange(hold + 2) - hold  # rows in which the hold's derivative changes
    over = k - delays[:, None] / step
    since = np.round(np.maximum(over - changes[:, None, None], 0.0), 9)
    periods, place = np.unique(since, return_inverse=True)  # of most delays they are the same
    G = plain_transitions(A[None], step * periods, hold + 1)[-1, 0][place.reshape(since.shape)]
    pulse = np.tensordot(differences_of(hold)[-1][::-1] / step**hold, G, (0, 0))
    return (C @ pulse).reshape(delays.size, -1, len(A))


def with_other_delays(estimate: Estimate) -> tuple[Estimate, list[str]]:
    """The estimate, its intervals over other delays that explain the log as well; and a sentence.

    Intervals are as wide about every maximum as about the likeliest.
    """
    log, best, spread = estimate.of_outputs, estimate.best, estimate.spread
    assert log is not None
    layout, vectors = log.layout, equivalent_delays(log, best.theta)
    if not vectors:
        return estimate, []
    place = layout.delay_places
    error = np.sqrt(np.diagonal(spread.covariance))
    fall = 0.5 * (spread.reach**2 * spread.inflation)[place].max()
    top = maximise(log, best.theta, window=estimate.window)[0]  # the noise of best is restricted
    others = []
    for vector in vectors:
        one = maximise(log, vector, window=estimate.window)[0]
        known = np.array([each.theta[place] for each in (top, *others)])
        apart = np.abs(one.theta[place] - known) > _SAME * error[place]
        if one.value > top.value - fall and apart.any(axis=1).all():
            others.append(one)
    if not others:
        return estimate, []
    half = spread.reach * error
    centres = np.array([best.theta, *(one.theta for one in others)])
    ends = np.column_stack((centres.min(axis=0) - half, centres.max(axis=0) + half))
    low = np.minimum(estimate.intervals[:, 0], ends[place, 0])
    high = np.maximum(estimate.intervals[:, 1], ends[place, 1])
    intervals = np.clip(np.column_stack((low, high)), estimate.searched[0], log.bounds[1])
    each = [", ".join(f"{d:.4g}" for d in one.theta[place]) for one in others]
    delays = "The delay" if place.size == 1 else "Delays"
    sentence = (
        f"{delays} may as well be {' or '.join(each)} s, with other weights of the inputs: evenly "
        "spaced rows hardly tell a zero from one on the other side. Log more often, or at uneven "
        "times."
    )
    return replace(estimate, intervals=intervals, ends=ends), [sentence]


_VAGUE = 1e8  # prior variance of a state, in variances of a sensor
_DECADES = 3.0  # range of the stiffness on either side, per derivative
_ENOUGH = 2.0  # rows for each unknown
_GROWTH = 10.0  # of a state from z_k to z_{k+q}: no logged plant grows faster
_SHARES = 1.0, 1e-2, 1e-4  # of the plant's noise at the start of chains with zeros
_APART = 8, 4, 2, 1  # periods between outputs that replace states
_NOTHING = 1e-8  # of the plant's noise, where it is neglected
_FEW = 1_000  # samples for climbs with fixed noise
_GAIN = 1e-2  # of log likelihood that is worth a step while noise is fixed


class Derivatives(NamedTuple):
    """States of every part, and per output its sensor's deviation and the noise that drives it.

    states : of every part, (samples, n), per second, per second², …
    deviation : (p,); drive : (p,), the intensity of the noise of the last derivative
    """

    states: tuple[Float[np.ndarray, "sample n"], ...]
    deviation: Float[np.ndarray, " p"]
    drive: Float[np.ndarray, " p"]


def derivatives_of(parts: tuple[Part, ...], order: tuple[int, ...], step: float) -> Derivatives:
    """The derivatives of every output of evenly sampled logs.

    Examples
    --------
    >>> t = 0.1 * np.arange(200)
    >>> part = Part(t, np.sin(t)[:, None], np.zeros((200, 1)), np.zeros(200, np.int64))
    >>> states = derivatives_of((part,), (2,), 0.1).states[0]
    >>> bool(np.abs(states[20:-20, 1] - np.cos(t)[20:-20]).max() < 1e-3)
    True
    """
    columns, deviation, drive = [], [], []
    for j, count in enumerate(order):
        series = [part.output[:, j : j + 1] for part in parts]
        states, r, q = _smoothed_chain(series, count)
        columns.append([one / step ** np.arange(count) for one in states])
        deviation.append(r)
        drive.append(q / step ** (2 * count - 1))
    every = tuple(np.hstack(one) for one in zip(*columns, strict=True))
    return Derivatives(every, np.array(deviation), np.array(drive))


def _smoothed_chain(series: list[np.ndarray], count: int) -> tuple[list[np.ndarray], float, float]:
    """The states of one output in units of a period, its deviation, and the noise behind it."""
    known = np.concatenate([one[np.isfinite(one)] for one in series])
    size = float(np.sqrt(np.mean(known**2)))
    grid = 10.0 ** np.arange(-_DECADES * count, _DECADES + 2.0)
    each = [one / size for one in series]
    tried = [(_likelihood(_integrators(each, count, q)), q) for q in grid.tolist()]
    (_, variance), q = max(tried, key=lambda one: one[0][0])
    best = _integrators(each, count, q)
    states = [size * best.states(number).smoothed for number in range(len(series))]
    return states, size * float(np.sqrt(variance)), size**2 * variance * q


def _integrators(series: list[np.ndarray], count: int, q: float) -> SwitchedKalmanFilter:
    """The filter of a chain of integrators; variances in units of the sensor's.

    The first measurements, which determine the initial state, are left out.
    """
    a, b = np.indices((count, count))
    i, j, factorial = count - 1 - a, count - 1 - b, np.cumprod([1, *range(1, count)])
    Phi = np.triu(1.0 / factorial[np.maximum(b - a, 0)])[None]
    Q = (q / (factorial[i] * factorial[j] * (i + j + 1)))[None]
    nothing = np.zeros((1, 0, count, count))

    def periods(_: Part, rows: np.ndarray, __: np.ndarray) -> FilterPeriods:
        kind, added = np.zeros(rows.size, np.int64), np.zeros((rows.size, count))
        by_added = np.zeros((rows.size, 0, count))
        return FilterPeriods(kind, kind, Phi, nothing, Q, nothing, added, by_added)

    rows = [np.arange(len(y)) for y in series]
    each = zip(rows, series, strict=True)
    parts = tuple(Part(k.astype(float), y, np.zeros((k.size, 0)), 0 * k) for k, y in each)
    initial = [np.isfinite(y) & (np.cumsum(np.isfinite(y), axis=0) <= count) for y in series]
    sensors = Sensors(np.eye(1, count), np.ones(1), (_VAGUE * (1.0 + q)) * np.eye(count))
    return SwitchedKalmanFilter(parts, [k == 0 for k in rows], initial, periods, sensors)


def _likelihood(chain: SwitchedKalmanFilter) -> tuple[float, float]:
    """Log likelihood with the sensor's variance at its likeliest, and that."""
    total, squares, logs = 0, 0.0, 0.0
    for block in chain.innovations(Places.none(1)):
        total += np.count_nonzero(np.isfinite(block.y))
        squares += float((block.e * block.e / block.s).sum())
        logs += float(np.log(block.s).sum())
    variance = max(squares / max(total, 1), 1e-14)
    return -0.5 * (total * np.log(variance) + logs), variance


class Guess(NamedTuple):
    """A first plant, and its noise; `size` of the states."""

    theta: Vector
    noise: tuple[NoiseLevels, ...]
    size: Float[np.ndarray, " n"]


def guess_of(
    grid: Recording, layout: Layout, order: tuple[int, ...], bounds: Window, within: bool
) -> Guess:
    """A first plant from evenly sampled outputs, as if their smoothed derivatives were measured."""
    smoothed = derivatives_of(grid.parts, order, grid.step)
    every = np.vstack(smoothed.states)
    shape = Embedding(order, False, np.sqrt(np.mean(every**2, axis=0)))
    parts = zip(grid.parts, smoothed.states, strict=True)
    measured = grid._replace(parts=tuple(part._replace(output=x) for part, x in parts))
    A, B, delays = layout.split(start_of(measured, layout, bounds, within).theta)
    A, B = A.copy(), B.copy()
    A[:, shape.upper], B[:, shape.upper] = shape.shift()[shape.upper], 0.0
    return Guess(layout.join(A, B, delays), _noises(smoothed, shape, grid.step), shape.size)


def _noises(smoothed: Derivatives, shape: Embedding, step: float) -> tuple[NoiseLevels, ...]:
    """Two guesses: outputs are moved mostly by noise of the plant, or of the sensors."""
    moves = [np.diff(states, axis=0) for states in smoothed.states]
    moves = np.mean(np.vstack(moves) ** 2, axis=0) / step
    deviation = np.maximum(smoothed.deviation, 1e-4 * (shape.C @ shape.size))
    noises = []
    for much, sensor in ((0.3, 0.5), (0.01, 1.0)):
        W = 0.1 * much * moves
        W[shape.last] = much * np.minimum(smoothed.drive, moves[shape.last])
        W = np.maximum(W, 1e-8 * shape.size**2)
        noises.append(NoiseLevels(np.diag(W), sensor * deviation))
    return tuple(noises)


def chains_by_past(
    parts: tuple[Part, ...],
    shape: Embedding,
    deviation: Float[np.ndarray, " p"],
    step: float,
    lag: int,
    modes: int,
    apart: int,
) -> Squares | None:
    """A of evenly sampled outputs; None if a mode has too few rows, or M is not that of a plant.

    deviation : of the sensors, approximately; step : between rows, seconds
    lag : the latest period in which an input acts; apart : q, periods

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> y, u = np.zeros((99, 1)), rng.standard_normal((99, 1))
    >>> for k in range(2, 98):
    ...     y[k + 1] = 0.5 * y[k] + u[k - 2]
    >>> part = Part(0.1 * np.arange(99), y, u, np.zeros(99, np.int64))
    >>> shape = Embedding((1,), False, np.ones(1))
    >>> chains_by_past((part,), shape, np.ones(1), 0.1, 4, 1, 2).round(4)  # log 0.5 / 0.1
    array([[[-6.9315]]])
    """
    rows = [_past_rows(part, shape, lag, apart) for part in parts]
    mode, y, z, u = (np.concatenate(column) for column in zip(*rows, strict=True))
    scale, A = np.repeat(deviation, shape.order), []
    for i in range(modes):
        own = mode == i
        if np.count_nonzero(own) < _ENOUGH * (u.shape[1] + z.shape[1]):
            return None
        basis = np.linalg.qr(u[own])[0]
        now, past = (a - basis @ (basis.T @ a) for a in (y[own] / deviation, z[own] / scale))
        M = _past_transition(now, past, shape)
        if not np.isfinite(M).all() or np.abs(np.linalg.eigvals(M)).max() > _GROWTH:
            return None
        F = matrix_logarithm(M * scale[:, None] / scale) / (apart * step)
        A.append(_in_chains(F, shape))
    return np.array(A)


def _past_rows(
    part: Part, shape: Embedding, lag: int, apart: int
) -> tuple[Int[np.ndarray, " row"], np.ndarray, np.ndarray, np.ndarray]:
    """Mode, outputs, z_k, inputs and 1, of rows that stay in a mode and are all known."""
    before = (max(shape.order) - 1) * apart
    k = np.arange(before + lag, len(part.output) - apart)
    z = [part.output[k - a * apart, j] for j, n in enumerate(shape.order) for a in range(n)]
    y, z = part.output[k + apart], np.column_stack(z)
    lags = np.arange(before + apart + lag)
    u = part.input[k[:, None] + apart - 1 - lags].reshape(k.size, lags.size * part.input.shape[1])
    u = np.hstack((u, np.ones((k.size, 1))))
    changes = np.concatenate(([0], np.cumsum(part.mode[1:] != part.mode[:-1])))
    own = np.isfinite(np.hstack((y, z, u))).all(axis=1)
    own &= changes[k + apart] == changes[k - before]
    return part.mode[k][own], y[own], z[own], u[own]


def _past_transition(
    now: Float[np.ndarray, "row p"], past: Float[np.ndarray, "row n"], shape: Embedding
) -> Square:
    """M of z_{k+q} = M z_k."""
    M = np.eye(past.shape[1], k=-1)
    for j, row in enumerate(shape.C.argmax(axis=1)):
        both = np.column_stack((past, now[:, j]))
        least = np.linalg.svd(both, full_matrices=False)[2][-1]
        with np.errstate(divide="ignore", invalid="ignore"):
            M[row] = -least[:-1] / least[-1]
    return M


def _in_chains(F: Square, shape: Embedding) -> Square:
    """F of the states z, transformed to the states of the embedding."""
    powers = [np.linalg.matrix_power(F, a) for a in range(max(shape.order))]
    T = np.array([shape.C[j] @ powers[a] for j, n in enumerate(shape.order) for a in range(n)])
    A = shape.shift()
    A[shape.last] = np.linalg.lstsq(T.T, (T @ F)[shape.last].T, rcond=1e-12)[0].T
    return A


def scan_starts(log: NoisyLog, guess: Guess) -> list[np.ndarray]:
    """Starts of a scan: of chains with zeros, from integrators, and several noises.

    Derivatives of outputs that jump with inputs are not states: an A fitted to them has fast poles
    in place of a zero and a part of the delay, at a local maximum of the likelihood. Another has
    much noise in place of a pole near a zero.
    """
    shape, layout = log.embedding, log.layout
    assert shape is not None
    if not (shape.zeros and shape.upper.size):
        return [log.join(guess.theta, noise) for noise in guess.noise]
    A, B, delays = layout.split(guess.theta)
    theta = layout.join(np.broadcast_to(shape.shift(), A.shape), B, delays)
    W, deviation = guess.noise[-1]
    return [log.join(theta, NoiseLevels(share * W, deviation)) for share in _SHARES]


def starts_from_past(log: NoisyLog, guess: Guess) -> list[np.ndarray]:
    """Starts of a climb with each A from past outputs: of chains with zeros.

    The noise of the plant is nearly 0 and fixed at first: otherwise it explains the error of
    a delay that is off by a part of a period, and a climb ends there.
    """
    shape, layout, grid = log.embedding, log.layout, log.recording.gridded()
    assert shape is not None
    if not (shape.zeros and shape.upper.size):
        return []
    _, B, delays = layout.split(guess.theta)
    W, deviation = guess.noise[-1]
    lag = grid.lag(log.bounds[1])
    few = replace(log, recording=log.recording.stretches(_FEW, lag))
    even, starts = replace(few, recording=few.recording.gridded()), []
    of_noise = np.arange(log.size) >= layout.size
    for apart in _APART:
        given = shape, deviation, grid.step, lag, layout.modes, apart
        if (A := chains_by_past(grid.parts, *given)) is None:
            continue
        start = log.join(layout.join(A, B, delays), NoiseLevels(_NOTHING * W, deviation))
        start = attributed_to_sensors(few, scan_delays(even, start).with_noise_of(start))
        best, _ = maximise(few, start, of_noise, log.bounds, _GAIN)
        starts.append(attributed_to_sensors(log, best.theta))
    return starts
