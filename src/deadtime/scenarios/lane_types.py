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

    x : states;  u : inputs;  both : states and inputs of one sample;  pair : inputs of two samples
    acting : the inputs that act over a period;  driving : with the forces;  z : with the state, too
    b : the window sums of factorised rows;  block : a block of its transition
    rows : the commands of all rows together
    force : all forces of a period
    seen : a measurement;  known : the vector that the law's rows multiply
    kept : the state of an observer, or zeros for a bank;  output : the outputs of the plant
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
    """Factorised rows, one row per mode if there are several; `length` is that of the window.

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

    head : (rows, m, n + m), flat, gains of x and of the latest input
    rest : (rows, m, width), flat, gains of the older inputs, latest first, padded to whole vectors
    apart, ages : of the table
    """

    taps: int
    head: np.ndarray
    rest: np.ndarray
    width: int
    apart: int
    ages: int


class PlantLanes(NamedTuple):
    """The plant: the lags l of the inputs u_{k−l} that act, oldest first, and signals by periods.

    See `periods.SignalPeriods` for the others.
    """

    lags: np.ndarray
    maps: np.ndarray
    first: np.ndarray
    step: np.ndarray
    mode: np.ndarray
    map: np.ndarray
    age: np.ndarray


class RunLanes(NamedTuple):
    """A run: samples, the weight of the last input, the first sample of the late half, x0, root.

    Energy is Σ|root u|², root (m, m) flat, or Σ|u|² if that is empty.
    """

    samples: int
    rest: float
    late: int
    x0: np.ndarray
    root: np.ndarray


class InstantLanes(NamedTuple):
    """Measurements within periods: the maps from z, x and the inputs of a period, to x there.

    series : (row, degree·n·z), Σ_d M_d δ^d, M_d (n, z);  cuts : (row, n·z), one M each
    row : (group, sample, lane), flat: a row of `series`, or beyond them one of `cuts`
    place : (group, sample, lane), flat: δ
    news : (group, sample), flat: whether a row differs from the sample before in some lane
    """

    series: np.ndarray
    cuts: np.ndarray
    row: np.ndarray
    place: np.ndarray
    news: np.ndarray


class MeasurementLanes(NamedTuple):
    """The data that a law receives; None: every sample at once. `instants`: None for at samples."""

    relayed: Received | None = None
    instants: InstantLanes | None = None
