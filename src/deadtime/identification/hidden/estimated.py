"""Estimates of plants whose modes were hidden, with intervals that count that in.

With noisy sensors, of the vector θ of plant and noise and the odds η of the chain, J is minus the
second differences of the log likelihood; J_θθ − J_θη J_ηη⁻¹ J_ηθ is left, at most what the filter
of logged modes would give along the likeliest path.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.identification.estimate import Estimate
from deadtime.identification.exact_estimate import estimate_of_plant
from deadtime.identification.hidden.choice import HiddenFit, Log
from deadtime.identification.hidden.hidden_information import Information, information_of, lifted
from deadtime.identification.hidden.regressions import scanned
from deadtime.identification.intervals import left_of, spread_of
from deadtime.identification.likelihoods.hidden_log import HiddenLog
from deadtime.identification.likelihoods.hidden_noisy_log import HiddenNoisyLog, Starts
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy.noise import estimate_of_sensors
from deadtime.identification.parameters import Layout, Vector
from deadtime.identification.scoring import Maximum
from deadtime.identification.start import Start

_SMALL = 0.1  # of a standard error, a step of second differences
_VAGUE = 1e-2  # information on the logarithm of a noise: its standard error is 10 at most
_ODDS = 0.03  # the same of the logarithm of a jump's odds
_NEVER = 1e-4  # a jump of less probability is none that could be estimated


@dataclass(frozen=True, eq=False)
class Decoded(Generic[Log]):
    """A fit whose modes are in the order of its likeliest path, and the recording with that path.

    order : of its modes in those of the fit; theta : its vector
    """

    fit: HiddenFit[Log]
    log: Log
    theta: Vector
    order: Int[np.ndarray, " mode"]
    recording: Recording


class ModesTold(NamedTuple):
    """An estimate, how likely each mode was in every row, and how many times longer intervals are.

    These are the plant's longest, beside those with known modes.
    """

    estimate: Estimate
    node: list[Float[np.ndarray, "sample mode"]]
    widening: float


def decoded(fit: HiddenFit[Log]) -> Decoded[Log]:
    """The likeliest path, modes in the order in which it visits them.

    Raises
    ------
    ArgumentError
        If it leaves a mode out.
    """
    paths = fit.log.path(fit.theta, fit.given)
    order, record = _ordered_by_path(paths, fit.log.recording, fit.layout)
    return Decoded(fit, fit.log.ordered(order), fit.layout.ordered(fit.theta, order), order, record)


def _ordered_by_path(
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


def estimated(found: Decoded[HiddenLog]) -> ModesTold:
    """With exact states."""
    log, theta, record = found.log, found.theta, found.recording
    layout, cells = log.layout, log.cells(theta)
    posterior = log.posterior(theta, cells)
    best = Maximum(theta, log.evaluate(theta, cells), np.zeros(theta.size, bool))
    told = information_of(log, theta, cells)
    counts = posterior.weight.sum(axis=0)
    spare = np.maximum(counts - layout.n - layout.m - 1, 1.0)
    share = np.sqrt(layout.of_each(spare) / layout.of_each(counts))
    known = told.left * share[:, None] * share
    spread = spread_of(told.held, layout.names(), known, layout.of_each(spare))
    peak = log, best, found.fit.window, spread, _start(found)
    S = log.S * (counts / spare)[:, None, None]
    free = np.maximum(spare * told.of_noise, 1.0).astype(np.int64)
    estimate = estimate_of_plant(*peak, S, free, record, told=log.periods.usable)
    return ModesTold(estimate, posterior.node, told.widening)


def estimated_with_noise(found: Decoded[HiddenNoisyLog]) -> ModesTold:
    """With noisy sensors."""
    fit, log, theta, record = found.fit, found.log, found.theta, found.recording
    layout, window, starts = log.layout, fit.window, fit.given
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
    posterior = log.posterior(theta, starts)
    rows = np.maximum(np.vstack(posterior.node).sum(axis=0), 1.0).astype(np.int64)
    peak = log, best, window, spread, _start(found)
    estimate = estimate_of_sensors(*peak, theta, path, rows)
    return ModesTold(estimate, posterior.node, told.widening)


def _start(found: Decoded) -> Start:
    """What other cells of the delays would be like: other peaks may lie far from those found."""
    fit, theta = found.fit, found.theta[: found.log.layout.size]
    whole, cells, layout = fit.grid.over(*fit.grid.bounds), fit.grid.cells(fit.on_grid), fit.layout
    periods, weight = whole.periods, whole.posterior(fit.on_grid, cells).weight
    _, curves = scanned(periods, weight, layout.spread(cells), fit.grid.layout)
    if layout.per_mode:
        curves = curves.reshape(layout.modes, layout.m, -1)[found.order].reshape(curves.shape)
    return Start(theta, found.log.cells(theta), int(periods.cells[0]), curves, 2 * layout.n)


def _information(
    log: HiddenNoisyLog,
    theta: Vector,
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
