"""Sampling, even or uneven: the usable periods of a log, and their regressions on the unknowns.

    x_{k+1} = P_σ(θ) r_k + w_k,    w_k ~ N(0, S_σ τ_k / h),    τ_k = t_{k+1} − t_k

**Between samples** an input is a polynomial of degree q, its hold: 0 where it is held, 1 where it
is linear. Its derivatives u⁽ⁱ⁾, i ≤ q, at the beginning of a period and the changes Δu⁽q⁾ that
arrive within it, at times c, determine what it adds:

    x_{k+1} = Φ(τ_k) x_k + W(τ_k) c_σ + Σ_j [Σ_{i≤q} W_{i+1}(τ_k) b_j u_j⁽ⁱ⁾(t_k − D_j)
              + Σ_c W_{q+1}(t_{k+1} − c) b_j Δu_j⁽q⁾(c)] + w_k,

with the repeated integrals W_i of Φ (`transition`). Its derivative by −D_j is the same sum for the
derivative of the input, of degree q − 1, with W_0 = Φ:

    −∂x_{k+1}/∂D_j = Σ_{1≤i≤q} W_i(τ_k) b_j u_j⁽ⁱ⁾(t_k − D_j) + Σ_c W_q(t_{k+1} − c) b_j Δu_j⁽q⁾(c).

**Even**, τ_k = h. With D_j in its cell (N − 1) h … N h only u_{k−N}, …, u_{k−N+q+1} act, as one
change arrives, s_j = N h − D_j before the end. With differences Δⁱ of these from the oldest on,

    h^i u⁽ⁱ⁾(t_k − D) = Σ_{i≤l≤q} (s/h)^{l−i} Δˡ,    h^q Δu⁽q⁾ = Δ^{q+1},

so for q = 0 u_{k−N} acts through W(h) − W(s), u_{k−N+1} through W(s). For all delays of a window
this depends on the log of a mode only through one triangular root over x_{k+1}, x_k and the inputs
of all lags. A likelihood has a kink at every whole number of periods if inputs are held, because
∂x_{k+1}/∂D jumps; if they are linear only its second derivative does.

**Causality.** If inputs are linear and a delay is shorter than a period, u_{k+1} acts before
t_{k+1}. An input that was computed from the measurement of its row then depends on the noise of
that period, and the product of the densities of x_{k+1} given all inputs is not the likelihood.

**Uneven.** Φ and its integrals at the many times are interpolated between nodes, to round-off, so
that all this is a regression again, on the weights of the nodes.

Lost rows are rows of NaN, and long gaps divide a log into parts (`Recording`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.checks import read_only
from deadtime.base.frozen import Frozen
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import (
    Cells,
    Layout,
    Nodes,
    Square,
    Squares,
    Vector,
    Window,
    cell_of,
)
from deadtime.identification.scoring import Climb, EvaluateIn, Maximum, climb, climb_cells
from deadtime.identification.transition import interpolation, nodes_of, noise_tables, transitions_of

_BLOCK = 2_000_000  # numbers stacked at a time, which bounds memory
_ROUND_OFF = 1e-9  # of a period: an arrival this close to a sample counts as at it

Roots = Callable[[np.ndarray], list[np.ndarray]]  # from the reads of modes to a root of each


class WeightMap(NamedTuple):
    """P (n, r) of a mode, its derivatives by the unknowns of the mode, and their places."""

    P: Float[np.ndarray, "n r"]
    by_P: Float[np.ndarray, "own n r"]
    place: Int[np.ndarray, " own"]


class Term(NamedTuple):
    """The regression of one mode.

    root : (rows, n + r), rootᵀ root = Σ z zᵀ
    periods : N_i, or the sum of weights
    P : (n, r); by_P : (unknowns, n, r), its derivatives by the unknowns at `place`
    """

    root: Float[np.ndarray, "row z"]
    periods: float
    P: Float[np.ndarray, "n r"]
    by_P: Float[np.ndarray, "own n r"]
    place: Int[np.ndarray, " own"]


TermsIn = Callable[[np.ndarray], Callable[[np.ndarray], list[Term]]]  # of cells, then unknowns


class FilterPeriods(NamedTuple):
    """The periods before samples, each from the sample before to its own.

    mode : (T,), and kind : (T,), the row of the next four
    Phi, Q : (kinds, n, n); by_Phi : (kinds, n², n, n) by its mode's A; by_Q : by A and then by L,
    W = L Lᵀ, (kinds, n² + n (n + 1)/2, n, n)
    added : (T, n), by inputs; by_added : (T, own, n), by A, B and the delays of the mode
    """

    mode: Int[np.ndarray, " T"]
    kind: Int[np.ndarray, " T"]
    Phi: Float[np.ndarray, "kind n n"]
    by_Phi: Float[np.ndarray, "kind a n n"]
    Q: Float[np.ndarray, "kind n n"]
    by_Q: Float[np.ndarray, "kind q n n"]
    added: Float[np.ndarray, "T n"]
    by_added: Float[np.ndarray, "T own n"]


# From a part, its samples, and whether the filter starts from the prior there
PeriodsOf = Callable[[Part, Int[np.ndarray, " T"], Bool[np.ndarray, " T"]], FilterPeriods]


class UsablePeriods(NamedTuple):
    """The usable periods k of every part, and the probabilities of their modes; None: as logged."""

    parts: tuple[Part, ...]
    k: Sequence[Int[np.ndarray, " period"]]
    weight: Float[np.ndarray, "every mode"] | None = None

    def counts(self, modes: int) -> list[float]:
        """The number of periods of each mode, or the sum of their weights."""
        if self.weight is not None:
            return self.weight.sum(axis=0).tolist()
        own = [part.mode[k] for part, k in zip(self.parts, self.k, strict=True)]
        return np.bincount(np.concatenate(own), minlength=modes).tolist()

    def blocks(self, mode: int, most: int) -> Iterator[tuple[Part, np.ndarray, np.ndarray]]:
        """The periods of a mode and the roots of their weights, block by block."""
        first = 0
        for part, every in zip(self.parts, self.k, strict=True):
            own = every if self.weight is not None else every[part.mode[every] == mode]
            for start in range(0, own.size, most):
                k = own[start : start + most]
                at = slice(first + start, first + start + k.size)
                weight = np.ones(k.size) if self.weight is None else self.weight[at, mode]
                yield part, k, np.sqrt(weight)[:, None]
            first += every.size

    def summed(
        self,
        mode: int,
        size: int,
        rows: Callable[[Part, np.ndarray], np.ndarray],
        root: bool = True,
    ) -> Float[np.ndarray, "some z"]:
        """R with RᵀR = Σ w z zᵀ over the rows z of a mode; RᵀR itself where `root` is False."""
        total, most = np.zeros((0 if root else size, size)), max(size, _BLOCK // size)
        for part, k, weight in self.blocks(mode, most):
            z = weight * rows(part, k)
            total = np.linalg.qr(np.vstack((total, z)), mode="r") if root else total + z.T @ z
        return np.asarray(total)


@dataclass(frozen=True, eq=False)
class Sampling(Frozen, ABC):
    """How logs are sampled: the regressions and filter periods of likelihoods.

    step : the median sampling period, seconds; nodes : of interpolation over a period
    hold : the degree q of inputs between samples
    summed_up : whether one root is sufficient for all delays of a window
    """

    step: float
    nodes: Nodes = field(repr=False)
    hold: int = 0

    summed_up: ClassVar[bool]

    @abstractmethod
    def window(self, low: float, high: float) -> Window:
        """The widest range of delays with the same usable periods as a given range, seconds."""

    @abstractmethod
    def span(self, reads: np.ndarray) -> Window:
        """The range of delays with given reads, seconds."""

    @abstractmethod
    def usable(self, part: Part, within: bool, low: float, high: float) -> Int[np.ndarray, " k"]:
        """The periods whose states and acting inputs are known, for delays in a range, seconds.

        within : whether the mode may change at any time, so that a period that begins and ends in
        different modes is not usable.
        """

    @abstractmethod
    def reads(self, layout: Layout, theta: Vector, cells: Cells) -> np.ndarray:
        """Cells of delays, or delays, which select the acting inputs of each mode, (modes, m)."""

    @abstractmethod
    def rows(
        self, part: Part, k: np.ndarray, reads: np.ndarray, constant: bool
    ) -> Float[np.ndarray, "period z"]:
        """z = (x_{k+1}, r_k) of periods k, all of one mode, their noise scaled to a period of h."""

    @abstractmethod
    def maps(
        self, layout: Layout, theta: Vector, cells: Cells, slopes: bool = True
    ) -> list[WeightMap]:
        """P of each mode, with its derivatives; without `slopes` none of these."""

    @abstractmethod
    def roots_in(self, layout: Layout, periods: UsablePeriods, window: Window) -> Roots:
        """Roots of Σ z zᵀ of every mode, for delays in a window."""

    @abstractmethod
    def periods_of(
        self, layout: Layout, theta: Vector, L: Square, cells: Cells, slopes: bool = True
    ) -> PeriodsOf:
        """The periods between the samples of a filter, W = L Lᵀ, delays in given cells.

        Without `slopes` they have no derivatives, which take most of the time.
        """

    @abstractmethod
    def climb(self, within: EvaluateIn, theta: Vector, window: Window, how: Climb) -> Maximum:
        """The maximum near a start with delays in a window."""

    @abstractmethod
    def to_kink(self, delay: float) -> float:
        """The distance of a delay from the nearest kink of the likelihood, seconds."""

    @property
    def lags(self) -> int:
        """The number of samples of an input that act in an even period, with its delay known."""
        return self.hold + 2

    def fed(self, part: Part, longest: float, shortest: float) -> Bool[np.ndarray, " period"]:
        """The periods whose mode and acting inputs are known, for delays in a range, seconds."""
        t = part.time
        lost = np.concatenate(([0], np.cumsum(~np.isfinite(part.input).all(axis=1))))
        slack = _ROUND_OFF * float(np.median(np.diff(t)))
        oldest = np.searchsorted(t, t[:-1] - longest + slack, side="right") - 1
        newest = np.searchsorted(t, t[1:] - shortest - slack, side="left") + self.hold
        newest = np.maximum(np.minimum(newest, t.size), oldest + 1)
        known = (lost[newest] == lost[np.maximum(oldest, 0)]) & (part.mode[:-1] >= 0)
        return known if part.rests else known & (oldest >= 0)

    def acting(
        self, part: Part, k: np.ndarray, delays: Float[np.ndarray, "mode m"]
    ) -> ActingInputs:
        """The inputs that act in periods k of a part, each with the delays of its mode."""
        return acting_in(part, k, delays, self.nodes, self.hold)

    def terms_in(self, layout: Layout, periods: UsablePeriods, window: Window) -> TermsIn:
        """The regressions of all modes, for delays in a window, in cells of theirs."""
        roots, counts = self.roots_in(layout, periods, window), periods.counts(layout.modes)

        def terms(theta: np.ndarray, cells: np.ndarray) -> list[Term]:
            own = roots(self.reads(layout, theta, cells)), counts, self.maps(layout, theta, cells)
            return [Term(root, count, *one) for root, count, one in zip(*own, strict=True)]

        return lambda cells: lambda theta: terms(theta, cells)


def sampling_of(recording: Recording, nodes: Nodes) -> Sampling:
    kind = EvenSampling if recording.even else UnevenSampling
    return kind(recording.step, nodes, recording.hold)


@dataclass(frozen=True, eq=False)
class EvenSampling(Sampling):
    """Samples one period apart up to rounding, with gaps of lost rows."""

    summed_up: ClassVar[bool] = True

    def window(self, low: float, high: float) -> Window:
        first, last = cell_of(low, self.step, up=True), cell_of(high, self.step)
        return (first - 1) * self.step, last * self.step

    def between(self, low: float, high: float) -> tuple[int, int]:
        """The latest and the oldest input that may act, in periods before."""
        return cell_of(low, self.step, up=True) - 1 - self.hold, cell_of(high, self.step)

    def span(self, reads: np.ndarray) -> Window:
        return (int(reads.min()) - 1) * self.step, int(reads.max()) * self.step

    def usable(self, part: Part, within: bool, low: float, high: float) -> Int[np.ndarray, " k"]:
        return usable_lags(part, within, *self.between(low, high))

    def reads(self, layout: Layout, theta: Vector, cells: Cells) -> np.ndarray:
        return layout.spread(cells)

    def rows(
        self, part: Part, k: np.ndarray, reads: np.ndarray, constant: bool
    ) -> Float[np.ndarray, "period z"]:
        acting = acting_evenly(part, k, reads[None], constant, self.lags)
        return np.hstack((part.output[k + 1], part.output[k], acting))

    def maps(
        self, layout: Layout, theta: Vector, cells: Cells, slopes: bool = True
    ) -> list[WeightMap]:
        A, B, delays = layout.split(theta)
        late = layout.spread(cells) * self.step - delays
        each = (
            period_weights(*one, self.step, slopes, self.hold)
            for one in zip(A, B, late, strict=True)
        )
        return [WeightMap(*one, layout.of_mode(i)) for i, one in enumerate(each)]

    def roots_in(self, layout: Layout, periods: UsablePeriods, window: Window) -> Roots:
        n, m, (low, high) = layout.n, layout.m, self.between(*window)
        every = lag_sums(layout, periods, low, high)
        ends = np.arange(2 * n), np.arange(every[0].shape[1])[-1:][: int(layout.constant)]

        def roots(reads: np.ndarray) -> list[np.ndarray]:
            columns = 2 * n + (reads - low) * m + np.arange(m)
            of = (columns[:, None] - m * np.arange(self.lags)[:, None]).reshape(len(reads), -1)
            each = zip(every, of, strict=True)
            return [R[:, np.concatenate((ends[0], at, ends[1]))] for R, at in each]

        return roots

    def periods_of(
        self, layout: Layout, theta: Vector, L: Square, cells: Cells, slopes: bool = True
    ) -> PeriodsOf:
        n, reads, once = layout.n, layout.spread(cells), np.array([self.step])
        maps = self.maps(layout, theta, cells, slopes)
        P, by_P = (np.array(one) for one in list(zip(*maps, strict=True))[:2])
        noise = [noise_tables(A, L, once, slopes) for A in layout.split(theta)[0]]
        Q, by_Q = (np.concatenate(one) for one in zip(*noise, strict=True))
        tables = P[:, :, :n].copy(), by_P[:, : n * n, :, :n].copy(), Q, by_Q

        def periods(part: Part, rows: np.ndarray, _: np.ndarray) -> FilterPeriods:
            before = np.maximum(rows - 1, 0)
            mode = np.maximum(part.mode[before], 0)  # of lost rows, where filters start anew
            own = reads[mode], layout.constant, self.lags
            z = np.nan_to_num(acting_evenly(part, before, *own))
            added, by_added = np.zeros((rows.size, n)), np.zeros((rows.size, by_P.shape[1], n))
            for i in np.unique(mode):
                own = np.flatnonzero(mode == i)
                added[own] = z[own] @ P[i, :, n:].T
                by_added[own] = np.tensordot(z[own], by_P[i, :, :, n:], (1, 2))
            return FilterPeriods(mode, mode, *tables, added, by_added)

        return periods

    def climb(self, within: EvaluateIn, theta: Vector, window: Window, how: Climb) -> Maximum:
        return climb_cells(within, theta, self.step, window, how)[0]

    def to_kink(self, delay: float) -> float:
        return np.inf if self.hold else abs(delay - self.step * round(delay / self.step))


@dataclass(frozen=True, eq=False)
class UnevenSampling(Sampling):
    """Samples at any times."""

    summed_up: ClassVar[bool] = False

    def window(self, low: float, high: float) -> Window:
        return low, high

    def span(self, reads: np.ndarray) -> Window:
        return float(reads.min()), float(reads.max())

    def usable(self, part: Part, within: bool, low: float, high: float) -> Int[np.ndarray, " k"]:
        return np.flatnonzero(known_ends(part, within) & self.fed(part, high, low))

    def reads(self, layout: Layout, theta: Vector, cells: Cells) -> np.ndarray:
        return layout.split(theta)[2]

    def rows(
        self, part: Part, k: np.ndarray, reads: np.ndarray, constant: bool
    ) -> Float[np.ndarray, "period z"]:
        length = part.time[k + 1] - part.time[k]
        one = part._replace(mode=np.zeros(part.time.size, np.int64))
        acts = self.acting(one, k, reads[None])
        over = interpolation(self.nodes, length)
        x = over[:, :, None] * part.output[k][:, None]
        flat = (one.reshape(k.size, -1) for one in (x, acts.joined(over, constant), acts.change))
        return np.hstack((part.output[k + 1], *flat)) / np.sqrt(length / self.step)[:, None]

    def maps(
        self, layout: Layout, theta: Vector, cells: Cells, slopes: bool = True
    ) -> list[WeightMap]:
        A, B, _ = layout.split(theta)
        of = layout.m, self.nodes, self.hold
        each = (node_weights(A[i], B[i], *of) for i in range(layout.modes))
        return [WeightMap(*one, layout.of_mode(i)) for i, one in enumerate(each)]

    def roots_in(self, layout: Layout, periods: UsablePeriods, window: Window) -> Roots:
        columns = layout.n + layout.acting + layout.m * (1 + self.hold)
        size = layout.n + self.nodes.size * columns

        def root(mode: int, reads: np.ndarray) -> np.ndarray:
            def rows(part: Part, k: np.ndarray) -> np.ndarray:
                return self.rows(part, k, reads, layout.constant)

            return periods.summed(mode, size, rows)

        return lambda reads: [root(i, own) for i, own in enumerate(reads)]

    def periods_of(
        self, layout: Layout, theta: Vector, L: Square, cells: Cells, slopes: bool = True
    ) -> PeriodsOf:
        A, B, delays = layout.split(theta)
        n, m, acting, modes = layout.n, layout.m, layout.acting, range(layout.modes)
        over = [transitions_of(A[i], self.nodes, slopes, self.hold + 1) for i in modes]
        noise = [noise_tables(A[i], L, self.nodes, slopes) for i in modes]
        tables = [(one.Phi, one.Phi_by_A, *own) for one, own in zip(over, noise, strict=True)]
        through = paths_of(acting, m, self.hold)
        forced = [
            (
                np.stack([over[i].integrals[w] @ B[i, :, j] for j, w in through], axis=-1),
                np.stack([over[i].by_A[w] @ B[i, :, j] for j, w in through], axis=-1),
                over[i].integrals[self.hold] @ B[i],
            )
            for i in modes
        ]

        def periods(part: Part, rows: np.ndarray, fresh: np.ndarray) -> FilterPeriods:
            mode = np.maximum(part.mode[np.maximum(rows - 1, 0)], 0)
            interpolated = [np.zeros((rows.size, *one.shape[1:])) for one in tables[0]]
            added = np.zeros((rows.size, n))
            by_added = np.zeros((rows.size, (n * (n + acting) + m) * slopes, n))
            for i in np.unique(mode):
                own = np.flatnonzero(~fresh & (mode == i))
                k = rows[own] - 1
                weight = interpolation(self.nodes, part.time[k + 1] - part.time[k])
                for result, table in zip(interpolated, tables[i], strict=True):
                    result[own] = np.tensordot(weight, table, (1, 0))
                acts = self.acting(part, k, delays)
                u, change = acts.joined(weight, layout.constant), acts.change
                steady, by_A, pushed = forced[i]
                added[own] = np.tensordot(u, steady, ((1, 2), (0, 2)))
                if not slopes:
                    continue
                by_added[own, : n * n] = np.tensordot(u, by_A, ((1, 2), (0, 3)))
                for column, (j, w) in enumerate(through):
                    # Places as in `Layout.of_mode`: A, B by rows, then D.
                    by_B = np.tensordot(
                        u[:, :, column], over[i].integrals[w].swapaxes(1, 2), (1, 0)
                    )
                    by_added[own[:, None], n * n + np.arange(n) * acting + j] += by_B
                for j in range(m):
                    by_D = -np.tensordot(change[:, :, j], pushed[:, :, j], (1, 0))
                    by_added[own, n * (n + acting) + j] = by_D
            Phi, by_Phi, Q, by_Q = interpolated
            kind = np.arange(rows.size)
            return FilterPeriods(mode, kind, Phi, by_Phi, Q, by_Q, added, by_added)

        return periods

    def climb(self, within: EvaluateIn, theta: Vector, window: Window, how: Climb) -> Maximum:
        evaluate, start = within(np.zeros(0, np.int64)), how.within(theta, *map(np.array, window))
        return climb(evaluate, *start, how.steps, how.gain, how.stride)

    def to_kink(self, delay: float) -> float:
        return np.inf


def known_ends(part: Part, within: bool) -> Bool[np.ndarray, " period"]:
    """Whether states at both ends of a period are known, and the mode in it: see `Sampling`."""
    known = np.asarray(np.isfinite(part.output).all(axis=1))
    good = known[:-1] & known[1:] & (part.mode[:-1] >= 0)
    return good & (part.mode[:-1] == part.mode[1:]) if within else good


def usable_lags(part: Part, within: bool, low: int, high: int) -> Int[np.ndarray, " period"]:
    """The periods of even samples of which inputs from `low` to `high` periods before are known."""
    good, count = known_ends(part, within), part.time.size - 1
    if not part.rests:
        good[: min(high, count)] = False
    lost = np.concatenate(([0], np.cumsum(~np.isfinite(part.input).all(axis=1))))
    k = np.flatnonzero(good)
    return k[lost[np.maximum(k - low + 1, 0)] == lost[np.maximum(k - high, 0)]]


def inputs_at(part: Part, rows: Int[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape m"]:
    """The inputs of rows of a part; before its first row that one's if it rests, else NaN."""
    u = part.input[np.maximum(rows, 0)]
    return u if part.rests or not (rows < 0).any() else np.where(rows[..., None] < 0, np.nan, u)


def stacked(part: Part, k: np.ndarray, low: int, high: int, constant: bool) -> np.ndarray:
    """z = (x_{k+1}, x_k, u_{k−low}, …, u_{k−high}) of periods, and 1 for a constant term."""
    lags = np.arange(low, high + 1)
    u = inputs_at(part, k[:, None] - lags).reshape(k.size, lags.size * part.input.shape[1])
    return np.hstack((part.output[k + 1], part.output[k], u, np.ones((k.size, int(constant)))))


def lag_sums(
    layout: Layout, periods: UsablePeriods, low: int, high: int, root: bool = True
) -> list[np.ndarray]:
    """Of every mode the root of Σ z zᵀ over the z of `stacked`; where `root` is False the sum."""
    size = 2 * layout.n + (high - low + 1) * layout.m + layout.constant

    def rows(part: Part, k: np.ndarray) -> np.ndarray:
        return stacked(part, k, low, high, layout.constant)

    return [periods.summed(i, size, rows, root) for i in range(layout.modes)]


def acting_evenly(
    part: Part,
    k: Int[np.ndarray, " T"],
    cells: Int[np.ndarray, "some m"],
    constant: bool,
    lags: int,
) -> Float[np.ndarray, "T r"]:
    """u_{k−N} of every input, then u_{k−N+1}, …, of periods k, and 1 for a constant term.

    cells : N of every period, or one row for all. Inputs before the log are its first ones: such
    periods are used where it rests there.
    """
    rows = (k[:, None] - cells)[:, None] + np.arange(lags)[:, None]
    u = part.input[np.clip(rows, 0, len(part.input) - 1), np.arange(cells.shape[1])]
    u = u.reshape(k.size, lags * cells.shape[1])
    return np.hstack((u, np.ones((k.size, int(constant)))))


class ActingInputs(NamedTuple):
    """Inputs that act in periods, weighted over nodes.

    value : of every derivative i of the inputs; it acts through W_{i+1}
    change : of the derivative by −D; it acts through W_q
    """

    value: Float[np.ndarray, "period node derivative m"]
    change: Float[np.ndarray, "period node m"]

    def joined(
        self, over: Float[np.ndarray, "period node"], constant: bool
    ) -> Float[np.ndarray, "period node column"]:
        """The columns of `paths_of`: inputs, 1 for a constant term, and derivatives."""
        first, *higher = np.moveaxis(self.value, 2, 0)
        return np.concatenate((first, over[:, :, None][:, :, : int(constant)], *higher), axis=2)


def paths_of(acting: int, m: int, hold: int) -> list[tuple[int, int]]:
    """Of every column of acting inputs the column j of B, and w: it acts through W_w."""
    return [(j, 1) for j in range(acting)] + [
        (j, i + 1) for i in range(1, hold + 1) for j in range(m)
    ]


def acting_in(
    part: Part, k: np.ndarray, delays: Float[np.ndarray, "mode m"], nodes: Nodes, hold: int
) -> ActingInputs:
    """The inputs that act in periods k of a part, each with the delays of its mode.

    Before the part's first row its first inputs act: such periods are used where it rests there.
    """
    t, m = part.time, part.input.shape[1]
    value = np.zeros((k.size, nodes.size, hold + 1, m))
    change = np.zeros((k.size, nodes.size, m))
    if k.size == 0:
        return ActingInputs(value, change)
    slack = _ROUND_OFF * float(np.median(t[k + 1] - t[k]))
    over = interpolation(nodes, t[k + 1] - t[k])
    for j in range(m):
        D = delays[part.mode[k], j]
        last_derivative = _pieces(t, part.input[:, j], hold)
        first = np.searchsorted(t, t[k] - D + slack, side="right")
        last = np.searchsorted(t, t[k + 1] - D - slack, side="left")
        if hold:
            value[:, :, 0, j] = over * np.interp(t[k] - D, t, part.input[:, j])[:, None]
        value[:, :, hold, j] = over * last_derivative[first][:, None]
        for later in range(1, int((last - first).max(initial=0)) + 1):
            has = np.flatnonzero(first + later <= last)
            index = first[has] + later
            weight = interpolation(nodes, t[k[has] + 1] - t[index - 1] - D[has])
            weight *= (last_derivative[index] - last_derivative[index - 1])[:, None]
            value[has, :, hold, j] += weight
            change[has, :, j] += weight
        if hold:
            change[:, :, j] = value[:, :, hold, j]
    return ActingInputs(value, change)


def _pieces(t: np.ndarray, u: np.ndarray, hold: int) -> Float[np.ndarray, " piece"]:
    """The derivative of order `hold` of an input, before the first row and after every row."""
    if not hold:
        return np.append(u[0], u)
    return np.concatenate(([0.0], np.diff(u) / np.diff(t), [0.0]))


def nodes_for(parts: tuple[Part, ...], A: Squares) -> np.ndarray:
    """Nodes accurate for plants near A over all periods of a recording."""
    longest = max(float(np.diff(part.time).max()) for part in parts)
    rate = 2.0 * float(np.abs(np.linalg.eigvals(A)).max()) + 1.0 / longest
    return nodes_of(longest * (1.0 + 1e-9), min(rate, 200.0 / longest))


def period_weights(
    A: Square,
    B: Float[np.ndarray, "n acting"],
    rest: Float[np.ndarray, " m"],
    step: float,
    slopes: bool = True,
    hold: int = 0,
) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "own n r"]]:
    """P of a period over x_k, u_{k−N}, …, u_{k−N+hold+1} and 1, with its derivatives.

    rest : s_j = N h − D_j, how long the newest input acts, seconds. Derivatives are by A, B, and D;
    without `slopes` there are none.
    """
    (n, acting), m, lags = B.shape, rest.size, hold + 2
    over, width = transitions_of(A, np.append(rest, step), slopes, hold + 1), n + lags * m
    # Columns: x, the oldest input of every kind, the next ones, …, 1; by_P is by A and B, then D.
    P = np.zeros((n, width + acting - m))
    by_P = np.zeros(((n * n + n * acting + m) * slopes, *P.shape))
    P[:, :n], by_P[: n * n, :, :n] = over.Phi[-1], over.Phi_by_A[-1]
    every = np.concatenate((over.integrals[:, :, None], over.by_A), axis=2)
    for j in range(m):
        b, at = B[:, j], slice(n + j, width, m)
        weights = _arriving(float(rest[j]), step, hold).T
        through = np.concatenate((every[1:, -1], every[-1:, j]))
        G = (weights @ through.reshape(hold + 2, -1)).reshape(lags, -1, n, n)
        P[:, at] = (G[:, 0] @ b).T
        if not slopes:
            continue
        by_P[: n * n, :, at] = np.moveaxis(G[:, 1:] @ b, 0, -1)
        by_P[n * n + np.arange(n) * acting + j, :, at] = G[:, 0].T
        through = np.concatenate((every[1:-1, -1, 0], every[-2:-1, j, 0])) @ b
        by_P[n * n + n * acting + j, :, at] = -(weights[:, 1:] @ through).T
    if acting > m:  # the constant term
        P[:, -1], by_P[: n * n, :, -1] = over.W[-1] @ B[:, m], over.W_by_A[-1] @ B[:, m]
        if slopes:
            by_P[n * n + np.arange(n) * acting + m, :, -1] = over.W[-1].T
    return P, by_P


@cache
def differences_of(hold: int) -> Float[np.ndarray, "difference lag"]:
    """The differences of the samples that act in an even period, the oldest sample first.

    Examples
    --------
    >>> differences_of(1)
    array([[ 1.,  0.,  0.],
           [-1.,  1.,  0.],
           [ 1., -2.,  1.]])
    """
    from scipy.linalg import invpascal

    return read_only(np.asarray(invpascal(hold + 2, kind="lower", exact=False)) + 0.0)


def _arriving(rest: float, step: float, hold: int) -> Float[np.ndarray, "derivative lag"]:
    """An input's derivatives at the beginning of a period, and its change that arrives in it.

    As weights of the samples that act, the oldest first; rest : from the arrival to the end.
    """
    taylor, order = np.eye(hold + 2), np.minimum(np.arange(hold + 2), hold)
    taylor[np.arange(hold), np.arange(hold) + 1] = rest / step
    return taylor @ differences_of(hold) / step ** order[:, None]


def node_weights(
    A: Square, B: Float[np.ndarray, "n acting"], m: int, nodes: Nodes, hold: int
) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "own n r"]]:
    """P over states, inputs and changes of inputs by the weights of nodes.

    With its derivatives by A, B and D; columns are those of `UnevenSampling.rows`.
    """
    (n, acting), over = B.shape, transitions_of(A, nodes, order=hold + 1)
    through = paths_of(acting, m, hold)
    whole = n + len(through)
    # (entry, node, row, column): a node has n columns of x, those of `paths_of`, and m of −∂/∂D.
    M = np.zeros((1 + n * (n + acting) + m, nodes.size, n, whole + m))
    by_A, by_B, by_D = np.split(M[1:], [n * n, n * (n + acting)])
    M[0, :, :, :n], by_A[..., :n] = over.Phi, over.Phi_by_A.swapaxes(0, 1)
    for column, (j, w) in enumerate(through, start=n):
        M[0, :, :, column] = over.integrals[w] @ B[:, j]
        by_A[..., column] = (over.by_A[w] @ B[:, j]).swapaxes(0, 1)
        # ∂(W B)/∂B_aj has W's column a as its column j.
        by_B[j::acting, :, :, column] = over.integrals[w].transpose(2, 0, 1)
    for j in range(m):
        by_D[j, :, :, whole + j] = -over.integrals[hold] @ B[:, j]
    groups = np.split(M.swapaxes(1, 2), [n, whole], axis=-1)
    P = np.concatenate([one.reshape(*M.shape[:1], n, -1) for one in groups], axis=-1)
    return P[0], P[1:]
