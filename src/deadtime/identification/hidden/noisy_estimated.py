"""The estimate where modes were hidden and sensors are noisy, with intervals that count both in.

Of the vector θ of plant and noise and the odds η of the chain, J is minus the second differences of
the log likelihood; J_θθ − J_θη J_ηη⁻¹ J_ηθ is left, at most what the filter of logged modes would
give along the likeliest path.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.delay_intervals import delay_intervals
from deadtime.identification.estimate import Estimate
from deadtime.identification.hidden.estimated import (
    Said,
    ordered_by_path,
    start_of_grid,
    widening_of,
)
from deadtime.identification.hidden.hidden_information import Information, left_of, lifted
from deadtime.identification.hidden.noisy_choice import NoisyFit
from deadtime.identification.intervals import spread_of
from deadtime.identification.likelihoods.hidden_noisy_log import HiddenNoisyLog, Starts
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy.noise import noisy_residuals, variance_errors
from deadtime.identification.residuals import judge_residuals
from deadtime.identification.scoring import Maximum
from deadtime.identification.start import Start

_SMALL = 0.1  # of a standard error, a step of second differences
_VAGUE = 1e-2  # information on the logarithm of a noise: its standard error is 10 at most
_ODDS = 0.03  # the same of the logarithm of a jump's odds
_NEVER = 1e-4  # a jump of less probability is none that could be estimated


class NoisyDecoded(NamedTuple):
    """A fit whose modes are in the order of its likeliest path, and the recording with that path.

    order : of its modes in those of the fit; theta : its vector
    """

    fit: NoisyFit
    log: HiddenNoisyLog
    theta: Float[np.ndarray, " size"]
    order: Int[np.ndarray, " mode"]
    recording: Recording


def decoded_with_noise(fit: NoisyFit) -> NoisyDecoded:
    """The likeliest path, modes in the order in which it visits them.

    Raises
    ------
    ArgumentError
        If it leaves a mode out.
    """
    log, vector, layout = fit.log, fit.best.theta, fit.layout
    paths = log.path(vector, log.starts(*fit.window))
    order, record = ordered_by_path(paths, log.recording, layout)
    A, B, D = layout.split(vector[: layout.size])
    theta = np.concatenate((layout.join(A[order], B[order], D[order]), vector[layout.size :]))
    errors = log.errors.copy()
    A, B, D = layout.split(errors[: layout.size])
    errors[: layout.size] = layout.join(A[order], B[order], D[order])
    log = replace(log, errors=errors, jumps=log.jumps.ordered(order), _kept={})
    return NoisyDecoded(fit, log, theta, order, record)


def estimated_with_noise(found: NoisyDecoded) -> tuple[Estimate, Said]:
    """The estimate, and what there is to say of the modes."""
    fit, log, theta, _, record = found
    layout, window, starts = log.layout, fit.window, log.starts(*fit.window)
    cells = log.cells(theta)
    path = log.along(record)
    of_path = path.evaluate_in(*window)(cells)(theta)
    path = replace(path, within=log.within)
    told = _information(log, theta, starts, cells, of_path.information + _vague(log))
    observations = sum(int(np.isfinite(part.output).sum()) for part in record.parts)
    spare = max(observations - theta.size, 1)
    every = np.full(theta.size, float(spare))
    spread = spread_of(told.held, layout.names(), told.left * (spare / observations), every)
    now = log.evaluate(theta, starts, cells)
    best = Maximum(theta, now._replace(information=told.held), np.zeros(theta.size, bool))
    start = _start(found)
    intervals, several = delay_intervals(log, best, window, spread, start)
    noise = log.noise(theta)
    plant = layout.plant(theta[: layout.size])
    white = noisy_residuals(path, theta, path.starts(*window))
    posterior = log.posterior(theta, starts)
    rows = np.vstack(posterior.node).sum(axis=0)
    estimate = Estimate(
        log=log,
        best=best,
        window=window,
        plant=plant,
        spread=spread,
        intervals=intervals,
        several=several,
        start=start,
        disturbance=np.tile(noise.W, (layout.modes, 1, 1)),
        noise=noise.deviation,
        noise_errors=variance_errors(log, theta, spread.covariance),
        spare=np.maximum(rows, 1.0).astype(np.int64),
        tests=judge_residuals(white, record, plant.longest_delay),
        white=tuple(white),
    )
    return estimate, Said(posterior.node, log.jumps.chain, fit.values, widening_of(told))


def _start(found: NoisyDecoded) -> Start:
    """What other cells of the delays would be like without noise, modes in their new order."""
    begun, order, layout = found.fit.begun, found.order, found.log.layout
    old = start_of_grid(begun.log, begun.theta)
    theta = found.theta[: layout.size]
    cells = found.log.cells(theta)
    curves = old.scanned
    if layout.per_mode:
        curves = curves.reshape(layout.modes, layout.m, -1)[order].reshape(curves.shape)
    return Start(theta, cells, old.first, curves, old.weights)


def _information(
    log: HiddenNoisyLog,
    theta: Float[np.ndarray, " size"],
    starts: Starts,
    cells: Int[np.ndarray, " delay"],
    known: Float[np.ndarray, "size size"],
) -> Information:
    """J of the vector, with the chain held and estimated; and that of the modes of the path."""
    jumps, size, vague = log.jumps.likelier(_NEVER), theta.size, _vague(log)
    unit = _SMALL * np.minimum(1.0 / np.sqrt(np.maximum(np.diagonal(known), 1e-300)), log.most)
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
    held, _ = lifted(J[:size, :size], known)
    left, told = lifted(left_of(J, np.arange(size)), known)
    return Information(held, left, known, told, np.ones(log.layout.modes))


def _vague(log: HiddenNoisyLog) -> Float[np.ndarray, "size size"]:
    """Next to no information on the noise, so that one which the log does not tell may be any."""
    return np.diag(_VAGUE / log.most**2)
