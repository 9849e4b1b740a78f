"""Other delays that explain the same samples, where inputs act on all states of an output.

An input u that stays for a period from t = 0 on makes, with a delay D,

    y(k h) = C (G(k h − D) − G(k h − D − h)) b,    G(t) = ∫₀ᵗ e^{As} ds,  0 before t = 0,

and all that evenly spaced rows tell of b and D is this pulse. With D in (N − 1) h … N h it follows
from y(N h) and the state at (N + 1) h, which is e^{A(N h − D)} G(h) b: another delay D' of the same
cell leaves that as it is with b' = e^{A(D' − D)} b, and of one output only

    C G(N h − D') b' = C G(N h − D) b

is asked, one equation for one number. For a double integrator with b = (β, 1) it is a parabola, and
D' = D − 2 β: b' = (−β, 1), the zero on the other side. So a zero at z is told from that at −z where
2/|z| is longer than what is left of the cell, or where rows are unevenly spaced.

Delays whose pulse comes close, with the likeliest b', are sought on a grid of three cells.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from deadtime.identification.estimate import Estimate
from deadtime.identification.likelihoods.likelihood import maximise
from deadtime.identification.likelihoods.noisy_log import NoisyLog
from deadtime.identification.parameters import Vector
from deadtime.identification.scoring import Maximum
from deadtime.identification.transition import plain_transitions

_PARTS = 32  # of a period
_SAME = 2.0  # standard errors, and parts of a period: a delay so near is no other one


def others_of(log: NoisyLog, theta: Vector) -> list[np.ndarray]:
    """Vectors with another delay and other weights, of nearly the same pulses; none if uneven."""
    shape, layout, h = log.embedding, log.layout, log.recording.step
    assert shape is not None
    if not (shape.zeros and shape.upper.size and log.recording.even):
        return []
    A, B, D = layout.split(theta[: layout.size])
    of, found = layout.spread(np.arange(layout.delays)), []
    for row in range(layout.delays):
        entries = np.argwhere(of == row)
        i, j = entries[0]
        begin = h * (np.floor(D[i, j] / h) - 1.0)
        grid = np.unique(np.clip(begin + h / _PARTS * np.arange(3 * _PARTS + 1), *log.bounds))
        with np.errstate(all="ignore"):
            misfit, weights = _fitted(A, B, entries, float(D[i, j]), grid, shape.C, h)
        inner = np.flatnonzero((misfit[1:-1] < misfit[:-2]) & (misfit[1:-1] <= misfit[2:])) + 1
        for place in inner[np.abs(grid[inner] - D[i, j]) > _SAME * h / _PARTS]:
            changed, other = B.copy(), D.copy()
            for (a, b), weight in zip(entries, weights, strict=True):
                changed[a, :, b], other[a, b] = weight[place], grid[place]
            vector = theta.copy()
            vector[: layout.size] = layout.join(A, changed, other)
            found.append(vector)
    return found


def _fitted(
    A: np.ndarray,
    B: np.ndarray,
    entries: np.ndarray,
    D: float,
    grid: np.ndarray,
    C: np.ndarray,
    step: float,
) -> tuple[Float[np.ndarray, " grid"], list[Float[np.ndarray, "grid n"]]]:
    """By how much the nearest pulse of every delay misses that of D, and its weights per entry."""
    first = int(grid[0] / step)
    k = np.arange(first, first + 2 * A.shape[1] + 6)
    misfit, weights = np.zeros(grid.size), []
    for i, j in entries:
        target = _pulses(A[i], np.array([D]), k, C, step)[0] @ B[i, :, j]
        pulses = _pulses(A[i], grid, k, C, step)
        own = np.full((grid.size, A.shape[1]), np.nan)
        for place, pulse in enumerate(pulses):
            if np.isfinite(pulse).all():
                own[place] = np.linalg.lstsq(pulse, target, rcond=1e-12)[0]
        misfit += ((np.einsum("gkn,gn->gk", pulses, own) - target) ** 2).sum(axis=1)
        weights.append(own)
    return misfit, weights


def _pulses(
    A: np.ndarray, delays: np.ndarray, k: np.ndarray, C: np.ndarray, step: float
) -> Float[np.ndarray, "delay kp n"]:
    """The outputs at samples k of a pulse of one period, for every delay, by the weights b."""
    over = k - delays[:, None] / step
    since = np.round(np.maximum(np.stack((over, over - 1.0)), 0.0), 9)
    periods, place = np.unique(since, return_inverse=True)  # of most delays they are the same
    G = plain_transitions(A[None], step * periods)[1][0][place.reshape(since.shape)]
    return (C @ (G[0] - G[1])).reshape(delays.size, -1, len(A))


def with_others(found: Estimate) -> tuple[Estimate, list[str]]:
    """The estimate, its intervals over other delays that explain the log as well; what to say."""
    log, layout, spread = found.of_outputs, found.log.layout, found.spread
    assert log is not None
    vectors = others_of(log, found.best.theta)
    if not vectors:
        return found, []
    place = np.arange(layout.size)[layout.at_delays]
    error = np.sqrt(np.diagonal(spread.covariance))
    fall = 0.5 * (spread.reach**2 * spread.inflation)[place].max()
    top = maximise(log, found.best.theta, window=found.window)[0]  # its noise is restricted
    others = []
    for vector in vectors:
        one = maximise(log, vector, window=found.window)[0]
        known = np.array([each.theta[place] for each in (top, *others)])
        apart = np.abs(one.theta[place] - known) > _SAME * error[place]
        if one.found.value > top.found.value - fall and apart.any(axis=1).all():
            others.append(one)
    if not others:
        return found, []
    return _widened(found, others, place, error), [_said(others, place)]


def _widened(
    found: Estimate, others: list[Maximum], place: np.ndarray, error: np.ndarray
) -> Estimate:
    """Its intervals, as wide about every maximum as about the likeliest."""
    half = found.spread.reach * error
    centres = np.array([found.best.theta, *(one.theta for one in others)])
    ends = np.column_stack((centres.min(axis=0) - half, centres.max(axis=0) + half))
    delays = np.column_stack(
        (
            np.minimum(found.intervals[:, 0], ends[place, 0]),
            np.maximum(found.intervals[:, 1], ends[place, 1]),
        )
    )
    return replace(found, intervals=np.clip(delays, *found.log.bounds), ends=ends)


def _said(others: list[Maximum], place: np.ndarray) -> str:
    each = [", ".join(f"{d:.4g}" for d in one.theta[place]) for one in others]
    one = "The delay" if place.size == 1 else "Delays"
    return (
        f"{one} may as well be {' or '.join(each)} s, with other weights of the inputs: evenly "
        "spaced rows hardly tell a zero from one on the other side. Log more often, or at uneven "
        "times."
    )
