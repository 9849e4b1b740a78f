"""The steps of a digital run in which the plant slid along a boundary.

No matrix exponential leads through them, so they are kept part by part, and gone through again
where the state between samples is asked for.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.numerics.polynomials import gauss
from deadtime.switching.rules.motion import Leg, Motion

_NODES = 10
_JOINED = 1e-6  # of a step: slides that close are one


class SlidePart(NamedTuple):
    """A part of a step in one motion: seconds from the step's start, the motion, what acts."""

    begin: float
    end: float
    leg: Leg
    u: np.ndarray


class Slide(NamedTuple):
    """One sliding motion, seconds from the run's start, between two modes."""

    begin: float
    end: float
    modes: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Slides:
    """The steps that slide, by number; filled by the run."""

    motion: Motion
    steps: dict[int, list[SlidePart]]

    def state_at(self, k: int, offset: float) -> Float[np.ndarray, " n"]:
        """x at t_k + offset."""
        part = [part for part in self.steps[k] if part.begin <= offset][-1]
        return self.motion.along(part.leg, part.u, offset - part.begin)

    def form_integral(self, k: int, end: float, rate: float, Q: np.ndarray) -> float:
        """∫xᵀQx over [t_k, t_k + end] by Gauss quadrature; `rate` (1/s) is the modes' fastest."""
        nodes, total = gauss(_NODES), 0.0
        for part in self.steps[k]:
            length = min(part.end, end) - part.begin
            if length <= 0.0:
                continue
            count = int(np.ceil(max(1.0, rate * length)))
            short = length / count
            for i in range(count):
                for point, weight in zip(nodes.points, nodes.weights, strict=True):
                    x = self.motion.along(part.leg, part.u, short * (i + point))
                    total += short * weight * float(x @ Q @ x)
        return total

    def slides(self, step: float, end: float) -> list[Slide]:
        """The sliding motions that begin before `end`."""
        return join(self._each(step, end), _JOINED * step)

    def _each(self, step: float, end: float) -> Iterator[Slide]:
        for k in sorted(self.steps):
            for begin, until, leg, _ in self.steps[k]:
                if leg.beside is not None and k * step + begin < end:
                    modes = (
                        self.motion.mode_of(leg.place),
                        self.motion.mode_of(leg.beside.place),
                    )
                    pair = min(modes), max(modes)
                    yield Slide(k * step + begin, min(k * step + until, end), pair)


def join(slides: Iterable[Slide], tolerance: float) -> list[Slide]:
    """Sliding motions in order, those that go on within a tolerance made one."""
    joined: list[Slide] = []
    for slide in slides:
        last = joined[-1] if joined else None
        if last and last.modes == slide.modes and slide.begin - last.end <= tolerance:
            joined[-1] = last._replace(end=slide.end)
        else:
            joined.append(slide)
    return joined


def slides_in_words(slides: list[Slide]) -> str:
    """What to say about a run's sliding motions, a sentence per pair of modes.

    Examples
    --------
    >>> slides_in_words([Slide(0.5, 0.52, (0, 1)), Slide(1.0, 1.01, (0, 1))])
    'slid along the boundary between modes 0 and 1, 2 times, for 0.03 s in all, first at t = 0.5 s.'
    """
    sentences = []
    for pair in sorted({slide.modes for slide in slides}):
        own = [slide for slide in slides if slide.modes == pair]
        total = sum(slide.end - slide.begin for slide in own)
        often = "once" if len(own) == 1 else f"{len(own)} times"
        sentences.append(
            f"slid along the boundary between modes {pair[0]} and {pair[1]}, {often}, for "
            f"{total:.4g} s in all, first at t = {own[0].begin:.6g} s."
        )
    return " ".join(sentences)
