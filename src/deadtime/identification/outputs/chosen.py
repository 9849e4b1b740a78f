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
from deadtime.identification.estimate import Estimate
from deadtime.identification.likelihoods.embedding import Embedding
from deadtime.identification.likelihoods.noisy_log import NoisyLog
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy.delay_scan import Scanned, largest_maximum
from deadtime.identification.outputs.begin import Guess, begins_of, by_past, guess_of
from deadtime.identification.outputs.other_delays import others_of
from deadtime.identification.parameters import Layout, Window
from deadtime.identification.sampling import nodes_for
from deadtime.identification.scoring import Maximum
from deadtime.numerics.kernels import expect_many_calls

_FEW = 4_000  # samples that tell where to begin
CHANCE = 1e-3  # that inputs seem to act on all states, or chains to jump, though they do not
_DOUBT = 0.05  # of a rise by chance: from there on zeros are plausible
_WIDE = 0.2  # of an input's weight: a standard error that comes with poles that are not there


class OutputsRequest(NamedTuple):
    """What is asked of a log; zeros None: where the log asks for them.

    progress : told what is begun
    """

    recording: Recording
    layout: Layout
    order: tuple[int, ...]
    zeros: bool | None
    bounds: Window
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
    guess = guess_of(recording.gridded(), layout, order, bounds, within)
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


def zeros_in_doubt(chosen: Chosen, inputs: tuple[str, ...]) -> list[str]:
    """What delays would be the other way round, where both ways are plausible.

    A zero looks like a delay, so that its likelihood may rise by chance at any of many delays: it
    is beyond doubt at Bonferroni's level of all cells that were looked at.
    """
    from scipy.stats import chi2

    if chosen.other is None:
        return []
    cells = chosen.scan.curves.size
    least, most = (float(chi2.isf(p, chosen.more)) for p in (_DOUBT, CHANCE / cells))
    if not least < chosen.rise < most:
        return []
    D = chosen.other.theta[chosen.log.layout.at_delays]
    one = "the delay" if D.size == 1 else "delays"
    were = f"{one} would be {', '.join(f'{d:.4g}' for d in D)} s"
    whether = "the last derivative alone" if chosen.shape.zeros else "all states"
    acting = "inputs act" if inputs[1:] else f"{inputs[0]} acts"
    return [
        f"The log hardly tells whether {acting} on all states or on the last derivative alone: if "
        f"on {whether}, {were}. Say which by zeros=True or zeros=False, --zeros or --no-zeros."
    ]


def hardly_tells(found: Estimate, shape: Embedding) -> bool:
    """Whether the order may be too high: of a chain no input's weight is well known.

    A pole that is not there may be anywhere far out, as a delay, or beside a zero: with it goes
    what inputs weigh.
    """
    layout, theta = found.log.layout, found.best.theta
    error = np.sqrt(np.diagonal(found.spread.covariance))
    for last, count in zip(shape.last, shape.order, strict=True):
        place = layout.of_B[:, last].reshape(-1)
        if count > 1 and (error[place] > _WIDE * np.abs(theta[place])).all():
            return True
    return False


def order_too_high(request: OutputsRequest, chosen: Chosen) -> list[str]:
    """Which smaller order explains the log better, by BIC of the same measurements."""
    order, fewer = request.order, []
    for j, count in enumerate(order):
        if count > 1:
            own = (*order[:j], count - 1, *order[j + 1 :])
            layout = replace(request.layout, n=sum(own))
            asked = request._replace(layout=layout, order=own)
            fewer.append((chosen_of(asked, lead=order).bic, own))
    if not fewer or min(fewer)[0] >= chosen.bic:
        return []
    bic, own = min(fewer)
    say = f"say order={_text(own)}, --order {' '.join(map(str, own))}"
    return [
        f"An order of {_text(own)} explains the log better (BIC {bic:.1f}, against "
        f"{chosen.bic:.1f} with {_text(order)}): {say}."
    ]


def _text(order: tuple[int, ...]) -> str:
    return str(order[0]) if len(order) == 1 else str(order)
