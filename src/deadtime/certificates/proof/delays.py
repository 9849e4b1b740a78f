"""The delays of a certificate: of which kind they are, and all that depends on the kind."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import positive
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.certificates.proof.box import Box
from deadtime.certificates.proof.family import DelayInterval, Family
from deadtime.plant import SwitchedSystem
from deadtime.plant.discretisation import snap
from deadtime.plant.plant_set import PlantSet
from deadtime.plant.switched_system import check_delays

Range = tuple[ArrayLike, ArrayLike]


@dataclass(frozen=True, eq=False)
class Delays(Frozen):
    """The delays that a certificate covers, in seconds (immutable).

    Attributes
    ----------
    ends : (2,), (modes, m) or (2, modes, m)
        Low and high of the plant's one delay, equal if it is known; the known delay of every mode
        and input; or low and high of each. Files store this array.
    """

    ends: Float[np.ndarray, "*kind"]

    @classmethod
    def of(
        cls, given: Range | None, plant: SwitchedSystem, step: float, inputs: Sequence[str] = ()
    ) -> Delays:
        """The delays of a given range, or the plant's own.

        An ArgumentError, with the names of the inputs, where a range is none within a period.
        """
        if given is None:
            return cls(np.array([plant.delay] * 2) if plant.has_one_delay else plant.delays)
        if plant.has_one_delay and not any(np.iterable(end) for end in given):
            ends = np.array([positive("delays", end) for end in given])
        else:
            ends = np.stack([check_delays(end, plant.delays.shape, "delays") for end in given])
        for at in np.ndindex(ends.shape[1:]):
            name, (low, high) = "delays", ends[:, *at].tolist()
            if at:
                mode, j = at
                name = f"delays of {inputs[j] if inputs else f'input {j}'} in mode {mode}"
            if low > high:
                raise ArgumentError(f"{name} must ascend, got ({low:g}, {high:g}).")
            try:
                DelayInterval.of(low, high, step)
            except ValueError:
                cut = (math.floor(snap(low / step)) + 1) * step
                raise ArgumentError(
                    f"{name} must lie within one period, between two multiples of step = {step:g} "
                    f"s, got ({low:g}, {high:g}): certify the parts below and above {cut:g} s one "
                    "after the other with delays= (--delays), or choose a step none of whose "
                    "multiples is within the range."
                ) from None
        return cls(ends if ends.ndim == 1 or np.any(ends[0] < ends[1]) else ends[0])

    def shape(self, modes: int, m: int) -> tuple[int, ...]:
        """The shape that `ends` must have."""
        return {2: (modes, m), 3: (2, modes, m)}.get(self.ends.ndim, (2,))

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Low and high, each () or (modes, m)."""
        ends = self.ends
        return (ends, ends) if ends.ndim == 2 else (ends[0, ...], ends[1, ...])

    @property
    def corners(self) -> list[ArrayLike]:
        """All delays at the lower ends, and at the upper ones where they differ."""
        low, high = self.bounds
        return [low.tolist(), high.tolist()] if np.any(low < high) else [low.tolist()]

    @property
    def moving(self) -> int:
        """The largest number of ranges that a step depends on: those of two modes."""
        low, high = self.bounds
        return sum(sorted(np.atleast_2d(low < high).sum(axis=1).tolist())[-2:])

    def family(self, plants: PlantSet, step: float) -> Family | Box:
        """The steps of plants with these delays."""
        if self.ends.ndim == 3:
            return Box.of(plants, self.ends, step)
        if self.ends.ndim == 2:
            return Family.of(plants, self.ends, step)
        low, high = self.ends.tolist()
        return Family.of_range(plants, low, high, step)

    def include(self, plant: SwitchedSystem) -> bool:
        """Whether a plant's delays are among them."""
        low, high = self.bounds
        inside = bool(np.all((low <= plant.delays) & (plant.delays <= high)))
        return inside and (self.ends.ndim > 1 or plant.has_one_delay)

    @property
    def claim(self) -> str:
        """To follow "for every admissible signal"; empty where the delays are known."""
        one = " and every constant delay from {low:.6g} s to {high:.6g} s"
        return self._written("", one, "", " and all constant delays in the given ranges")

    @property
    def stated(self) -> str:
        """To follow "input delay"."""
        lists = " (a list per mode, with a value per input)"
        return self._written(
            " {low} s",
            " any constant value in [{low}, {high}] s",
            f"s {{low}} s{lists}",
            f"s any constant values from {{low}} s to {{high}} s{lists}, "
            "each in its own range, independently",
        )

    @property
    def in_figures(self) -> str:
        """As one of several properties of a plant."""
        known, one = "delay {low} s", "delay {low} to {high} s"
        return self._written(known, one, "delays {low} s", "delays from {low} to {high} s")

    @property
    def in_words(self) -> str:
        """To follow "a plant with"."""
        known, one = "a delay of {low} s", "a delay in [{low}, {high}] s"
        return self._written(known, one, "the delays {low} s", "delays from {low} to {high} s")

    def _written(self, known: str, one: str, each: str, ranges: str) -> str:
        """The text for this kind: a known delay, a range of one, known delays, a range of each."""
        low, high = self.bounds
        kinds = [known if np.all(low == high) else one, each, ranges]
        return kinds[self.ends.ndim - 1].format(low=low.tolist(), high=high.tolist())
