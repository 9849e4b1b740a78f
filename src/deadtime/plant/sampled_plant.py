"""SampledPlant: a plant at a sampling period, in pieces over which no acting input changes.

An input u_k is held from t_k = k h on and acts a delay later, so within a period several samples of
it act one after the other. A *piece* is a part of a period with constant mode and acting inputs; a
lag per input counts the samples since it was computed. An input of delay D, with N = ⌈D/h⌉ and
φ = D − (N − 1) h (`deadtime.plant.discretisation`), has

    on [t_k, t_k + φ):      lag N          u_{k−N}
    on [t_k + φ, t_{k+1}):  lag N − 1      u_{k−N+1}; empty where φ = h

so a period of a mode is divided at the φ of each of its inputs. Over a whole period

    x_{k+1} = Φ x_k + Σ_l Γ_l u_{k−l},    l over the lags of all pieces.

Along a switching signal pieces end at switches, too: a `PieceTable` has the pieces of many periods,
as arrays for compiled loops.

A mode that depends on the state is not known beforehand. It may change at any instant, and with it
the delays at which inputs are read. With the input as read by each mode as inputs of their own,

    dx/dt = A_σ x + B̃_σ ũ,   ũ = (u as mode 0 reads it, u as mode 1 reads it, …),
    B̃_i = [0 … B_i … 0],

ũ is constant over a stretch of `SampledPlant.cut_alike`, whatever the mode becomes. If all modes
have the same delays, ũ = u and B̃ = B.
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

_KEPT = 100_000  # periods up to which tables are cached; longer ones are too large


@dataclass(frozen=True, eq=False)
class SampledPlant(Frozen):
    """A plant at a sampling period, its modes held over whole periods (immutable).

    Attributes
    ----------
    plant : SwitchedSystem
    step : float
        Sampling period h, seconds.
    alike : bool
        Whether the periods of all modes are divided at the same instants: see `cut_alike`.
    windows : tuple of Window
        The different windows of its delays, by increasing delay.

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
        """A plant at a period; the last ones are cached, so that runs of a plant share tables."""
        return _cached(plant, positive("step", step), alike=False)

    def cut_alike(self) -> SampledPlant:
        """This plant with the periods of all modes divided at the same instants.

        Then a switch within a stretch changes no acting input.

        Examples
        --------
        >>> plant = SwitchedSystem([[[0.0]], [[0.0]]], [[[1.0]], [[1.0]]], delay=[[0.27], [0.15]])
        >>> [part.stop for part in SampledPlant.of(plant, 0.1).cut_alike().stretches(0)]
        [0.04999999999999999, 0.07, 0.1]
        """
        if self.plant.modes_share_delays or self.alike:
            return self
        return _cached(self.plant, self.step, alike=True)

    @property
    def window(self) -> Window:
        """The window of a plant with one delay; an ArgumentError for one with several."""
        if len(self.windows) > 1:
            self.plant.one_delay("a single window of inputs in flight")
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
        # stretch: | mode 0: first[0] … | mode 1: first[1] … | …
        return Stretches(*map(read_only, (first, np.array(start), np.array(stop), np.array(lag))))

    @cached_property
    def ahead(self) -> Ahead:
        """The stretches until an input computed now arrives."""
        step, count, phase = self.window.step, self.window.count, self.window.phase
        stop = phase + np.arange(count) * step
        start = np.concatenate(([0.0], stop[:-1]))
        lag = np.repeat(np.arange(count, 0, -1)[:, None], self.plant.inputs, axis=1)
        kind = (np.arange(count) > 0).astype(np.int64)
        return Ahead(*map(read_only, (start, stop, lag, np.array([phase, step]), kind)))

    def along(self, cuts: Cuts, periods: int) -> PieceTable:
        """The pieces of the periods 0, …, periods − 1 along a switching signal.

        The last tables are cached, unless they are long, so that runs along one signal share them.
        """
        return (_kept_along if periods <= _KEPT else _along)(self, cuts, periods)

    def gramians_along(
        self, cuts: Cuts, periods: int, Q: Float[np.ndarray, "n n"]
    ) -> Float[np.ndarray, "entry q q"]:
        """M of every entry of `along`: ∫xᵀQx dt = zᵀMz over it, z = (x, u) at its start."""
        work = _kept_gramians if periods <= _KEPT else _gramians
        return work(self, cuts, periods, Q.tobytes())

    @cached_property
    def _whole(self) -> tuple[np.ndarray, np.ndarray]:
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

        The lags are those of all modes, the oldest input first; Γ is 0 for lags that a mode lacks.
        """
        each = [self.period(mode) for mode in range(self.plant.modes)]
        # Lags decrease, and searchsorted needs increasing values: hence the minus signs.
        lag = np.unique(np.concatenate([period.lags for period in each]))[::-1]
        Gamma = np.zeros((len(each), lag.size, *self.plant.B.shape[1:]))
        for mode, period in enumerate(each):
            Gamma[mode, np.searchsorted(-lag, -np.array(period.lags))] = period.Gamma
        return np.stack([period.Phi for period in each]), Gamma, lag

    def cut_period(self, mode: int, after: int, offset: float) -> Period:
        """A period that begins in one mode and switches to another after `offset` seconds.

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
def _cached(plant: SwitchedSystem, step: float, *, alike: bool) -> SampledPlant:
    return SampledPlant(plant, step, alike)


def _composed(pieces: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Period:
    """The period that consists of these pieces, given as (Φ, Γ, lags)."""
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
    """The acting inputs of a piece, from the inputs u_k, u_{k−1}, ….

    Examples
    --------
    >>> acting_inputs(np.array([2, 0]), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]))
    array([5., 2.])
    """
    return np.array([inputs[k][j] for j, k in enumerate(lag)])


class EveryReading(NamedTuple):
    """A plant with the inputs ũ of the module's docstring.

    plant : SwitchedSystem
        With the inputs ũ; its delays are meaningless.
    stretches : tuple of Stretch
        The stretches of a period in any mode; `lag` (inputs of ũ,).
    readers : int
        Number of modes in ũ: all, or 1 where they have the same delays.
    """

    plant: SwitchedSystem
    stretches: tuple[Stretch, ...]
    readers: int

    @classmethod
    def of(cls, sampled: SampledPlant) -> EveryReading:
        """The plant with the inputs ũ, from one with all periods `cut_alike`.

        Examples
        --------
        >>> plant = SwitchedSystem([[[0.0]], [[1.0]]], [[[1.0]], [[2.0]]], delay=[[0.2], [0.1]])
        >>> every = EveryReading.of(SampledPlant(plant, 0.1).cut_alike())
        >>> every.plant.B.tolist(), every.stretches[0].lag
        ([[[1.0, 0.0]], [[0.0, 2.0]]], array([2, 1]))
        """
        plant = sampled.plant
        if plant.modes_share_delays:
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
