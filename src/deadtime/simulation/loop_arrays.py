"""Arrays that the digital loop reads and fills.

Its grid and its delay line, the rows of its law or the pieces that a law with a preview predicts
over, and what imperfections make of measurements, modes and inputs, all that is random drawn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Foresight, Law
from deadtime.imperfections import (
    Heard,
    Imperfection,
    Relaying,
    Sizes,
    TimingImperfection,
)
from deadtime.imperfections.received import is_known, relayed
from deadtime.imperfections.sensors_and_actuators import InputLimits
from deadtime.loop.preview_steps import PreviewSizes, PreviewState
from deadtime.loop.received_samples import MeasurementLags, lags_of, lags_of_run
from deadtime.numerics.kernels import kernel
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.discretisation import Cuts, snap
from deadtime.plant.pieces import PieceTable, up_to
from deadtime.simulation.initial_input import InitialInput, held_samples
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import cuts_of

Pairs = Sequence[tuple[Imperfection, np.random.Generator]]  # imperfections and their streams


def lags_among(pairs: Pairs, sizes: Sizes, samples: int) -> MeasurementLags | None:
    """The measurement lags of a run, None where every state is measured at its sample."""
    timings = [(each, rng) for each, rng in pairs if isinstance(each, TimingImperfection)]
    if not timings:
        return None
    return MeasurementLags.of(
        (each, lags_of(each, sizes, samples, rng)[None]) for each, rng in timings
    )


class Arrays(NamedTuple):
    """The imperfections of a run as arrays, all draws made; independent of plant and signal.

    Attributes
    ----------
    commanded : bool
        Whether the law takes the inputs that it asked for to be those applied.
    """

    heard: Heard
    lags: MeasurementLags | None
    limits: InputLimits
    commanded: bool

    @classmethod
    def of(cls, pairs: Pairs, sizes: Sizes, samples: int, predict: str) -> Arrays:
        """The arrays of a run; everything random is drawn from the streams."""
        commanded, heard = tells_commands(predict), heard_of(pairs, sizes, samples)
        lags = lags_among(pairs, sizes, samples)
        return cls(heard, lags, InputLimits.of([each for each, _ in pairs], sizes), commanded)


def heard_of(pairs: Pairs, sizes: Sizes, samples: int) -> Heard:
    """The measurements received through all sensors among them, one after the other."""
    heard = Heard.perfect(samples, sizes)
    for each, rng in pairs:
        if isinstance(each, Relaying):
            heard = relayed(each, heard, sizes, rng)
    return heard


def tells_commands(predict: str) -> bool:
    """Whether the law's past inputs are those asked for."""
    if predict not in ("applied", "commanded"):
        raise ArgumentError(f'predict must be "applied" or "commanded", got {predict!r}.')
    return predict == "commanded"


def takes(pairs: Pairs) -> bool:
    """Whether the compiled loop takes them all.

    Examples
    --------
    >>> from deadtime.imperfections import Dropout, Noise, SensorImperfection
    >>> class Own(SensorImperfection):
    ...     def sensor(self, sizes, rng):
    ...         return lambda seen: seen
    >>> rng = np.random.default_rng(0)
    >>> takes([(Noise(0.1), rng), (Dropout(0.1), rng)]), takes([(Noise(0.1), rng), (Own(), rng)])
    (True, False)
    """
    return all(is_known(each) for each, _ in pairs)


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
    """The inputs of the delay line, (past + samples, m), u_k in row past + k, and their sources.

    The law asks for `asked`, the plant is given `inputs`, and the law is `told` past inputs: all
    three are one array where what is asked for is applied. What is `measured` (samples, n or p) is
    what reaches the law, and a law with a memory makes `estimates` (samples, z) of it, and one on a
    belief `beliefs` (samples, modes).
    """

    past: int
    inputs: np.ndarray
    asked: np.ndarray
    told: np.ndarray
    measured: np.ndarray
    estimates: np.ndarray
    beliefs: np.ndarray

    @classmethod
    def of(
        cls, grid: Grid, arrays: Arrays | None, measured: int, remembered: int, believed: int
    ) -> DelayLine:
        """A line before its run, for states or outputs, a memory and a belief of these sizes."""
        inputs, samples = grid.inputs, grid.samples
        limited = arrays is not None and arrays.limits.relative.size
        asked = inputs.copy() if limited else inputs
        told = asked if arrays is not None and arrays.commanded else inputs
        sizes = (samples, measured), (samples if remembered else 0, remembered), (samples, believed)
        return cls(grid.past, inputs, asked, told, *map(np.empty, sizes))


@dataclass(frozen=True, eq=False)
class Grid:
    """The samples of a run: how many, the plant at its period, and the inputs, history first.

    Attributes
    ----------
    inputs : (past + samples, m)
        u_k is inputs[past + k]; filled by the run from row `past` on.
    """

    sampled: SampledPlant
    samples: int
    past: int
    inputs: np.ndarray

    @classmethod
    def of(
        cls, plant: SwitchedSystem, law: Law, horizon: float, step: float, u0: InitialInput
    ) -> Grid:
        """The grid of a run on [0, horizon], its history read from `simulate`'s u0."""
        sampled = SampledPlant.of(plant, step)
        samples = math.floor(snap(horizon / step)) + 1
        past = max(sampled.longest_lag, law.sampled_plant(step).longest_lag)
        inputs = np.zeros((past + samples, plant.inputs))
        longest = max(plant.longest_delay, law.plant.longest_delay)
        inputs[:past] = held_samples(u0, plant.inputs, past, step, longest)
        return cls(sampled, samples, past, inputs)

    @property
    def periods(self) -> int:
        """How many periods the plant is moved: on until nothing that is in flight is left."""
        return self.samples + self.sampled.longest_lag

    def acting(self, k: int, lag: np.ndarray) -> np.ndarray:
        """The inputs that act in period k, as many samples old as their lags say.

        Lags (m,), or those of several modes side by side (`deadtime.plant.sampled_plant`).
        """
        return self.inputs[self.past + k - lag, np.arange(lag.size) % self.inputs.shape[1]]


class Sight(NamedTuple):
    """The measurement instant of the law at every sample, and the map to it.

    piece : (samples,), the piece in which x is measured; −1 where nothing is received
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
        """The measurements of a run in which the plant has these modes at the samples."""
        n, m = sampled.plant.B.shape[1:]
        C = np.empty((1, 0, n)) if outputs is None else outputs
        force = np.zeros((table.entry.size, 0)) if forces is None else forces
        heard, noise = np.arange(modes.size), np.empty((0, 0))
        step, piece = heard, table.first[: modes.size]
        ways = np.full(heard.size, -1), np.empty((0, n, n)), np.empty((0, n, m))
        if arrays is not None:
            heard, noise = arrays.heard.sample, arrays.heard.noise
            lag, offset = lags_of_run(heard, arrays.lags, sampled.step)
            step = np.where(lag < 0, -1, np.arange(heard.size) - lag)
            piece = np.where(lag < 0, -1, table.first[step])
            if offset.any():
                piece, *ways = _within(piece, step, offset, sampled, table, cuts, through)
        mode = np.zeros(heard.size, np.int64) if outputs is None else modes[heard]
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
    sampled: SampledPlant,
    table: PieceTable,
    cuts: Cuts,
    through: np.ndarray | None,
) -> tuple[np.ndarray, ...]:
    """`piece`, `way`, `Phi` and `Gamma` of measurements that may lie within periods."""
    A, B = sampled.plant.A, sampled.plant.B
    way, inside = np.full(step.size, -1), np.flatnonzero(offset > 0.0)
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
    return piece, way, *ways(A, B, table, cuts.offset, cuts.mode, entry, at)


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
        """A law's preview over a run, with empty stacks that have room for the longest window."""
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
        return cls(
            read_only(move.reshape(-1, n * (n + m))),
            read_only(np.column_stack((table.entry, sample))),
            read_only(np.column_stack((begin, until))),
            read_only(np.concatenate((foresight.gains, latest), axis=2).reshape(modes, -1)),
            read_only(foresight.modes_ahead(samples)),
            PreviewState.of(PreviewSizes.of(n, m, m), int((until - begin).max())),
        )
