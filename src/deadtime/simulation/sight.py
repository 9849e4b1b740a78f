"""Where along a run the measurements lie that its law is told: arrays for the compiled loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.plant import SampledPlant
from deadtime.plant.pieces import PieceTable
from deadtime.plant.steps import Cuts, snap_all
from deadtime.simulation.compiled import Arrays, Lags


class Sight(NamedTuple):
    """What the law is told of the plant at every sample.

    piece : (samples,), the piece in which x is measured; −1 where nothing is heard
    step : (samples,), the period of that piece
    way : (samples,), how x follows from the start of the piece; −1 where it is measured there
    Phi : (ways, n, n), Gamma : (ways, n, q), from x and what acts to x; q = m, or m + n with
        the forces of the pieces behind the inputs
    force : (pieces, n) or (0, n)
    noise : (samples, p) or (0, p), what is added
    C : (modes, p, n), or (0, p, n) where x is measured itself
    mode : (samples,), the mode of the sample that is heard
    """

    piece: Int[np.ndarray, " sample"]
    step: Int[np.ndarray, " sample"]
    way: Int[np.ndarray, " sample"]
    Phi: Float[np.ndarray, "way n n"]
    Gamma: Float[np.ndarray, "way n q"]
    force: Float[np.ndarray, "piece n"]
    noise: Float[np.ndarray, "sample p"]
    C: Float[np.ndarray, "c p n"]
    mode: Int[np.ndarray, " sample"]

    @classmethod
    def of(
        cls,
        arrays: Arrays | None,
        sampled: SampledPlant,
        table: PieceTable,
        cuts: Cuts,
        forces: np.ndarray | None,
        outputs: np.ndarray | None,
        modes: Int[np.ndarray, " sample"],
    ) -> Sight:
        """The sight of a run in which the plant has these modes at the samples."""
        n, samples = sampled.plant.states, modes.size
        C = np.zeros((0, n, n)) if outputs is None else outputs
        force = np.zeros((0, n)) if forces is None else forces
        heard = np.arange(samples) if arrays is None else arrays.heard.sample
        noise = np.zeros((0, C.shape[1])) if arrays is None else arrays.heard.noise
        step, offset = heard, np.zeros(samples)
        if arrays is not None and arrays.lags is not None:
            measured, offset = _instants(arrays.lags, sampled.step)
            step = np.where(heard < 0, -1, measured[heard])
            offset = np.where(step < 0, 0.0, offset[heard])
        piece = np.where(step < 0, -1, table.first[step])
        way, Phi, Gamma = _ways(sampled, table, cuts, forces, piece, step, offset)
        mode = modes[heard]
        return cls(*map(read_only, (piece, step, way, Phi, Gamma, force, noise, C, mode)))


def _instants(lags: Lags, h: float) -> tuple[np.ndarray, np.ndarray]:
    """The period, −1 before time 0, and the seconds into it at which each state is measured."""
    k = np.arange(lags.missing.size)
    ratio = np.maximum(0.0, snap_all(k - (lags.missing + lags.early) / h))
    whole = np.floor(ratio)
    step = np.where(snap_all(k - lags.missing / h) < 0.0, -1, whole.astype(np.int64))
    return step, (ratio - whole) * h


def _ways(
    sampled: SampledPlant,
    table: PieceTable,
    cuts: Cuts,
    forces: np.ndarray | None,
    piece: np.ndarray,
    step: np.ndarray,
    offset: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`way`, `Phi` and `Gamma`; measurements within periods are moved to their `piece`."""
    A, B = sampled.plant.A, sampled.plant.B
    n, m = B.shape[1:]
    way, within = np.full(step.size, -1), np.flatnonzero(offset > 0.0)
    if within.size == 0:
        return way, np.zeros((0, n, n)), np.zeros((0, n, m))
    from deadtime.simulation.kernel import ways

    first, stop = table.first[step[within]], table.first[step[within] + 1]
    for more in range(1, int((stop - first).max())):
        q = np.minimum(first + more, stop - 1)
        begun = table.start[table.entry[q]] <= offset[within]
        piece[within] = np.where(begun, q, piece[within])
    pairs = np.column_stack((table.entry[piece[within]], offset[within]))
    distinct, way[within] = np.unique(pairs, axis=0, return_inverse=True)
    if forces is not None:
        B = np.concatenate((B, np.broadcast_to(np.eye(n), A.shape)), axis=2)
    entry, at = distinct[:, 0].astype(np.int64), distinct[:, 1].copy()
    return way, *ways(A, read_only(B), table, cuts.offset, cuts.mode, entry, at)
