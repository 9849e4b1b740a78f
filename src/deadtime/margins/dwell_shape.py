"""Which dwell times a search for the least one moves: all in proportion, or that of one mode."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from deadtime.base.checks import count, index
from deadtime.base.errors import ArgumentError
from deadtime.switching.constraint import PerMode, SwitchingConstraint

if TYPE_CHECKING:
    from deadtime.certificates import WorstCase


@dataclass(frozen=True)
class DwellShape:
    """Dwell times of all modes as functions of one time T: T times a weight, or fixed.

    Attributes
    ----------
    weights : tuple of float, one per mode
        Dwell times over T, the least of them 1; 0 where the dwell time is fixed.
    limits : SwitchingConstraint
        The longest sojourns, the switches, and the dwell times that are fixed.
    mode : int or None
        The mode that moves alone.
    chatter : int
        Above 1, T is an average dwell time; then one for all modes.

    Examples
    --------
    >>> shape = DwellShape.of(3, [0.25, 0.75, 0.5], maximum_dwell=[2.0, 3.0, 4.0])
    >>> shape.dwell_times(0.5), shape.longest
    ((0.5, 1.5, 1.0), 1.0)
    >>> DwellShape.of(3, [0.25, 0.75, 0.5], mode=1).dwell_times(0.125)
    (0.25, 0.125, 0.5)
    """

    weights: tuple[float, ...]
    limits: SwitchingConstraint
    mode: int | None = None
    chatter: int = 1

    @classmethod
    def of(
        cls,
        modes: int,
        dwell_time: PerMode | None = None,
        maximum_dwell: PerMode | None = None,
        transitions: ArrayLike | None = None,
        mode: int | None = None,
        chatter: int = 1,
    ) -> DwellShape:
        """From the arguments of `least_dwell_time`."""
        limits = SwitchingConstraint.of(modes, dwell_time, maximum_dwell, transitions)
        several = mode is not None or len(set(limits.dwell_time)) > 1
        if count("chatter", chatter) > 1 and (several or len(limits.lasting) < modes):
            raise ArgumentError(
                "chatter above 1 asks about one average dwell time for all modes: leave out mode, "
                "maximum_dwell and dwell times of their own."
            )
        if mode is None:
            least = min(limits.dwell_time)
            each = (time / least if least else 1.0 for time in limits.dwell_time)
            return cls(tuple(each), limits, None, chatter)
        mode = index("mode", mode, modes)
        if dwell_time is None:
            raise ArgumentError(
                "dwell_time must be given with mode: the dwell times that the other modes keep."
            )
        return cls(tuple(float(i == mode) for i in range(modes)), limits, mode)

    @property
    def longest(self) -> float:
        """The longest T, seconds: beyond it a mode would have to last longer than it may."""
        pairs = zip(self.weights, self.limits.maximum_dwell, strict=True)
        return min(most / weight for weight, most in pairs if weight)

    def dwell_times(self, time: float) -> tuple[float, ...]:
        """Of every mode, seconds."""
        return tuple(
            min(time * weight, most) if weight else fixed
            for weight, most, fixed in zip(
                self.weights, self.limits.maximum_dwell, self.limits.dwell_time, strict=True
            )
        )

    def signals(self, time: float) -> SwitchingConstraint:
        """The admissible signals at T."""
        return SwitchingConstraint(
            self.dwell_times(time), self.limits.maximum_dwell, self.limits.following
        )

    def admits(self, worst: WorstCase) -> float:
        """The longest T with which a signal is admissible, seconds; inf where it always is."""
        if len(worst.modes) == 1:
            return math.inf
        visits = zip(worst.modes, worst.sojourns, strict=True)
        times = (lasts / self.weights[mode] for mode, lasts in visits if self.weights[mode])
        return float(min(times, default=math.inf))

    @property
    def alike(self) -> bool:
        """Whether one dwell time of all modes is what moves."""
        return self.mode is None and len(set(self.weights)) == 1
