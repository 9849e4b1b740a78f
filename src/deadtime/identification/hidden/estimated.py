"""The estimate of a plant whose modes were hidden, with intervals that count that in."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.identification.estimate import Estimate
from deadtime.identification.hidden.choice import Fitted
from deadtime.identification.hidden.found import HiddenModes
from deadtime.identification.hidden.information import Information, information_of
from deadtime.identification.hidden.likelihood import HiddenLog
from deadtime.identification.hidden.regressions import scanned
from deadtime.identification.intervals import delay_intervals, spread_of
from deadtime.identification.noise import continuous
from deadtime.identification.recording import Recording
from deadtime.identification.residuals import judge_residuals, residuals_of
from deadtime.identification.scoring import Maximum
from deadtime.identification.start import Start
from deadtime.plant import SwitchedSystem


class Decoded(NamedTuple):
    """A likelihood and unknowns whose modes are in the order of the path, and that path.

    log.recording : with the path as its modes; theta, cells : unknowns, and cells of the delays
    grid : the likelihood on a grid
    """

    log: HiddenLog
    theta: Float[np.ndarray, " size"]
    cells: Int[np.ndarray, " delay"]
    grid: HiddenLog


def decoded(fit: Fitted, recording: Recording) -> Decoded:
    """The likeliest path, modes in the order in which it visits them.

    Raises
    ------
    ArgumentError
        If it leaves a mode out.
    """
    log, theta, layout = fit.ascent.log, fit.ascent.theta, fit.layout
    paths = log.path(theta, log.cells(theta))
    seen, first = np.unique(np.concatenate(paths), return_index=True)
    if seen.size < layout.modes:
        raise ArgumentError(
            f"modes = {layout.modes} is too many for this log: its likeliest path has only "
            f"{seen.size} of them: ask for fewer, or log for longer."
        )
    order = seen[np.argsort(first)]
    back = np.argsort(order)
    parts = tuple(
        part._replace(mode=back[path]) for part, path in zip(recording.parts, paths, strict=True)
    )
    names = tuple(map(str, range(layout.modes)))
    record = recording._replace(parts=parts, modes=names)
    A, B, D = layout.split(theta)
    theta = layout.join(A[order], B[order], D[order])
    log = replace(log, recording=record, S=log.S[order], jumps=log.jumps.ordered(order))
    grid = replace(fit.grid, S=fit.grid.S[order], jumps=fit.grid.jumps.ordered(order))
    return Decoded(log, theta, log.cells(theta), grid)


def estimated(found: Decoded) -> tuple[Estimate, Information]:
    """The estimate, and what not knowing the modes takes from the information."""
    log, theta, cells, grid = found
    layout, record = log.layout, log.recording
    posterior = log.posterior(theta, cells)
    best = Maximum(theta, log.evaluate(theta, cells), np.zeros(theta.size, bool))
    told = information_of(log, theta, cells)
    counts = posterior.weight.sum(axis=0)
    spare = np.maximum(counts - layout.n - layout.m - 1, 1.0)
    share = np.sqrt(layout.of_each(spare) / layout.of_each(counts))
    known = told.left * share[:, None] * share
    spread = spread_of(told.held, layout.names(), known, layout.of_each(spare))
    whole = grid.over(*log.bounds)  # other peaks may lie far from the delays found
    weight = whole.posterior(theta, cells).weight
    _, curves = scanned(whole.periods, weight, layout.spread(cells), layout)
    start = Start(theta, cells, whole.periods.first, curves)
    A, B, delays = layout.split(theta)
    window = log.window
    intervals, several = delay_intervals(log, best, window, spread, start)
    plant = SwitchedSystem(A, B, delays)
    covariances = log.S * (counts / spare)[:, None, None]
    roots = np.linalg.cholesky(covariances)
    white = residuals_of(record, plant, log.nodes, log.within, roots)
    for one, k in zip(white, log.periods.usable, strict=True):
        one[np.setdiff1d(np.arange(len(one)), k + 1)] = np.nan  # nothing told their modes
    estimate = Estimate(
        log,
        best,
        window,
        plant,
        spread,
        intervals,
        several,
        start,
        continuous(A, covariances, record.step),
        np.zeros(layout.n),
        spare.astype(np.int64),
        judge_residuals(white, record, float(delays.max())),
        tuple(white),
    )
    return estimate, told


def hidden_modes(fit: Fitted, fits: list[Fitted], found: Decoded, told: Information) -> HiddenModes:
    """What there is to say of the modes; `fits` are those of all numbers tried."""
    log, theta, cells, _ = found
    posterior, parts = log.posterior(theta, cells), log.recording.parts
    errors = [np.diagonal(np.linalg.inv(F)) for F in (told.left, told.known)]
    return HiddenModes(
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.mode for part in parts]),
        np.vstack(posterior.node),
        log.jumps.chain,
        np.array([one.layout.modes for one in fits]),
        np.array([one.bic for one in fits]),
        fit.ascent.values,
        fit.starts,
        fit.agreed,
        float(np.sqrt((errors[0] / errors[1]).max())),
    )
