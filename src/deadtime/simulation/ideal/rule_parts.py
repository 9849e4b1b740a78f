"""What ideal loops under a rule are made of, parts in one motion each, and a run made of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.simulation.digital import RunOutcome
from deadtime.simulation.ideal.ideal_run import IdealRecord
from deadtime.simulation.slides import Slide, join, slides_in_words
from deadtime.switching import SwitchingSignal
from deadtime.switching.rules.motion import Leg, Motion

_SAME = 1e-12  # of the time: switches that close are one


class RulePart(NamedTuple):
    """A part of the run in one motion, seconds from its start, and the input held over it."""

    begin: float
    end: float
    motion: Motion
    leg: Leg
    u: np.ndarray

    @property
    def mode(self) -> int:
        return self.motion.mode_of(self.leg.place)


def no_loop(stop: str, arrived: float) -> ArgumentError:
    """The error of a start from which no ideal run goes on."""
    return ArgumentError(
        f"x0 leads to no ideal loop, {stop}, before all inputs of the law have arrived, at "
        f"{arrived:g} s: give a step for a run up to there."
    )


def outcome_of(record: IdealRecord, parts: list[RulePart], end: float, stop: str) -> RunOutcome:
    """What a run of these parts leaves behind; `stop` says why it ended early at `end`, if so."""
    reached = parts[-1].end
    signal = _signal(parts, reached)
    slides = join(
        [_slide(part, end) for part in parts if part.leg.beside and part.begin < end],
        _SAME * max(1.0, reached),
    )
    diverged = stop.startswith("diverged")  # `simulate` says so itself
    early = (
        f"{stop}, a delay ahead: the run ends at t = {end:g} s." if stop and not diverged else ""
    )
    return RunOutcome(
        record,
        signal,
        lambda time: signal(time + record.states.slack),
        end if stop else None,
        diverged,
        " ".join(filter(None, [early, slides_in_words(slides)])),
    )


def _signal(parts: list[RulePart], reached: float) -> SwitchingSignal:
    """The switching signal that the parts are, known up to where they reach."""
    times, modes = [0.0], [parts[0].mode]
    for part in parts[1:]:
        if part.mode == modes[-1]:
            continue
        if part.begin - times[-1] <= _SAME * max(1.0, reached):
            modes[-1] = part.mode
            if modes[-1] in modes[-2:-1]:
                del times[-1], modes[-1]
        else:
            times.append(part.begin)
            modes.append(part.mode)
    return SwitchingSignal(times, modes, reached)


def _slide(part: RulePart, end: float) -> Slide:
    """The sliding motion of a part, up to the end of the run."""
    assert part.leg.beside is not None
    mode, other = (part.motion.mode_of(p) for p in (part.leg.place, part.leg.beside.place))
    return Slide(part.begin, min(part.end, end), (min(mode, other), max(mode, other)))
