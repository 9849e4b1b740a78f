"""How a plant whose mode is a function of its state moves under held inputs.

Time is cut into pieces of a few lengths, each under one input. Within a piece the plant stays in
its *place* (a region of the rule, or for rules that only name a mode that mode) until it crosses
into another, from where it goes on in the new mode. Its matrix exponentials take it from crossing
to crossing; a crossing's time is the right end of its bracket, at which the new mode is active.

Where both modes point at their boundary no trajectory goes on: crossings pile up, the plant
chatters. The move then says so, and holds one of the modes from there on.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np


class Chatter(NamedTuple):
    """When crossings pile up (seconds from the start), between which modes, and why."""

    time: float
    modes: tuple[int, int]
    reason: str

    @classmethod
    def found(cls, time: float, mode: int, other: int, back: bool, length: float) -> Chatter:
        from deadtime.switching.crossings import INSTANT, MOST

        low, high = sorted((mode, other))
        reason = (
            f"both vector fields point at the boundary between modes {low} and {high}"
            if back
            else f"more than {MOST} boundaries are crossed within {length:g} s"
        )
        return cls(time if time > INSTANT * length else 0.0, (low, high), reason)


class Move(NamedTuple):
    """One piece: the state and place at its end, and the switches within it."""

    x: np.ndarray
    place: int
    times: np.ndarray
    modes: np.ndarray
    chatter: Chatter | None


class Arrival(NamedTuple):
    """Many pieces: the state and place at their end, unless the plant chatters on the way."""

    x: np.ndarray
    place: int
    chatter: Chatter | None


class Motion(ABC):
    """A plant under a rule, made for pieces of given lengths."""

    @abstractmethod
    def place_of(self, x: np.ndarray) -> int:
        """The place of a state."""

    @abstractmethod
    def mode_of(self, place: int) -> int:
        """The mode of a place."""

    @abstractmethod
    def advance(self, kind: int, x: np.ndarray, place: int, u: np.ndarray) -> Move:
        """Move over one piece of length number `kind`."""

    @abstractmethod
    def hold(self, kind: int, x: np.ndarray, place: int, u: np.ndarray) -> np.ndarray:
        """x at the end of one piece if the mode is held, whatever the rule says."""

    @abstractmethod
    def follow(self, kinds: np.ndarray, inputs: np.ndarray, x: np.ndarray) -> Arrival:
        """Move over many pieces."""
