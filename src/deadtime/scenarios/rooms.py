"""Memory that a thread uses again: new memory costs more than to write into it."""

from __future__ import annotations

import math
import threading
from collections.abc import Hashable

import numpy as np
from numpy.typing import DTypeLike


class Rooms(threading.local):
    """Arrays by name, of each thread its own; what is in one lasts until it is asked for again.

    Examples
    --------
    >>> rooms = Rooms()
    >>> numbers = rooms.of("numbers", (2, 3))
    >>> rooms.of("numbers", (5,)).shape, np.shares_memory(numbers, rooms.of("numbers", (5,)))
    ((5,), True)
    """

    def __init__(self) -> None:
        self._kept: dict[Hashable, np.ndarray] = {}
        self._inner: dict[Hashable, Rooms] = {}

    def under(self, name: Hashable) -> Rooms:
        """Others, with names of their own."""
        return self._inner.setdefault(name, Rooms())

    def of(
        self, name: Hashable, shape: tuple[int, ...], kind: DTypeLike = np.float64
    ) -> np.ndarray:
        """An array, which holds anything; a name has one kind of numbers."""
        size, kept = math.prod(shape), self._kept.get(name)
        if kept is None or kept.size < size:
            kept = self._kept[name] = np.empty(size, kind)
        return kept[:size].reshape(shape)
