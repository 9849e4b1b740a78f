"""The prediction of a law that knows the signal, by two stacks of affine maps.

At t_k the prediction composes the pieces of the model between t_k and t_k + D, each an affine map
x → Φ x + v under its input. From sample to sample pieces leave this window at its begin and enter
at its end. A piece that enters is stored in a slot and composed into `back`. When the window has
moved past the last suffix, all its slots become suffixes, each the composition of its piece and all
later ones:

    piece      q    q + 1   q + 2 | q + 3   q + 4
    slot       a    b       c     | d       e          a = pieces q … q + 2, b = q + 1 … q + 2, …
               suffixes           | composed in `back`
    prediction from piece q + 1 on: x → b x, then `back`

So nothing is inverted, a sample costs a few products of matrices however long the delay is, and
every prediction starts from the measured x_k.

Piece q lies in slot q modulo the number of slots. Numbers are as in `belief_steps.py`: of one
scenario, or of eight, whose pieces then enter and leave together.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.numerics.kernels import kernel
from deadtime.numerics.numbers import arrays_of, room_of


class PreviewSizes(NamedTuple):
    """States, inputs, how many inputs act in a piece, and the numbers of a map."""

    n: int
    m: int
    acting: int
    room: int

    @classmethod
    def of(cls, n: int, m: int, acting: int) -> PreviewSizes:
        return cls(n, m, acting, n * (n + 1))


class PreviewState(NamedTuple):
    """The two stacks, and scratch arrays.

    sizes : PreviewSizes, or in batches the same as constants of compiled code
    maps : (slots + 1, n (n + 1)), [Φ v] of the pieces in the window; the last one is `back`
    acting : (q,), the inputs of a piece, written before it enters
    x : (n,), x_k before the prediction and x(t_k + D) after it
    room : (n (n + 1),)
    bounds : the number of pieces that entered, the slot of the next, and the first in no suffix
    """

    sizes: PreviewSizes
    maps: Float[np.ndarray, "slot c ..."]
    acting: Float[np.ndarray, "q ..."]
    x: Float[np.ndarray, "n ..."]
    room: Float[np.ndarray, "r ..."]
    bounds: Int[np.ndarray, " 3"]

    @classmethod
    def of(cls, sizes: PreviewSizes, slots: int, *lanes: int) -> PreviewState:
        """Empty stacks for a window of `slots` pieces; `lanes`: scenarios side by side, if any."""
        n, _, acting, room = sizes
        shapes = (max(1, slots) + 1, room), (acting,), (n,), (room,)
        maps, inputs, x, spare = arrays_of(*shapes, lanes=lanes)
        return cls(sizes, maps, inputs, x, spare, np.zeros(3, np.int64))


# Inlined into compiled callers, and run by Python in short runs.
_step: dict[str, Any] = {"nogil": True, "forceinline": True, "_nrt": False}


@kernel(**_step)
def enter_piece(state, move):
    """Let the next piece enter the window, `move` being its (n, n + q) under `state.acting`."""
    n, q, maps, bounds = state.sizes.n, state.sizes.acting, state.maps, state.bounds
    slots, slot, acting = maps.shape[0] - 1, bounds[1], state.acting
    bounds[0] += 1
    bounds[1] = 0 if slot + 1 == slots else slot + 1
    for i in range(n):
        entered = 0.0
        for j in range(q):
            entered += move[i * (n + q) + n + j] * acting[j]
        maps[slot, i * (n + 1) + n] = entered
        for j in range(n):
            maps[slot, i * (n + 1) + j] = move[i * (n + q) + j]
    # The last slot is `back`: it composes the pieces that belong to no suffix yet.
    _follow(state.sizes, maps, state.room, slots, slot)


@kernel(**_step)
def move_window(state, begin):
    """Let the window begin with piece `begin`, no earlier than before; new suffixes if needed."""
    n, maps, bounds, room = state.sizes.n, state.maps, state.bounds, state.room
    slots, back, slot = maps.shape[0] - 1, maps.shape[0] - 1, bounds[1]
    if begin >= bounds[2]:
        # From the newest piece back, so that each finds the suffix after it composed.
        for q in range(bounds[0] - 1, begin - 1, -1):
            after, slot = slot, slots - 1 if slot == 0 else slot - 1
            if q < bounds[0] - 1:
                _follow(state.sizes, maps, room, slot, after)
        # Every piece in the window has its suffix: `back` begins again as the identity.
        for i in range(n):
            for j in range(n + 1):
                maps[back, i * (n + 1) + j] = 1.0 if i == j else 0.0
        bounds[2] = bounds[0]


@kernel(**_step)
def predict_ahead(state, begin):
    """x(t_k + D) in `state.x`, from x_k there, over a window that is not empty."""
    maps, bounds = state.maps, state.bounds
    slots, slot = maps.shape[0] - 1, bounds[1] - (bounds[0] - begin)
    _go_through(state.sizes, maps, slot + slots if slot < 0 else slot, state.x, state.room)
    _go_through(state.sizes, maps, slots, state.x, state.room)


@kernel(**_step)
def _follow(sizes, maps, room, slot, after):
    """Compose: the map of `slot`, followed by that of `after`, into `slot`."""
    n, result = sizes.n, room_of(room, sizes)
    for i in range(n):
        for j in range(n + 1):
            total = maps[after, i * (n + 1) + n] if j == n else 0.0
            for k in range(n):
                total += maps[after, i * (n + 1) + k] * maps[slot, k * (n + 1) + j]
            result[i * (n + 1) + j] = total
    for i in range(n):
        for j in range(n + 1):
            maps[slot, i * (n + 1) + j] = result[i * (n + 1) + j]


@kernel(**_step)
def _go_through(sizes, maps, slot, x, room):
    """x = Φ x + v by the map of a slot."""
    n, result = sizes.n, room_of(room, sizes)
    for i in range(n):
        total = maps[slot, i * (n + 1) + n]
        for j in range(n):
            total += maps[slot, i * (n + 1) + j] * x[j]
        result[i] = total
    for i in range(n):
        x[i] = result[i]


@kernel(**_step)
def answer_ahead(state, tail, latest, answer):
    """K x(t_k + D) + L u_{k−1}, `tail` being [K L]."""
    n, m = state.sizes.n, state.sizes.m
    for i in range(m):
        total = 0.0
        for j in range(m):
            total += tail[i * (n + m) + n + j] * latest[j]
        for j in range(n):
            total += tail[i * (n + m) + j] * state.x[j]
        answer[i] = total
