"""Estimates of plants with hidden modes, whose intervals include the uncertainty of the modes.

The information is the one of the log, instead of the one with known modes. With exact states the
score in all unknowns, θ, S and P, follows from Fisher's identity, and the observed information is
minus its derivative, by central differences, equal to Louis' formula (J. Royal Statistical Society
B 44(2), 1982). S and P are estimated, too, so the information on θ is the Schur complement

    J = J_θθ − J_θη J_ηη⁻¹ J_ηθ,    η: M of S = L M Lᵀ at M = I, and the log odds of P.

With noisy sensors, of the vector θ of plant and noise and the odds η of the chain, J is minus the
second differences of the log likelihood. The Schur complement is bounded by the information of the
filter with the modes of the likeliest path.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.identification.estimate import Estimate
from deadtime.identification.exact_estimate import estimate_of_plant
from deadtime.identification.expectation_maximisation import scan_cells
from deadtime.identification.hidden_fit import HiddenFit, Log
from deadtime.identification.intervals import Peak, left_of, spread_of
from deadtime.identification.likelihoods.hidden_log import HiddenLog, HiddenNoisyLog
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy_estimate import estimate_of_sensors
from deadtime.identification.parameters import Cells, FisherMatrix, Vector, Window
from deadtime.identification.scoring import Maximum
from deadtime.identification.start import Start

_FAINT = 1e-8  # relative eigenvalue of information that is lost in differences
_SMALL = 1e-3  # step of first differences, in standard errors
_NEVER = 1e-6  # least probability of a jump whose odds are estimated
_ROUND_OFF = 1e-12  # step relative to the unknowns that is lost in round-off
_CERTAIN = 1e-6  # Σ γ (1 − γ) below which modes count as known
_LEAST = 1e-4  # least share of the information with known modes, in every direction


class Information(NamedTuple):
    """Information on θ: with S and P fixed, with S and P estimated, and with known modes.

    of_noise : (modes,), the least share that remains of the information on S's diagonal
    """

    fixed: FisherMatrix
    left: FisherMatrix
    known: FisherMatrix
    of_noise: Float[np.ndarray, " mode"]

    @property
    def widening(self) -> float:
        """The largest ratio of an interval to the interval with known modes."""
        errors = [np.diagonal(np.linalg.inv(F)) for F in (self.left, self.known)]
        return float(np.sqrt((errors[0] / errors[1]).max()))


class _Noise:
    """The vector η at S and P of a likelihood: M, and the logarithms of odds."""

    def __init__(self, log: HiddenLog) -> None:
        self.log, n = log, log.layout.n
        self.i, self.j = np.tril_indices(n)
        self.L = np.linalg.cholesky(log.S)
        self.jumps = log.jumps.likelier(_NEVER)

    def at(self, eta: np.ndarray) -> HiddenLog:
        """The likelihood with S and P of η."""
        cut = len(self.L) * self.i.size
        M = np.tile(np.eye(self.L.shape[1]), (len(self.L), 1, 1))
        shift = eta[:cut].reshape(len(self.L), -1)
        M[:, self.i, self.j] += shift
        M[:, self.j, self.i] += np.where(self.i == self.j, 0.0, shift)
        odds = np.ones(self.log.jumps.matrix.shape)
        for (i, j), change in zip(self.jumps, eta[cut:], strict=True):
            odds[i, j] = np.exp(change)
        S = self.L @ M @ self.L.transpose(0, 2, 1)
        return replace(self.log, S=S, jumps=self.log.jumps.scaled(odds))

    @property
    def known(self) -> Float[np.ndarray, "M M"]:
        """The information on M per period with known modes."""
        return np.diag(np.where(self.i == self.j, 0.5, 1.0))

    def shares(
        self, J: Float[np.ndarray, "M M"], counts: Float[np.ndarray, " mode"]
    ) -> Float[np.ndarray, " mode"]:
        """The least share over a of the information on log S_aa that remains, in each mode."""
        known = np.kron(np.diag(counts), self.known)
        covariance, own = np.linalg.inv(clipped(J, known)), self.i.size
        shares = np.empty(len(self.L))
        for mode, L in enumerate(self.L):
            twice = np.where(self.i == self.j, 1.0, 2.0)
            slope = twice * L[:, self.i] * L[:, self.j] / (L**2).sum(axis=1)[:, None]
            at = slice(mode * own, (mode + 1) * own)
            spread = np.einsum("as,st,at->a", slope, covariance[at, at], slope)
            shares[mode] = (2.0 / counts[mode] / spread).min()
        return shares

    def score(self, theta: np.ndarray, eta: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """The score in θ and η."""
        log = self.at(eta)
        n, parts = log.layout.n, [log.evaluate(theta, cells).score]
        terms, posterior = log.weighted(theta, cells)
        for term, L, S in zip(terms, self.L, log.S, strict=True):
            e = np.linalg.solve(L, (term.root[:, :n] - term.root[:, n:] @ term.P.T).T)
            back = np.linalg.inv(np.linalg.solve(L, np.linalg.solve(L, S).T))
            total = posterior.weight[:, len(parts) - 1].sum()
            slope = 0.5 * (back @ (e @ e.T) @ back - total * back)
            twice = np.where(self.i == self.j, 1.0, 2.0)
            parts.append(twice * slope[self.i, self.j])
        leave = log.jumps.slope(posterior.counts)
        return np.concatenate((*parts, [leave[i, j] for i, j in self.jumps]))


def information_of(log: HiddenLog, theta: Vector, cells: Cells) -> Information:
    """The information on θ at the maximum, delays within their cells."""
    noise, known = _Noise(log), log.evaluate(theta, cells).information
    weight = log.posterior(theta, cells).weight
    unit = 1.0 / np.sqrt(np.maximum(np.diagonal(known), 1e-300))
    coarse = (_SMALL * unit).min() < _ROUND_OFF * np.abs(theta).max()
    coarse |= np.linalg.eigvalsh(known * unit * unit[:, None])[0] < _FAINT
    if coarse or (weight * (1.0 - weight)).sum() < _CERTAIN:
        # Without noise the steps are below round-off; known modes lose no information.
        return Information(known, known, known, np.ones(log.layout.modes))
    of_S = np.repeat(1.0 / np.sqrt(weight.sum(axis=0)), noise.i.size)
    steps = _SMALL * np.concatenate((unit, of_S, np.full(len(noise.jumps), 0.3)))
    size = theta.size
    J = np.empty((steps.size, steps.size))
    for a, step in enumerate(steps):
        moved = np.zeros(steps.size)
        moved[a] = step
        up = noise.score(theta + moved[:size], moved[size:], cells)
        down = noise.score(theta - moved[:size], -moved[size:], cells)
        J[a] = (down - up) / (2.0 * step)
    J = 0.5 * (J + J.T)
    of_noise = left_of(J, np.arange(size, steps.size - len(noise.jumps)))
    return _information(J, known, noise.shares(of_noise, weight.sum(axis=0)))


def _information(
    J: np.ndarray, known: FisherMatrix, of_noise: Float[np.ndarray, " mode"]
) -> Information:
    """From J of θ and η, and the information on θ with known modes."""
    size = len(known)
    left = clipped(left_of(J, np.arange(size)), known)
    return Information(clipped(J[:size, :size], known), left, known, of_noise)


def clipped(J: np.ndarray, known: np.ndarray) -> np.ndarray:
    """J clipped to shares between `_LEAST` and 1 of the information with known modes.

    Shares above 1 are errors of differences or of a single log.
    """
    unit = np.sqrt(np.maximum(np.diagonal(known), 1e-300))
    try:
        L = np.linalg.cholesky(known / unit / unit[:, None])
    except np.linalg.LinAlgError:
        return known  # singular: `require_identified` refuses it and names the direction
    inner = np.linalg.solve(L, np.linalg.solve(L, J / unit / unit[:, None]).T)
    values, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    whole = L @ (vectors * np.clip(values, _LEAST, 1.0)) @ vectors.T @ L.T
    return whole * unit * unit[:, None]


_BROAD = 0.1  # step of second differences, in standard errors
_VAGUE = 1e-2  # information added on the logarithm of a noise: its standard error is at most 10
_ODDS = 0.03  # step of the logarithm of a jump's odds
_SELDOM = 1e-4  # least probability of a jump whose odds are estimated


@dataclass(frozen=True, eq=False)
class DecodedFit(Generic[Log]):
    """A fit with modes in the order of its likeliest path, and the recording with that path.

    order : the fit's number of each mode; theta : the reordered vector
    """

    fit: HiddenFit[Log]
    log: Log
    theta: Vector
    order: Int[np.ndarray, " mode"]
    recording: Recording


class ModesEstimate(NamedTuple):
    """An estimate, the probability of each mode in every row, and `Information.widening`."""

    estimate: Estimate
    node: list[Float[np.ndarray, "sample mode"]]
    widening: float


def decode(fit: HiddenFit[Log]) -> DecodedFit[Log]:
    """The likeliest path of a fit, modes numbered by first visit; refused if it misses a mode."""
    layout, recording = fit.layout, fit.log.recording
    paths = fit.log.path(fit.theta, fit.window)
    visited, first = np.unique(np.concatenate(paths), return_index=True)
    if visited.size < layout.modes:
        raise ArgumentError(
            f"modes = {layout.modes} is too many for this log: its likeliest path has only "
            f"{visited.size} of them: ask for fewer, or log for longer."
        )
    order = visited[np.argsort(first)]
    number = np.argsort(order)
    each = zip(recording.parts, paths, strict=True)
    parts = tuple(part._replace(mode=number[path]) for part, path in each)
    record = recording._replace(parts=parts, modes=tuple(map(str, range(layout.modes))))
    return DecodedFit(fit, fit.log.ordered(order), layout.ordered(fit.theta, order), order, record)


def estimate_hidden(decoded: DecodedFit[HiddenLog]) -> ModesEstimate:
    """The estimate with exact states."""
    log, theta = decoded.log, decoded.theta
    layout, cells, window = log.layout, log.cells(theta), decoded.fit.window
    posterior, now = log.posterior(theta, cells), log.evaluate(theta, cells)
    best = Maximum(theta, now.value, now.information, np.zeros(theta.size, bool))
    information = information_of(log, theta, cells)
    counts = posterior.weight.sum(axis=0)
    spare = np.maximum(counts - layout.n - layout.m - 1, 1.0)
    share = np.sqrt(layout.of_each(spare) / layout.of_each(counts))
    known = information.left * share[:, None] * share
    spread = spread_of(information.fixed, layout.names(), known, layout.of_each(spare))
    peak = Peak(log=log, best=best, window=window, spread=spread, start=_delay_scan(decoded))
    S = log.S * (counts / spare)[:, None, None]
    free = np.maximum(spare * information.of_noise, 1.0).astype(np.int64)
    estimate = estimate_of_plant(peak, S, free, decoded.recording, usable=log.periods.usable)
    return ModesEstimate(estimate, posterior.node, information.widening)


def estimate_hidden_noisy(decoded: DecodedFit[HiddenNoisyLog]) -> ModesEstimate:
    """The estimate with noisy sensors."""
    log, theta, record = decoded.log, decoded.theta, decoded.recording
    layout, window, cells = log.layout, decoded.fit.window, log.cells(theta)
    path, starts = log.along(record), log.starts(*window)
    of_path = path.evaluate_in(*window)(cells)(theta)
    path = replace(path, within=log.within)
    information = _by_differences(log, theta, window, of_path.information + _vague(log))
    observations = sum(int(np.isfinite(part.output).sum()) for part in record.parts)
    spare = max(observations - theta.size, 1)
    every = np.full(theta.size, float(spare))
    left = information.left * (spare / observations)
    spread = spread_of(information.fixed, layout.names(), left, every)
    value, still = log.value(theta, starts, cells), np.zeros(theta.size, bool)
    best = Maximum(theta, value, information.fixed, still)
    posterior = log.posterior(theta, starts)
    rows = np.maximum(np.vstack(posterior.node).sum(axis=0), 1.0).astype(np.int64)
    peak = Peak(log=log, best=best, window=window, spread=spread, start=_delay_scan(decoded))
    estimate = estimate_of_sensors(peak, theta, path, rows)
    return ModesEstimate(estimate, posterior.node, information.widening)


def _delay_scan(decoded: DecodedFit) -> Start:
    """A scan of the delays' other cells, where other peaks may lie."""
    start, layout = decoded.fit.start, decoded.fit.layout
    whole = start.log.over(*start.log.bounds)
    cells = start.log.cells(start.theta)
    weight = whole.posterior(start.theta, cells).weight
    _, curves = scan_cells(whole.periods, weight, layout.spread(cells), start.log.layout)
    if layout.per_mode:
        curves = curves.reshape(layout.modes, layout.m, -1)[decoded.order].reshape(curves.shape)
    theta, first = decoded.theta[: decoded.log.layout.size], int(whole.periods.cells[0])
    return Start(
        theta, decoded.log.cells(theta), first, curves, decoded.log.sampling.lags * layout.n
    )


def _by_differences(
    log: HiddenNoisyLog, theta: Vector, window: Window, known: FisherMatrix
) -> Information:
    """Information on the vector, by second differences of the log likelihood."""
    jumps, size, vague = log.jumps.likelier(_SELDOM), theta.size, _vague(log)
    starts, cells = log.starts(*window), log.cells(theta)
    unit = _BROAD * np.minimum(1.0 / np.sqrt(np.maximum(np.diagonal(known), 1e-300)), log.most)
    steps = np.diag(np.concatenate((unit, np.full(len(jumps), _ODDS))))

    def value(moved: np.ndarray) -> float:
        odds = np.ones(log.jumps.matrix.shape)
        odds[tuple(jumps.T)] = np.exp(moved[size:])
        shifted = log if not moved[size:].any() else replace(log, jumps=log.jumps.scaled(odds))
        return shifted.value(theta + moved[:size], starts, cells)

    top, ends = value(np.zeros(len(steps))), [[value(s * e) for e in steps] for s in (1, -1)]
    single, J = np.array(ends).sum(axis=0) - 2.0 * top, np.empty(steps.shape)
    for a in range(len(steps)):
        J[a, a] = -single[a]
        for b in range(a):
            both = steps[a] + steps[b]
            twice = value(both) + value(-both) - 2.0 * top
            J[a, b] = J[b, a] = -0.5 * (twice - single[a] - single[b])
    scale = np.diagonal(steps)
    J = J / scale / scale[:, None]
    J[:size, :size] += vague
    return _information(J, known, np.ones(log.layout.modes))


def _vague(log: HiddenNoisyLog) -> FisherMatrix:
    """A little information on the noise, which keeps that of unidentified noise regular."""
    return np.diag(_VAGUE / log.most**2)
