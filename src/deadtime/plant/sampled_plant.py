"""SampledPlant: a plant at a sampling period, as the pieces in which nothing that acts changes.

An input u_k is held from t_k = k h on and reaches the plant a delay later, so within a period
different samples of it act one after the other. A *piece* is a stretch of a period in which the
mode and all acting inputs stay; its lags say how many samples before the period's own they were
computed. An input of delay D, N = ⌈D/h⌉ and φ = D − (N − 1) h (`deadtime.plant.discretisation`), is

    on [t_k, t_k + φ):      that of t_{k−N}       lag N
    on [t_k + φ, t_{k+1}):  that of t_{k−N+1}     lag N − 1, nothing of it where φ = h

so a period of a mode is cut at the φ of each of its inputs. Over a whole one, with the pieces' Φ
and Γ,

    x_{k+1} = Φ x_k + Σ_l Γ_l u_{k−l},    l over the lags of all pieces.

Along a switching signal pieces end at switches, too: a `PieceTable` has those of many periods, as
arrays for compiled loops. Whoever needs to know what acts when reads pieces or periods, and works
out neither.

A mode that the state decides is not known beforehand. It may change within a stretch of a period,
and with it the delays with which inputs are read. With what each mode reads as inputs of its own,

    dx/dt = A_σ x + B̃_σ ũ,   ũ = (u as mode 0 reads it, u as mode 1 does, …),   B̃_i = [0 … B_i … 0],

nothing that acts changes over a stretch of `SampledPlant.cut_alike`, whatever the mode becomes.
Where all modes have the same delays they all read one u: ũ = u, B̃ = B.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import positive, read_only
from deadtime.base.frozen import Frozen
from deadtime.plant.discretisation import Cuts, Window, require_step, windows_of
from deadtime.plant.pieces import (
    Ahead,
    Period,
    Piece,
    PieceTable,
    Stretch,
    Stretches,
    gramians,
    pieces_along,
    whole_stretches,
)
from deadtime.plant.switched_system import SwitchedSystem

_KEPT = 100_000  # periods; of more, tables are too large to lie about


@dataclass(frozen=True, eq=False)
class SampledPlant(Frozen):
    """A plant at a sampling period, its modes held over whole periods (immutable).

    Attributes
    ----------
    plant : SwitchedSystem
    step : float
        Sampling period h, seconds.
    alike : bool
        Whether periods of every mode are cut where those of any mode are, so that stretch number p
        is the same time in all modes: see `cut_alike`.
    windows : tuple of Window
        The windows of its delays, each once, those of shorter delays first.

    Raises
    ------
    ArgumentError
        If the step is not positive, or too short or too long for the plant.

    Examples
    --------
    >>> plant = SwitchedSystem([[[0.0]]], [[[1.0]]], delay=0.27)
    >>> for piece in SampledPlant(plant, 0.1).pieces(0):
    ...     print(round(piece.Gamma.item(), 12), piece.stretch.lag)
    0.07 [3]
    0.03 [2]
    >>> SampledPlant(plant, 0.1).period(0).lags
    (3, 2)
    """

    plant: SwitchedSystem
    step: float
    alike: bool = field(default=False, repr=False)
    windows: Sequence[Window] = field(init=False, repr=False)
    _by_mode: list[list[Window]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        step = require_step(self.plant, self.step)
        by_mode = windows_of(self.plant, step)
        windows = {window.delay: window for row in by_mode for window in row}
        ordered = tuple(windows[delay] for delay in sorted(windows))
        vars(self).update(step=step, windows=ordered, _by_mode=by_mode)
        super().__post_init__()

    @classmethod
    def of(cls, plant: SwitchedSystem, step: float) -> SampledPlant:
        """The one of a plant and a period that was made before, if it was one of the last.

        So runs of one plant share what it works out.
        """
        return _made_before(plant, positive("step", step), alike=False)

    def cut_alike(self) -> SampledPlant:
        """This plant with the periods of all modes cut at the same instants, if they are not yet.

        So a stretch can be moved over whatever the mode becomes within it.

        Examples
        --------
        >>> plant = SwitchedSystem([[[0.0]], [[0.0]]], [[[1.0]], [[1.0]]], delay=[[0.27], [0.15]])
        >>> [part.stop for part in SampledPlant.of(plant, 0.1).cut_alike().stretches(0)]
        [0.04999999999999999, 0.07, 0.1]
        """
        same = (self.plant.delays == self.plant.delays[0]).all()
        return self if same or self.alike else _made_before(self.plant, self.step, alike=True)

    @property
    def window(self) -> Window:
        """The window of the one delay; of several there are `windows`, and none is it."""
        if len(self.windows) > 1:
            self.plant.one_delay("what asks for its window")
        return self.windows[-1]

    @property
    def longest_lag(self) -> int:
        """N: no input older than u_{k−N} acts in period k."""
        return self.windows[-1].count

    def stretches(self, mode: int) -> tuple[Stretch, ...]:
        """The stretches of a period in which a mode is held, in order."""
        windows = self._by_mode[mode]
        cutting = self.windows if self.alike else windows
        ends = sorted({self.step, *(window.phase for window in cutting)})
        starts = [0.0, *ends[:-1]]
        lags = [
            read_only(np.array([w.count - (start >= w.phase) for w in windows], np.int64))
            for start in starts
        ]
        return tuple(map(Stretch, starts, ends, lags))

    @cached_property
    def every_stretch(self) -> Stretches:
        """The stretches of all modes."""
        parts = [self.stretches(mode) for mode in range(self.plant.modes)]
        start, stop, lag = zip(*(part for mode in parts for part in mode), strict=True)
        first = np.cumsum([0, *map(len, parts)])
        return Stretches(*map(read_only, (first, np.array(start), np.array(stop), np.array(lag))))

    @cached_property
    def ahead(self) -> Ahead:
        """The inputs that act until one computed now arrives."""
        step, count, phase = self.window.step, self.window.count, self.window.phase
        stop = phase + np.arange(count) * step
        start = np.concatenate(([0.0], stop[:-1]))
        lag = np.repeat(np.arange(count, 0, -1)[:, None], self.plant.inputs, axis=1)
        kind = (np.arange(count) > 0).astype(np.int64)
        return Ahead(*map(read_only, (start, stop, lag, np.array([phase, step]), kind)))

    def along(self, cuts: Cuts, periods: int) -> PieceTable:
        """The pieces of the periods 0, …, periods − 1 along a switching signal.

        Runs along one signal share them: the last are kept, unless they are long.
        """
        return (_kept_along if periods <= _KEPT else _along)(self, cuts, periods)

    def gramians_along(
        self, cuts: Cuts, periods: int, Q: Float[np.ndarray, "n n"]
    ) -> Float[np.ndarray, "entry q q"]:
        """M of every entry of `along`: ∫xᵀQx = zᵀMz over it, z = (x, u) at its start."""
        work = _kept_gramians if periods <= _KEPT else _gramians
        return work(self, cuts, periods, Q.tobytes())

    @cached_property
    def _whole(self) -> tuple[np.ndarray, np.ndarray]:
        """Φ and Γ of the stretches."""
        return whole_stretches(self.plant.A, self.plant.B, self.every_stretch)

    def pieces(self, mode: int) -> tuple[Piece, ...]:
        """The pieces of a period in which a mode is held, in order."""
        from deadtime.numerics.exponential import discretise

        A, B = self.plant.A[mode], self.plant.B[mode]
        pieces = []
        for part in self.stretches(mode):
            Phi, Gamma = discretise(A, B, part.stop - part.start)
            pieces.append(Piece(read_only(Phi), read_only(Gamma), part))
        return tuple(pieces)

    def period(self, mode: int) -> Period:
        """A whole period in which a mode is held."""
        return _composed([(p.Phi, p.Gamma, p.stretch.lag) for p in self.pieces(mode)])

    def periods(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Whole periods in every mode: Φ (modes, n, n), Γ (modes, lags, n, m) and the lags.

        The inputs u_{k−lag} that act in some mode, the oldest first; Γ is 0 in the others.
        """
        each = [self.period(mode) for mode in range(self.plant.modes)]
        lag = np.unique(np.concatenate([period.lags for period in each]))[::-1]
        Gamma = np.zeros((len(each), lag.size, *self.plant.B.shape[1:]))
        for mode, period in enumerate(each):
            Gamma[mode, np.searchsorted(-lag, -np.array(period.lags))] = period.Gamma
        return np.stack([period.Phi for period in each]), Gamma, lag

    def cut_period(self, mode: int, after: int, offset: float) -> Period:
        """A period that begins in a mode and goes over to another one, `offset` seconds in.

        Examples
        --------
        >>> plant = SwitchedSystem([[[0.0]], [[0.0]]], [[[1.0]], [[3.0]]], delay=0.1)
        >>> SampledPlant.of(plant, 0.1).cut_period(0, 1, 0.05).Gamma.round(12)
        array([[[0.2]]])
        """
        cuts = Cuts(np.array([0]), np.array([offset]), np.array([mode, after]))
        table = self.along(cuts, 1)
        return _composed([(table.Phi[e], table.Gamma[e], table.lag[e]) for e in table.entry])


def _along(sampled: SampledPlant, cuts: Cuts, periods: int) -> PieceTable:
    A, B = sampled.plant.A, sampled.plant.B
    place = cuts.step, cuts.offset, cuts.mode
    table = pieces_along(A, B, sampled.every_stretch, *place, periods, sampled._whole)
    return PieceTable(*map(read_only, table))


def _gramians(sampled: SampledPlant, cuts: Cuts, periods: int, Q: bytes) -> np.ndarray:
    (A, B), table = (sampled.plant.A, sampled.plant.B), sampled.along(cuts, periods)
    weight = read_only(np.frombuffer(Q).reshape(A.shape[1:]))
    return read_only(gramians(A, B, table, cuts.offset, cuts.mode, weight))


_kept_along = lru_cache(maxsize=2)(_along)
_kept_gramians = lru_cache(maxsize=2)(_gramians)


@lru_cache(maxsize=16)
def _made_before(plant: SwitchedSystem, step: float, *, alike: bool) -> SampledPlant:
    return SampledPlant(plant, step, alike)


def _composed(pieces: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Period:
    """The whole of pieces that follow each other, as (Φ, Γ, lags) each."""
    (Phi, first, lags), *others = pieces
    Gamma = _by_lag(first, lags)
    for part, arriving, lags in others:
        Phi = part @ Phi
        Gamma = {lag: part @ arrived for lag, arrived in Gamma.items()}
        for lag, own in _by_lag(arriving, lags).items():
            Gamma[lag] = Gamma.get(lag, np.zeros(arriving.shape)) + own
    acting = tuple(sorted(Gamma, reverse=True))
    return Period(read_only(Phi), read_only(np.stack([Gamma[lag] for lag in acting])), acting)


def _by_lag(
    Gamma: Float[np.ndarray, "n m"], lags: Int[np.ndarray, " m"]
) -> dict[int, Float[np.ndarray, "n m"]]:
    """Γ of a piece, the columns of inputs of the same lag together."""
    return {int(lag): np.where(lags == lag, Gamma, 0.0) for lag in np.unique(lags)}


def acting_inputs(
    lag: Int[np.ndarray, " m"], inputs: Sequence[np.ndarray] | np.ndarray
) -> Float[np.ndarray, " m"]:
    """The inputs that act in a piece; `inputs` are u_k, u_{k−1}, …, the latest first.

    Examples
    --------
    >>> acting_inputs(np.array([2, 0]), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]))
    array([5., 2.])
    """
    return np.array([inputs[k][j] for j, k in enumerate(lag)])


class EveryReading(NamedTuple):
    """A plant under what every mode reads.

    plant : SwitchedSystem
        With the inputs ũ; nobody reads its delays.
    stretches : tuple of Stretch
        Of a period, in any mode; `lag` (inputs of ũ,).
    readers : int
        How many modes stand side by side in ũ: all, or 1 where they read alike.
    """

    plant: SwitchedSystem
    stretches: tuple[Stretch, ...]
    readers: int

    @classmethod
    def of(cls, sampled: SampledPlant) -> EveryReading:
        """Of a plant whose periods are cut alike in all modes.

        Examples
        --------
        >>> plant = SwitchedSystem([[[0.0]], [[1.0]]], [[[1.0]], [[2.0]]], delay=[[0.2], [0.1]])
        >>> every = EveryReading.of(SampledPlant(plant, 0.1).cut_alike())
        >>> every.plant.B.tolist(), every.stretches[0].lag
        ([[[1.0, 0.0]], [[0.0, 2.0]]], array([2, 1]))
        """
        plant = sampled.plant
        if (plant.delays == plant.delays[0]).all():
            return cls(plant, sampled.stretches(0), 1)
        modes, n, m = plant.B.shape
        B = np.zeros((modes, n, modes, m))
        B[np.arange(modes), :, np.arange(modes)] = plant.B
        by_mode = [sampled.stretches(mode) for mode in range(modes)]
        stretches = tuple(
            parts[0]._replace(lag=read_only(np.concatenate([part.lag for part in parts])))
            for parts in zip(*by_mode, strict=True)
        )
        delays = np.tile(plant.delays.ravel(), (modes, 1))
        return cls(plant.like(plant.A, B.reshape(modes, n, -1), delays), stretches, modes)
