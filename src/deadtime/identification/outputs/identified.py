"""`identify` from outputs alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.identification.cells import cells_of
from deadtime.identification.estimate import Estimate
from deadtime.identification.logged_modes import fit_switching
from deadtime.identification.maximum import maximise
from deadtime.identification.noise import estimated_of, stretches
from deadtime.identification.noisy import NoisyLog
from deadtime.identification.outputs.embedding import Embedding
from deadtime.identification.outputs.request import order_of, state_names
from deadtime.identification.outputs.start import Scanned, guess_of, scanned
from deadtime.identification.parameters import Layout
from deadtime.identification.recording import Recording
from deadtime.identification.scoring import Maximum
from deadtime.identification.start import Start
from deadtime.identification.uneven import nodes_for, on_a_grid
from deadtime.numerics.kernels import expect_many_calls
from deadtime.switching import SemiMarkov

_FEW = 4_000  # samples that tell where to begin
_ROUNDS = 3  # of scans, each about the likeliest plant so far
_BETTER = 0.1  # of log likelihood: cells that are worth going to
_NEARLY = 3.0  # of log likelihood: delays that may be the likeliest after all
_CHANCE = 1e-3  # that inputs seem to act on all states though they do not


class FromOutputs(NamedTuple):
    """What `Identification.of` takes."""

    estimate: Estimate
    recording: Recording
    model: SemiMarkov | None
    why: str
    C: Float[np.ndarray, "p n"]
    states: tuple[str, ...]


def identify_outputs(
    recording: Recording,
    order: int | Sequence[int],
    zeros: bool | None,
    per_mode: bool,
    bounds: tuple[float, float],
    within: bool,
) -> FromOutputs:
    """The likeliest plant with so many states of each output."""
    given = order_of(order, recording.outputs)
    _require_moving(recording)
    layout = Layout(len(recording.modes), sum(given), len(recording.inputs), per_mode)
    found, shape = estimate_from_outputs(recording, layout, given, zeros, bounds, within)
    names = state_names(recording.outputs, given, shape.zeros)
    return FromOutputs(found, recording, *fit_switching(recording), shape.C, names)


def _require_moving(recording: Recording) -> None:
    """Refuse outputs that never move."""
    every = np.vstack([part.output for part in recording.parts])
    for name, column in zip(recording.outputs, every.T, strict=True):
        known = column[np.isfinite(column)]
        if not known.size or np.ptp(known) == 0.0:
            raise ArgumentError(
                f"{name} must move, got {known[0] if known.size else 'nothing'} throughout: leave "
                "it out by outputs=[…]."
            )


def estimate_from_outputs(
    recording: Recording,
    layout: Layout,
    order: tuple[int, ...],
    zeros: bool | None,
    bounds: tuple[float, float],
    within: bool,
) -> tuple[Estimate, Embedding]:
    """The likeliest plant with the states of `order`; zeros None: where the log asks for them."""
    from scipy.stats import chi2

    expect_many_calls()
    grid = recording
    if not recording.even:
        parts = tuple(on_a_grid(part, recording.step) for part in recording.parts)
        grid = recording._replace(parts=parts, even=True)
    lag = int(np.ceil(bounds[1] / recording.step)) + 1
    guess = guess_of(grid, layout, order, bounds, within)
    shape = Embedding(order, zeros is True, guess.size)
    nodes = nodes_for(recording.parts, layout.split(guess.theta)[0])
    log = NoisyLog(recording, layout, shape.C, within, bounds, nodes, shape)
    some = replace(log, recording=stretches(grid, _FEW, lag))
    begins = [log.join(guess.theta, noise) for noise in guess.noise]
    best, scan = _begun(some, begins)
    if zeros is None and shape.upper.size:
        wider = replace(some, embedding=replace(shape, zeros=True))
        other = _begun(wider, [*begins, best.theta])
        rise = 2.0 * (other[0].found.value - best.found.value)
        if rise > float(chi2.isf(_CHANCE, wider.free.size - some.free.size)):
            shape, (best, scan) = replace(shape, zeros=True), other
            log = replace(log, embedding=shape)
    top, window = maximise(log, best.theta)
    cells = cells_of(top.theta[layout.at_delays], recording.step)
    start = Start(top.theta[: layout.size], cells, scan.first, scan.curves)
    return estimated_of(log, top, window, start), shape


def _begun(log: NoisyLog, begins: list[np.ndarray]) -> tuple[Maximum, Scanned]:
    """The likeliest plant that scans of all delays lead to, and the last scan."""
    best, scan = None, None
    for begin in begins:
        scan = scanned(log, begin)
        found = _from(log, begin, scan)
        if best is None or found.found.value > best.found.value:
            best = found
    assert best is not None
    for _ in range(_ROUNDS):
        scan = scanned(log, best.theta)
        tried = [maximise(log, theta, window=log.bounds)[0] for theta in _others(log, best, scan)]
        top = max(tried, key=lambda one: one.found.value, default=best)
        if top.found.value < best.found.value + _BETTER:
            break
        best = top
    assert scan is not None
    return best, scan


def _others(log: NoisyLog, best: Maximum, scan: Scanned) -> list[np.ndarray]:
    """Where else a maximum may be: where the scan is, and of each delay where it is nearly so."""
    place, h = log.layout.at_delays, log.recording.step
    found = []
    if np.abs(scan.theta[place] - best.theta[place]).max() >= h:
        found.append(np.concatenate((scan.theta, best.theta[log.layout.size :])))
    for row, curve in enumerate(scan.curves):
        D = (scan.first + np.arange(curve.size) - 0.5) * h
        near = (curve > curve.max() - _NEARLY) & (np.abs(D - best.theta[place][row]) > 1.5 * h)
        if near.any():
            theta = best.theta.copy()
            theta[place.start + row] = D[near][curve[near].argmax()]
            found.append(theta)
    return found


def _from(log: NoisyLog, vector: np.ndarray, scan: Scanned) -> Maximum:
    """The maximum that a scan leads to, over the whole range of delays."""
    theta = vector.copy()
    theta[: log.layout.size] = scan.theta
    return maximise(log, theta, window=log.bounds)[0]
