"""A law that knows the signal, in the loop of a single run: its prediction by two stacks.

At t_k the prediction goes through the model's pieces from t_k to t_k + D, each an affine map under
the input that acts in it. From sample to sample pieces leave this window at its begin and enter at
its end. Those that enter are composed into `back`; once the older ones are used up, the pieces of
the window become suffixes, slot q the composition of all from q on. So nothing is inverted, a
sample costs a few products of matrices however long the delay is, and every prediction starts from
the x_k that was measured.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.feedback import Foresight
from deadtime.numerics.kernels import kernel
from deadtime.plant import SampledPlant
from deadtime.plant.pieces import PieceTable
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import cuts_of


class Along(NamedTuple):
    """A plant's pieces along a signal."""

    sampled: SampledPlant
    signal: SwitchingSignal
    table: PieceTable


class Foreseen(NamedTuple):
    """A law that knows the signal, and its two stacks, for `foresee`.

    move : (entries, n, n + m), Φ and Γ side by side, of the model's pieces along the signal
    piece : (pieces, 1 + m), the entry of each, and the k of the u_k that acts in it
    window : (samples, 2), the first piece from t_k on, and the first in which u_k acts
    gain : (samples, m, n), K of the mode at t_k + D
    latest : (m, m), what u_{k−1} adds
    maps : (slots + 2, n, n + 1), [Φ v] for x → Φ x + v; after the slots `back` and a spare one
    bounds : the piece of slot 0, that after the last slot's, and that before which pieces entered
    room : (2, n), x(t_k + D) and what it becomes
    """

    move: Float[np.ndarray, "entry n q"]
    piece: Int[np.ndarray, "piece r"]
    window: Int[np.ndarray, "sample 2"]
    gain: Float[np.ndarray, "sample m n"]
    latest: Float[np.ndarray, "m m"]
    maps: Float[np.ndarray, "slot n c"]
    bounds: Int[np.ndarray, " 3"]
    room: Float[np.ndarray, "2 n"]

    @classmethod
    def of(cls, foresight: Foresight, samples: int, along: Along) -> Foreseen:
        """A law's foresight over a run, with empty stacks that have room for the longest window."""
        sampled, signal = foresight.sampled, foresight.signal
        if sampled is along.sampled and signal is along.signal:
            table = along.table
        else:
            cuts = cuts_of(signal, sampled)
            table = sampled.along(cuts, samples + sampled.longest_lag)
        sample, begin, n = table.sample, table.first[:samples], sampled.plant.states
        until = np.searchsorted(sample.min(axis=1), np.arange(samples))
        gain = foresight.gains[foresight.modes_ahead(samples)]
        slots = max(1, int((until - begin).max())) + 2
        move = np.concatenate((table.Phi, table.Gamma), axis=2)
        piece, window = np.column_stack((table.entry, sample)), np.column_stack((begin, until))
        return cls(
            *(read_only(move), read_only(piece), read_only(window)),
            *(read_only(gain), read_only(foresight.latest)),
            *(np.zeros((slots, n, n + 1)), np.zeros(3, np.int64), np.zeros((2, n))),
        )


@kernel
def _put(maps, slot, move, piece, q, past, told):
    """Put piece q, under the inputs told, into a slot."""
    e, n = piece[q, 0], maps.shape[1]
    for i in range(n):
        entered = 0.0
        for j in range(piece.shape[1] - 1):
            entered += move[e, i, n + j] * told[past + piece[q, 1 + j], j]
        maps[slot, i, n] = entered
        for j in range(n):
            maps[slot, i, j] = move[e, i, j]


@kernel
def _follow(maps, room, slot, after):
    """Let the map of another slot follow on that of a slot, column by column."""
    n = maps.shape[1]
    for j in range(n + 1):
        for i in range(n):
            total = 0.0
            for k in range(n):
                total += maps[after, i, k] * maps[slot, k, j]
            room[1, i] = total
        for i in range(n):
            maps[slot, i, j] = room[1, i]
    for i in range(n):
        maps[slot, i, n] += maps[after, i, n]


@kernel
def _through(maps, slot, room):
    """Let the state in the first row of `room` go through the map of a slot."""
    n = maps.shape[1]
    for i in range(n):
        total = maps[slot, i, n]
        for j in range(n):
            total += maps[slot, i, j] * room[0, j]
        room[1, i] = total
    for i in range(n):
        room[0, i] = room[1, i]


@kernel
def _predict(maps, bounds, room, move, piece, begin, end, past, told):
    """Let a state go on over the pieces begin, …, end − 1 under the inputs told, from row `past`.

    `begin` and `end` are never less than in the call before.
    """
    n, back, spare = maps.shape[1], maps.shape[0] - 2, maps.shape[0] - 1
    if begin >= bounds[1]:
        for slot in range(end - begin - 1, -1, -1):
            _put(maps, slot, move, piece, begin + slot, past, told)
            if begin + slot < end - 1:
                _follow(maps, room, slot, slot + 1)
        for i in range(n):
            for j in range(n + 1):
                maps[back, i, j] = 1.0 if i == j else 0.0
        bounds[0], bounds[1] = begin, end
    else:
        for q in range(bounds[2], end):
            _put(maps, spare, move, piece, q, past, told)
            _follow(maps, room, back, spare)
    bounds[2] = end
    if begin < bounds[1]:
        _through(maps, begin - bounds[0], room)
    _through(maps, back, room)


@kernel
def foresee(law, k, past, told, x, answer):
    """The input of sample k for the state x: K x(t_k + D) + L u_{k−1}, u_0 in row `past`."""
    gain, latest, room, window = law.gain, law.latest, law.room, law.window
    for i in range(x.size):
        room[0, i] = x[i]
    begin, end = window[k, 0], window[k, 1]
    _predict(law.maps, law.bounds, room, law.move, law.piece, begin, end, past, told)
    for i in range(answer.size):
        total = 0.0
        for j in range(answer.size):
            total += latest[i, j] * told[past + k - 1, j]
        for j in range(x.size):
            total += gain[k, i, j] * room[0, j]
        answer[i] = total
