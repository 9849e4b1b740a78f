"""The first true delay at which a loop is at the limit of stability.

With the plant's delay line p at the true delay D (`deadtime.spectrum.response`) a root lies on the
limit of stability at the frequency ω exactly if

    X(ω, D) = M⁻¹ r p    has the eigenvalue λ = 1.

In the ideal loop a longer delay turns λ by e^{−iωD} and does not change |λ|; in the digital loop
|λ| also depends on where in a period the delay ends, and on no other property of it. So no delay
puts a root at ω unless some |λ| is 1 there at some fraction of a period: |λ| alone leaves a few
short bands of frequencies. A perturbation of X gives, for an eigenvalue with left and right vectors
y, x,

    d ln λ = yᴴ dX x/(λ yᴴ x),    dX = M⁻¹ (d(r p) − dM X).

In a band, let D_k(ω) be the curves on which the phase of λ is 0. A root lies on the limit where

    arg λ(ω, D_k(ω)) = 0 (mod 2π)    and the level    G(ω) = ln|λ(ω, D_k(ω))|    is 0.

This is one real equation on an interval of frequencies, with a known slope. From
d ln λ = a dω + b dD it follows that

    dD_k/dω = −Im a/Im b,    dG/dω = Re a − Re b · Im a/Im b.

Where G changes sign a root crosses the limit. Where G only touches 0, at a maximum or a minimum,
a root comes to the limit and goes back: the loop is not asymptotically stable at that delay, so
the margin ends there as well. A search along D slows down towards such a delay, as the root
does; along ω it is an ordinary maximum. Levels within 1e-9 of 0 count as touching: round-off
makes 1e-15 of an exact 0, and no plant is known to 1e-9.

A cell between two frequencies is halved until it is decided: G cannot reach 0 in it, since |G| at
both ends is above what the slopes there allow; G changes its sign once; or |G| is below `TOUCH`. In
a digital loop G has a bend wherever D_k passes a multiple of the period.

At the Nyquist frequency X is real and the curve is that frequency itself: a real root passes −1.
There det(I − X) is a real function of D, of period 2h. All this is double precision on samples,
not a proof.
"""

from __future__ import annotations

import heapq
import math
from typing import NamedTuple

import numpy as np

from deadtime.numerics.small_matrices import inverses, matched, traces
from deadtime.spectrum.response import Response, Samples

_FINE = 0.25  # of |d ln λ/dω|, times the distance of two samples
_END = 1e-6  # of the lowest even sample
_LARGE = 1e150
_NOTHING = 1e-12  # relative to the largest entry: a smaller eigenvalue is round-off
TOUCH = 1e-9  # of ln|λ|
_NEWTON, _PHASE, _RIGHT, _SHORTEST = 40, 1e-12, 1e-6, 1e-4
_ROUNDS, _MOST = 60, 20_000
_FINEST = 1e-14  # relative, of frequencies: closer than this nothing is sampled
_SECANT, _PART = 60, 1e-11  # of a cell
_AT_ONCE = 16  # curves
_RING = 0.05  # of the delay: the width of the first ring
_NYQUIST = 256  # delays in two periods


class Gain(NamedTuple):
    """Eigenvalues λ of X and d ln λ by frequency and by delay, each (points, m)."""

    value: np.ndarray
    by_frequency: np.ndarray
    by_delay: np.ndarray


class Band(NamedTuple):
    """Neighbouring frequencies between which |λ| may be 1 at some delay.

    spread : bound of the change of ln|λ| between delays within a period
    around : bound, s of delay, of the error of the phase of λ predicted by e^{−iωD}
    """

    samples: Samples
    spread: float
    around: float


def loop_gain(response: Response, samples: Samples, delay: np.ndarray) -> Gain:
    """λ and its slopes at samples, a delay for each or one for all."""
    p, p_slope, p_speed = response.delay_line(samples.omega, delay)
    inverse = inverses(samples.M)
    X = inverse @ samples.r @ p
    turned = inverse @ (samples.r_slope @ p + samples.r @ p_slope - samples.M_slope @ X)
    moved = inverse @ samples.r @ p_speed
    X, turned, moved = (np.where(np.isfinite(part), part, _LARGE) for part in (X, turned, moved))
    if X.shape[-1] == 1:
        value, parts = X[:, :, 0], (turned[:, :, 0], moved[:, :, 0])
    else:
        value, right = np.linalg.eig(X)
        left = inverses(right)
        parts = tuple(np.einsum("pij,pjk,pki->pi", left, part, right) for part in (turned, moved))
    # Fewer states than inputs, or a gain with a row of 0, leave eigenvalues that are 0 but for
    # round-off, whose logarithm has no slope.
    floor = _NOTHING * (1.0 + np.abs(X).max(axis=(1, 2)))[:, None]
    nothing = np.abs(value) <= floor
    value = np.where(nothing, floor, value)
    by_frequency, by_delay = (np.where(nothing, 0.0, part / value) for part in parts)
    return Gain(value, by_frequency, by_delay)


def bands(response: Response, delay: float) -> list[Band]:
    """The bands in which |λ| may be 1 at some delay, in rising order, first sampled for `delay`."""
    count = int(2.0 * response.highest * (response.memory + delay)) + 64
    omega = (np.arange(count) + 0.5) / count * response.highest
    # Outermost samples so close to the ends of the range that the cells beyond them are decided.
    outer = response.samples(np.array([_END * omega[0], response.highest - _END * omega[0]]))
    inner = response.samples(omega, even=True)
    parts = zip(outer, inner, strict=True)
    samples = Samples(*(np.concatenate((a[:1], b, a[1:])) for a, b in parts))
    low, high, rate, lag = _levels(response, samples)
    least = _FINEST * response.highest
    while True:
        points = np.concatenate(([0.0], samples.omega, [response.highest]))
        gap = np.diff(points)
        turns = _ends(rate, np.maximum) * gap
        away = np.maximum(_ends(low, np.minimum), -_ends(high, np.maximum)).min(axis=1)
        clear = turns <= np.clip(away, 0.0, _FINE)
        coarse = np.flatnonzero(~clear & ~(turns <= _FINE) & (gap > least))
        if coarse.size == 0:
            break
        more = response.samples(points[coarse] + gap[coarse] / 2.0)
        new = (*more, *_levels(response, more))
        old = (*samples, low, high, rate, lag)
        # Cell i ends at sample i, so what is put into it comes before that sample.
        merged = [np.insert(a, coarse, b, axis=0) for a, b in zip(old, new, strict=True)]
        samples, (low, high, rate, lag) = Samples(*merged[:-4]), merged[-4:]
    return _runs(samples, clear, high - low, lag)


def _levels(response: Response, samples: Samples) -> tuple[np.ndarray, ...]:
    """The least and largest ln|λ| over all delays, moduli sorted; rate of change; phase error."""
    cuts, points = response.cuts, samples.omega.size
    delay = np.repeat(cuts, points)
    gain = loop_gain(response, samples.repeat(cuts.size), delay)
    level = np.sort(np.log(np.abs(gain.value)), axis=1).reshape(cuts.size, points, -1)
    rates = np.abs(gain.by_frequency + 1j * delay[:, None]).max(axis=1).reshape(cuts.size, points)
    turns = np.imag(gain.by_delay).reshape(level.shape) / samples.omega[:, None]
    lags = np.abs(1.0 + turns).max(axis=2)
    # Between two of these delays the level may change by half of their difference; the first
    # follows the last, since |λ| has period h in the delay.
    slack = 0.5 * np.abs(np.diff(level, axis=0, prepend=level[-1:])).max(axis=0)
    low, high = level.min(axis=0) - slack, level.max(axis=0) + slack
    # Where |λ| is small its zeros make ln|λ| steep but |λ| not; poles make both steep.
    own = np.max(rates, axis=0) * np.exp(np.minimum(high.max(axis=1), 0.0))
    law = np.abs(traces(inverses(samples.M), samples.M_slope))
    rate = np.nan_to_num(np.max([own, np.abs(samples.plant), law], axis=0), nan=np.inf)
    lag = (response.period or 0.0) * np.minimum(np.nan_to_num(np.max(lags, axis=0), nan=1.0), 1.0)
    return low, high, rate, lag


def _ends(value: np.ndarray, choose: np.ufunc) -> np.ndarray:
    """The chosen value of both ends of every cell; the outer two cells have one end each."""
    return np.concatenate((value[:1], choose(value[1:], value[:-1]), value[-1:]))


def _runs(samples: Samples, clear: np.ndarray, spread: np.ndarray, lag: np.ndarray) -> list[Band]:
    """Samples around the cells that are not clear, neighbouring cells in one band."""
    # Cell i lies between the samples i − 1 and i; the outer two have one sample each.
    inside = np.concatenate(([False], ~clear, [False]))
    edges = np.flatnonzero(np.diff(inside.astype(int)))
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        part = slice(max(first - 1, 0), min(last, samples.omega.size - 1) + 1)
        inner = Samples(*(x[part] for x in samples))
        found.append(Band(inner, float(spread[part].max()), float(lag[part].max())))
    return found


class Curve(NamedTuple):
    """Points of pieces of curves D_k: piece number, rising ω, D, G, dG/dω, the band's spread.

    above : G less the mean of ln|λ| over all eigenvalues, which identifies the eigenvalue: a change
        of the delay within a period scales all of them about equally.
    """

    piece: np.ndarray
    omega: np.ndarray
    delay: np.ndarray
    level: np.ndarray
    slope: np.ndarray
    spread: np.ndarray
    above: np.ndarray

    def at(self, index: np.ndarray) -> Curve:
        return Curve(*(part[index] for part in self))

    def where(self, here: np.ndarray, other: Curve) -> Curve:
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
        # A step across the curve was too long; without this Newton's method may alternate.
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
    # Where the phase does not converge to 0, or turns back, there is no point of the curve.
    right = (np.abs(phase) < enough) & np.isfinite(slope)
    level, slope = np.where(right, (np.log(np.abs(value)), slope), np.nan)
    return Curve(piece, omega, delay, level, slope, spread, above)


def refine(response: Response, curve: Curve, low: float, high: float) -> Curve:
    """The curve with points added until every cell with delays in [low, high] is decided."""
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
    """The cells in which the level changes sign; or, where it is within `TOUCH` of 0, its slope."""
    _, crossing, touching = _judge(curve, period)
    turning = touching & (curve.slope[1:] * curve.slope[:-1] <= 0.0)
    return np.flatnonzero(crossing | turning)


def _judge(curve: Curve, period: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For every cell between two points: undecided; with a change of sign; touching 0."""
    before, after = curve.level[:-1], curve.level[1:]
    gap = np.diff(curve.omega)
    steep = np.maximum(np.abs(curve.slope[:-1]), np.abs(curve.slope[1:])) * gap
    # Over a quarter of a period or more the level may bend: slopes at the ends are no bound.
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
    """Points of the curve at frequencies between two points, from interpolated phases."""
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
        # Newton's method while it stays between the ends; otherwise a secant, halving the weight
        # of an end that stays (Illinois).
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
    # Rings of growing radius around the start: distant curves need not be followed once a near
    # crossing is known.
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
    """The first crossing with |D − D_start| in a ring, or `best` if that is nearer."""
    sign = math.copysign(1.0, end - start)
    inner, outer = ring
    # Curves by the least |D − D_start| that they may have, with their branch and k.
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
    """About |D − D_start| on the k-th curve, as if the delay turned λ by e^{−iωD} alone."""
    return (sign * branch.phase - 2.0 * np.pi * k) / branch.omega


def _least(branch: EigenvalueBranch, k: int, sign: float, inner: float) -> float:
    """A lower bound of |D − D_start| on the k-th curve, beyond the distance `inner`."""
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
    """The points of the k-th curve that may lie in a ring, and one on either side."""
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
    """The nearest crossing ahead on curves, or `best` if that is nearer."""
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
