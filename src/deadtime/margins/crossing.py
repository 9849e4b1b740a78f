"""The first true delay at which a loop is at the limit of stability.

A root lies there at (ω, D) if an eigenvalue of the loop's gain X(ω, D) is 1
(`deadtime.margins.loop_gain`), that is, if along one of the curves D_k(ω) on which the phase is
right,

    arg λ(ω, D_k(ω)) = 0 (mod 2π),    the level    G(ω) = ln|λ(ω, D_k(ω))|    is 0.

This is one real equation on an interval of frequencies, with a slope that is known. From
d ln λ = a dω + b dD it follows that

    dD_k/dω = −Im a/Im b,    dG/dω = Re a − Re b · Im a/Im b.

Where G changes sign a root crosses the limit. Where G only touches 0, at a maximum or a minimum,
a root comes to the limit and goes back: the loop is not asymptotically stable at that delay, so
that the margin ends there as well. Walking along D would crawl towards such a delay, as the root
does; along ω it is a maximum like any other. Levels within 1e-9 of 0 count as touching: round-off
makes 1e-15 of an exact 0, and no plant is known to 1e-9.

At the Nyquist frequency X is real and the curve is that frequency itself, for a real root passes
−1. There det(I − X) is a real function of D, of period 2h. All this is double precision on
samples, not a proof.
"""

from __future__ import annotations

import heapq
import math
from typing import NamedTuple

import numpy as np

from deadtime.margins.curves import Curve, candidates, follow, refine, solve
from deadtime.margins.loop_gain import Band, loop_gain
from deadtime.numerics.small_matrices import inverses, matched
from deadtime.spectrum.response import Response, Samples

_AT_ONCE = 16  # curves
_RING = 0.05  # of the delay: the width of the first ring
_NYQUIST = 256  # delays in two periods


class Crossing(NamedTuple):
    """A true delay, seconds, and the frequency, rad/s, of a root at the limit of stability."""

    delay: float
    frequency: float


class EigenvalueBranch(NamedTuple):
    """An eigenvalue in a band at one delay: ω, `Curve.above`, arg λ unwrapped; as `Band`."""

    omega: np.ndarray
    above: np.ndarray
    phase: np.ndarray
    spread: float
    around: float


def first_crossing(
    response: Response, parts: list[Band], start: float, end: float
) -> Crossing | None:
    """The first crossing on the way from a true delay, where the loop is stable, to another.

    `parts` are the `bands` of the response.
    """
    if not parts:
        return None
    best = _at_nyquist(response, start, end)
    branches = _branches(response, parts, start)
    # Rings around the start: what is far away need not be followed where something is near.
    inner, width = 0.0, max(response.period or 0.0, _RING * start)
    while True:
        far = abs((end if best is None else best.delay) - start)
        outer = min(inner + width, far)
        best = _in_ring(response, branches, (inner, outer), start, end, best)
        if outer == far or (best is not None and abs(best.delay - start) <= outer):
            return best
        inner, width = outer, 4.0 * width


def _in_ring(
    response: Response,
    branches: list[EigenvalueBranch],
    ring: tuple[float, float],
    start: float,
    end: float,
    best: Crossing | None,
) -> Crossing | None:
    """The first crossing at a distance from the start, or one that is known and nearer."""
    sign = math.copysign(1.0, end - start)
    inner, outer = ring
    # Curves in the order in which they may come: the least of |D − D_start|, branch and k.
    queue: list[tuple[float, int, int]] = []
    for i, branch in enumerate(branches):
        turns = sign * branch.phase - (inner - branch.around) * branch.omega
        k = math.floor(turns.max() / (2.0 * np.pi))
        queue.append((_least(branch, k, sign, inner), i, k))
    heapq.heapify(queue)
    while queue:
        reach = outer if best is None else min(outer, abs(best.delay - start))
        batch: list[Curve] = []
        while len(batch) < _AT_ONCE and queue[0][0] <= reach:
            _, i, k = queue[0]
            batch.append(_guess(branches[i], k, sign, start, (inner, reach), len(batch)))
            heapq.heapreplace(queue, (_least(branches[i], k - 1, sign, inner), i, k - 1))
        if not batch:
            break
        guess = Curve(*(np.concatenate(part) for part in zip(*batch, strict=True)))
        curve = follow(response, *(guess[i] for i in (0, 1, 2, 5, 6)))
        between = sorted((start + sign * inner, start + sign * reach))
        curve = refine(response, curve, *between)
        best = _nearest(response, curve, start, end, best)
    return best


def unit_bands(response: Response, parts: list[Band], delay: float) -> list[Band]:
    """The bands of an ideal loop in which |λ| is 1, which there does not depend on the delay."""
    if not parts:
        return []
    found = _branches(response, parts, delay)
    sizes = [branch.omega.size for branch in found]
    omega, above, phase, spread, _ = zip(*found, strict=True)
    omega, above, phase = (np.concatenate(part) for part in (omega, above, phase))
    piece, spread = np.repeat(np.arange(len(found)), sizes), np.repeat(spread, sizes)
    curve = follow(response, piece, omega, delay + phase / omega, spread, above)
    curve = refine(response, curve, -math.inf, math.inf)
    reached = curve.piece[candidates(curve, response.period)] // (len(found) // len(parts))
    return [parts[i] for i in np.unique(reached)]


def _branches(response: Response, parts: list[Band], delay: float) -> list[EigenvalueBranch]:
    """A branch for each eigenvalue in each band."""
    every = Samples(
        *(np.concatenate(x) for x in zip(*(band.samples for band in parts), strict=True))
    )
    turn = every.omega[:, None] * delay
    value = loop_gain(response, every, np.array([delay])).value * np.exp(1j * turn)  # turns slowly
    value = matched(value)
    level, phase = np.log(np.abs(value)), np.unwrap(np.angle(value), axis=0) - turn
    above = level - level.mean(axis=1, keepdims=True)
    ends = np.cumsum([band.samples.omega.size for band in parts])[:-1]
    each = zip(parts, np.split(above, ends), np.split(phase, ends), strict=True)
    return [
        EigenvalueBranch(band.samples.omega, *of_one, spread=band.spread, around=band.around)
        for band, *of_band in each
        for of_one in zip(*(part.T for part in of_band), strict=True)
    ]


def _ahead(branch: EigenvalueBranch, k: int, sign: float) -> np.ndarray:
    """About how far ahead the k-th curve is: the delay turns λ by e^{−iωD}, or nearly so."""
    return (sign * branch.phase - 2.0 * np.pi * k) / branch.omega


def _least(branch: EigenvalueBranch, k: int, sign: float, inner: float) -> float:
    """The k-th curve is no nearer than this, beyond a distance."""
    ahead = _ahead(branch, k, sign)
    return float(ahead[ahead >= inner - branch.around].min(initial=math.inf)) - branch.around


def _guess(
    branch: EigenvalueBranch,
    k: int,
    sign: float,
    start: float,
    ring: tuple[float, float],
    number: int,
) -> Curve:
    """The k-th curve where it may be in a ring, and a point on either side."""
    ahead = _ahead(branch, k, sign)
    near = (ahead >= ring[0] - branch.around) & (ahead <= ring[1] + branch.around)
    wide = near.copy()
    wide[1:] |= near[:-1]
    wide[:-1] |= near[1:]
    rises = np.diff(wide.astype(int), prepend=0) > 0
    piece = number + np.cumsum(rises) / (rises.sum() + 1.0)
    nothing = np.full(ahead.size, np.nan)
    spread = np.full(ahead.size, branch.spread)
    delay = start + sign * ahead
    return Curve(piece, branch.omega, delay, nothing, nothing, spread, branch.above).at(wide)


def _nearest(
    response: Response, curve: Curve, start: float, end: float, best: Crossing | None
) -> Crossing | None:
    """The nearest crossing ahead on curves, or one that is known and nearer."""
    limit = end if best is None else best.delay
    cells = candidates(curve, response.period)
    near = np.minimum(np.abs(curve.delay[cells] - start), np.abs(curve.delay[cells + 1] - start))
    cells = cells[near <= abs(limit - start)]
    if cells.size == 0:
        return best
    found = solve(response, curve, cells)
    share = (found.delay - start) / (limit - start)
    ahead = np.where((share > 0.0) & (found.delay > 0.0), share, np.inf)
    i = int(ahead.argmin())
    return Crossing(float(found.delay[i]), float(found.omega[i])) if ahead[i] < 1.0 else best


def _at_nyquist(response: Response, start: float, end: float) -> Crossing | None:
    """The first delay ahead at which a real root of the digital loop passes −1."""
    if response.period is None:
        return None
    samples = response.samples(np.array([response.highest]))
    open_loop = inverses(samples.M) @ samples.r

    def gap(delay: np.ndarray) -> np.ndarray:
        X = open_loop @ response.delay_line(np.full(delay.size, response.highest), delay)[0]
        return np.linalg.det(np.eye(X.shape[-1]) - X).real

    reach = min(2.0 * response.period, abs(end - start))
    delays = start + math.copysign(1.0, end - start) * np.linspace(0.0, reach, _NYQUIST)
    delays = delays[delays > 0.0]
    values = gap(delays)
    changes = np.flatnonzero(values[1:] * values[:-1] < 0.0)
    if changes.size == 0:
        return None
    ends = sorted(delays[changes[0] : changes[0] + 2].tolist())
    while ends[1] - ends[0] > 1e-15 + 4.0 * np.spacing(ends[1]):
        delays = np.linspace(ends[0], ends[1], _NYQUIST)
        values = gap(delays)
        change = max(1, int(np.argmax(np.sign(values) != np.sign(values[0]))))
        ends = delays[change - 1 : change + 1].tolist()
    return Crossing(0.5 * (ends[0] + ends[1]), response.highest)
