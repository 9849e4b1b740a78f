"""The Markov chain of a hidden mode, and the densities of a log's periods in every mode.

The chain has a matrix per period of even rows, and rates where rows are uneven:

    even:      P(σ_{k+1} = j | σ_k = i) = P_ij
    uneven:    P(σ_{k+1} = j | σ_k = i) = (e^{Λ τ_k})_ij,    Λ_ij ≥ 0,    Σ_j Λ_ij = 0

Given the posterior ξ_k of the jumps in every period, the next rates of expectation–maximisation are
expected jumps over expected time (Hobolth and Jensen, Statistical Applications in Genetics and
Molecular Biology 4(1), 2005), Λ_ij ← E N_ij / E T_i,

    E N_ij = Λ_ij Σ_k Σ_ab ξ_k(a, b) ∂(e^{Λ τ_k})_ab/∂Λ_ij / (e^{Λ τ_k})_ab,

E T_i the sum for i = j without the factor Λ_ij. With even rows N counts jumps and stays, T rows.

In each mode a period is normal about the mode's prediction, e = x_{k+1} − P_i r_k ~ N(0, S_i).
With a `pooled` model the mode may change at any time: a period that begins and ends in different
modes has the density of the pooled model, one for all modes. It contains no unknown, so these
periods locate the switches and do not affect the plant, as with logged modes. Without it the mode
of a row holds for its period. A period with missing data has density 1, and the chain goes on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.base.frozen import Frozen
from deadtime.identification.likelihoods.chain import likeliest, smooth
from deadtime.identification.likelihoods.likelihood import log_density
from deadtime.identification.log.recording import Part
from deadtime.identification.parameters import Square, Window, cell_of
from deadtime.identification.sampling import Sampling
from deadtime.identification.transition import interpolation, nodes_of, transitions_of

_STAY = 0.95  # a first guess of the chain's diagonal
_FLOOR = 1e-300  # of a probability, whose logarithm is taken


class Counts(NamedTuple):
    """Expected jumps N (modes, modes), and the time or rows T (modes,) spent in each mode."""

    jumps: Float[np.ndarray, "mode mode"]
    spent: Float[np.ndarray, " mode"]

    def __add__(self, other: Counts) -> Counts:  # pyright: ignore[reportIncompatibleMethodOverride]
        return Counts(self.jumps + other.jumps, self.spent + other.spent)


@dataclass(frozen=True, eq=False)
class Jumps(Frozen):
    """The chain of a log. matrix : P of even rows, Λ per second of uneven ones

    step : the sampling period, seconds; rates : whether the matrix is Λ
    """

    matrix: Float[np.ndarray, "mode mode"]
    step: float
    rates: bool

    @classmethod
    def of(cls, P: Float[np.ndarray, "mode mode"], step: float, rates: bool) -> Jumps:
        """The chain with probabilities P per period, for rates to first order."""
        return cls(_rates(P / step), step, rates) if rates else cls(P, step, rates)

    @classmethod
    def lasting(cls, modes: int, step: float, rates: bool) -> Jumps:
        """A first guess: modes stay with probability 0.95 per period."""
        P = np.full((modes, modes), (1.0 - _STAY) / max(modes - 1, 1))
        np.fill_diagonal(P, _STAY if modes > 1 else 1.0)
        return cls.of(P, step, rates)

    @property
    def modes(self) -> int:
        return len(self.matrix)

    @property
    def first(self) -> Float[np.ndarray, " mode"]:
        """Logarithms of the probabilities of the first mode, uniform."""
        return np.full(self.modes, -np.log(self.modes))

    @property
    def chain(self) -> Float[np.ndarray, "mode mode"]:
        """The probabilities of a jump within a sampling period."""
        if not self.rates:
            return self.matrix
        return np.clip(transitions_of(self.matrix, np.array([self.step])).Phi[0], 0.0, 1.0)

    def likelier(self, least: float) -> Int[np.ndarray, "jump 2"]:
        """The jumps (i, j) of at least some probability in a period."""
        once = self.matrix * (self.step if self.rates else 1.0)
        return np.argwhere((once > least) & ~np.eye(self.modes, dtype=bool))

    def over(
        self, time: Float[np.ndarray, " sample"]
    ) -> tuple[Float[np.ndarray, "kind mode mode"], Int[np.ndarray, " period"]]:
        """Logarithms of the periods' probabilities between times, and which are of each."""
        if not self.rates:
            logs = np.log(np.maximum(self.matrix, _FLOOR))
            return logs[None], np.zeros(time.size - 1, np.int64)
        return np.log(np.maximum(self._within(time)[2], _FLOOR)), np.arange(time.size - 1)

    def _within(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of e^{Λτ} at nodes, weights of these in every period, and the e^{Λτ}."""
        length = np.diff(time)
        longest = float(length.max()) * (1.0 + 1e-9)
        rate = 2.0 * float(np.abs(self.matrix).max()) + 1.0 / longest
        nodes = nodes_of(longest, min(rate, 200.0 / longest))
        at, weight = transitions_of(self.matrix, nodes), interpolation(nodes, length)
        return at.Phi_by_A, weight, np.tensordot(weight, at.Phi, (1, 0))

    def counted(self, time: Float[np.ndarray, " sample"], pairs: np.ndarray) -> Counts:
        """Expected counts of jumps whose probabilities are the pairs of `chain.smooth`."""
        if not self.rates:
            return Counts(pairs[0], pairs[0].sum(axis=1))
        by, weight, whole = self._within(time)
        share = np.tensordot(weight, pairs / np.maximum(whole, _FLOOR), (0, 0))
        total = np.einsum("qab,qcab->c", share, by).reshape(self.matrix.shape)
        return Counts(self.matrix * total, np.diagonal(total).copy())

    def next(self, counts: Counts) -> Jumps:
        """The chain that maximises the likelihood with expected counts."""
        spent = counts.spent[:, None]
        ratio = counts.jumps / np.where(spent > 0.0, spent, 1.0)
        matrix = _rates(ratio) if self.rates else np.where(spent > 0.0, ratio, np.eye(self.modes))
        return replace(self, matrix=matrix)

    def scaled(self, factor: Float[np.ndarray, "mode mode"]) -> Jumps:
        """The chain with odds of jumps, or rates, times factors; factors of stays are 1."""
        moved = self.matrix * factor
        matrix = _rates(moved) if self.rates else moved / moved.sum(axis=1, keepdims=True)
        return replace(self, matrix=matrix)

    def slope(self, counts: Counts) -> Float[np.ndarray, "mode mode"]:
        """The score in the logarithms of those factors."""
        return counts.jumps - counts.spent[:, None] * self.matrix

    def ordered(self, order: Int[np.ndarray, " mode"]) -> Jumps:
        return replace(self, matrix=self.matrix[np.ix_(order, order)])


def _rates(matrix: np.ndarray) -> np.ndarray:
    """A matrix as rates: none below 0 between modes, rows of sum 0."""
    off = np.where(np.eye(len(matrix), dtype=bool), 0.0, np.maximum(matrix, 0.0))
    return off - np.diag(off.sum(axis=1))


class Pooled(NamedTuple):
    """One regression for all modes.

    reads : which inputs act, (m,), see `Sampling.reads`
    constant : whether the last column of P is a constant term
    """

    P: Float[np.ndarray, "n r"]
    S: Square
    reads: Int[np.ndarray, " m"] | Float[np.ndarray, " m"]
    sampling: Sampling
    constant: bool

    def density(self, part: Part, k: Int[np.ndarray, " period"]) -> Float[np.ndarray, " period"]:
        """The log density of periods k of a part."""
        z = self.sampling.rows(part, k, self.reads, self.constant)
        return log_density(z, self.P, self.S)


class Posterior(NamedTuple):
    """The posterior of modes given a log.

    value : log likelihood
    weight : (periods, modes), probability of each mode throughout each usable period
    counts : the expected jumps
    node : of every part (samples, modes), probability of each mode
    """

    value: float
    weight: Float[np.ndarray, "period mode"]
    counts: Counts
    node: list[Float[np.ndarray, "sample mode"]]


@dataclass(frozen=True, eq=False)
class Periods(Frozen):
    """The periods k of every part that are usable for all delays in a window.

    pooled : model of periods within which the mode changes; None if it changes at samples only
    constant : whether dx/dt has a constant term in each mode
    """

    sampling: Sampling
    parts: tuple[Part, ...]
    window: Window
    usable: tuple[Int[np.ndarray, " period"], ...]
    pooled: Pooled | None
    constant: bool

    @classmethod
    def of(
        cls,
        sampling: Sampling,
        parts: tuple[Part, ...],
        window: Window,
        pooled: Pooled | None,
        constant: bool,
    ) -> Periods:
        """The usable periods of parts, for delays in a window and those of the pooled model."""
        low, high = sampling.window(*window)
        least, most = (low, high) if pooled is None else sampling.span(pooled.reads)
        ends = min(low, least), max(high, most)
        usable = tuple(sampling.usable(part, False, *ends) for part in parts)
        return cls(sampling, parts, (low, high), usable, pooled, constant)

    def over(self, low: float, high: float) -> Periods:
        """Those that are usable for delays between two, seconds."""
        window = self.sampling.window(low, high)
        if window == self.window:
            return self
        return Periods.of(self.sampling, self.parts, window, self.pooled, self.constant)

    @property
    def cells(self) -> Int[np.ndarray, " cell"]:
        """The cells of the window."""
        step = self.sampling.step
        return np.arange(cell_of(self.window[0], step, up=True), cell_of(self.window[1], step) + 1)

    def rows(self, reads: np.ndarray) -> Float[np.ndarray, "period z"]:
        """The rows of `Sampling.rows`, as if all were of one mode."""
        each = zip(self.parts, self.usable, strict=True)
        every = [self.sampling.rows(part, k, reads, self.constant) for part, k in each]
        return np.vstack(every)

    def rows_of_modes(self, reads: np.ndarray) -> list[np.ndarray]:
        """The rows of each mode, shared where reads are the same."""
        rows = {key: self.rows(own) for key, own in {own.tobytes(): own for own in reads}.items()}
        return [rows[own.tobytes()] for own in reads]

    @property
    def count(self) -> int:
        return sum(k.size for k in self.usable)

    @property
    def within(self) -> bool:
        """Whether the mode may change within periods."""
        return self.pooled is not None

    @cached_property
    def _mixed(self) -> Float[np.ndarray, " period"]:
        """The log density of periods within which the mode changes."""
        if self.pooled is None:
            return read_only(np.zeros(self.count))
        each = zip(self.parts, self.usable, strict=True)
        return read_only(np.concatenate([self.pooled.density(part, k) for part, k in each]))

    def posterior(self, density: Float[np.ndarray, "period mode"], jumps: Jumps) -> Posterior:
        """The posterior of modes, given log densities of usable periods and the chain.

        The first mode of a part is uniformly distributed.
        """
        return posterior_of(self.parts, self._by_part(density), jumps, self.usable, self.within)

    def path(
        self, density: Float[np.ndarray, "period mode"], jumps: Jumps
    ) -> list[Int[np.ndarray, " sample"]]:
        """The likeliest modes of the samples of every part."""
        return path_of(self.parts, self._by_part(density), jumps)

    def _by_part(self, density: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Log densities of all periods of every part, if the mode stays and if it changes."""
        modes, by_part, start = density.shape[1], [], 0
        for part, k in zip(self.parts, self.usable, strict=True):
            # Density 1, logarithm 0, where a period is not usable.
            stay = np.zeros((part.time.size - 1, modes))
            stay[k] = density[start : start + k.size]
            move = stay[..., None]
            if self.within:
                move = np.zeros((*stay.shape, 1))
                move[k] = self._mixed[start : start + k.size, None, None]
            by_part.append((stay, move))
            start += k.size
        return by_part


def posterior_of(
    parts: Sequence[Part],
    by_part: list[tuple[np.ndarray, np.ndarray]],
    jumps: Jumps,
    usable: Sequence[np.ndarray],
    within: bool,
) -> Posterior:
    """The posterior of modes from log densities of all periods, part by part."""
    modes = jumps.modes
    value, weight, nodes = 0.0, [], []
    counts = Counts(np.zeros((modes, modes)), np.zeros(modes))
    for part, (stay, move), k in zip(parts, by_part, usable, strict=True):
        logs, kind = jumps.over(part.time)
        same, node = np.empty(stay.shape), np.empty((len(stay) + 1, modes))
        pairs = np.empty(logs.shape)
        value += smooth(stay, move, logs, kind, jumps.first, same, node, pairs)
        counts = counts + jumps.counted(part.time, pairs)
        weight.append((same if within else node[:-1])[k])
        nodes.append(node)
    return Posterior(value, np.vstack(weight), counts, nodes)


def path_of(
    parts: Sequence[Part], by_part: list[tuple[np.ndarray, np.ndarray]], jumps: Jumps
) -> list[Int[np.ndarray, " sample"]]:
    """The likeliest modes of the samples of every part."""
    paths = [np.empty(part.time.size, np.int64) for part in parts]
    for part, (stay, move), path in zip(parts, by_part, paths, strict=True):
        likeliest(stay, move, *jumps.over(part.time), jumps.first, path)
    return paths
