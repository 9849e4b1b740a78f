"""The largest maximum of the likelihood with noisy sensors: climbs from scans of all delays.

The likelihood has several maxima over the delays, and over the shares of plant and sensors in the
noise. So all delays are scanned near the start of each climb, and again near the likeliest plant so
far, until a scan leads no higher.

With A, W and V fixed, innovations of the filter are linear in the contributions of inputs and
constant terms. A delay of N periods selects the column of u_{k−N} if inputs are held; a delay
between N − 1 and N nearly a mean of two columns, of three if inputs are linear between samples. So
the fit for each delay is a regression for B alone over the whole
log. Constant terms do not depend on the delays and are eliminated first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.identification.likelihoods.likelihood import maximise, window_of
from deadtime.identification.likelihoods.noisy_log import NoisyLog
from deadtime.identification.likelihoods.switched_filter import FilterPeriods, Places
from deadtime.identification.log.recording import Part
from deadtime.identification.parameters import Layout, Vector, Window
from deadtime.identification.sampling import inputs_at, period_weights
from deadtime.identification.scoring import Maximum, best_in_turn
from deadtime.identification.start import cell_range
from deadtime.identification.transition import transitions_of

_PARTS = 4  # delays tried per period
_SWEEPS = 4  # over all delays, each in turn
_ROUNDS = 3  # of scans, each near the likeliest plant so far
_BETTER = 0.1  # rise of log likelihood that is worth another round
# Rise of log likelihood that ends a climb: of a plant with one pole too many it never converges.
_GAIN = 1e-4
_ALIKE = 0.1  # of log likelihood: starts so close differ in noise that the log hardly shows
_NEARLY = 3.0  # largest fall of log likelihood at which other delays are tried
_LESS = 1e-4  # factor of W where all noise is attributed to the sensors
# Share of samples: if the whole range of delays makes more of them unusable, a part is searched.
_LOST = 0.5
_Options = tuple[int | np.ndarray | None, ...]  # of each delay: one, several, or no such input


class DelayScan(NamedTuple):
    """The likeliest plant, and the log likelihood of each cell of a delay, from cell `first` on."""

    theta: Vector
    first: int
    curves: Float[np.ndarray, "delay cell"]

    def with_noise_of(self, vector: Vector) -> Vector:
        """This plant with the noise of `vector`."""
        return np.concatenate((self.theta, vector[self.theta.size :]))


def scan_delays(log: NoisyLog, vector: Vector) -> DelayScan:
    """A scan of all delays of an even log, with A and noise of `vector`."""
    layout, h, rows = log.layout, log.recording.step, log.acting
    first, last = cell_range(h, log.bounds, layout.m)
    lags = np.arange(first - 1 - log.sampling.hold, last + 1)
    gram, share = _gram(log, vector, rows, lags), _shares(log, vector, rows.size)
    scan = _DelayRegressions(gram, share, layout, lags.size)
    own = np.round(_PARTS * (vector[layout.at_delays] / h - first + 1)).astype(int)
    places, curves = scan.best(np.clip(own, 0, scan.options - 1))
    chosen, shape = tuple(places.tolist()), (layout.modes, rows.size, -1)
    B = np.zeros((layout.modes, layout.n, layout.acting))
    B[:, rows, : layout.m] = scan.weights(chosen)[0].reshape(shape)
    B[:, rows, layout.m :] = scan.constants(chosen)
    D = np.clip(h * (first - 1 + places / _PARTS), *log.bounds)
    theta = layout.join(layout.split(vector)[0], B, layout.spread(D))
    inside = [curves[:, a : a + scan.options - _PARTS : _PARTS] for a in range(_PARTS + 1)]
    return DelayScan(theta, first, np.max(inside, axis=0))


def _gram(
    log: NoisyLog, vector: np.ndarray, rows: np.ndarray, lags: np.ndarray
) -> Float[np.ndarray, "z z"]:
    """Σ z zᵀ of the innovations without inputs, and of their derivatives by B at every lag.

    z is in standard deviations of the innovations. Its columns:

        e | mode 0: row 0: lag 0: u_1 … u_m, lag 1: …, (1) | row 1: … | mode 1: …

    with a column for the constant term at the end of each row, if the layout has one.
    """
    layout, whole = log.layout, log.filter(vector, log.starts(*log.bounds))
    modes, n, columns = layout.modes, layout.n, lags.size * layout.m + layout.constant
    A = layout.split(vector[: layout.size])[0]
    step = np.array([log.recording.step])
    push = np.array([transitions_of(one, step).W[0][:, rows] for one in A])
    own = np.arange(modes * rows.size * columns).reshape(modes, -1)
    own = np.hstack((np.full((modes, n * n), -1), own))  # A is known
    places = Places.none(modes)._replace(size=int(own.max()) + 1, own=own)

    def periods_of(part: Part, k: np.ndarray, fresh: np.ndarray) -> FilterPeriods:
        periods = whole.periods_of(part, k, fresh)
        u = np.nan_to_num(inputs_at(part, k[:, None] - 1 - lags)).reshape(k.size, -1)
        u = np.hstack((u, np.ones((k.size, int(layout.constant)))))
        acting = push[periods.mode].swapaxes(1, 2)[:, :, None] * u[:, None, :, None]
        by = np.hstack((np.zeros((k.size, n * n, n)), acting.reshape(k.size, -1, n)))
        return periods._replace(added=np.zeros(periods.added.shape), by_added=by)

    total = 0.0
    for block in whole._replace(periods_of=periods_of).innovations(places):
        z = np.concatenate((block.e[..., None], -block.by_e), axis=2)
        z = (z / np.sqrt(block.s)[..., None])[np.isfinite(block.y)]
        total = total + z.T @ z
    return np.asarray(total)


def _shares(log: NoisyLog, vector: np.ndarray, rows: int) -> Float[np.ndarray, "mode part lag r r"]:
    """K in P b = W(h) K b: the share of each input that acts, the newest first, of arrivals at f h.

    Where some rows of b are 0, K is that of A = 0.
    """
    h, lags, n = log.recording.step, log.sampling.lags, log.layout.n
    A = log.layout.split(vector[: log.layout.size])[0]
    if rows < n:
        A, n = np.zeros((len(A), 1, 1)), 1
    shares = np.empty((len(A), _PARTS, lags, n, n))
    for place in np.ndindex(len(A), _PARTS):
        rest = np.full(n, h * (1.0 - place[1] / _PARTS))
        P, _ = period_weights(A[place[0]], np.eye(n), rest, h, False, log.sampling.hold)
        weights = P[:, n:].reshape(n, lags, n).swapaxes(0, 1)[::-1]
        shares[place] = np.linalg.solve(weights.sum(axis=0), weights)
    return shares if rows == log.layout.n else shares * np.eye(rows)


class _DelayRegressions:
    """Regressions of innovations on the inputs, for all delays of each input."""

    def __init__(self, gram: np.ndarray, share: np.ndarray, layout: Layout, lags: int) -> None:
        self.layout, self.rows, self.share = layout, share.shape[-1], share
        self.options = (lags + 1 - share.shape[2]) * _PARTS + 1
        columns = lags * layout.m + layout.constant
        every = 1 + np.arange(layout.modes * self.rows * columns).reshape(-1, self.rows, columns)
        self.place = every[:, :, : lags * layout.m].reshape(-1, self.rows, lags, layout.m)
        self.gram, self.constant = gram, every[:, :, lags * layout.m :].ravel()
        self.by_constant = np.zeros((0, len(gram)))
        if layout.constant:
            G = gram[np.ix_(self.constant, self.constant)]
            unit = 1.0 / np.sqrt(np.maximum(np.diagonal(G), 1e-300))
            scaled = np.linalg.pinv(G * unit * unit[:, None], rcond=1e-10, hermitian=True)
            self.by_constant = (scaled * unit * unit[:, None]) @ gram[self.constant]
            self.gram = gram - gram[:, self.constant] @ self.by_constant

    def _columns(self, places: _Options) -> tuple[np.ndarray, ...]:
        """For each mode, row and input with a delay, the columns of acting lags, their weights."""
        of, last = self.layout.spread(np.arange(self.layout.delays)), self.place.shape[2] - 1
        at, weight = [], []
        for i, row, j in np.ndindex(self.layout.modes, self.rows, self.layout.m):
            if (place := places[of[i, j]]) is not None:
                lag, part = np.divmod(np.asarray(place), _PARTS)
                lags = np.minimum(lag[..., None] + np.arange(self.share.shape[2]), last)
                own = np.moveaxis(self.place[i][:, lags, j], 0, -1)  # (*options, lag, row)
                at.append(own.reshape(*lag.shape, -1))
                weight.append(self.share[i, part, :, :, row].reshape(*lag.shape, -1))
        return tuple(np.stack(np.broadcast_arrays(*one), axis=-2) for one in (at, weight))

    def weights(self, places: _Options) -> tuple[np.ndarray, np.ndarray]:
        """B (*options, modes, rows, m), and the sums of squares that it explains."""
        at, share = self._columns(places)
        G = np.zeros((*at.shape[:-1], at.shape[-2]))
        for a, b in np.ndindex(2 * (at.shape[-1],)):
            product = self.gram[at[..., :, None, a], at[..., None, :, b]]
            G += product * share[..., :, None, a] * share[..., None, :, b]
        right = (share * self.gram[at, 0]).sum(axis=-1)
        unit = 1.0 / np.sqrt(np.maximum(np.diagonal(G, axis1=-2, axis2=-1), 1e-300))
        scaled = np.linalg.pinv(G * unit[..., None] * unit[..., None, :], 1e-10, hermitian=True)
        w = unit * (scaled @ (right * unit)[..., None])[..., 0]
        return w, np.asarray((right * w).sum(axis=-1))

    def constants(self, places: _Options) -> Float[np.ndarray, "mode row c"]:
        """The constant terms with the likeliest weights."""
        at, share = self._columns(places)
        acting = np.einsum("cia,ia->ci", self.by_constant[:, at], share)
        terms = self.by_constant[:, 0] - acting @ self.weights(places)[0]
        return terms.reshape(self.layout.modes, self.rows, -1)

    def likelihood(self, *places: int | np.ndarray | None) -> np.ndarray:
        """Log likelihood up to a constant."""
        return np.asarray(0.5 * self.weights(places)[1])

    def best(self, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The likeliest delays, and the log likelihood of each with the others fixed."""
        starts, options = ((None,) * own.size, tuple(own.tolist())), range(self.options)
        tried = [best_in_turn(one, options, self.likelihood, _SWEEPS) for one in starts]
        best = max(tried, key=lambda places: self.likelihood(*places))
        beside = [(*best[:d], np.array(options), *best[d + 1 :]) for d in range(own.size)]
        return np.array(best), np.array([self.likelihood(*one) for one in beside])


def largest_maximum(
    log: NoisyLog,
    guesses: Sequence[np.ndarray],
    climbed: Sequence[np.ndarray] = (),
    others: Callable[[np.ndarray], list[np.ndarray]] = lambda _: [],
) -> tuple[Maximum, DelayScan]:
    """The likeliest vector that is reached, and the last scan.

    guesses : vectors with A and noise for scans; climbed : vectors from which to climb without a
    scan; others : more starts near a vector
    """
    log = replace(log, bounds=_search_range(log, (*guesses, *climbed)[0]))
    scan, grid = None, replace(log, recording=log.recording.gridded())
    scanned = (scan_delays(grid, guess).with_noise_of(guess) for guess in guesses)
    maxima = [_climb(log, start) for start in _distinct(log, [*climbed, *scanned])]
    best = max(maxima, key=lambda one: one.value)
    for _ in range(_ROUNDS):
        scan = scan_delays(grid, best.theta)
        beside = [
            attributed_to_sensors(log, best.theta),
            *others(best.theta),
            *_elsewhere(log, best, scan),
        ]
        tried = [_climb(log, one) for one in beside]
        top = max(tried, key=lambda one: one.value, default=best)
        if top.value < best.value + _BETTER:
            break
        best = top
    assert scan is not None
    return best, scan


def _search_range(log: NoisyLog, theta: np.ndarray) -> Window:
    """The range of delays to search, or a part of it if all of it makes too many samples unusable.

    A sample is usable if all inputs back to the longest delay are known.
    """
    low, high = window_of(log, theta[log.layout.at_delays])
    most, least = (np.concatenate(log.starts(*ends)).sum() for ends in ((low, high), log.bounds))
    return (low, high) if least - most > _LOST * log.recording.samples else log.bounds


def _elsewhere(log: NoisyLog, best: Maximum, scan: DelayScan) -> list[np.ndarray]:
    """Other starts: the scan's maximum, and cells of each delay that are nearly as likely."""
    place, h, starts = log.layout.at_delays, log.recording.step, []
    if np.abs(scan.theta[place] - best.theta[place]).max() >= h:
        starts.append(scan.with_noise_of(best.theta))
    for row, curve in enumerate(scan.curves):
        D = (scan.first + np.arange(curve.size) - 0.5) * h
        near = (curve > curve.max() - _NEARLY) & (np.abs(D - best.theta[place][row]) > 1.5 * h)
        if near.any():
            theta = best.theta.copy()
            theta[place.start + row] = D[near][curve[near].argmax()]
            starts.append(theta)
    return starts


def _distinct(log: NoisyLog, starts: list[np.ndarray]) -> list[np.ndarray]:
    """Starts without those within ½ dᵀ F d < `_ALIKE` of one before, F the information."""
    kept, begins = starts[:1], log.starts(*log.bounds)
    for start in starts[1:]:
        F, apart = log.evaluate(start, begins).information, start - np.array(kept)
        if not (0.5 * np.einsum("ka,ab,kb->k", apart, F, apart) < _ALIKE).any():
            kept.append(start)
    return kept


def attributed_to_sensors(log: NoisyLog, vector: np.ndarray) -> np.ndarray:
    """A vector's plant with all innovations attributed to noise of the sensors.

    A climb does not return from a sensor without noise, where the score in its logarithm is 0.
    """
    e, _ = log.innovations(vector, log.starts(*log.bounds))
    changed, (i, j) = vector.copy(), log.places
    L = slice(log.layout.size, log.layout.size + i.size)
    less = np.sqrt(_LESS)
    changed[L] = np.where(i == j, vector[L] + np.log(less), less * vector[L])
    error = np.sqrt(np.mean(e**2, axis=0))
    changed[L.stop :] = np.log(np.maximum(error, np.finfo(float).tiny))
    return changed


def _climb(log: NoisyLog, vector: np.ndarray) -> Maximum:
    """The maximum near a vector, over the whole range of delays."""
    return maximise(log, vector, window=log.bounds, gain=_GAIN)[0]
