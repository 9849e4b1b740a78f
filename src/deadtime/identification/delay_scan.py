"""The largest maximum of the likelihood with noisy sensors: climbs from scans of all delays.

There are several maxima over the delays, and over how the noise is shared between plant and
sensors. So all delays are scanned about where each climb begins, and again about the likeliest
plant so far, until a scan leads no higher.

With A, W and V as they are, errors of the filter are linear in what inputs and constant terms add,
and a delay of N periods takes the column of u_{k−N}; one between N − 1 and N nearly a mean of two
columns. So every delay is a regression, of B alone, over the whole log. Constant terms are
eliminated first: they are the same whatever the delays are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.identification.likelihoods.likelihood import maximise, window_of
from deadtime.identification.likelihoods.noisy_log import NoisyLog
from deadtime.identification.likelihoods.switched_filter import FilterPeriods, Places
from deadtime.identification.log.recording import Part
from deadtime.identification.parameters import Layout, Vector, Window
from deadtime.identification.sampling import inputs_at
from deadtime.identification.scoring import Maximum, best_in_turn
from deadtime.identification.start import cell_range
from deadtime.identification.transition import transitions_of

_PARTS = 4  # of a period: delays that are tried
_SWEEPS = 4  # over all delays, each in turn
_ROUNDS = 3  # of scans, each about the likeliest plant so far
_BETTER = 0.1  # of log likelihood: cells that are worth going to
_GAIN = 1e-4  # of log likelihood that a start may lack: with a pole too many a climb never ends
_NEARLY = 3.0  # of log likelihood: delays that may be the likeliest after all
_LESS = 1e-4  # of the plant's noise, where all errors may be the sensors'
_LOST = 0.5  # of the samples: a range of delays for which more are of no use is searched in part


class Scanned(NamedTuple):
    """The likeliest plant, and how likely each cell of a delay is beside it, from `first` on."""

    theta: Vector
    first: int
    curves: Float[np.ndarray, "delay cell"]

    def moved(self, vector: Vector) -> Vector:
        """The vector with its plant, and its own noise."""
        return np.concatenate((self.theta, vector[self.theta.size :]))


def scanned(log: NoisyLog, vector: Vector) -> Scanned:
    """All delays of an even log, A and noise as they are in `vector`."""
    layout, h, rows = log.layout, log.recording.step, log.acting
    first, last = cell_range(h, log.bounds, layout.m)
    lags = np.arange(first - 1, last + 1)
    gram, share = _gram(log, vector, rows, lags), _shares(log, vector, rows.size)
    scan = _DelayScan(gram, share, layout, lags.size)
    own = np.round(_PARTS * (vector[layout.at_delays] / h - first + 1)).astype(int)
    places, curves = scan.best(np.clip(own, 0, scan.options - 1))
    B = np.zeros((layout.modes, layout.n, layout.acting))
    B[:, rows, : layout.m] = scan.weights(tuple(places.tolist()))[0]
    B[:, rows, layout.m :] = scan.constants(tuple(places.tolist()))
    D = np.clip(h * (first - 1 + places / _PARTS), *log.bounds)
    theta = layout.join(layout.split(vector)[0], B, layout.spread(D))
    inside = [curves[:, a : a + scan.options - _PARTS : _PARTS] for a in range(_PARTS + 1)]
    return Scanned(theta, first, np.max(inside, axis=0))


def _gram(
    log: NoisyLog, vector: np.ndarray, rows: np.ndarray, lags: np.ndarray
) -> Float[np.ndarray, "z z"]:
    """Sums of the errors without inputs and of the responses to each: modes, rows, lags × m (+ 1).

    Constant terms come last in each row, where there are any. A response is what an error would be
    less by, in standard deviations, for one more input: the filter's derivative.
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
        found = whole.periods_of(part, k, fresh)
        u = np.nan_to_num(inputs_at(part, k[:, None] - 1 - lags)).reshape(k.size, -1)
        u = np.hstack((u, np.ones((k.size, int(layout.constant)))))
        acting = push[found.mode].swapaxes(1, 2)[:, :, None] * u[:, None, :, None]
        by = np.hstack((np.zeros((k.size, n * n, n)), acting.reshape(k.size, -1, n)))
        return found._replace(added=np.zeros(found.added.shape), by_added=by)

    total = 0.0
    for block in whole._replace(periods_of=periods_of).innovations(places):
        z = np.concatenate((block.e[..., None], -block.by_e), axis=2)
        z = (z / np.sqrt(block.s)[..., None])[np.isfinite(block.y)]
        total = total + z.T @ z
    return np.asarray(total)


def _shares(log: NoisyLog, vector: np.ndarray, rows: int) -> Float[np.ndarray, "mode part r r"]:
    """The share of b that the newer of two inputs adds in a period, at every part of it.

    An input that arrives a part f of the period h late acts on the rest of it, W((1 − f) h) b =
    W(h) K b. K is close to 1 − f, which stands for it where b has rows that are 0.
    """
    late = np.arange(_PARTS) / _PARTS
    modes, n = log.layout.modes, log.layout.n
    if rows < n:
        return np.tile((1.0 - late)[:, None, None] * np.eye(rows), (modes, 1, 1, 1))
    A = log.layout.split(vector[: log.layout.size])[0]
    acting = [transitions_of(one, log.recording.step * (1.0 - late)).W for one in A]
    return np.array([[np.linalg.lstsq(W[0], part, rcond=None)[0] for part in W] for W in acting])


class _DelayScan:
    """Regressions of errors on what every input adds, at so many delays of each."""

    def __init__(self, gram: np.ndarray, share: np.ndarray, layout: Layout, lags: int) -> None:
        self.layout, self.rows, self.share = layout, share.shape[-1], share
        self.options = (lags - 1) * _PARTS + 1
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

    def _columns(self, places: tuple[int | None, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Of each mode, row and input that acts, columns of two lags and what they weigh."""
        of = self.layout.spread(np.arange(self.layout.delays))
        at, weight = [], []
        for i, row, j in np.ndindex(self.layout.modes, self.rows, self.layout.m):
            if (place := places[of[i, j]]) is not None:
                lag, part = divmod(place, _PARTS)
                later = min(lag + 1, self.place.shape[2] - 1)
                new = self.share[i, part, :, row]
                at.append((self.place[i, :, lag, j], self.place[i, :, later, j]))
                weight.append((new, np.eye(self.rows)[row] - new))
        size = -1, 2 * self.rows
        return np.array(at, int).reshape(size), np.array(weight).reshape(size)

    def weights(self, places: tuple[int | None, ...]) -> tuple[np.ndarray, float]:
        """B (modes, rows, m), and the squares of errors that it explains."""
        at, share = self._columns(places)
        if not len(at):
            return np.zeros(0), 0.0
        G = np.einsum("ia,jb,iajb->ij", share, share, self.gram[at[:, :, None, None], at])
        b = np.einsum("ia,ia->i", share, self.gram[at, 0])
        unit = 1.0 / np.sqrt(np.maximum(np.diagonal(G), 1e-300))
        w = unit * np.linalg.lstsq(G * unit * unit[:, None], b * unit, rcond=1e-10)[0]
        shape = self.layout.modes, self.rows, -1
        return w.reshape(shape) if None not in places else w, float(b @ w)

    def constants(self, places: tuple[int | None, ...]) -> Float[np.ndarray, "mode row c"]:
        """The constant terms beside the likeliest weights; none where there are none."""
        at, share = self._columns(places)
        acting = np.einsum("cia,ia->ci", self.by_constant[:, at], share)
        terms = self.by_constant[:, 0] - acting @ self.weights(places)[0].ravel()
        return terms.reshape(self.layout.modes, self.rows, -1)

    def likelihood(self, places: tuple[int | None, ...]) -> float:
        """Of errors in units of their deviation, but for a constant."""
        return 0.5 * self.weights(places)[1]

    def best(self, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The likeliest delays, and each one's curve beside them."""
        delays, options = self.layout.delays, range(self.options)
        begins = (None,) * delays, tuple(own.tolist())
        given = options, self.likelihood, _SWEEPS
        best = max((best_in_turn(one, *given) for one in begins), key=self.likelihood)
        curves = [
            [self.likelihood((*best[:d], c, *best[d + 1 :])) for c in options]
            for d in range(delays)
        ]
        return np.array(best), np.array(curves)


def largest_maximum(
    log: NoisyLog,
    begins: Iterable[np.ndarray],
    climbed: Iterable[np.ndarray] = (),
    others: Callable[[np.ndarray], list[np.ndarray]] = lambda _: [],
) -> tuple[Maximum, Scanned]:
    """The likeliest vector that is found, and the last scan.

    begins : vectors whose A and noise a scan begins with; climbed : those that are climbed from as
    they are; others : what else to try beside a vector
    """
    begins, climbed = list(begins), list(climbed)
    log = replace(log, bounds=_searched(log, (*begins, *climbed)[0]))
    scan, grid = None, replace(log, recording=log.recording.gridded())
    found = [_climbed(log, begin) for begin in climbed]
    for begin in begins:
        scan = scanned(grid, begin)
        found.append(_climbed(log, scan.moved(begin)))
    best = max(found, key=lambda one: one.found.value)
    for _ in range(_ROUNDS):
        scan = scanned(grid, best.theta)
        beside = [of_sensors(log, best.theta), *others(best.theta), *_elsewhere(log, best, scan)]
        tried = [_climbed(log, one) for one in beside]
        top = max(tried, key=lambda one: one.found.value, default=best)
        if top.found.value < best.found.value + _BETTER:
            break
        best = top
    assert scan is not None
    return best, scan


def _searched(log: NoisyLog, theta: np.ndarray) -> Window:
    """The range of delays, or a part of it about a vector's where all of it would cost too much.

    What is usable of a log depends on how far back inputs must be known.
    """
    low, high = window_of(log, theta[log.layout.at_delays])
    most, least = (np.concatenate(log.starts(*ends)).sum() for ends in ((low, high), log.bounds))
    return (low, high) if least - most > _LOST * log.recording.samples else log.bounds


def _elsewhere(log: NoisyLog, best: Maximum, scan: Scanned) -> list[np.ndarray]:
    """Where else a maximum may be: where the scan is, and of each delay where it is nearly so."""
    place, h, found = log.layout.at_delays, log.recording.step, []
    if np.abs(scan.theta[place] - best.theta[place]).max() >= h:
        found.append(scan.moved(best.theta))
    for row, curve in enumerate(scan.curves):
        D = (scan.first + np.arange(curve.size) - 0.5) * h
        near = (curve > curve.max() - _NEARLY) & (np.abs(D - best.theta[place][row]) > 1.5 * h)
        if near.any():
            theta = best.theta.copy()
            theta[place.start + row] = D[near][curve[near].argmax()]
            found.append(theta)
    return found


def of_sensors(log: NoisyLog, vector: np.ndarray) -> np.ndarray:
    """A vector's plant, as if all that it cannot foretell were noise of the sensors.

    A climb does not come back by itself from a sensor without noise.
    """
    e, _ = log.innovations(vector, log.starts(*log.bounds))
    changed, (i, j) = vector.copy(), log.places
    L = slice(log.layout.size, log.layout.size + i.size)
    less = np.sqrt(_LESS)
    changed[L] = np.where(i == j, vector[L] + np.log(less), less * vector[L])
    error = np.sqrt(np.mean(e**2, axis=0))
    changed[L.stop :] = np.log(np.maximum(error, np.finfo(float).tiny))
    return changed


def _climbed(log: NoisyLog, vector: np.ndarray) -> Maximum:
    """The maximum that a vector leads to, over the whole range of delays."""
    return maximise(log, vector, window=log.bounds, gain=_GAIN)[0]
