"""Cycles: periodic switching signals whose length is a whole number of sampling periods.

A cycle is a sequence of modes and of sojourns, in sampling periods, that is gone through again
and again. Only if its length is a whole number of periods does the loop with its samples repeat
as the signal does, and has a growth rate: ln(spectral radius over the cycle)/length. Sojourns
themselves may be any real numbers, and the first switch may fall anywhere in a period.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deadtime.switching import SwitchingSignal


@dataclass(frozen=True)
class Cycle:
    """One cycle (immutable).

    Attributes
    ----------
    modes : tuple of int
        The modes in turn; neighbours differ, the last and the first too.
    gaps : tuple of float
        Their sojourns in sampling periods; the sum is an integer.
    offset : float
        Where in its period the switch to the first mode falls, in [0, 1).
    lost : tuple of int
        The samples of the cycle, 0 the first, that the law does not get.
    """

    modes: tuple[int, ...]
    gaps: tuple[float, ...]
    offset: float = 0.0
    lost: tuple[int, ...] = ()

    @property
    def periods(self) -> int:
        """The length of the cycle in sampling periods."""
        return round(sum(self.gaps))

    @property
    def constant(self) -> bool:
        """Whether the mode never changes."""
        return len(self.modes) == 1

    def instants(self) -> np.ndarray:
        """The switches to the modes in turn, in periods, within [0, periods)."""
        return self.offset + np.concatenate(([0.0], np.cumsum(self.gaps[:-1])))

    def signal(self, step: float) -> SwitchingSignal:
        """σ over one cycle, from 0."""
        times, modes = self.instants() * step, np.array(self.modes)
        if self.offset > 0.0:
            times, modes = np.append(0.0, times), np.append(self.modes[-1], modes)
        return SwitchingSignal(times, modes)

    def reduce(self) -> Cycle:
        """The shortest cycle that this one repeats.

        Examples
        --------
        >>> Cycle((0, 1, 0, 1), (2.0, 3.0, 2.0, 3.0)).reduce()
        Cycle(modes=(0, 1), gaps=(2.0, 3.0), offset=0.0, lost=())
        """
        count = len(self.modes)
        for size in range(1, count):
            times = count // size
            whole = abs(sum(self.gaps[:size]) - round(sum(self.gaps[:size]))) < 1e-9
            if (
                whole
                and times * size == count
                and self.modes[:size] * times == self.modes
                and np.allclose(self.gaps[:size] * times, self.gaps, rtol=0.0, atol=1e-9)
            ):
                return Cycle(self.modes[:size], self.gaps[:size], self.offset)
        return self

    @classmethod
    def on_grid(cls, sojourns: list[tuple[int, int, bool]], late: float) -> Cycle:
        """From modes, lengths in samples, and whether each begins `late` after its sample.

        All rotations give the same cycle.

        Examples
        --------
        >>> Cycle.on_grid([(1, 3, False), (0, 2, True)], late=0.125)
        Cycle(modes=(0, 1), gaps=(1.875, 3.125), offset=0.125, lost=())
        """
        first = min(sojourns[i:] + sojourns[:i] for i in range(len(sojourns)))
        modes, lengths, after = zip(*first, strict=True)
        begins = late * np.array(after)
        gaps = np.array(lengths) + np.roll(begins, -1) - begins
        return cls(modes, tuple(gaps.tolist()), float(begins[0])).reduce()
