"""A law that knows the signal, in the loop of a single run: the pieces of its model along it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.feedback import Foresight
from deadtime.loop.preview_steps import (
    PreviewSizes,
    PreviewState,
    answer_ahead,
    enter_piece,
    move_window,
    predict_ahead,
)
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


class PreviewLaw(NamedTuple):
    """A law that knows the signal, and its stacks, for `foresee`.

    move : (entries, n (n + m)), Φ and Γ side by side, of the model's pieces along the signal
    piece : (pieces, 1 + m), the entry of each, and the k of the u_k that acts in it
    window : (samples, 2), the first piece from t_k on, and the first in which u_k acts
    tails : (modes, m (n + m)), K and L side by side
    mode : (samples,), that at t_k + D
    stacks : PreviewState
    """

    move: Float[np.ndarray, "entry q"]
    piece: Int[np.ndarray, "piece r"]
    window: Int[np.ndarray, "sample 2"]
    tails: Float[np.ndarray, "mode q"]
    mode: Int[np.ndarray, " sample"]
    stacks: PreviewState

    @classmethod
    def of(cls, foresight: Foresight, samples: int, along: Along) -> PreviewLaw:
        """A law's foresight over a run, with empty stacks that have room for the longest window."""
        sampled, signal = foresight.sampled, foresight.signal
        if sampled is along.sampled and signal is along.signal:
            table = along.table
        else:
            cuts = cuts_of(signal, sampled)
            table = sampled.along(cuts, samples + sampled.longest_lag)
        sample, begin, (modes, m, n) = table.sample, table.first[:samples], foresight.gains.shape
        until = np.searchsorted(sample.min(axis=1), np.arange(samples))
        latest = np.broadcast_to(foresight.latest, (modes, m, m))
        move = np.concatenate((table.Phi, table.Gamma), axis=2)
        arrays = (
            move.reshape(-1, n * (n + m)),
            np.column_stack((table.entry, sample)),
            np.column_stack((begin, until)),
            np.concatenate((foresight.gains, latest), axis=2).reshape(modes, -1),
            foresight.modes_ahead(samples),
        )
        slots = int((until - begin).max())
        return cls(*map(read_only, arrays), PreviewState.of(PreviewSizes.of(n, m, m), slots))


@kernel
def foresee(law, k, past, told, x, answer):
    """The input of sample k for the state x: K x(t_k + D) + L u_{k−1}, u_0 in row `past`."""
    stacks, piece, begin, end = law.stacks, law.piece, law.window[k, 0], law.window[k, 1]
    for q in range(stacks.bounds[0], end):
        for j in range(stacks.acting.size):
            stacks.acting[j] = told[past + piece[q, 1 + j], j]
        enter_piece(stacks, law.move[piece[q, 0]])
    for i in range(x.size):
        stacks.x[i] = x[i]
    if begin < end:
        move_window(stacks, begin)
        predict_ahead(stacks, begin)
    answer_ahead(stacks, law.tails[law.mode[k]], told[past + k - 1], answer)
