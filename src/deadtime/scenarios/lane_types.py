"""Arguments of the compiled loop of `scenarios.lane_loop`: sizes as types, law, plant and run."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from deadtime.loop.received_samples import Received


@dataclass(frozen=True)
class LoopSizes:
    """The sizes of a loop, which compiled code knows as types: the lengths of tuples.

    x : states;  u : inputs;  both : states and the inputs of one sample;  pair : two inputs
    acting : the inputs that act over a period;  driving : these and the forces;  z : and the state
    b : the window of factorised rows;  block : a block of its transition
    rows : the inputs that all its rows ask for
    force : all forces of a period
    seen : what is measured;  known : what the law's rows are multiplied with
    kept : that of a law with a memory, zeros of one with a bank;  output : what it measures
    head : m (n + m), for the heads of dense rows
    entering : `acting` of the model of a law that knows the signal
    """

    x: int
    u: int
    both: int
    acting: int
    driving: int
    z: int
    pair: int
    force: int = 0
    seen: int = 0
    known: int = 0
    kept: int = 0
    output: int = 0
    b: int = 0
    block: int = 0
    rows: int = 0
    head: int = 0
    entering: int = 0

    @cached_property
    def _numba_type_(self) -> Any:
        from deadtime.numerics.lanes.code import LaneSizes

        return LaneSizes(asdict(self))


class Factored(NamedTuple):
    """Factorised rows, the row a mode's where there are several; `length` is the window.

    state (rows, m, n), out (rows, m, q), last (rows, m, m), transition (q, block), enter (q, m),
    ahead (length, q, m) and behind (length, rows, m, q), flat.
    """

    length: int
    state: np.ndarray
    out: np.ndarray
    last: np.ndarray
    transition: np.ndarray
    enter: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray


class Dense(NamedTuple):
    """Dense rows of `taps` inputs.

    `head` (rows, m, n + m): what x and the latest input, and `rest` (rows, m, width): what the
    others, the latest first, are multiplied by, padded. `apart` and `ages` are those of the table.
    """

    taps: int
    head: np.ndarray
    rest: np.ndarray
    width: int
    apart: int
    ages: int


class PlantLanes(NamedTuple):
    """The plant: l of the inputs u_{k−l} that act, oldest first, and its signals by periods.

    See `periods.SignalPeriods`.
    """

    lags: np.ndarray
    maps: np.ndarray
    first: np.ndarray
    step: np.ndarray
    mode: np.ndarray
    map: np.ndarray
    age: np.ndarray


class RunLanes(NamedTuple):
    """samples, the weight of the last one's input, where the late half begins, x0, root.

    Energy is |root u|², root (m, m) flat, or |u|² where that is empty.
    """

    samples: int
    rest: float
    late: int
    x0: np.ndarray
    root: np.ndarray


class InstantLanes(NamedTuple):
    """Measurements within periods: from z, x and what acts in a period, to what is measured there.

    series : (row, degree·n·z), Σ_d M_d δ^d, M_d (n, z);  cuts : (row, n·z), one M each
    row : (group, sample, lane), flat: a row of `series`, or beyond them one of `cuts`
    place : (group, sample, lane), flat: δ
    news : (group, sample), flat: whether a scenario's row is another one than before
    """

    series: np.ndarray
    cuts: np.ndarray
    row: np.ndarray
    place: np.ndarray
    news: np.ndarray


class MeasurementLanes(NamedTuple):
    """The received data of a law, None for all; `instants` is None with measurements at samples."""

    relayed: Received | None = None
    instants: InstantLanes | None = None
