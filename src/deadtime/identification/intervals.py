"""Intervals: from the information, from the profile, and over all plausible peaks.

**Profile.** The information describes a log likelihood that is a parabola, and takes the noise as
known. Near a kink over a delay it is no parabola. Where the log hardly tells noise of the plant
from none, as in step tests with a noisy sensor, the precision of every unknown depends on a noise
that the log does not determine, and an interval that takes W = 0 as known is too short if there is
noise. Then the interval holds all values of an unknown a at which the profile of the restricted
likelihood (Cox and Reid, J. Royal Statistical Society B 49(1), 1987),

    log L_p(a) = max over the others and the noise (log L) − ½ log det F of the plant's others,

is at most ½ (ν + 1) log(1 + t²/ν) below that at the maximum, with ν measurements less unknowns and
Student's quantile t. In a regression this is its interval exactly: with residual sums of squares
RSS(a), log L_p = −½ (ν + 1) log RSS(a), and RSS at the ends is 1 + t²/ν times the least. Of known
noise F is constant, and the fall ½ t² times the inflation of the variance.

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
_PARABOLA = 0.1  # of its fall to an end: a profile so near a parabola is taken as one
_PRECISE = 0.02  # of a standard error: ends of profiles of A and B
_FAR = 50.0  # times the interval of a parabola: a profile is followed no farther
_SINGULAR = -20.0  # least fall of log det F: Laplace's approximation is none of a singular F
_DEEP = -1e6  # least log likelihood of a profile: an exponential that overflows has −∞
_NEAR = 4.0  # standard errors: a nearer kink lies within the interval or close to it


class Spread(NamedTuple):
    """The covariance of all unknowns, and the half widths of intervals in standard errors.

    inflation : ratio of each unknown's variance to the one from the information alone
    spare : degrees of freedom of each unknown: observations less unknowns
    fall : of the profile of each unknown from its maximum to the ends of the interval
    uncertain : whether the precision depends on a noise that the log does not determine
    """

    covariance: FisherMatrix
    reach: Vector
    inflation: Vector
    spare: Vector
    fall: Vector
    uncertain: bool = False


def spread_of(F: FisherMatrix, names: list[str], known: FisherMatrix, spare: Vector) -> Spread:
    """The inverse of `known`, the information F reduced by the estimation of the noise.

    spare : degrees of freedom of each unknown. A singular F is refused.
    """
    from scipy.stats import t

    require_identified(F, names)
    covariance = inverse(known)
    inflation = np.diagonal(covariance) / np.diagonal(inverse(F))
    reach = np.asarray(t.ppf(0.5 + 0.5 * LEVEL, spare))
    return Spread(covariance, reach, inflation, spare, 0.5 * reach**2 * inflation)


def restricted_fall(spare: float) -> float:
    """The fall of a profile of the restricted likelihood to the ends of a 95 % interval.

    Examples
    --------
    >>> round(restricted_fall(1e6), 3), round(restricted_fall(10.0), 3)
    (1.921, 2.217)
    """
    from scipy.stats import t

    return 0.5 * (spare + 1.0) * float(np.log1p(t.ppf(0.5 + 0.5 * LEVEL, spare) ** 2 / spare))


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
            near = log.sampling.to_kink(D) < _NEAR * own
            if log.profiled and (near or spread.uncertain):
                result[row] = [self._profile_end(a, own * sign) for sign in (-1, 1)]
            else:
                result[row] = D - reach * own, D + reach * own
            result[row] = np.clip(result[row], *log.bounds)
            wider = self._over_other_peaks(result[row], row, float(spread.inflation[a]))
            several[row], result[row] = (wider != result[row]).any(), wider
        return result, several

    def profiled_ends(self) -> Float[np.ndarray, "unknown 2"]:
        """Ends of intervals of A and B, from profiles where these differ from a parabola.

        NaN of known entries.
        """
        layout, spread = self.log.layout, self.spread
        ends = np.full((layout.size, 2), np.nan)
        error = np.sqrt(np.diagonal(spread.covariance))[: layout.size - layout.delays]
        for a in np.flatnonzero(error).tolist():
            for side, step in enumerate((-float(error[a]), float(error[a]))):
                ends[a, side] = end = float(self.best.theta[a] + spread.reach[a] * step)
                if abs(self.profile(a, end) / spread.fall[a] + 1.0) > _PARABOLA:
                    ends[a, side] = self._profile_end(a, step)
        return ends

    def profile(self, place: int, value: float) -> float:
        """The log likelihood with one unknown fixed, less the largest one.

        Of uncertain noise it is restricted: see the module.
        """
        log, variance = self.log, self.spread.covariance[:, place]
        theta, fixed = self.best.theta.copy(), np.zeros(self.best.theta.size, bool)
        plant = slice(log.layout.size)
        theta[plant] += variance[plant] / variance[place] * (value - theta[place])
        theta[place], fixed[place] = value, True
        theta = log.with_visible_noise(theta, self.best.information)
        top, _ = maximise(log, theta, fixed, self.window, _WORTH)
        fall = top.value - self.best.value
        if not self.spread.uncertain:
            return fall
        others = np.flatnonzero(np.diagonal(self.spread.covariance)[plant] > 0.0)
        own = np.ix_(*2 * [others[others != place]])
        sizes = [np.linalg.slogdet(F[own])[1] for F in (top.information, self.best.information)]
        return fall - 0.5 * max(float(sizes[0] - sizes[1]), _SINGULAR)

    def _profile_end(self, place: int, step: float) -> float:
        """The end of an interval on one side, where the profile crosses its level, or a bound.

        If the crossing of a delay lies outside the window, everything is maximised again in one
        twice as wide.
        """
        from scipy.optimize import brentq

        at_delay = place in self.log.layout.delay_places
        reach, bounds = float(self.spread.reach[place]), self.log.bounds
        precise = (1e-3 if at_delay else _PRECISE) * abs(step)
        origin, fall, top = float(self.best.theta[place]), float(self.spread.fall[place]), self

        def left(shift: float) -> float:
            return max(top.profile(place, origin + shift), _DEEP) + fall

        inner, outer = 0.0, reach * step
        while True:
            low, high = top.window if at_delay else (-np.inf, np.inf)
            end = min(max(origin + outer, low), high)
            if left(end - origin) < 0.0:
                if left(inner) < 0.0:  # in a wider window the top may lie elsewhere
                    return origin + inner
                root = brentq(left, inner, end - origin, xtol=precise)
                return origin + float(root)  # pyright: ignore[reportArgumentType]
            inner = end - origin
            if end == origin + outer:
                if abs(outer) > _FAR * abs(reach * step):
                    return end
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
