"""Disturbances by normal numbers, drawn at once of one run or of many."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import final

import numpy as np
from jaxtyping import Float

from deadtime.imperfections.base import Disturbance, Sizes, Stacked


class DrawnDisturbance(Stacked, Disturbance):
    """A disturbance that draws as many normal numbers for each stretch.

    The first stretch of all periods has the run's stream, the second one the first that this
    spawns, and so on: a seed draws the same numbers for a stretch however many there are of them,
    and a longer run begins as a shorter one.
    """

    @abstractmethod
    def counts(self, sizes: Sizes) -> tuple[int, int]:
        """How many normal numbers a stretch takes before the first period, and in every one."""

    @abstractmethod
    def draws_from(
        self,
        numbers: Float[np.ndarray, "stretch runs count"],
        sizes: Sizes,
        lengths: tuple[float, ...],
        steps: int,
        room_for: Callable[[tuple[int, ...]], np.ndarray] = np.empty,
    ) -> Float[np.ndarray, "stretch some steps r"]:
        """What decides w in runs that drew these numbers, stretch by stretch.

        No length is 0. An axis of length 1 stands for all runs. `room_for` gives memory for it.
        """

    @abstractmethod
    def spreads_in(
        self, sizes: Sizes, A: np.ndarray, mode: np.ndarray, tau: np.ndarray
    ) -> Float[np.ndarray, "count n r"]:
        """`Disturbance.spread` of many stretches, (count, n, r).

        Each has tau (count, pieces) seconds in a mode (count, pieces) of A (modes, n, n).
        """

    @final
    def spreads(self, sizes: Sizes, A: np.ndarray, tau: np.ndarray) -> np.ndarray:
        mode = np.arange(tau.size).reshape(tau.shape)
        return self.spreads_in(sizes, A.reshape(-1, *A.shape[2:]), mode, tau)

    @final
    def draws(
        self, sizes: Sizes, lengths: tuple[float, ...], steps: int, rng: np.random.Generator
    ) -> np.ndarray:
        before, each = self.counts(sizes)
        (there,) = np.nonzero(np.array(lengths))
        # All spawn, so that who is missing changes nobody's numbers.
        streams = [rng, *rng.spawn(len(lengths) - 1)]
        numbers = [streams[i].standard_normal((1, before + each * steps)) for i in there]
        found = self.draws_from(np.stack(numbers), sizes, tuple(lengths[i] for i in there), steps)
        draws = np.zeros((steps, len(lengths), found.shape[3]))
        draws[:, there] = found[:, 0].transpose(1, 0, 2)
        return draws
