"""The likeliest plant of outputs alone, from where a scan of delays leads; which states it has.

Of long logs that is done on stretches: they tell where the maximum is. Uneven ones are scanned on a
grid.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deadtime.base.wording import number_of
from deadtime.identification.likelihoods.embedding import Embedding
from deadtime.identification.likelihoods.noisy_log import NoisyLog
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy.delay_scan import Scanned
from deadtime.identification.noisy.largest import largest_maximum
from deadtime.identification.outputs.begin import begins_of, by_past
from deadtime.identification.outputs.other_delays import others_of
from deadtime.identification.outputs.smoothed_start import Guess, guess_of
from deadtime.identification.parameters import Layout
from deadtime.identification.scoring import Maximum
from deadtime.identification.uneven import gridded, nodes_for
from deadtime.numerics.kernels import expect_many_calls

_FEW = 4_000  # samples that tell where to begin
CHANCE = 1e-3  # that inputs seem to act on all states, or chains to jump, though they do not


class OutputsRequest(NamedTuple):
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

    added : how many unknowns each thing added that was asked of the log: jumps, zeros, a level
    other : the likeliest one with zeros if it has none, without if it has; None if not asked
    rise : 2 (log L with zeros − log L without); more : how many numbers of B zeros have
    """

    log: NoisyLog
    best: Maximum
    scan: Scanned
    added: tuple[int, ...] = ()
    other: Maximum | None = None
    rise: float = 0.0
    more: int = 0

    @property
    def shape(self) -> Embedding:
        """Which states it has."""
        assert self.log.embedding is not None
        return self.log.embedding

    @property
    def worth(self) -> float:
        """2 log L less what chance alone would add to it, seldom, by each thing added.

        So plants compare of which neither is a special case of the other: one at rest elsewhere
        than at 0, and one with zeros that make up for it.
        """
        from scipy.stats import chi2

        chance = sum(float(chi2.isf(CHANCE, count)) for count in self.added)
        return 2.0 * self.best.found.value - chance

    def adding(self, wider: Chosen) -> Chosen:
        """A wider plant, told what it adds to this one."""
        return wider._replace(added=(*self.added, wider.log.free.size - self.log.free.size))

    @property
    def bic(self) -> float:
        """−2 log L + q log N, of q unknowns and N measurements."""
        count = self.log.measured(self.log.starts(*self.log.bounds))
        return self.log.free.size * float(np.log(count)) - 2.0 * self.best.found.value


def chosen_of(request: OutputsRequest, lead: tuple[int, ...] | None = None) -> Chosen:
    """The likeliest plant; `lead`: see `Embedding`."""
    expect_many_calls()
    recording, layout, order, zeros, bounds, within, progress = request
    guess = guess_of(gridded(recording), layout, order, bounds, within)
    shape = Embedding(order, zeros is True, guess.size, lead)
    nodes = nodes_for(recording.parts, layout.split(guess.theta)[0])
    some = recording.stretches(_FEW, recording.lag(bounds[1]))
    log = NoisyLog(some, layout, within, bounds, nodes, shape.C, shape)
    before = "".join(f"{n} + " for n in order[:-1])
    progress(f"looking for the delay with {before}{number_of(order[-1], 'state')}")
    simple = Chosen(log, *_begun(log, guess))
    if not shape.upper.size:
        return simple
    chosen = simple
    if layout.modes > 1 and not within:
        progress("trying states that are an output's derivatives in one mode alone")
        free = replace(log, embedding=replace(shape, jumps=True))
        wider = Chosen(free, *_searched(free, (), (simple.best.theta,)))
        chosen = worthier(simple, simple.adding(wider))
    if zeros is not None:
        return chosen
    progress("trying inputs that act on all states")
    wider = _with_zeros(chosen, guess)
    if wider.shape.zeros and wider.shape.jumps:  # what zeros do may have looked like a jump
        alone = _with_zeros(simple, guess)
        return worthier(alone, wider)
    return wider


def worthier(simple: Chosen, wider: Chosen) -> Chosen:
    """The wider one of two plants if it is likelier than chance makes it, else the other."""
    return wider if wider.worth > simple.worth else simple


def _with_zeros(simple: Chosen, guess: Guess) -> Chosen:
    """The same plant, or one with zeros, if that is likelier than chance makes it."""
    log = replace(simple.log, embedding=replace(simple.shape, zeros=True))
    wider = simple.adding(Chosen(log, *_begun(log, guess, simple.best.theta)))
    own = worthier(simple, wider)
    rise = 2.0 * (wider.best.found.value - simple.best.found.value)
    other = (simple if own is wider else wider).best
    return own._replace(other=other, rise=rise, more=wider.added[-1])


def _begun(log: NoisyLog, guess: Guess, *more: np.ndarray) -> tuple[Maximum, Scanned]:
    """The likeliest plant that scans of all delays or outputs' past lead to; and the last scan."""
    return _searched(log, (*begins_of(log, guess), *more), by_past(log, guess))


def _searched(
    log: NoisyLog, begins: Sequence[np.ndarray], climbed: Sequence[np.ndarray]
) -> tuple[Maximum, Scanned]:
    """The same from some beginnings: see `largest_maximum`."""
    return largest_maximum(log, begins, climbed, lambda theta: others_of(log, theta))
