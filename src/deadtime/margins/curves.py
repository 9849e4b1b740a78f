"""Curves D_k(ω) along which the loop's gain is real and positive, and the zeros of its level there.

`deadtime.margins.crossing` says what they are for: where G(ω) = ln|λ(ω, D_k(ω))| is 0 a root
lies on the limit of stability. A cell between two frequencies is cut in halves until it is
decided: G cannot reach 0 in it, |G| at both ends being above what the slopes there allow; G changes
its sign once; or G is 0 but for `TOUCH`. In a digital loop G has a bend wherever D_k passes a
multiple of the period.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deadtime.margins.loop_gain import loop_gain
from deadtime.spectrum.response import Response, Samples

TOUCH = 1e-9  # of ln|λ|
_NEWTON, _PHASE, _RIGHT, _SHORTEST = 40, 1e-12, 1e-6, 1e-4
_ROUNDS, _MOST, _FINEST = 60, 20_000, 1e-14
_SECANT, _PART = 60, 1e-11  # of a cell


class Curve(NamedTuple):
    """Points of pieces of curves D_k: which piece, rising ω, D, G, dG/dω, the band's spread.

    above : by how much G is above the mean of ln|λ| over all eigenvalues, which tells them apart:
        a change of the delay within a period makes all of them larger or smaller, much alike.
    """

    piece: np.ndarray
    omega: np.ndarray
    delay: np.ndarray
    level: np.ndarray
    slope: np.ndarray
    spread: np.ndarray
    above: np.ndarray

    def at(self, index: np.ndarray) -> Curve:
        """Some of the points."""
        return Curve(*(part[index] for part in self))

    def where(self, here: np.ndarray, other: Curve) -> Curve:
        """These points, or another curve's."""
        return Curve(*(np.where(here, *pair) for pair in zip(self, other, strict=True)))

    def with_points(self, other: Curve) -> Curve:
        """Both curves' points, in order."""
        both = [np.concatenate(pair) for pair in zip(self, other, strict=True)]
        order = np.lexsort((both[1], both[0]))
        return Curve(*both).at(order)


def follow(
    response: Response,
    piece: np.ndarray,
    omega: np.ndarray,
    delay: np.ndarray,
    spread: np.ndarray,
    above: np.ndarray,
) -> Curve:
    """Curves at frequencies, by Newton's method on the phase from delays near them."""
    samples, period = response.samples(omega), response.period or math.inf
    shortest = _SHORTEST * (response.period or 0.0)
    value, a, b = np.empty((3, omega.size), complex)
    farthest, phase = np.full(omega.size, 0.25 * period), np.zeros(omega.size)
    delay, above, moving = delay.copy(), above.copy(), np.arange(omega.size)
    for _ in range(_NEWTON):
        gain = loop_gain(response, Samples(*(x[moving] for x in samples)), delay[moving])
        which = np.arange(moving.size), np.zeros(moving.size, int)
        if gain.value.shape[1] > 1:
            log = np.log(gain.value)
            log -= np.real(log).mean(axis=1, keepdims=True)
            alike = np.exp(np.clip(above[moving], -600.0, 600.0))[:, None]
            which = which[0], np.abs(np.exp(log) - alike).argmin(axis=1)
            above[moving] = np.real(log)[which]
        for kept, part in zip((value, a, b), gain, strict=True):
            kept[moving] = part[which]
        now = np.angle(value[moving])
        # A step over the curve was too long; without this, two delays may follow on each other.
        farthest[moving] *= np.where(now * phase[moving] < 0.0, 0.5, 1.0)
        phase[moving] = now
        far = np.abs(now) > _PHASE * (1.0 + omega[moving] * np.abs(delay[moving]))
        moving = moving[far & (farthest[moving] > shortest)]
        if moving.size == 0:
            break
        with np.errstate(all="ignore"):
            change = np.clip(
                -phase[moving] / np.imag(b[moving]), -farthest[moving], farthest[moving]
            )
        delay[moving] += np.where(np.isfinite(change), change, 0.0)
    with np.errstate(all="ignore"):
        slope = np.real(a) - np.real(b) * np.imag(a) / np.imag(b)
        # Close to the Nyquist frequency the phase is next to 0 at any delay.
        enough = _RIGHT * np.fmin(1.0, period * np.abs(np.imag(b)))
    # Where the phase does not come right, or turns back, there is no point of the curve.
    right = (np.abs(phase) < enough) & np.isfinite(slope)
    level, slope = np.where(right, (np.log(np.abs(value)), slope), np.nan)
    return Curve(piece, omega, delay, level, slope, spread, above)


def refine(response: Response, curve: Curve, low: float, high: float) -> Curve:
    """The curve with points so close that every cell with delays in an interval is decided."""
    most = curve.omega.size + _MOST
    for _ in range(_ROUNDS):
        cells = np.flatnonzero(_judge(curve, response.period)[0])
        before, after = curve.delay[cells], curve.delay[cells + 1]
        within = (np.maximum(before, after) >= low) & (np.minimum(before, after) <= high)
        cells = cells[within]
        if cells.size == 0 or curve.omega.size + cells.size > most:
            break
        one, other = curve.at(cells), curve.at(cells + 1)
        curve = curve.with_points(_between(response, one, other, 0.5 * (one.omega + other.omega)))
    return curve


def candidates(curve: Curve, period: float | None) -> np.ndarray:
    """The cells in which the level changes its sign; or, where it is all but 0, its slope."""
    _, crossing, touching = _judge(curve, period)
    turning = touching & (curve.slope[1:] * curve.slope[:-1] <= 0.0)
    return np.flatnonzero(crossing | turning)


def _judge(curve: Curve, period: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of every cell between two points: undecided; with a change of sign; all but 0."""
    before, after = curve.level[:-1], curve.level[1:]
    gap = np.diff(curve.omega)
    steep = np.maximum(np.abs(curve.slope[:-1]), np.abs(curve.slope[1:])) * gap
    # Over a quarter of a period and more, the delay may do to the level what slopes do not tell.
    far = np.zeros(gap.size, bool)
    if period is not None:
        far = np.abs(np.diff(curve.delay)) > 0.25 * period
    change, same = after - before, before * after > 0.0
    clear = same & (np.minimum(np.abs(before), np.abs(after)) > steep + curve.spread[1:] * far)
    along = (curve.slope[:-1] * change > 0.0) & (curve.slope[1:] * change > 0.0)
    crossing = ~same & along & (steep < 4.0 * np.abs(change)) & ~far
    touching = (np.maximum(np.abs(before), np.abs(after)) <= TOUCH) & (steep <= 10.0 * TOUCH)
    known = np.isfinite(before) & np.isfinite(after) & (np.diff(curve.piece) == 0.0)
    undecided = known & ~clear & ~crossing & ~(touching & ~far)
    undecided &= gap > _FINEST * curve.omega[1:]
    return undecided, known & ~same & ~undecided, known & touching & ~undecided


def _between(response: Response, one: Curve, other: Curve, omega: np.ndarray) -> Curve:
    """Points of the curve at frequencies between those of two."""
    gap = other.omega - one.omega
    part = (omega - one.omega) / np.where(gap == 0.0, 1.0, gap)
    turned = one.omega * one.delay + part * (other.omega * other.delay - one.omega * one.delay)
    above = one.above + part * (other.above - one.above)
    return follow(response, one.piece, omega, turned / omega, one.spread, above)


def solve(response: Response, curve: Curve, cells: np.ndarray) -> Curve:
    """The zero of the level in cells in which it changes its sign, or else of its slope."""
    low, high = curve.at(cells), curve.at(cells + 1)
    changes, close = low.level * high.level <= 0.0, _PART * (high.omega - low.omega)
    at_low, at_high = (np.where(changes, end.level, end.slope) for end in (low, high))
    point, side, step = low, np.full(cells.size, -1), 0
    while True:
        # Newton's method where there is a slope and it stays between the ends. Or else a secant,
        # with the weight of an end that stays halved (Illinois).
        with np.errstate(invalid="ignore", divide="ignore"):
            omega = point.omega - point.level / point.slope
            secant = low.omega - at_low * (high.omega - low.omega) / (at_high - at_low)
        secant = np.where(np.isfinite(secant), secant, 0.5 * (low.omega + high.omega))
        inside = changes & (omega > low.omega) & (omega < high.omega)
        omega = np.where(inside, omega, secant)
        if step == _SECANT or (np.abs(omega - point.omega) <= close).all():
            return point
        point, step = _between(response, low, high, omega), step + 1
        now = np.nan_to_num(np.where(changes, point.level, point.slope))
        left = now * at_low > 0.0
        stays = np.where(left == side, 0.5, 1.0)
        at_low, at_high = np.where(left, now, stays * at_low), np.where(left, stays * at_high, now)
        known = np.isfinite(point.level)
        low, high = point.where(left & known, low), point.where(~left & known, high)
        side = left.astype(int)
