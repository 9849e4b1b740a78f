"""How a hidden mode jumps: by a matrix per period of even rows, by rates where rows are uneven.

    even:      P(σ_{k+1} = j | σ_k = i) = P_ij
    uneven:    P(σ_{k+1} = j | σ_k = i) = (e^{Λ τ_k})_ij,    Λ_ij ≥ 0,    Σ_j Λ_ij = 0

Given how likely every jump of every period is, ξ_k, the rates that are likeliest next are those of
expected jumps over expected time (Hobolth and Jensen, Statistical Applications in Genetics and
Molecular Biology 4(1), 2005), Λ_ij ← E N_ij / E T_i,

    E N_ij = Λ_ij Σ_k Σ_ab ξ_k(a, b) ∂(e^{Λ τ_k})_ab/∂Λ_ij / (e^{Λ τ_k})_ab,

E T_i the sum for i = j without Λ_ij in front. Of even rows N are jumps, stays too, and T rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.frozen import Frozen
from deadtime.identification.transition import interpolation, nodes_of, transitions_of

_STAY = 0.95  # a first guess of the chain's diagonal
_FLOOR = 1e-300  # of a probability, whose logarithm is taken


class Counts(NamedTuple):
    """Expected jumps N (modes, modes), and the time, or the rows, T (modes,) that led to them."""

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
        """Those of which a period makes about P."""
        return cls(_rates(P / step), step, rates) if rates else cls(P, step, rates)

    @classmethod
    def lasting(cls, modes: int, step: float, rates: bool) -> Jumps:
        """A first guess, of modes that last."""
        P = np.full((modes, modes), (1.0 - _STAY) / max(modes - 1, 1))
        np.fill_diagonal(P, _STAY if modes > 1 else 1.0)
        return cls.of(P, step, rates)

    @property
    def modes(self) -> int:
        """How many there are."""
        return len(self.matrix)

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
        """What is expected of jumps whose probabilities are the pairs of `chain.smooth`."""
        if not self.rates:
            return Counts(pairs[0], pairs[0].sum(axis=1))
        by, weight, whole = self._within(time)
        share = np.tensordot(weight, pairs / np.maximum(whole, _FLOOR), (0, 0))
        total = np.einsum("qab,qcab->c", share, by).reshape(self.matrix.shape)
        return Counts(self.matrix * total, np.diagonal(total).copy())

    def next(self, counts: Counts) -> Jumps:
        """The likeliest ones of what is expected."""
        spent = counts.spent[:, None]
        found = counts.jumps / np.where(spent > 0.0, spent, 1.0)
        if self.rates:
            return Jumps(_rates(found), self.step, True)
        return Jumps(np.where(spent > 0.0, found, np.eye(self.modes)), self.step, False)

    def scaled(self, factor: Float[np.ndarray, "mode mode"]) -> Jumps:
        """With odds, or rates, times factors, those of stays 1."""
        moved = self.matrix * factor
        if self.rates:
            return Jumps(_rates(moved), self.step, True)
        return Jumps(moved / moved.sum(axis=1, keepdims=True), self.step, False)

    def slope(self, counts: Counts) -> Float[np.ndarray, "mode mode"]:
        """The score in the logarithms of those factors."""
        return counts.jumps - counts.spent[:, None] * self.matrix

    def ordered(self, order: Int[np.ndarray, " mode"]) -> Jumps:
        """With modes in another order."""
        return Jumps(self.matrix[np.ix_(order, order)], self.step, self.rates)


def _rates(matrix: np.ndarray) -> np.ndarray:
    """The same between modes, rows of sum 0."""
    off = np.where(np.eye(len(matrix), dtype=bool), 0.0, np.maximum(matrix, 0.0))
    return off - np.diag(off.sum(axis=1))
