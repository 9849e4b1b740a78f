"""Motion under held inputs of a plant whose mode is a function of its state.

Time is divided into pieces of a few lengths, each under one input. A state has a *place*, a region
of the rule, or the mode for rules without regions. Matrix exponentials lead from crossing to
crossing of their boundaries; the time of a crossing is the right end of its bracket, at which the
new mode is active.

A state has round-off, and so have its mode and the direction of the vector field near a boundary. A
crossing counts when it exceeds the round-off of the state, and a field points at a boundary if it
does so beyond its own round-off; otherwise the mode is kept.

Where both modes' fields point at their boundary the state slides along it, in the sense of Filippov
(`switching.rules.boundaries`). It keeps its place, and mode, until it leaves the boundary. When the
input changes, it crosses the boundary if the field beyond it points away. If the boundaries of a
rule are unknown, or crossings accumulate, the plant chatters: the move reports it and holds one of
the modes from there on.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

MOST = 50  # crossings of boundaries within one piece; more are chattering
ROUND_OFF = 16.0 * 2.0**-52  # relative, of a state that many exponentials have made
_INSTANT = 1e-10  # of a piece: chattering so early began at its start


class Chatter(NamedTuple):
    """Chattering: its time in seconds from the start, the two modes, and the reason."""

    time: float
    modes: tuple[int, int]
    reason: str

    @classmethod
    def facing(cls, time: float, mode: int, other: int, length: float) -> Chatter:
        """Both modes' fields point at an unknown boundary."""
        i, j = sorted((mode, other))
        reason = (
            f"both vector fields point at the boundary between modes {i} and {j}, and a function "
            "does not say how to slide along it: use HalfSpace, Polyhedra or QuadraticRegions"
        )
        return cls(time if time > _INSTANT * length else 0.0, (i, j), reason)

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
        i, j = sorted((mode, other))
        reason = (
            f"the motion along the boundary between modes {i} and {j} changes too fast to be "
            "followed: both fields become tangent to the boundary at once"
        )
        return cls(time, (i, j), reason)


class Beside(NamedTuple):
    """The boundary along which a state slides: the place beyond it, and its number."""

    place: int
    boundary: int


class Leg(NamedTuple):
    """A part of a piece in one motion.

    time, x, place : at its start, seconds after the start of the piece
    beside : the boundary along which the state slides, if it does
    """

    time: float
    x: np.ndarray
    place: int
    beside: Beside | None = None


class Move(NamedTuple):
    """A motion: state, place and boundary at its end, the legs if of one piece, chattering."""

    x: np.ndarray
    place: int
    beside: Beside | None
    legs: list[Leg]
    chatter: Chatter | None = None


class Motion(ABC):
    """A plant under a rule, over pieces of given lengths."""

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
        """Move over one piece of length number `kind`; `beside` is the boundary at its start."""

    @abstractmethod
    def hold(self, kind: int, x: np.ndarray, place: int, u: np.ndarray) -> np.ndarray:
        """x at the end of one piece with the mode held, regardless of the rule."""

    @abstractmethod
    def follow(self, kinds: np.ndarray, inputs: np.ndarray, x: np.ndarray, mode: int) -> Move:
        """Move over many pieces; a state on a boundary starts in the reported mode, if it can."""

    @abstractmethod
    def along(self, leg: Leg, u: np.ndarray, tau: float) -> np.ndarray:
        """x in a leg, τ seconds after its start."""

    @abstractmethod
    def leads_on(self, x: np.ndarray, beside: Beside, u: np.ndarray) -> bool:
        """Whether the field beyond a boundary points away from it, beyond round-off."""


def round_off(
    A: Float[np.ndarray, "mode n n"], B: Float[np.ndarray, "mode n m"], tau: float
) -> tuple[Float[np.ndarray, "mode n n"], Float[np.ndarray, "mode n m"]]:
    """M and N per mode, with M|x| + N|u| the round-off of x by coordinate.

    A coordinate has its own round-off and the effect of that of the others within `tau` seconds, or
    within the coordinate's time constant 1/Σ_j|A_ij| if that is shorter.
    """
    times = 1.0 / np.maximum(np.abs(A).sum(axis=2), 1.0 / tau)[:, :, None]
    return ROUND_OFF * (np.eye(A.shape[1]) + times * np.abs(A)), ROUND_OFF * times * np.abs(B)


def most_crossings(A: Float[np.ndarray, "mode n n"], tau: float) -> int:
    """The most crossings of a piece: more than MOST if the plant can oscillate within it."""
    return int(MOST * min(max(1.0, tau * np.abs(A).sum(axis=2).max()), 200.0))
