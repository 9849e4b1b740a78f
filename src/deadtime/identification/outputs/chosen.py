"""The likeliest plant of outputs alone, from where a scan of delays leads; which states it has.

Of long logs that is done on stretches: they tell where the maximum is. Uneven ones are scanned on a
grid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deadtime.base.wording import number_of
from deadtime.identification.log.recording import Recording
from deadtime.identification.maximum import maximise
from deadtime.identification.noisy.likelihood import NoisyLog
from deadtime.identification.noisy.noise import stretches
from deadtime.identification.outputs.begin import begins_of, by_past, of_sensors
from deadtime.identification.outputs.embedding import Embedding
from deadtime.identification.outputs.other_delays import others_of
from deadtime.identification.outputs.start import Guess, Scanned, guess_of, scanned
from deadtime.identification.parameters import Layout
from deadtime.identification.scoring import Maximum
from deadtime.identification.uneven import gridded, nodes_for
from deadtime.numerics.kernels import expect_many_calls

_FEW = 4_000  # samples that tell where to begin
_ROUNDS = 3  # of scans, each about the likeliest plant so far
_BETTER = 0.1  # of log likelihood: cells that are worth going to
_GAIN = 1e-4  # of log likelihood that a beginning may be short of: a pole too many runs for ever
_NEARLY = 3.0  # of log likelihood: delays that may be the likeliest after all
CHANCE = 1e-3  # that inputs seem to act on all states, or chains to jump, though they do not


class Request(NamedTuple):
    """What is asked of a log; zeros None: where the log asks for them.

    progress : told what is begun
    """

    recording: Recording
    layout: Layout
    order: tuple[int, ...]
    zeros: bool | None
    bounds: tuple[float, float]
    within: bool
    progress: Callable[[str], None]


class Chosen(NamedTuple):
    """A plant, what it is likeliest of, and the last scan.

    other : the likeliest one with zeros if it has none, without if it has; None if not asked
    rise : 2 (log L with zeros − log L without); more : how many numbers of B zeros have
    """

    log: NoisyLog
    best: Maximum
    scan: Scanned
    other: Maximum | None = None
    rise: float = 0.0
    more: int = 0

    @property
    def shape(self) -> Embedding:
        """Which states it has."""
        assert self.log.embedding is not None
        return self.log.embedding

    @property
    def bic(self) -> float:
        """−2 log L + q log N, of q unknowns and N measurements."""
        count = self.log.measured(self.log.starts(*self.log.bounds))
        return self.log.free.size * float(np.log(count)) - 2.0 * self.best.found.value


def chosen_of(request: Request, lead: tuple[int, ...] | None = None) -> Chosen:
    """The likeliest plant; `lead`: see `Embedding`."""
    expect_many_calls()
    recording, layout, order, zeros, bounds, within, progress = request
    guess = guess_of(gridded(recording), layout, order, bounds, within)
    shape = Embedding(order, zeros is True, guess.size, lead)
    nodes = nodes_for(recording.parts, layout.split(guess.theta)[0])
    some = stretches(recording, _FEW, recording.lag(bounds[1]))
    log = NoisyLog(some, layout, shape.C, within, bounds, nodes, shape)
    before = "".join(f"{n} + " for n in order[:-1])
    progress(f"looking for the delay with {before}{number_of(order[-1], 'state')}")
    simple = Chosen(log, *_begun(log, guess))
    if not shape.upper.size:
        return simple
    chosen = simple
    if layout.modes > 1 and not within:
        progress("trying states that are an output's derivatives in one mode alone")
        free = replace(log, embedding=replace(shape, jumps=True))
        chosen = _better(
            simple, Chosen(free, *_searched(free, [_climbed(free, simple.best.theta)]))
        )
    if zeros is not None:
        return chosen
    progress("trying inputs that act on all states")
    wider = _with_zeros(chosen, guess)
    if wider.shape.zeros and wider.shape.jumps:  # what zeros do may have looked like a jump
        alone = _with_zeros(simple, guess)
        return wider if _better(alone, wider) is wider else alone
    return wider


def _better(simple: Chosen, wider: Chosen) -> Chosen:
    """The wider one of two plants if it is likelier than chance makes it, else the other."""
    from scipy.stats import chi2

    rise = 2.0 * (wider.best.found.value - simple.best.found.value)
    more = wider.log.free.size - simple.log.free.size
    return wider if rise > float(chi2.isf(CHANCE, more)) else simple


def _with_zeros(simple: Chosen, guess: Guess) -> Chosen:
    """The same plant, or one with zeros, if that is likelier than chance makes it."""
    log = replace(simple.log, embedding=replace(simple.shape, zeros=True))
    wider = Chosen(log, *_begun(log, guess, simple.best.theta))
    own = _better(simple, wider)
    rise = 2.0 * (wider.best.found.value - simple.best.found.value)
    more = log.free.size - simple.log.free.size
    return own._replace(other=(simple if own is wider else wider).best, rise=rise, more=more)


def _begun(log: NoisyLog, guess: Guess, *more: np.ndarray) -> tuple[Maximum, Scanned]:
    """The likeliest plant that scans of all delays or outputs' past lead to; and the last scan."""
    grid = replace(log, recording=gridded(log.recording))
    found = [_climbed(log, begin) for begin in by_past(log, guess)]
    found += [
        _climbed(log, scanned(grid, begin).moved(begin))
        for begin in (*begins_of(log, guess), *more)
    ]
    return _searched(log, found)


def _searched(log: NoisyLog, found: list[Maximum]) -> tuple[Maximum, Scanned]:
    """The likeliest plant that scans about the best of some lead to; and the last scan."""
    grid = replace(log, recording=gridded(log.recording))
    best, scan = max(found, key=lambda one: one.found.value), None
    for _ in range(_ROUNDS):
        scan = scanned(grid, best.theta)
        tried = [_climbed(log, theta) for theta in _others(log, best, scan)]
        top = max(tried, key=lambda one: one.found.value, default=best)
        if top.found.value < best.found.value + _BETTER:
            break
        best = top
    assert scan is not None
    return best, scan


def _others(log: NoisyLog, best: Maximum, scan: Scanned) -> list[np.ndarray]:
    """Where else a maximum may be: where the scan is, and of each delay where it is nearly so.

    And where errors are all the sensors': a climb does not come back from a sensor without noise.
    """
    place, h = log.layout.at_delays, log.recording.step
    found = [of_sensors(log, best.theta), *others_of(log, best.theta)]
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


def _climbed(log: NoisyLog, vector: np.ndarray) -> Maximum:
    """The maximum that a vector leads to, over the whole range of delays."""
    return maximise(log, vector, window=log.bounds, gain=_GAIN)[0]
