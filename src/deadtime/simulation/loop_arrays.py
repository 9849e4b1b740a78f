"""Arrays that the digital loop reads and fills; everything random is drawn before.

The delay line; the rows of the law, or the pieces over which a law with a preview predicts; and the
instants, noise and limits that imperfections cause.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.feedback import Preview
from deadtime.loop.preview_steps import PreviewSizes, PreviewState
from deadtime.loop.received_samples import DrawnImperfections, lags_of_run
from deadtime.numerics.kernels import kernel
from deadtime.plant.pieces import up_to
from deadtime.simulation.truth import Grid, KnownTruth
from deadtime.switching.grid import cuts_of

LIMIT = 1e100  # of |x|, beyond which a run has diverged


class Rows(NamedTuple):
    """The rows of a law's table for the compiled loop: F (contexts, m, n), G (contexts, m, taps·m)
    with the oldest input first, the row of every sample, and the mode that an observer uses.
    """

    F: np.ndarray
    G: np.ndarray
    row: np.ndarray
    mode: np.ndarray


class DelayLine(NamedTuple):
    """Inputs of the delay line, and the signals of the law at every sample.

    inputs : (past + samples, m), applied to the plant; `asked`: commanded by the law;
        `known_inputs`: read by the law as its past inputs. All three are one array where every
        command is applied.
    measured : (samples, n or p), received by the law, NaN where nothing arrives
    estimates : (samples, z), of a law with an observer;  beliefs : (samples, modes), with a belief

        row        0 …  past − 1 | past      past + 1   …  past + samples − 1
        content    u_{−past} … u_{−1} | u_0       u_1        …
                   history            | filled by the run
    """

    past: int
    inputs: np.ndarray
    asked: np.ndarray
    known_inputs: np.ndarray
    measured: np.ndarray
    estimates: np.ndarray
    beliefs: np.ndarray

    @classmethod
    def of(
        cls,
        grid: Grid,
        drawn: DrawnImperfections | None,
        measured: int,
        memory_size: int,
        modes: int,
    ) -> DelayLine:
        """A line before its run, for states or outputs, a memory and a belief of these sizes."""
        inputs, samples = grid.inputs, grid.samples
        limited = drawn is not None and drawn.limits.relative.size
        asked = inputs.copy() if limited else inputs
        known_inputs = asked if drawn is not None and drawn.commanded else inputs
        estimates = np.empty((samples if memory_size else 0, memory_size))
        own = np.empty((samples, measured)), estimates, np.empty((samples, modes))
        return cls(grid.past, inputs, asked, known_inputs, *own)


class MeasurementInstants(NamedTuple):
    """The measurement instant of the law at every sample, and the map to it.

    piece : (samples,), the piece in which x is measured; −1 where nothing is received
    step : (samples,), the period of that piece
    way : (samples,), the map from the start of the piece to the instant; −1 at the start itself
    Phi : (ways, n, n), Gamma : (ways, n, q), the maps of x and of the inputs; q = m, or m + f with
        the forces of the piece behind the inputs
    force : (pieces, f) or (pieces, 0)
    noise : (samples, p) or (0, 0), added to it
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
        cls, drawn: DrawnImperfections | None, truth: KnownTruth, outputs: np.ndarray | None
    ) -> MeasurementInstants:
        """The measurements of a run."""
        sampled, table, samples = truth.grid.sampled, truth.table, truth.grid.samples
        n, m = sampled.plant.B.shape[1:]
        C = np.empty((1, 0, n)) if outputs is None else outputs
        force = np.zeros((table.entry.size, 0)) if truth.forces is None else truth.forces
        received, noise = np.arange(samples), np.empty((0, 0))
        step, piece = received, table.first[:samples]
        ways = np.full(samples, -1), np.empty((0, n, n)), np.empty((0, n, m))
        if drawn is not None:
            received, noise = drawn.received.sample, drawn.received.noise
            lag, offset = lags_of_run(received, drawn.lags, sampled.step)
            step = np.where(lag < 0, -1, np.arange(samples) - lag)
            piece = np.where(lag < 0, -1, table.first[step])
            if offset.any():
                piece, *ways = _within(piece, step, offset, truth)
        mode = np.zeros(samples, np.int64) if outputs is None else truth.modes[received]
        return cls(*map(read_only, (piece, step, *ways, force, noise, C, mode)))


@kernel
def ways(A, B, table, cut_offset, cut_mode, entry, offset):
    """Φ and Γ of entries from their starts up to `offset` seconds after their period's sample."""
    n, m = B.shape[1:]
    Phi, Gamma = np.empty((entry.size, n, n)), np.empty((entry.size, n, m))
    for v in range(entry.size):
        one_Phi, one_Gamma = up_to(A, B, table, cut_offset, cut_mode, entry[v], offset[v])
        for i in range(n):
            for j in range(n):
                Phi[v, i, j] = one_Phi[i, j]
            for j in range(m):
                Gamma[v, i, j] = one_Gamma[i, j]
    return Phi, Gamma


def _within(
    piece: Int[np.ndarray, " sample"],
    step: Int[np.ndarray, " sample"],
    offset: Float[np.ndarray, " sample"],
    truth: KnownTruth,
) -> tuple[np.ndarray, ...]:
    """`piece`, `way`, `Phi` and `Gamma` of measurements that may lie within periods."""
    table, cuts = truth.table, truth.cuts
    way, inside = np.full(step.size, -1), np.flatnonzero(offset > 0.0)
    first, stop = table.first[step[inside]], table.first[step[inside] + 1]
    for more in range(1, int((stop - first).max(initial=0))):
        # Piece by piece, for all samples at once: periods have two or three pieces.
        q = np.minimum(first + more, stop - 1)
        begun = table.start[table.entry[q]] <= offset[inside]
        piece[inside] = np.where(begun, q, piece[inside])
    # An entry and an offset in one complex number: `unique` of rows is many times slower.
    pairs = table.entry[piece[inside]] + 1j * offset[inside]
    distinct, way[inside] = np.unique(pairs, return_inverse=True)
    entry, at = distinct.real.astype(np.int64), distinct.imag.copy()
    return piece, way, *ways(*truth.driven, table, cuts.offset, cuts.mode, entry, at)


class PreviewLaw(NamedTuple):
    """A law that knows the signal, for `answer_with_preview`.

    move : (entries, n (n + m)), [Φ Γ] of the model's pieces along the signal
    piece : (pieces, 1 + m), the entry of each, and for each input the k of the u_k that acts in it
    window : (samples, 2), the first piece from t_k on, and the first in which u_k acts
    tails : (modes, m (n + m)), [K L]
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
    def of(cls, preview: Preview, truth: KnownTruth) -> PreviewLaw:
        """A law's preview over a run, with empty stacks that have room for the longest window."""
        sampled, signal, samples = preview.sampled, preview.signal, truth.grid.samples
        if sampled is truth.grid.sampled and signal is truth.switching:
            table = truth.table
        else:
            cuts = cuts_of(signal, sampled)
            table = sampled.along(cuts, samples + sampled.longest_lag)
        sample, begin, (modes, m, n) = table.sample, table.first[:samples], preview.gains.shape
        until = np.searchsorted(sample.min(axis=1), np.arange(samples))
        latest = np.broadcast_to(preview.latest, (modes, m, m))
        move = np.concatenate((table.Phi, table.Gamma), axis=2)
        return cls(
            read_only(move.reshape(-1, n * (n + m))),
            read_only(np.column_stack((table.entry, sample))),
            read_only(np.column_stack((begin, until))),
            read_only(np.concatenate((preview.gains, latest), axis=2).reshape(modes, -1)),
            read_only(preview.modes_ahead(samples)),
            PreviewState.of(PreviewSizes.of(n, m, m), int((until - begin).max())),
        )
