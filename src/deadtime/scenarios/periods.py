"""The periods of a loop: their inputs, the maps of whole and cut periods, and signals by periods.

Over a period x_{k+1} = M z and ∫xᵀQx = zᵀ E z, where z is the state at the sample, the inputs of
several lags and the forces of disturbances, each constant over its stretch (`simulation.forcing`):

    z = ( x_k | u_{k−l₁} | u_{k−l₂} | … | d of stretch 1 | d of stretch 2 | … )
          n     m          m              n                n
        states                       plain                                 wide

Where one switch from mode i to mode j cuts the period, M and E are analytic in the instant of the
switch, as long as no piece of either mode ends there: series in it replace two exponentials by one
short polynomial.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.checks import read_only
from deadtime.plant import SampledPlant, SwitchedSystem, Weight
from deadtime.plant.pieces import Stretches

WIDE = 8  # entries of a map come in vectors of so many
NODES = 20  # of a series in a cell, which converges to round-off for ‖A‖ times its length ≤ 1
_ROUND_OFF = 2e-15  # of the largest value: smaller terms of a series are left out
MOST_NUMBERS = 4e6  # of the series for all pairs of modes: 32 MB


class Acting(NamedTuple):
    """The stretches of all modes on one vector, z = (x_k, u_{k−l} for the l of `lags`, forces).

    states : the entries of x; plain : those of x and the inputs; wide : those of z
    lags : (lags,), oldest first
    stretches : those of every mode; column : (stretches, inputs), the entry of z that is input j of
        B (modes, n, inputs), to which forces add n unit vectors
    edges : (parts + 1,), seconds: between two of these no stretch of any mode begins or ends
    arrival, arriving : (arrivals,), seconds into the period at which an input u_{k−l} begins to
        act, and its l
    """

    states: int
    plain: int
    wide: int
    lags: Int[np.ndarray, " lag"]
    stretches: Stretches
    column: Int[np.ndarray, "stretch input"]
    B: Float[np.ndarray, "mode n input"]
    edges: Float[np.ndarray, " part+1"]
    arrival: Float[np.ndarray, " arrival"]
    arriving: Int[np.ndarray, " arrival"]


def acting_of(sampled: SampledPlant, forced: bool = False) -> Acting:
    """The inputs of a sampled plant over a period; if `forced`, a force over each stretch, too.

    Stretches of all modes with the same number within the period have the same force.

    Examples
    --------
    >>> from deadtime.plant import SwitchedSystem
    >>> acting = acting_of(SampledPlant(SwitchedSystem([[[0.0]]], [[[1.0]]], delay=0.27), 0.1))
    >>> acting.lags, acting.column.ravel(), acting.edges.round(12), acting.arriving
    (array([3, 2]), array([1, 2]), array([0.  , 0.07, 0.1 ]), array([2]))
    """
    stretches, n, m = sampled.every_stretch, sampled.plant.states, sampled.plant.inputs
    lags = np.unique(stretches.lag)[::-1]
    block = np.searchsorted(-lags, -stretches.lag)
    column, B, wide = n + block * m + np.arange(m), sampled.plant.B, n + lags.size * m
    plain = wide
    if forced:
        place = np.concatenate([np.arange(count) for count in np.diff(stretches.first)])
        column = np.concatenate((column, plain + place[:, None] * n + np.arange(n)), axis=1)
        B = np.concatenate((B, np.broadcast_to(np.eye(n), sampled.plant.A.shape)), axis=2)
        wide += (int(place.max()) + 1) * n
    edges = np.unique(np.concatenate((stretches.start, stretches.stop)))
    begins = np.flatnonzero(stretches.start > 0.0)
    arrivals = {
        (float(stretches.start[s]), int(lag))
        for s in begins
        for lag in stretches.lag[s][stretches.lag[s] != stretches.lag[s - 1]]
    }
    pairs = np.reshape(sorted(arrivals), (-1, 2))
    arrays = lags.copy(), column, B.copy(), edges, pairs[:, 0].copy(), pairs[:, 1].astype(np.int64)
    lags, *rest = map(read_only, arrays)
    return Acting(n, plain, wide, lags, stretches, *rest)


class Records(NamedTuple):
    """The map that moves a scenario over a period, from that period on.

    Record r of scenario s, first[s] ≤ r < first[s + 1]: from period `step[r]` on the sampled mode
    is `mode[r]` and the map is `map[r]`. A map below the number of modes is that mode's. Map
    modes + c is that of cut period c with the sojourns sojourn[c], …, until[c] − 1 of the signals;
    sojourn i begins at[i] seconds into the period, the first one at its start or before. The last
    period of a scenario counts as cut, and is marked in `last`.

        scenario s:  period   0  1  2  3  4  5  6       a switch within period 3, from mode 0 to 1
        record       step     0        3  4     6       three maps: mode 0, cut c, mode 1, cut c + 1
                     map      0        2+c 1    2+c+1   (two modes)
    """

    first: Int[np.ndarray, " scenario+1"]
    step: Int[np.ndarray, " record"]
    mode: Int[np.ndarray, " record"]
    map: Int[np.ndarray, " record"]
    sojourn: Int[np.ndarray, " cut"]
    until: Int[np.ndarray, " cut"]
    last: Bool[np.ndarray, " cut"]
    at: Float[np.ndarray, " sojourn"]

    def modes(self, samples: int) -> Int[np.ndarray, "scenario sample"]:
        """The sampled mode of every scenario at the samples 0, …, samples − 1."""
        return self._along(self.mode, samples)

    def maps(self, samples: int) -> Int[np.ndarray, "scenario period"]:
        """The map of every scenario over the periods 0, …, samples − 1."""
        return self._along(self.map, samples)

    def _along(self, values: Int[np.ndarray, " record"], samples: int) -> Int[np.ndarray, "s k"]:
        ends = np.append(self.step[1:], samples)
        ends[self.first[1:-1] - 1] = samples
        return np.repeat(values, ends - self.step).reshape(-1, samples).astype(np.int64)


class SignalPeriods(NamedTuple):
    """Signals by the periods 0, …, K, the last of which ends at the horizon.

    Row `records.map[r]` of `maps` moves the plant over a period: `move` and the upper triangle of
    `energy` with its off-diagonal doubled, flat (`Maps`). `age` is the age of the first mode at
    time 0, in samples.
    """

    records: Records
    maps: Float[np.ndarray, "map size"]
    age: Int[np.ndarray, " scenario"]

    @property
    def scenarios(self) -> int:
        return self.age.size


class Maps(NamedTuple):
    """Whole periods, mode by mode: x_{k+1} = move z and ∫xᵀQx = zᵀ energy z."""

    move: Float[np.ndarray, "mode n z"]
    energy: Float[np.ndarray, "mode z z"]


class CellSeries(NamedTuple):
    """Series by cells of a period, in δ ∈ [−1, 1] across each, the lowest power first.

    switched : (mode·mode, part, cell, degree, size), M and E of a period with one switch from
        mode i to mode j, row i·modes + j, in every part of the period (`Acting.edges`); no cells
        if there are too many modes
    pieces : (mode, cell, degree, size), Φ, Γ and the energy of one mode over a time
    width : the size of a map, in whole vectors
    """

    switched: Float[np.ndarray, "pair part cell degree size"]
    pieces: Float[np.ndarray, "mode cell degree piece"]
    width: int


def pack(form: Float[np.ndarray, "*rows z z"]) -> Float[np.ndarray, "*rows size"]:
    """The upper triangle of a symmetric matrix, its off-diagonal doubled, flat.

    Examples
    --------
    >>> pack(np.array([[1.0, 2.0], [2.0, 5.0]]))
    array([1., 4., 5.])
    """
    i, j = np.triu_indices(form.shape[-1])
    return form[..., i, j] * np.where(i == j, 1.0, 2.0)


def balanced_norm(A: Float[np.ndarray, "n n"]) -> float:
    """Largest row sum of A in the units in which it is balanced."""
    from deadtime.numerics.exponential import balance

    unit = balance(A)
    return float(np.abs(A * unit / unit[:, None]).sum(axis=1).max())


class ModePart(NamedTuple):
    """A time in one mode under the inputs z[column]."""

    mode: int
    length: float
    column: Int[np.ndarray, " m"]


def parts_of(acting: Acting, i: int, low: float, high: float) -> list[ModePart]:
    """The parts of a period between two instants in mode i, with constant inputs each."""
    stretches, parts = acting.stretches, []
    for s in range(stretches.first[i], stretches.first[i + 1]):
        start, stop = max(low, stretches.start[s]), min(high, stretches.stop[s])
        if stop > start:
            parts.append(ModePart(i, stop - start, acting.column[s]))
    return parts


def compose(
    plant: SwitchedSystem,
    acting: Acting,
    periods: Sequence[Sequence[ModePart]],
    wide: int,
    weight: Weight | None = None,
) -> Maps:
    """M and E of every period, over its parts, z having `wide` entries."""
    from deadtime.numerics.exponential import discretise_all, gramian_all

    parts = [part for period in periods for part in period]
    mode, tau = np.array([part.mode for part in parts]), np.array([part.length for part in parts])
    Q = np.eye(plant.states) if weight is None else weight.Q
    Phi, Gamma = discretise_all(plant.A, acting.B, mode, tau)
    gramian = gramian_all(plant.A, acting.B, mode, tau, Q)
    maps = Maps(
        np.tile(np.eye(plant.states, wide), (len(periods), 1, 1)),
        np.zeros((len(periods), wide, wide)),
    )
    period = np.repeat(np.arange(len(periods)), list(map(len, periods)))
    for p, k in enumerate(period):
        u = np.eye(wide)[parts[p].column]
        z = np.vstack((maps.move[k], u))
        maps.energy[k] += z.T @ gramian[p] @ z
        maps.move[k] = Phi[p] @ maps.move[k] + Gamma[p] @ u
    return maps


def whole_periods(sampled: SampledPlant, acting: Acting, weight: Weight | None = None) -> Maps:
    """The maps of periods without a switch."""
    plant, step = sampled.plant, sampled.step
    periods = [parts_of(acting, i, 0.0, step) for i in range(plant.modes)]
    return compose(plant, acting, periods, acting.wide, weight)


@lru_cache(8)
def tables_of(
    sampled: SampledPlant, cells: int, weight: Weight | None = None, forced: bool = False
) -> CellSeries:
    """The series of a plant at a period."""
    plant, step, acting = sampled.plant, sampled.step, acting_of(sampled, forced)
    modes, n = plant.modes, plant.states
    wide, edges, m = acting.wide, acting.edges, acting.B.shape[2]

    def piece(i: int) -> Callable[[np.ndarray], np.ndarray]:
        def at(times: np.ndarray) -> np.ndarray:
            periods = [[ModePart(i, t, np.arange(n, n + m))] for t in times]
            move, energy = compose(plant, acting, periods, n + m, weight)
            Phi, Gamma = move[:, :, :n], move[:, :, n:]
            flat = Phi.reshape(times.size, -1), Gamma.reshape(times.size, -1), pack(energy)
            return np.concatenate(flat, axis=1)

        return at

    def with_switch(i: int, j: int) -> Callable[[np.ndarray], np.ndarray]:
        def at(times: np.ndarray) -> np.ndarray:
            periods = [parts_of(acting, i, 0.0, t) + parts_of(acting, j, t, step) for t in times]
            move, energy = compose(plant, acting, periods, wide, weight)
            return np.concatenate((move.reshape(times.size, -1), pack(energy)), axis=1)

        return at

    width = -(-(n * wide + wide * (wide + 1) // 2) // WIDE) * WIDE
    pieces = stack([[_series(piece(i), 0.0, step, cells)] for i in range(modes)])[:, 0]
    if modes * modes * (edges.size - 1) * cells * NODES * width > MOST_NUMBERS:
        return CellSeries(np.zeros((1, 1, 0, 1, width)), pieces, width)
    pairs = [
        [_series(with_switch(i, j), low, high, cells) for low, high in itertools.pairwise(edges)]
        for i in range(modes)
        for j in range(modes)
    ]
    return CellSeries(stack(pairs), pieces, width)


def _series(
    function: Callable[[np.ndarray], np.ndarray], low: float, high: float, cells: int
) -> Float[np.ndarray, "cell degree size"]:
    """A function of time on [low, high] in powers of δ, cell by cell.

    Interpolation at Chebyshev's nodes; cells are short enough for terms to fall so fast that
    powers of δ lose nothing against Chebyshev's polynomials.
    """
    times = nodes(low, high, cells)
    return series_through(function(times.ravel()).reshape(*times.shape, -1))


def nodes(low: float, high: float, cells: int) -> Float[np.ndarray, "cell node"]:
    """The instants of [low, high] through which a series is fitted: Chebyshev's, cell by cell."""
    places = np.arange(cells)[:, None] + 0.5 + 0.5 * np.polynomial.chebyshev.chebpts1(NODES)
    return low + (high - low) / cells * places


def series_through(values: Float[np.ndarray, "cell node size"]) -> np.ndarray:
    """Powers of δ (cell, degree, size), the lowest first, through values at the nodes."""
    places = np.polynomial.chebyshev.chebpts1(NODES)
    polynomials = np.polynomial.chebyshev.chebvander(places, NODES - 1)
    weights = np.where(np.arange(NODES) == 0, 1.0, 2.0) / NODES
    powers, result = _chebyshev(NODES), []
    for samples in values:
        scale = np.abs(samples).max(axis=0)
        terms = weights[:, None] * (polynomials.T @ samples)
        kept = np.flatnonzero((np.abs(terms) > _ROUND_OFF * np.maximum(scale, 1e-300)).any(axis=1))
        terms = terms[: 1 + int(kept.max(initial=0))]
        result.append(powers[: len(terms), : len(terms)] @ terms)
    return stack(result)


@lru_cache(1)
def _chebyshev(count: int) -> Float[np.ndarray, "power polynomial"]:
    """Chebyshev's polynomials T_0, …, T_{count − 1} as columns of powers."""
    columns = [
        np.polynomial.chebyshev.cheb2poly(row[: d + 1]) for d, row in enumerate(np.eye(count))
    ]
    return read_only(
        np.stack([np.pad(column, (0, count - column.size)) for column in columns], axis=1)
    )


def stack(parts: Sequence) -> np.ndarray:
    """Nested lists of arrays (…, degree, size) as one, padded to one degree and whole vectors."""
    flat = [part if isinstance(part, np.ndarray) else stack(part) for part in parts]
    shape = [max(sizes) for sizes in zip(*(part.shape for part in flat), strict=True)]
    shape[-1] = -(-shape[-1] // WIDE) * WIDE
    result = np.zeros([len(flat), *shape])
    for row, part in zip(result, flat, strict=True):
        row[tuple(slice(size) for size in part.shape)] = part
    return result
