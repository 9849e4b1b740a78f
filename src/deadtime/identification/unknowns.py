"""The unknowns of an estimate by name: their likeliest values and 95 % intervals."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from deadtime.base.checks import brief
from deadtime.base.errors import ArgumentError
from deadtime.identification.estimate import Estimate
from deadtime.identification.noisy.noise_intervals import noise_interval


class Unknowns:
    """Those of an estimate."""

    def __init__(self, found: Estimate) -> None:
        self._found = found

    @cached_property
    def places(self) -> dict[str, int]:
        """Where each lies, by name: in the layout, then W's diagonals, then the sensors."""
        log, noise = self._found.log, self._found.noise
        modes, n = self._found.disturbance.shape[:2]
        more = [f"disturbance[{i}][{a},{a}]" for i in range(modes) for a in range(n)]
        more += [f"noise[{j}]" for j in range(noise.size)] if noise.any() else []
        places = {name: a for a, name in enumerate([*log.layout.names(), *more])}
        if (of_outputs := self._found.of_outputs) is None:
            return places
        free = {*of_outputs.free.tolist(), *range(log.layout.size, len(places))}
        return {name: a for name, a in places.items() if a in free}

    def estimate(self, name: str) -> float:
        """The likeliest value."""
        found, place = self._found, self._place(name)
        if place < found.log.layout.size:
            return float(found.best.theta[place])
        diagonal = np.diagonal(found.disturbance, axis1=1, axis2=2)
        return float(np.concatenate((diagonal.ravel(), found.noise))[place - found.log.layout.size])

    def interval(self, name: str) -> tuple[float, float]:
        """The ends of its interval."""
        layout, found = self._found.log.layout, self._found
        place = self._place(name)
        if layout.size - layout.delays <= place < layout.size:
            low, high = found.intervals[place - layout.size + layout.delays]
            return float(low), float(high)
        if place >= layout.size:
            return noise_interval(found, place - layout.size)
        if found.ends is not None:
            low, high = found.ends[place]
            return float(low), float(high)
        half = float(found.spread.reach[place]) * float(
            np.sqrt(found.spread.covariance[place, place])
        )
        return float(found.best.theta[place] - half), float(found.best.theta[place] + half)

    def require_inside(self) -> None:
        """Refuse an estimate that lies outside an interval of its own.

        An interval over several plausible delays may leave the likeliest plant out: then this one
        maximum is not what the log says.
        """
        outside = []
        for name, place in self.places.items():
            low, high = self.interval(name)
            if place < self._found.log.layout.size and not low <= self.estimate(name) <= high:
                outside.append(f"{name} ({self.estimate(name):.4g}, not {low:.4g} … {high:.4g})")
        if outside:
            raise ArgumentError(
                "log leaves several delays open, and their 95 % intervals do not hold the "
                f"likeliest plant: {', '.join(outside)}. Move the input more, log for longer, or "
                "narrow delay=(low, high), --delay LOW HIGH."
            )

    def _place(self, name: str) -> int:
        if name not in self.places:
            raise ArgumentError(f"name must be one of {', '.join(self.places)}, got {brief(name)}.")
        return self.places[name]
