"""The loop that a batch engine runs, with the scenarios' signals sampled on its grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.feedback.table import OLDEST
from deadtime.imperfections import Limiting
from deadtime.numerics.covariance import square_root
from deadtime.plant import SampledPlant, SwitchedSystem, Weight
from deadtime.plant.discretisation import snap, snap_all
from deadtime.scenarios.periods import (
    WIDE,
    Acting,
    CellSeries,
    Maps,
    Records,
    SignalPeriods,
    acting_of,
    balanced_norm,
    pack,
    tables_of,
    whole_periods,
)
from deadtime.simulation.trajectory import LATE
from deadtime.switching import SignalBatch

_CELLS = 1024  # of a period, at most: beyond, the plant is too fast for series


@dataclass(frozen=True, eq=False)
class Loop:
    """The plant, the periods of its run, and the limits of its inputs.

    Attributes
    ----------
    sampled : SampledPlant
    x0 : (n,)
    horizon : float
        Seconds.
    whole : int
        K, periods within the horizon; samples are t_0, …, t_K.
    rest : float
        Seconds from t_K to the horizon, in [0, h).
    actuators : sequence of Limiting
    weight : Weight or None
        Q and R of the ise and energy that engines measure; None for the identity.
    forced : bool
        Whether disturbances act.
    """

    sampled: SampledPlant
    x0: Float[np.ndarray, " n"]
    horizon: float
    actuators: Sequence[Limiting] = ()
    weight: Weight | None = None
    forced: bool = False

    @property
    def plant(self) -> SwitchedSystem:
        return self.sampled.plant

    @property
    def step(self) -> float:
        return self.sampled.step

    @cached_property
    def acting(self) -> Acting:
        """The inputs, and forces if any, that act on the plant over a period."""
        return acting_of(self.sampled, self.forced)

    @cached_property
    def whole(self) -> int:
        return math.floor(snap(self.horizon / self.step))

    @cached_property
    def rest(self) -> float:
        ratio = snap(self.horizon / self.step)
        return 0.0 if ratio == self.whole else self.horizon - self.whole * self.step

    @cached_property
    def late(self) -> int:
        """The first sample of the second half."""
        step, half = self.step, 0.5 * self.horizon
        # The quotient may be off by a rounding: the comparison of `simulate` decides.
        first = max(0, math.floor(half / step) - 1)
        return next(k for k in range(first, first + 4) if k * step >= half)

    @cached_property
    def late_times(self) -> Float[np.ndarray, " time"] | None:
        """Instants of |x| for the decay rate, if the second half has too few samples."""
        samples = self.whole + 1 - self.late + (self.rest > 0.0)
        if samples >= LATE:
            return None
        return read_only(np.linspace(0.5 * self.horizon, self.horizon, LATE))

    @cached_property
    def root(self) -> Float[np.ndarray, "rows m"]:
        """L with LᵀL = R, so that engines sum |L u|²; empty for R = I."""
        if self.weight is None:
            return np.zeros((0, self.plant.inputs))
        return read_only(square_root(self.weight.R).T)

    @cached_property
    def maps(self) -> Maps:
        """The maps of periods without a switch."""
        return whole_periods(self.sampled, self.acting, self.weight)

    @cached_property
    def tables(self) -> CellSeries | None:
        """The series of periods with a switch; None if the plant is too fast for them."""
        if self.cells > _CELLS:
            return None
        return tables_of(self.sampled, self.cells, self.weight, self.forced)

    @cached_property
    def cells(self) -> int:
        """Cells of a period, each with its own series: a power of two, about ‖A‖h."""
        size = max(map(balanced_norm, self.plant.A)) * self.step
        return 1 << max(0, math.ceil(math.log2(max(size, 1.0))))

    def place(self, signals: SignalBatch) -> Records:
        """The periods in which the switches of signals fall, and the instants within them."""
        from deadtime.scenarios.by_period import sample_signals

        grid = self.whole + 1, self.step, self.acting, self.plant.modes
        return sample_signals(signals.first, signals.times, signals.modes, *grid)

    def sample_signals(self, signals: SignalBatch) -> SignalPeriods:
        """Signals sampled on the periods up to the horizon.

        maps :  0 … modes − 1 | modes, modes + 1, …
                whole periods | cut periods, in the order of `Records.sojourn`
        """
        records, tables = self.place(signals), self.tables
        assert tables is not None
        modes = self.plant.modes
        own = np.concatenate((self.maps.move.reshape(modes, -1), pack(self.maps.energy)), axis=1)
        maps = np.empty((modes + records.sojourn.size, tables.width))
        maps[:modes] = 0.0
        maps[:modes, : own.shape[1]] = own
        self._fill_cuts(maps[modes:], records, signals.modes, tables)
        ages = np.floor(snap_all(np.minimum(signals.initial_age / self.step, OLDEST)))
        return SignalPeriods(records, maps, ages.astype(np.int64))

    def _fill_cuts(
        self, maps: np.ndarray, records: Records, modes: np.ndarray, tables: CellSeries
    ) -> None:
        """Fill in the cut periods: with one switch from series, the others piece by piece."""
        from deadtime.scenarios.by_period import compose_cuts, fill_series

        last, series, acting = records.last, tables.switched, self.acting
        # Series are of whole periods: the last one ends at the horizon.
        alone = ~last & (records.until - records.sojourn == 2) & (series.shape[2] > 0)
        which, width = np.flatnonzero(alone), (0.0,) * (tables.width // WIDE)
        i = records.sojourn[which].astype(np.int64)
        pair = modes[i] * np.int64(self.plant.modes) + modes[i + 1]
        fill_series(maps, which, pair, records.at[i + 1], acting.edges, series, width)
        left = ~alone
        # A horizon at a sample leaves nothing of the last period: x stays, and costs nothing.
        if self.rest == 0.0:
            left &= ~last
            n = acting.states * acting.wide
            maps[last] = 0.0
            maps[last, :n] = np.eye(acting.states, acting.wide).ravel()
        if left.any():
            which = np.flatnonzero(left)
            end = np.where(last[which], self.rest, self.step)
            given = end, records, modes, acting, tables.pieces, self.step
            compose_cuts(maps, which, records.until[which], *given)

    def moves(
        self,
        records: Records,
        modes: Int[np.ndarray, " sojourn"],
        cut: Int[np.ndarray, " part"],
        until: Float[np.ndarray, " part"],
    ) -> Float[np.ndarray, "part n z"]:
        """M of x(t_k + τ) = M z_k in the cut periods `cut`, with τ = `until`, seconds."""
        from deadtime.scenarios.by_period import follow_cuts

        assert self.tables is not None
        _, n, m = self.acting.B.shape
        pieces, width = self.tables.pieces, (0.0,) * -(-(n * n + n * m) // WIDE)
        moves = np.empty((cut.size, n, self.acting.wide))
        cell = self.step / pieces.shape[1]
        follow_cuts(moves, cut, until, records, modes, self.acting, pieces, cell, width)
        return moves

    def without_signals(self) -> SignalPeriods:
        """The result of `sample_signals` for no signals, without compiling anything."""
        assert self.tables is not None
        few = np.zeros(0, np.int32)
        cuts = few, few, np.zeros(0, np.bool_), np.zeros(0)
        records = Records(np.zeros(1, np.int64), few, few, few, *cuts)
        return SignalPeriods(
            records, np.zeros((self.plant.modes, self.tables.width)), np.zeros(0, np.int64)
        )
