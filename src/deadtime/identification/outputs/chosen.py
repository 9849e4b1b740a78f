"""The likeliest plant of outputs alone, from where a scan of delays leads; whether it has zeros.

Of long logs that is done on stretches: they tell where the maximum is. Uneven ones are scanned on a
grid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from deadtime.base.wording import number_of
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy.delay_scan import Scanned
from deadtime.identification.noisy.largest import largest_maximum
from deadtime.identification.noisy.likelihood import NoisyLog
from deadtime.identification.outputs.begin import begins_of, by_past
from deadtime.identification.outputs.embedding import Embedding
from deadtime.identification.outputs.other_delays import others_of
from deadtime.identification.outputs.start import Guess, guess_of
from deadtime.identification.parameters import Layout
from deadtime.identification.scoring import Maximum
from deadtime.identification.uneven import gridded, nodes_for
from deadtime.numerics.kernels import expect_many_calls

_FEW = 4_000  # samples that tell where to begin
CHANCE = 1e-3  # that inputs seem to act on all states though they do not


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
    from scipy.stats import chi2

    expect_many_calls()
    recording, layout, order, zeros, bounds, within, progress = request
    guess = guess_of(gridded(recording), layout, order, bounds, within)
    shape = Embedding(order, zeros is True, guess.size, lead)
    nodes = nodes_for(recording.parts, layout.split(guess.theta)[0])
    some = recording.stretches(_FEW, recording.lag(bounds[1]))
    log = NoisyLog(some, layout, shape.C, within, bounds, nodes, shape)
    before = "".join(f"{n} + " for n in order[:-1])
    progress(f"looking for the delay with {before}{number_of(order[-1], 'state')}")
    best, scan = _begun(log, guess)
    if zeros is not None or not shape.upper.size:
        return Chosen(log, best, scan)
    progress("trying inputs that act on all states")
    wider = replace(log, embedding=replace(shape, zeros=True))
    other, scan_of_other = _begun(wider, guess, best.theta)
    rise = 2.0 * (other.found.value - best.found.value)
    more = wider.free.size - log.free.size
    if rise > float(chi2.isf(CHANCE, more)):
        return Chosen(wider, other, scan_of_other, best, rise, more)
    return Chosen(log, best, scan, other, rise, more)


def _begun(log: NoisyLog, guess: Guess, *more: np.ndarray) -> tuple[Maximum, Scanned]:
    """The likeliest plant that scans of all delays or outputs' past lead to; and the last scan."""
    begins = (*begins_of(log, guess), *more)
    return largest_maximum(
        log, begins, by_past(log, guess), lambda theta: others_of(log, theta)
    )
