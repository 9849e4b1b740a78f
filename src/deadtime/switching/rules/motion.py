"""How a plant whose mode is a function of its state moves under held inputs.

Time is cut into pieces of a few lengths, each under one input. Within a piece the plant stays in
its *place* (a region of the rule, or for rules that only name a mode that mode) until it crosses
into another, from where it goes on in the new mode. Its matrix exponentials take it from crossing
to crossing; a crossing's time is the right end of its bracket, at which the new mode is active.

A state is known to round-off only, and so are its mode and the direction of the vector field near
a boundary. A crossing counts once it is beyond the round-off of the state, and a vector field
points at a boundary if it does so beyond its own; below that the mode is kept.

Where both modes point at their boundary the state slides along it, in the sense of Filippov
(`switching.rules.boundaries`); its place, and mode, is the one that it came from until it leaves
the boundary. When its input changes it goes on beyond the boundary, if the mode there leads on.
Where a rule does not say what its boundaries are, or crossings pile up, no trajectory goes on: the
plant chatters. The move then says so, and holds one of the modes from there on.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

MOST = 50  # crossings of boundaries within one piece; more are chattering
ROUND_OFF = 16.0 * 2.0**-52  # relative, of a state that many exponentials have made
_INSTANT = 1e-10  # of a piece: chattering that soon has been there from its start


class Chatter(NamedTuple):
    """When crossings pile up (seconds from the start), between which modes, and why."""

    time: float
    modes: tuple[int, int]
    reason: str

    @classmethod
    def facing(cls, time: float, mode: int, other: int, length: float) -> Chatter:
        """Both modes point at their boundary."""
        modes = min(mode, other), max(mode, other)
        reason = (
            "both vector fields point at the boundary between modes {} and {}, and a function does "
            "not say how to slide along it: use HalfSpace, Polyhedra or QuadraticRegions"
        ).format(*modes)
        return cls(time if time > _INSTANT * length else 0.0, modes, reason)

    @classmethod
    def pile_up(cls, time: float, mode: int, other: int, length: float, most: int) -> Chatter:
        """More than `most` boundaries are crossed in a piece."""
        reason = (
            f"more than {most} boundaries are crossed within {length:g} s; if they are meant to "
            "be, shorten the step"
        )
        return cls(time, (min(mode, other), max(mode, other)), reason)

    @classmethod
    def stray(cls, time: float, mode: int, other: int) -> Chatter:
        """A sliding motion cannot be integrated to round-off."""
        modes = min(mode, other), max(mode, other)
        reason = (
            "the motion along the boundary between modes {} and {} changes too fast to be "
            "followed: both fields come to touch the boundary at once"
        ).format(*modes)
        return cls(time, modes, reason)


class Beside(NamedTuple):
    """The boundary that a state slides along: the place beyond it, and its number."""

    place: int
    boundary: int


class Leg(NamedTuple):
    """A part of a piece in one motion.

    time, x, place : at its start, seconds from that of the piece
    beside : along what the state slides, if it does
    """

    time: float
    x: np.ndarray
    place: int
    beside: Beside | None = None


class Move(NamedTuple):
    """One piece: state, place and boundary at its end, and its legs, the first from its start."""

    x: np.ndarray
    place: int
    beside: Beside | None
    legs: list[Leg]
    chatter: Chatter | None


class Arrival(NamedTuple):
    """Many pieces: state, place and boundary at their end, unless the plant chatters on the way."""

    x: np.ndarray
    place: int
    beside: Beside | None
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
    def advance(
        self, kind: int, x: np.ndarray, place: int, u: np.ndarray, beside: Beside | None = None
    ) -> Move:
        """Move over one piece of length number `kind`, from a boundary slid along until now."""

    @abstractmethod
    def hold(self, kind: int, x: np.ndarray, place: int, u: np.ndarray) -> np.ndarray:
        """x at the end of one piece if the mode is held, whatever the rule says."""

    @abstractmethod
    def follow(self, kinds: np.ndarray, inputs: np.ndarray, x: np.ndarray, mode: int) -> Arrival:
        """Move over many pieces; from a state on a boundary in the mode that is seen, if it can."""

    @abstractmethod
    def along(self, leg: Leg, u: np.ndarray, tau: float) -> np.ndarray:
        """x in a leg, τ seconds after its start."""

    @abstractmethod
    def leads_on(self, x: np.ndarray, beside: Beside, u: np.ndarray) -> bool:
        """Whether on a boundary the mode beyond it leads on under an input, surely."""


def round_off(
    A: Float[np.ndarray, "mode n n"], B: Float[np.ndarray, "mode n m"], tau: float
) -> tuple[Float[np.ndarray, "mode n n"], Float[np.ndarray, "mode n m"]]:
    """M and N per mode: M|x| + N|u| is the round-off of x, coordinate by coordinate.

    Besides its own a coordinate carries that of the others which move it: as much as they add
    within `tau` seconds, or within the coordinate's own time 1/Σ_j|A_ij| if that is shorter.
    """
    times = 1.0 / np.maximum(np.abs(A).sum(axis=2), 1.0 / tau)[:, :, None]
    return ROUND_OFF * (np.eye(A.shape[1]) + times * np.abs(A)), ROUND_OFF * times * np.abs(B)


def most_crossings(A: Float[np.ndarray, "mode n n"], tau: float) -> int:
    """How many crossings a piece may hold: more than MOST if the plant can turn round in it."""
    return int(MOST * min(max(1.0, tau * np.abs(A).sum(axis=2).max()), 200.0))
