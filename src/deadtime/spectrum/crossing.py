"""The first true delay at which a loop stands at the limit of stability.

Walk from a delay at which the loop is stable. A root can only cross where Δ(ω, D) is singular for
some ω (`deadtime.spectrum.response`), and from one delay to another the pipe p changes by at most
c |C| per second. With S = (M − r p)⁻¹ r, the response of the input to a change of p,

    det Δ(ω, D') ≠ 0    while    |D' − D| v(ω) < 1,    v = c ρ(|S C|),

ρ(|·|) the spectral radius of the matrix of absolute values, in any basis. So no root crosses
within 1/max_ω v, and that is how far each step goes: no pair of crossings is stepped over, however
close. Where the gain ρ(M⁻¹ r p) < 1 for every delay, none puts a root at ω, and ω is left out.

Near a crossing v has a peak at its frequency. From every peak Newton's method solves det Δ = 0
for (ω, D) together. The nearest solution ahead is the crossing once all peaks that steps could
not exclude before it have led to solutions ahead, so near in units in which Δ turns that each is
the only one of its peak.

Frequencies are so close that |∂ ln det Δ/∂ω| times their distance is below 1: a root near the
limit makes them as close as needed. All this is double precision on samples, not a proof.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.spectrum.newton import decomposed
from deadtime.spectrum.response import Response, Samples
from deadtime.spectrum.small_matrices import inverses, spectral_radii, speeds, traces

_SAFETY = 0.5  # of a step, for what happens between samples
_SMALL_GAIN, _FINE = 0.98, 0.25
_NEAR, _FAR = 0.3, 3.0  # radian
_PEAKS, _HIGH, _NEWTON = 40, 0.2, 15
_CONVERGED = 1e-9  # relative: the next step would be round-off
_FINEST, _CLOSEST = 1e-9, 1e-13  # relative, of frequencies and of delays
_MOST_STEPS = 10_000


class Crossing(NamedTuple):
    """A true delay, seconds, and the frequency, rad/s, of a root at the limit of stability."""

    delay: float
    frequency: float


class Grid(NamedTuple):
    """Samples at increasing frequencies, and which cells between them matter.

    cells : (points + 1,) bool; cell i lies below point i, the last between the last and the highest
    """

    samples: Samples
    cells: np.ndarray


def first_crossing(response: Response, grid: Grid, start: float, end: float) -> Crossing | None:
    """The first crossing on the way from a true delay, where the loop is stable, to another.

    `grid` is made by `relevant` for the first of these delays. Where steps become as short as
    round-off, or are too many, a root all but touches the limit: that counts as a crossing.
    """
    sign, delay = (1.0, start) if end > start else (-1.0, start)
    for step in range(_MOST_STEPS if grid.samples.omega.size else 0):
        grid, v = _resolved(response, grid, delay)
        crossing = _ahead(response, grid, v, delay, sign)
        reach = _SAFETY / v.max()
        if crossing is None and (reach < _CLOSEST * start or step == _MOST_STEPS - 1):
            crossing = Crossing(delay, float(grid.samples.omega[v.argmax()]))
        if crossing is not None:
            return crossing if sign * (end - crossing.delay) > 0.0 else None
        delay += sign * reach
        if sign * (end - delay) <= 0.0:
            break
    return None


def relevant(response: Response, delay: float) -> Grid:
    """The frequencies at which some delay could have a root; none if no delay has any."""
    count = int(2.0 * response.highest * (response.memory + delay)) + 64
    omega = (np.arange(count) + 0.5) / count * response.highest
    grid = Grid(response.samples(omega, even=True), np.ones(count + 1, bool))
    while True:
        _, plant, M, M_slope, r, _ = grid.samples
        inverse = inverses(M)
        open_loop, pipes = inverse @ r, response.pipes(grid.samples.omega)
        gain = np.max([spectral_radii(open_loop @ p) for p in pipes], axis=0)
        # Between samples the gain is at most (1 + rate · distance) times what it is there.
        rate = np.maximum(np.abs(plant), np.abs(traces(inverse, M_slope)))
        able = ~(gain < _SMALL_GAIN)
        room = np.where(able, _FINE, np.clip(1.0 / np.maximum(gain, 1e-300) - 1.0, 0.0, _FINE))
        finer = _finer(response, grid, rate / room)
        if finer is None:
            break
        grid = finer
    near = able.copy()
    near[1:] |= able[:-1]
    near[:-1] |= able[1:]
    kept = np.flatnonzero(near)
    ends = [-1, *kept, near.size] if kept.size else [-1, near.size + 1]
    cells = np.diff(ends) == 1
    return Grid(Samples(*(part[kept] for part in grid.samples)), cells)


def _resolved(response: Response, grid: Grid, delay: float) -> tuple[Grid, np.ndarray]:
    """The grid, made as fine as this delay asks for, and v at its frequencies."""
    while True:
        omega, plant, M, M_slope, r, r_slope = grid.samples
        p, p_slope, _ = response.pipe(omega, np.full(omega.size, delay))
        inverse = inverses(M - r @ p)
        turn = plant + traces(inverse, M_slope - r_slope @ p - r @ p_slope)
        finer = _finer(response, grid, np.abs(turn))
        if finer is None:
            c, C = response.speed(omega)
            return grid, c * speeds(inverse @ r, C)
        grid = finer


def _finer(response: Response, grid: Grid, rate: np.ndarray) -> Grid | None:
    """Halve the cells that a rate of change, per rad/s, is too fast for; None if there are none."""
    samples, cells = grid
    points = np.concatenate(([0.0], samples.omega, [response.highest]))
    gap = np.diff(points)
    rate = np.concatenate((rate[:1], np.maximum(rate[1:], rate[:-1]), rate[-1:]))
    least = _FINEST * response.highest
    coarse = np.flatnonzero(cells & ~(rate * gap <= 1.0) & (gap > least))
    if coarse.size == 0:
        return None
    more = response.samples(points[coarse] + gap[coarse] / 2.0)
    merged = (np.insert(old, coarse, new, axis=0) for old, new in zip(samples, more, strict=True))
    return Grid(Samples(*merged), np.insert(cells, coarse, True))


def _ahead(
    response: Response, grid: Grid, v: np.ndarray, delay: float, sign: float
) -> Crossing | None:
    """The nearest crossing ahead, if it is sure to be."""
    higher = np.concatenate(([True], v[1:] >= v[:-1])) & np.concatenate((v[:-1] >= v[1:], [True]))
    peaks = np.flatnonzero(higher)
    peaks = peaks[np.argsort(-v[peaks])]
    omega, v = grid.samples.omega[peaks], v[peaks]
    turns = response.memory + delay
    count = int((v > _HIGH * v[0]).sum())
    while count <= _PEAKS:
        w, d = _solved(response, omega[:count], delay)
        near = np.abs(w - omega[:count]) * turns < _NEAR
        near &= np.abs(d - delay) * np.maximum(w, 1.0 / turns) < _NEAR
        near &= sign * (d - delay) > 0.0
        if not near.any():
            return None
        away = np.where(near, np.abs(d - delay), np.inf)
        best = int(away.argmin())
        doubtful = int((v * away[best] > _SAFETY).sum())  # steps cannot exclude these before it
        if doubtful <= count:
            return Crossing(float(d[best]), float(w[best])) if near[:doubtful].all() else None
        count = doubtful
    return None


def _solved(response: Response, omega: np.ndarray, delay: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and delays at which det Δ = 0, by Newton's method; infinite where it fails."""
    w, d = omega.copy(), np.full(omega.size, delay)
    done, alive = np.zeros(omega.size, bool), np.arange(omega.size)
    for _ in range(_NEWTON):
        now = decomposed(*response.matrix(w[alive], d[alive]))
        # 1 + a dω + b dD = 0: with b divided out, the imaginary part has no dD.
        a, b = now.slope(0), now.slope(1)
        with np.errstate(divide="ignore", invalid="ignore"):
            dw = -np.imag(1.0 / b) / np.imag(a / b)
            dd = -np.real(1.0 / b) - dw * np.real(a / b)
        step = np.maximum(np.abs(dw) / omega[alive], np.abs(dd) / delay)
        able = step < np.inf
        alive, dw, dd, step = alive[able], dw[able], dd[able], step[able]
        w[alive] += dw
        d[alive] += dd
        done[alive] = step < _CONVERGED
        turn = np.maximum(np.abs(w - omega) * delay, np.abs(d - delay) * omega)[alive]
        alive = alive[(step >= _CONVERGED) & (turn < _FAR) & (d[alive] > 0.0)]
        if alive.size == 0:
            break
    return np.where(done, w, np.inf), np.where(done, d, np.inf)
