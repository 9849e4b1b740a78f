"""Intervals: from the information, at a kink from the profile, and over all plausible peaks.

Where several delays are plausible, intervals of A and B cover all of them. An interval about the
likeliest delay alone ignores that the delay is uncertain: of many delays that are about equally
likely by noise, the likeliest is the one with the largest apparent effect of the input, so B is
biased upwards, and its interval is too short. So every plausible cell c of the delay has its own
maximum θ_c, with log L_c and information F_c, and the distribution of an unknown is the mixture

    Σ_c w_c t_ν((θ − θ_c)/σ_c),    w_c ∝ L_c |F_c|^{−½},    σ_c² = (F_c⁻¹)_aa,

Laplace's approximation of the posterior with a uniform prior of the delay. F_c includes 12/h² for
the delay, the information of a uniform distribution over a cell of length h. With noisy sensors
|F_c|^{−½} is the determinant for A, B and the delay, without the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.identification.likelihoods.likelihood import Likelihood, climb_within, maximise
from deadtime.identification.parameters import FisherMatrix, Layout, Vector, Window
from deadtime.identification.scoring import Maximum
from deadtime.identification.start import Start

LEVEL = 0.95
_UNSEEN = 1e-12  # of an eigenvalue of the information, scaled to a diagonal of ones
_PROFILE = 3.841458820694124  # χ² of one degree of freedom at 95 %
_CELL_GAIN = 1e-3  # rise of log likelihood that ends the climb in a cell
_WORTH = 1e-5  # the same for profiles, which fall by 1.9 or more to the end of an interval
_NEAR = 4.0  # standard errors: a nearer kink lies within the interval or close to it


class Spread(NamedTuple):
    """The covariance of all unknowns, and the half widths of intervals in standard errors.

    inflation : ratio of each unknown's variance to the one from the information alone
    spare : degrees of freedom of each unknown: observations less unknowns
    """

    covariance: FisherMatrix
    reach: Vector
    inflation: Vector
    spare: Vector


def spread_of(F: FisherMatrix, names: list[str], known: FisherMatrix, spare: Vector) -> Spread:
    """The inverse of `known`, the information F reduced by the estimation of the noise.

    spare : degrees of freedom of each unknown. A singular F is refused.
    """
    from scipy.stats import t

    require_identified(F, names)
    covariance = inverse(known)
    inflation = np.diagonal(covariance) / np.diagonal(inverse(F))
    return Spread(covariance, np.asarray(t.ppf(0.5 + 0.5 * LEVEL, spare)), inflation, spare)


def inverse(F: FisherMatrix) -> FisherMatrix:
    """F⁻¹, scaled so that units of the unknowns do not matter."""
    unit = 1.0 / np.sqrt(np.diagonal(F))
    return np.linalg.inv(F * unit[:, None] * unit) * unit[:, None] * unit


def require_identified(F: FisherMatrix, names: list[str]) -> None:
    """Refuse a singular information and name the direction."""
    diagonal = np.diagonal(F)
    blind = [names[a] for a in np.flatnonzero(~(diagonal > 0.0)) if a < len(names)]
    if blind or not np.isfinite(F).all():
        raise ArgumentError(
            f"log tells nothing of {', '.join(blind) or 'its unknowns'}: the states or inputs that "
            "they multiply never move. Excite them, or leave them out."
        )
    scaled = F / np.sqrt(diagonal)[:, None] / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(scaled)
    if values[0] > _UNSEEN:
        return
    direction = vectors[:, 0]
    part = np.abs(direction) > 0.2 * np.abs(direction).max()
    together = [names[a] if a < len(names) else "kinds of noise" for a in np.flatnonzero(part)]
    raise ArgumentError(
        f"log does not tell {', '.join(dict.fromkeys(together))} apart: they can all change "
        "together and nothing in it would. Log a run in which states and inputs move apart, such "
        "as with an input that is not a function of the state alone, or widen delay=(low, high) if "
        "the delay may lie outside it."
    )


def left_of(
    J: Float[np.ndarray, "all all"], of: Int[np.ndarray, " of"]
) -> Float[np.ndarray, "of of"]:
    """The Schur complement: the information on some unknowns with the others estimated.

    It is computed for scaled unknowns, so that the cutoff of singular values has no unit.
    """
    rest = np.setdiff1d(np.arange(len(J)), of)
    unit = 1.0 / np.sqrt(np.maximum(np.abs(np.diagonal(J)), 1e-300))
    scaled = J * unit[:, None] * unit
    cross, own = scaled[np.ix_(of, rest)], scaled[np.ix_(rest, rest)]
    left = scaled[np.ix_(of, of)] - cross @ np.linalg.pinv(own, _UNSEEN, hermitian=True) @ cross.T
    return left / unit[of, None] / unit[of]


@dataclass(frozen=True, eq=False, kw_only=True)
class Peak(Frozen):
    """The maximum of a likelihood, its covariance, and the scan that shows other peaks.

    log, best, window : the likelihood, its maximum, and the range of delays searched
    spread : of all unknowns; start : the first guess with the likelihood of all cells
    """

    log: Likelihood
    best: Maximum
    window: Window
    spread: Spread
    start: Start

    def delay_intervals(self) -> tuple[Float[np.ndarray, "delay 2"], Bool[np.ndarray, " delay"]]:
        """The interval of each delay, seconds, and whether it has several peaks."""
        log, spread, place = self.log, self.spread, self.log.layout.delay_places
        error = np.sqrt(np.diagonal(spread.covariance))[place]
        result, several = np.empty((place.size, 2)), np.zeros(place.size, bool)
        for row, (a, own) in enumerate(zip(place.tolist(), error.tolist(), strict=True)):
            D, reach = float(self.best.theta[a]), float(spread.reach[a])
            if log.profiled and log.sampling.to_kink(D) < _NEAR * own:
                result[row] = [self._profile_end(a, own * sign) for sign in (-1, 1)]
            else:
                result[row] = D - reach * own, D + reach * own
            result[row] = np.clip(result[row], *log.bounds)
            wider = self._over_other_peaks(result[row], row, float(spread.inflation[a]))
            several[row], result[row] = (wider != result[row]).any(), wider
        return result, several

    def profile(self, place: int, delay: float) -> float:
        """The log likelihood with one delay fixed, less the largest one."""
        theta, fixed = self.best.theta.copy(), np.zeros(self.best.theta.size, bool)
        theta[place], fixed[place] = delay, True
        top, _ = maximise(self.log, theta, fixed, self.window, _WORTH)
        return top.value - self.best.value

    def _profile_end(self, place: int, step: float) -> float:
        """The end of the interval on one side, where the profile crosses its level, or the bound.

        If the crossing lies outside the window, everything is maximised again in one twice as wide.
        """
        from scipy.optimize import brentq

        reach, bounds = float(self.spread.reach[place]), self.log.bounds
        D = float(self.best.theta[place])
        fall, top = 0.5 * reach**2 * float(self.spread.inflation[place]), self

        def left(shift: float) -> float:
            return top.profile(place, D + shift) + fall

        inner, outer = 0.0, reach * step
        while True:
            low, high = top.window
            end = min(max(D + outer, low), high)
            if left(end - D) < 0.0:
                if left(inner) < 0.0:  # in a wider window the top may lie elsewhere
                    return D + inner
                root = brentq(left, inner, end - D, xtol=1e-3 * abs(step))
                return D + float(root)  # pyright: ignore[reportArgumentType]
            inner = end - D
            if end == D + outer:
                outer = 1.5 * outer
            elif end in bounds:
                return end
            else:
                half = 0.5 * (high - low)
                window = max(bounds[0], low - half), min(bounds[1], high + half)
                best, _ = maximise(self.log, self.best.theta, window=window)
                top = replace(top, best=best, window=window)

    def _over_other_peaks(self, interval: np.ndarray, row: int, inflation: float) -> np.ndarray:
        """An interval extended to the last plausible cell of another peak."""
        log, start = self.log, self.start
        h, curve = log.recording.step, start.curves[row]
        fall = plausible_fall(log.layout, start.weights, curve.size, inflation)
        ends = interval.copy()
        first = max(int(np.ceil(interval[0] / h - 1e-9)) - start.first, 0)  # the cell of the end
        last = max(int(np.ceil(interval[1] / h - 1e-9)) - start.first, 0)
        # A neighbour of the interval is the same peak: cells of uneven rows are not exact.
        top = int(curve.argmax())
        first, last = first - (top == first - 1), last + (top == last + 1)
        below, above = curve[: first + 1][::-1], curve[last:]
        if (cell := fresh_rise(below, curve.max() - fall)) is not None:
            ends[0] = min(ends[0], (start.first + first - cell - 1) * h)
        if (cell := fresh_rise(above, curve.max() - fall)) is not None:
            ends[1] = max(ends[1], (start.first + last + cell) * h)
        if start.vectors is not None:  # the curve is a profile, maximised in every cell
            near = start.first + np.flatnonzero(curve >= curve.max() - 0.5 * inflation * _PROFILE)
            if near[0] * h < interval[0] - h:
                ends[0] = min(ends[0], (near[0] - 1) * h)
            if (near[-1] - 1) * h > interval[1] + h:
                ends[1] = max(ends[1], near[-1] * h)
        return np.clip(ends, *log.bounds)

    def ends_over_peaks(self) -> Float[np.ndarray, "unknown 2"] | None:
        """Ends of intervals of A and B over all plausible cells of a delay.

        None where no delay has several peaks. Of several delays that have, the others stay in their
        cells, and intervals are joined.
        """
        layout, start, mixed = self.log.layout, self.start, []
        for row, (place, curve) in enumerate(zip(layout.delay_places, start.curves, strict=True)):
            inflation = float(self.spread.inflation[place])
            level = curve.max() - plausible_fall(layout, start.weights, curve.size, inflation)
            top = int(curve.argmax())
            if any(fresh_rise(side, level) is not None for side in (curve[top::-1], curve[top:])):
                near = np.flatnonzero(curve >= level)
                vectors = None if start.vectors is None else start.vectors[row][near]
                mixed.append(self._mixed(row, start.first + near, vectors))
        if not mixed:
            return None
        return np.column_stack((np.min(mixed, axis=0)[:, 0], np.max(mixed, axis=0)[:, 1]))

    def _mixed(
        self, row: int, cells: np.ndarray, vectors: np.ndarray | None
    ) -> Float[np.ndarray, "size 2"]:
        """The ends of all intervals over cells of one delay, from the mixture of the module."""
        log, best, h = self.log, self.best, self.log.recording.step
        size, place = log.layout.size, log.layout.delay_places
        inflation, spare = self.spread.inflation[:size], self.spread.spare[:size]
        evaluate_in, centre, width, weight = log.evaluate_in(*log.bounds), [], [], []
        for k, cell in enumerate(cells):
            own, theta = log.cells(best.theta), best.theta.copy()
            own[row], theta[place[row]] = cell, (cell - 0.5) * h
            theta = theta if vectors is None else vectors[k]
            top = climb_within(log, evaluate_in(own), theta, own, _CELL_GAIN)
            if not np.isfinite(top.value):
                continue
            F = top.information.copy()
            F[place[row], place[row]] += 12.0 / h**2
            identified = log.identified(top.theta, F)
            try:
                covariance = inverse(F[np.ix_(identified, identified)])[:size, :size]
            except np.linalg.LinAlgError:
                continue
            variance = np.diagonal(covariance) * inflation
            if not (np.isfinite(variance).all() and (variance > 0.0).all()):
                continue
            centre.append(top.theta[:size])
            width.append(np.sqrt(variance))
            value = top.value / float(inflation[place[row]])
            weight.append(value + 0.5 * np.linalg.slogdet(covariance)[1])
        weight = np.exp(np.array(weight) - np.max(weight))
        return mixture_ends(np.array(centre), np.array(width), weight / weight.sum(), spare)


def plausible_fall(layout: Layout, weights: int, cells: int, inflation: float) -> float:
    """The largest difference of log likelihood between the likeliest and a plausible cell.

    A cell's weights are free in each mode that has the delay. Each of many cells may be the
    likeliest by chance, so the level is Bonferroni's.
    """
    from scipy.stats import chi2

    free = weights * (1 if layout.per_mode else layout.modes)
    return 0.5 * inflation * float(chi2.isf((1.0 - LEVEL) / cells, free))


def fresh_rise(outwards: np.ndarray, level: float) -> int | None:
    """The last cell above a level that is likelier than one before it."""
    least = np.minimum.accumulate(outwards)
    rises = np.flatnonzero((outwards > least) & (outwards >= level))
    return int(rises[-1]) if rises.size else None


def mixture_ends(
    centre: Float[np.ndarray, "cell size"],
    width: Float[np.ndarray, "cell size"],
    weight: Float[np.ndarray, " cell"],
    spare: Vector,
) -> Float[np.ndarray, "size 2"]:
    """The central 95 % intervals of mixtures of Student's distributions, by bisection.

    Examples
    --------
    >>> one = mixture_ends(np.array([[3.0]]), np.array([[2.0]]), np.ones(1), np.array([1e9]))
    >>> one.round(3)
    array([[-0.92,  6.92]])
    """
    from scipy.special import stdtr, stdtrit

    ends = []
    for share in (0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL):
        each = centre + stdtrit(spare, share) * width
        low, high = each.min(axis=0), each.max(axis=0)
        for _ in range(60):
            middle = 0.5 * (low + high)
            above = weight @ stdtr(spare, (middle - centre) / width) > share
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        ends.append(0.5 * (low + high))
    return np.column_stack(ends)
