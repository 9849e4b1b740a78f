"""Expectation–maximisation where modes are hidden: over linear regressions, then over the plant.

**Regressions.** With the cell N of every delay given, each mode is a weighted regression x_{k+1} =
P_i r_k + e with a known maximum; P, S and the chain are free. Cells are found by a scan.

Starts are regressions over short stretches of the log. Modes last, so most stretches of a few dozen
periods have one mode. Each stretch has its own regression; the cells in which these fit best
together are taken for the delays. Then one stretch per mode is drawn, each from the stretches that
the ones before fit badly (the seeding of k-means++: Arthur and Vassilvitskii, SODA 2007).

**The plant**, with delays at any fraction of a period. Each step maximises the expected likelihood
with known modes over A, B and D, with S from the weighted residuals. It never lowers the likelihood
of the log (Dempster, Laird and Rubin, J. Royal Statistical Society B 39(1), 1977).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.likelihoods.hidden_chain import Jumps, Periods, Posterior
from deadtime.identification.likelihoods.hidden_log import HiddenLog
from deadtime.identification.likelihoods.likelihood import (
    concentrated,
    floored,
    log_density,
    maximise,
    rooted,
    window_of,
)
from deadtime.identification.parameters import Layout, ModeCells, Square, Squares, Vector
from deadtime.identification.scoring import STEPS, best_in_turn

_MOST = 150  # stretches
_PURE = (0.4, 0.8)  # shares of the best fitting stretches, one of which is drawn from
_FAR = 25.0  # squared deviation per state beyond which weights of the draw are equal
_WIDE = 4.0  # factor of the covariance of a stretch, since its regression has few periods
_LEAST = 1e-6  # share of the covariance of all rows added to a start: without noise it is regular
_SWEEPS = 3  # over the delays, in a scan

# Runs of usable periods that follow each other, as places of rows.
Runs = Int[np.ndarray, "stretch period"]


def stretches_of(periods: Periods, layout: Layout, short: bool = False) -> Runs | None:
    """Half overlapping stretches spread over the log, at most 150; None if fewer than modes.

    Short ones have few periods more than a regression needs, and more often a single mode.
    """
    columns = layout.n + periods.sampling.lags * layout.m + layout.constant
    length = (1 if short else 2) * columns + layout.n + 2
    places, start = [], 0
    for k in periods.usable:
        runs = np.split(np.arange(k.size), np.flatnonzero(np.diff(k) != 1) + 1)
        for run in runs:
            firsts = np.arange(0, run.size - length + 1, length // 2)
            places += [start + run[0] + first for first in firsts]
        start += k.size
    if len(places) < layout.modes:
        return None
    chosen = np.linspace(0, len(places) - 1, min(len(places), _MOST)).round().astype(int)
    return np.array(places)[chosen, None] + np.arange(length)


def first_cells(periods: Periods, stretches: Runs, layout: Layout) -> Int[np.ndarray, " m"]:
    """The cells with the largest likelihood of separate regressions, inputs in turn, twice."""
    n, constant = layout.n, np.ones(int(layout.constant), bool)

    def likelihood(*cells: int | None) -> float:
        """Of all stretches, without the inputs that have no cell yet."""
        z = periods.rows(np.array([periods.cells[0] if c is None else c for c in cells]))
        known = np.array([c is not None for c in cells])
        of_inputs = np.tile(known, periods.sampling.lags)
        keep = np.concatenate((np.ones(2 * n, bool), of_inputs, constant))
        return float(-_own_covariances(z[:, keep][stretches], n)[1].sum())

    each = np.vectorize(likelihood, otypes=[float])
    return np.array(best_in_turn((None,) * layout.m, periods.cells.tolist(), each, 2))


def _own_covariances(
    z: Float[np.ndarray, "stretch period z"], n: int
) -> tuple[np.ndarray, np.ndarray]:
    """The residuals' covariance of each stretch under a regression of its own, and its log det."""
    turned = np.concatenate((z[..., n:], z[..., :n]), axis=-1)
    scale = np.maximum(np.sqrt((turned**2).mean(axis=(0, 1))), 1e-300)
    whole = np.asarray(np.linalg.qr(turned / scale, mode="r"))
    R = whole[:, -n:, -n:] * scale[-n:]
    spare = z.shape[1] - (z.shape[2] - n)
    S = R.transpose(0, 2, 1) @ R / spare
    pivots = np.diagonal(R, axis1=1, axis2=2) ** 2 / spare + 1e-24 * scale[-n:] ** 2
    return S, np.log(np.maximum(pivots, np.finfo(float).tiny)).sum(axis=1)


def draw_start(
    periods: Periods,
    stretches: Runs,
    cells: Int[np.ndarray, " m"],
    layout: Layout,
    rng: np.random.Generator,
) -> Regressions:
    """Regressions over random stretches, with one covariance for all modes.

    The share of stretches to draw from is random, too: with short or noisy modes few fit well.
    """
    n, modes = layout.n, layout.modes
    z = periods.rows(cells)[stretches]
    S, size = _own_covariances(z, n)
    pure = np.flatnonzero(size <= np.quantile(size, rng.choice(_PURE)))
    flat = z.reshape(-1, z.shape[2])
    _, whole = regression_of(rooted(flat, np.ones(len(flat))), n, float(len(flat)))
    # The mean of the better half: entrywise medians need not form a covariance.
    best = pure[size[pure] <= np.median(size[pure])]
    shared = S[best].mean(axis=0) + _LEAST * whole
    white = np.linalg.inv(np.linalg.cholesky(shared))
    P, off = [], np.full(pure.size, np.inf)
    for _ in range(modes):
        chance = np.ones(pure.size) if not P else np.minimum(off, _FAR) + 1e-12
        own = z[pure[rng.choice(pure.size, p=chance / chance.sum())]]
        P.append(np.linalg.lstsq(own[:, n:], own[:, :n], rcond=1e-13)[0].T)
        e = (z[pure, :, :n] - z[pure, :, n:] @ P[-1].T) @ white.T
        off = np.minimum(off, (e**2).mean(axis=(1, 2)))
    count = np.full(modes, periods.count / modes)
    every, jumps = np.tile(_WIDE * shared, (modes, 1, 1)), Jumps.lasting(modes, 1.0, rates=False)
    return Regressions(np.array(P), every, jumps, np.tile(cells, (modes, 1)), count)


class Regressions(NamedTuple):
    """One regression per mode, P (modes, n, r) and S (modes, n, n), and the chain between them.

    cells : (modes, m); weight : (modes,), expected numbers of periods
    """

    P: Float[np.ndarray, "mode n r"]
    S: Squares
    jumps: Jumps
    cells: ModeCells
    weight: Float[np.ndarray, " mode"]


def regression_of(
    root: Float[np.ndarray, "z z"], n: int, total: float
) -> tuple[Float[np.ndarray, "n r"], Square]:
    """P and the residuals' covariance of weighted rows (x_{k+1}, r_k), of weight `total`."""
    y, r = root[:, :n], root[:, n:]
    unit = np.maximum(np.sqrt((r**2).sum(axis=0)), 1e-300)
    P = np.linalg.lstsq(r / unit, y, rcond=1e-13)[0].T / unit
    e = y - r @ P.T
    return P, floored(e.T @ e / total, P[:, : y.shape[1]], y, total)


def _expectation_step(periods: Periods, model: Regressions, rows: list[np.ndarray]) -> Posterior:
    """The posterior of modes given regressions."""
    each = zip(rows, model.P, model.S, strict=True)
    return periods.posterior(
        np.column_stack([log_density(z, *one) for z, *one in each]), model.jumps
    )


def maximisation_step(
    rows: list[np.ndarray], posterior: Posterior, model: Regressions, cells: ModeCells, common: bool
) -> Regressions:
    """The likeliest regressions given the posterior of modes; `common`: with one S for all."""
    count, n = posterior.weight.sum(axis=0), model.P.shape[1]
    P, S = [], []
    for z, weight, total in zip(rows, posterior.weight.T, count, strict=True):
        one = regression_of(rooted(z, weight), n, max(float(total), 1e-300))
        P.append(one[0])
        S.append(one[1])
    S = np.array(S)
    if common:
        S[:] = np.tensordot(count / count.sum(), S, axes=1)
    return Regressions(np.array(P), S, model.jumps.next(posterior.counts), cells, count)


def climb_regressions(
    periods: Periods, model: Regressions, steps: int, least: float, common: bool, gain: float
) -> tuple[Regressions, Posterior] | None:
    """The regressions after some steps; None if a mode has fewer periods than `least`."""
    rows, before = periods.rows_of_modes(model.cells), -np.inf
    posterior = _expectation_step(periods, model, rows)
    for _ in range(steps):
        if posterior.weight.sum(axis=0).min() < least:
            return None
        model = maximisation_step(rows, posterior, model, model.cells, common)
        posterior = _expectation_step(periods, model, rows)
        if posterior.value - before < gain:
            break
        before = posterior.value
    return model, posterior


def scan_cells(
    periods: Periods, weight: Float[np.ndarray, "period mode"], cells: ModeCells, layout: Layout
) -> tuple[ModeCells, Float[np.ndarray, "delay cell"]]:
    """The likeliest cells with given weights of modes, and the log likelihood of all cells.

    Delays are scanned in turn, with the others in their cells.
    """
    options, count = periods.cells, weight.sum(axis=0)
    groups = [[i] for i in range(layout.modes)] if layout.per_mode else [list(range(layout.modes))]
    cells = cells.copy()

    def likelihood(i: int, own: np.ndarray) -> float:
        root = rooted(periods.rows(own), weight[:, i])
        _, S = regression_of(root, layout.n, float(count[i]))
        return -0.5 * float(count[i]) * float(np.linalg.slogdet(S)[1])

    curves = np.empty((len(groups), layout.m, options.size))
    for _ in range(_SWEEPS):
        before = cells.copy()
        for row, group in enumerate(groups):
            for j in range(layout.m):
                for place, option in enumerate(options):
                    own = cells[group[0]].copy()
                    own[j] = option
                    curves[row, j, place] = sum(likelihood(i, own) for i in group)
                cells[group, j] = options[int(curves[row, j].argmax())]
        if (cells == before).all():
            break
    return cells, curves.reshape(-1, options.size)


_GAIN = 1e-6  # rise of log likelihood that ends the climb
_STEPS = 400
_FEW = 4  # scoring steps per step of expectation–maximisation, where each reads all of the log


class Ascent(NamedTuple):
    """The maximum reached: the likelihood with its S and P, and the unknowns.

    values : log likelihood after every step; posterior : of modes, at the end
    """

    log: HiddenLog
    theta: Vector
    values: Float[np.ndarray, " step"]
    posterior: Posterior


def maximise_plant(
    log: HiddenLog, theta: Vector, least: float, posterior: Posterior | None = None
) -> Ascent | None:
    """The maximum near a start; None if a mode is left with fewer periods than `least`.

    The first step uses `posterior`, by default that of the log's own S and P. The plant is only
    near the regressions it starts from: with the small S of theirs, no period would be assigned to
    a mode.
    """
    values = []
    if posterior is None:
        posterior = log.posterior(theta, log.cells(theta))
        values.append(posterior.value)
    for _ in range(_STEPS):
        if posterior.weight.sum(axis=0).min() < least:
            return None
        known, near = log.known(posterior.weight), window_of(log, theta[log.layout.at_delays])
        window = max(log.window[0], near[0]), min(log.window[1], near[1])
        steps = STEPS if log.sampling.summed_up else _FEW  # any rise suffices
        theta = maximise(known, theta, window=window, steps=steps)[0].theta
        terms = known.terms_in(*window)(log.cells(theta))(theta)
        S = concentrated(terms, log.layout.size)[1]
        log = replace(log, S=S, jumps=log.jumps.next(posterior.counts))
        posterior = log.posterior(theta, log.cells(theta))
        values.append(posterior.value)
        if len(values) > 1 and values[-1] - values[-2] < _GAIN:
            break
    return Ascent(log, theta, np.array(values), posterior)
