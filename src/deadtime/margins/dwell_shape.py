"""Which dwell times a search for the least one moves: all in proportion, or that of one mode."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from deadtime.base.checks import index
from deadtime.base.errors import ArgumentError
from deadtime.switching import SignalClass
from deadtime.switching.constraint import SwitchingConstraint, one_or_each

if TYPE_CHECKING:
    from deadtime.certificates import WorstCase


@dataclass(frozen=True)
class DwellShape:
    """Dwell times of all modes as functions of one time T: T times a weight, or fixed.

    Attributes
    ----------
    weights : tuple of float, one per mode
        Dwell times over T, the least of them 1; 0 where the dwell time is fixed.
    signals : SignalClass
        What stays of the signals; with a chatter above 1 T is an average dwell time.
    limits : SwitchingConstraint
        The longest sojourns, the switches, and the dwell times that are fixed.
    mode : int or None
        The mode that moves alone.

    Examples
    --------
    >>> shape = DwellShape.of(3, SignalClass([0.25, 0.75, 0.5], maximum_dwell=[2.0, 3.0, 4.0]))
    >>> shape.dwell_times(0.5), shape.longest
    ((0.5, 1.5, 1.0), 1.0)
    >>> DwellShape.of(3, SignalClass([0.25, 0.75, 0.5]), mode=1).dwell_times(0.125)
    (0.25, 0.125, 0.5)
    """

    weights: tuple[float, ...]
    signals: SignalClass
    limits: SwitchingConstraint
    mode: int | None = None

    @classmethod
    def of(cls, modes: int, signals: SignalClass, mode: int | None = None) -> DwellShape:
        """Of dwell times in proportion to those of a class of signals, or of one mode's alone."""
        limits = signals.limits(modes)
        if mode is not None and signals.chatter > 1:
            raise ArgumentError(
                "chatter above 1 asks about one average dwell time for all modes: leave out mode."
            )
        if mode is None:
            least = min(limits.dwell_time)
            return cls(tuple(time / least for time in limits.dwell_time), signals, limits)
        mode = index("mode", mode, modes)
        return cls(tuple(float(i == mode) for i in range(modes)), signals, limits, mode)

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

    def at(self, time: float) -> SignalClass:
        """The admissible signals at T."""
        return replace(self.signals, dwell_time=one_or_each(self.dwell_times(time)))

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
