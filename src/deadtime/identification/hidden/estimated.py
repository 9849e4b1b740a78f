"""The estimate of a plant whose modes were hidden, with intervals that count that in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.identification.delay_intervals import delay_intervals
from deadtime.identification.estimate import Estimate
from deadtime.identification.hidden.choice import Begun, Fitted
from deadtime.identification.hidden.hidden_information import Information, information_of
from deadtime.identification.hidden.hidden_modes import HiddenModes
from deadtime.identification.hidden.noisy_choice import NoisyFit
from deadtime.identification.hidden.regressions import scanned
from deadtime.identification.intervals import spread_of
from deadtime.identification.likelihoods.hidden_log import HiddenLog
from deadtime.identification.likelihoods.mode_periods import EvenPeriods
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy.noise import continuous, intensity_errors
from deadtime.identification.parameters import Layout
from deadtime.identification.residuals import judge_residuals, residuals_of
from deadtime.identification.scoring import Maximum
from deadtime.identification.start import Start


class Decoded(NamedTuple):
    """A likelihood and unknowns whose modes are in the order of the path, and that path.

    log.recording : with the path as its modes; theta, cells : unknowns, and cells of the delays
    grid : the likelihood on a grid
    """

    fit: Fitted
    log: HiddenLog
    theta: Float[np.ndarray, " size"]
    cells: Int[np.ndarray, " delay"]
    grid: HiddenLog


class Said(NamedTuple):
    """Of the modes: how likely each was, their chain, the way up, and how much intervals widen."""

    node: list[Float[np.ndarray, "sample mode"]]
    chain: Float[np.ndarray, "mode mode"]
    values: Float[np.ndarray, " step"]
    widening: float


def decoded(fit: Fitted) -> Decoded:
    """The likeliest path, modes in the order in which it visits them.

    Raises
    ------
    ArgumentError
        If it leaves a mode out.
    """
    log, theta, layout = fit.ascent.log, fit.ascent.theta, fit.layout
    recording = log.recording
    paths = log.path(theta, log.cells(theta))
    order, record = ordered_by_path(paths, recording, layout)
    A, B, D = layout.split(theta)
    theta = layout.join(A[order], B[order], D[order])
    log = replace(log, recording=record, S=log.S[order], jumps=log.jumps.ordered(order))
    grid = replace(fit.grid, S=fit.grid.S[order], jumps=fit.grid.jumps.ordered(order))
    return Decoded(fit, log, theta, log.cells(theta), grid)


def ordered_by_path(
    paths: list[Int[np.ndarray, " sample"]], recording: Recording, layout: Layout
) -> tuple[Int[np.ndarray, " mode"], Recording]:
    """Modes in the order in which paths visit them, and the recording with these as its modes.

    Raises
    ------
    ArgumentError
        If the paths leave a mode out.
    """
    seen, first = np.unique(np.concatenate(paths), return_index=True)
    if seen.size < layout.modes:
        raise ArgumentError(
            f"modes = {layout.modes} is too many for this log: its likeliest path has only "
            f"{seen.size} of them: ask for fewer, or log for longer."
        )
    order = seen[np.argsort(first)]
    back = np.argsort(order)
    each = zip(recording.parts, paths, strict=True)
    parts = tuple(part._replace(mode=back[path]) for part, path in each)
    return order, recording._replace(parts=parts, modes=tuple(map(str, range(layout.modes))))


def estimated(found: Decoded) -> tuple[Estimate, Said]:
    """The estimate, and what there is to say of the modes."""
    _, log, theta, cells, grid = found
    layout, record = log.layout, log.recording
    posterior = log.posterior(theta, cells)
    best = Maximum(theta, log.evaluate(theta, cells), np.zeros(theta.size, bool))
    told = information_of(log, theta, cells)
    counts = posterior.weight.sum(axis=0)
    spare = np.maximum(counts - layout.n - layout.m - 1, 1.0)
    share = np.sqrt(layout.of_each(spare) / layout.of_each(counts))
    known = told.left * share[:, None] * share
    spread = spread_of(told.held, layout.names(), known, layout.of_each(spare))
    start = start_of_grid(grid, theta)
    window = log.window
    intervals, several = delay_intervals(log, best, window, spread, start)
    plant = layout.plant(theta)
    covariances = log.S * (counts / spare)[:, None, None]
    roots = np.linalg.cholesky(covariances)
    white = residuals_of(record, plant, layout.constant_of(theta), log.nodes, log.within, roots)
    for one, k in zip(white, log.periods.usable, strict=True):
        one[np.setdiff1d(np.arange(len(one)), k + 1)] = np.nan  # nothing told their modes
    W = continuous(plant.A, covariances, record.step)
    free = np.maximum(spare * told.of_noise, 1.0).astype(np.int64)
    estimate = Estimate(
        log=log,
        best=best,
        window=window,
        plant=plant,
        spread=spread,
        intervals=intervals,
        several=several,
        start=start,
        disturbance=W,
        noise=np.zeros(layout.n),
        noise_errors=intensity_errors(plant.A, W, record.step, free),
        spare=free,
        tests=judge_residuals(white, record, plant.longest_delay),
        white=tuple(white),
    )
    said = Said(posterior.node, log.jumps.chain, found.fit.ascent.values, widening_of(told))
    return estimate, said


def start_of_grid(grid: HiddenLog, theta: Float[np.ndarray, " size"]) -> Start:
    """What other cells of the delays would be like: other peaks may lie far from those found."""
    whole, cells, layout = grid.over(*grid.bounds), grid.cells(theta), grid.layout
    periods, weight = whole.periods, whole.posterior(theta, cells).weight
    if not isinstance(periods, EvenPeriods):
        raise ArgumentError("grid must be even.")
    _, curves = scanned(periods, weight, layout.spread(cells), layout)
    return Start(theta, cells, periods.first, curves, 2 * layout.n)


def widening_of(told: Information) -> float:
    """How many times longer than with known modes the longest interval is."""
    errors = [np.diagonal(np.linalg.inv(F)) for F in (told.left, told.known)]
    return float(np.sqrt((errors[0] / errors[1]).max()))


def hidden_modes(
    fits: Sequence[Fitted] | Sequence[NoisyFit],
    best: Fitted | Begun,
    recording: Recording,
    said: Said,
) -> HiddenModes:
    """What there is to say of the modes; `fits` are those of all numbers tried."""
    return HiddenModes(
        np.concatenate([part.time for part in recording.parts]),
        np.concatenate([part.mode for part in recording.parts]),
        np.vstack(said.node),
        said.chain,
        np.array([one.layout.modes for one in fits]),
        np.array([one.bic for one in fits]),
        said.values,
        best.starts,
        best.agreed,
        said.widening,
    )
