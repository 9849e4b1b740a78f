"""Where along a run the measurements lie that its law is told: arrays for the compiled loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.plant import SampledPlant
from deadtime.plant.discretisation import Cuts
from deadtime.plant.pieces import PieceTable
from deadtime.simulation.imperfection_arrays import Arrays, MeasurementLags


class Sight(NamedTuple):
    """What the law's measurement is at every sample.

    piece : (samples,), the piece in which x is measured; −1 where nothing is heard
    step : (samples,), the period of that piece
    way : (samples,), how x follows from the start of the piece; −1 where it is measured there
    Phi : (ways, n, n), Gamma : (ways, n, q), from x and what acts to x; q = m, or m + f with
        the forces of the pieces behind the inputs
    force : (pieces, f) or (pieces, 0)
    noise : (samples, p) or (0, 0), what is added
    C : (modes, p, n), or (1, 0, n) where x is measured itself
    mode : (samples,), that of C
    """

    piece: Int[np.ndarray, " sample"]
    step: Int[np.ndarray, " sample"]
    way: Int[np.ndarray, " sample"]
    Phi: Float[np.ndarray, "way n n"]
    Gamma: Float[np.ndarray, "way n q"]
    force: Float[np.ndarray, "piece f"]
    noise: Float[np.ndarray, "s p"]
    C: Float[np.ndarray, "mode p n"]
    mode: Int[np.ndarray, " sample"]

    @classmethod
    def of(
        cls,
        arrays: Arrays | None,
        sampled: SampledPlant,
        table: PieceTable,
        cuts: Cuts,
        forces: np.ndarray | None,
        through: np.ndarray | None,
        outputs: np.ndarray | None,
        modes: Int[np.ndarray, " sample"],
    ) -> Sight:
        """The sight of a run in which the plant has these modes at the samples."""
        n, m = sampled.plant.B.shape[1:]
        C = np.empty((1, 0, n)) if outputs is None else outputs
        force = np.zeros((table.entry.size, 0)) if forces is None else forces
        heard, noise = np.arange(modes.size), np.empty((0, 0))
        piece = table.first[: modes.size]
        if arrays is not None:
            heard, noise = arrays.heard.sample, arrays.heard.noise
            piece = np.where(heard < 0, -1, table.first[heard])
        if arrays is not None and arrays.lags is not None:
            place = _within(arrays.lags, heard, sampled, table, cuts, through)
        else:
            ways = np.full(heard.size, -1), np.empty((0, n, n)), np.empty((0, n, m))
            place = piece, heard, *ways
        mode = np.zeros(heard.size, np.int64) if outputs is None else modes[heard]
        return cls(*map(read_only, (*place, force, noise, C, mode)))


def _within(
    lags: MeasurementLags,
    heard: np.ndarray,
    sampled: SampledPlant,
    table: PieceTable,
    cuts: Cuts,
    through: np.ndarray | None,
) -> tuple[np.ndarray, ...]:
    """`piece`, `step`, `way`, `Phi` and `Gamma` of measurements that may lie within periods."""
    A, B = sampled.plant.A, sampled.plant.B
    from deadtime.simulation.sight_kernel import ways

    measured, offset = lags.instants(sampled.step, heard.size)
    step = np.where(heard < 0, -1, measured[heard])
    offset = np.where(step < 0, 0.0, offset[heard])
    piece, way, inside = table.first[step], np.full(step.size, -1), np.flatnonzero(offset > 0.0)
    first, stop = table.first[step[inside]], table.first[step[inside] + 1]
    for more in range(1, int((stop - first).max(initial=0))):
        q = np.minimum(first + more, stop - 1)
        begun = table.start[table.entry[q]] <= offset[inside]
        piece[inside] = np.where(begun, q, piece[inside])
    pairs = table.entry[piece[inside]] + 1j * offset[inside]
    distinct, way[inside] = np.unique(pairs, return_inverse=True)
    if through is not None:
        B = read_only(np.concatenate((B, through), axis=2))
    entry, at = distinct.real.astype(np.int64), distinct.imag.copy()
    Phi, Gamma = ways(A, B, table, cuts.offset, cuts.mode, entry, at)
    return np.where(step < 0, -1, piece), step, way, Phi, Gamma
