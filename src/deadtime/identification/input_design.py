"""Input sequences and the information in their logs: the usual ones, and the best one found.

Fisher's information F is a constant plus a quadratic form of z̄, the means of states and inputs
that act in every period, which are linear in the inputs (`experiment_information`). The covariance
of unbiased estimates is at least F⁻¹ (Cramér and Rao), which maximum likelihood attains for long
logs.

The criterion is smooth in the inputs and has many local maxima, most of them with nearly all inputs
at their limits. It is climbed by a quasi-Newton method with bounds (L-BFGS-B), its exact gradient
from one sweep backwards through the log, from several starts; the best is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.identification.experiment_information import Chain, ExactStates, NoisyStates
from deadtime.identification.parameters import FisherMatrix, Inputs, Layout, Vector

SIGMAS = 3.0  # standard deviations of the noise that limits leave room for
_UNSEEN = 1e-12  # of an eigenvalue of the information, scaled to a diagonal of ones


class CriterionValue(NamedTuple):
    """The criterion of inputs, its derivatives by them, and their largest relative excess."""

    value: float
    by_r: Inputs
    excess: float


@dataclass(frozen=True, eq=False)
class Prospect(Frozen):
    """The expected information of inputs r.

    measured : the information as a function of z̄, for exact or noisy states
    room : (T, n + m), limits of |mean of x| and |mean of u|; inf for no limit
    deviation : (T, n + m), standard deviations of states and inputs by noise
    """

    chain: Chain
    layout: Layout
    measured: ExactStates | NoisyStates
    room: Float[np.ndarray, "sample y"]
    deviation: Float[np.ndarray, "sample y"] = field(repr=False)

    @classmethod
    def of(cls, chain: Chain, layout: Layout, measured: ExactStates | NoisyStates) -> Prospect:
        """The information along a chain, without limits."""
        room = np.full((chain.kind.size, layout.n + layout.m), np.inf)
        return cls(chain, layout, measured, room, chain.deviations())

    @property
    def samples(self) -> int:
        return self.chain.kind.size

    def reach(self, r: Inputs) -> Float[np.ndarray, "sample y"]:
        """Bounds of every |state| and |input|, at three standard deviations."""
        xi = self.chain.means(r)
        return np.abs(self._outputs(xi, r)) + SIGMAS * self.deviation

    def _outputs(self, xi: np.ndarray, r: np.ndarray) -> Float[np.ndarray, "sample y"]:
        own = np.einsum("kmx,kx->km", self.chain.U[self.chain.kind], xi)
        return np.hstack((xi[:, : self.layout.n], own + r))

    def acting(self, r: Inputs) -> tuple[np.ndarray, np.ndarray]:
        """ξ̄ and z̄ of every sample."""
        chain = self.chain
        xi = chain.means(r)
        z = np.einsum("kzx,kx->kz", chain.Z[chain.kind], xi)
        return xi, z + np.einsum("kzm,km->kz", chain.Y[chain.kind], r)

    def information(self, r: Inputs) -> FisherMatrix:
        return self.measured.information(self.acting(r)[1])[0]

    def errors(self, r: Inputs) -> Vector:
        """The standard error of every unknown, roots of the diagonal of F⁻¹; infinite if singular.

        Errors do not depend on the units of unknowns: F is scaled to a diagonal of ones first.
        """
        F = self.information(r)
        unit = 1.0 / np.sqrt(np.maximum(np.diagonal(F), 1e-300))
        scaled = F * unit[:, None] * unit
        if not _is_identified(scaled):
            return np.full(len(F), np.inf)
        values, vectors = np.linalg.eigh(scaled)
        return unit * np.sqrt((vectors**2 / values).sum(axis=1))

    def evaluate(self, r: Inputs, price: float = 0.0) -> CriterionValue:
        """The criterion less `price` times the sum of squares of relative excesses over limits."""
        chain, n = self.chain, self.layout.n
        xi, z = self.acting(r)
        F, back = self.measured.information(z)
        value, by_F = self._criterion(F)
        of_z = back(by_F)
        of_xi = np.einsum("kzx,kz->kx", chain.Z[chain.kind], of_z)
        by_r = np.einsum("kzm,kz->km", chain.Y[chain.kind], of_z)
        U = chain.U[chain.kind]
        y = self._outputs(xi, r)
        excess = np.maximum(np.abs(y) / self.room - 1.0, 0.0)
        if price > 0.0 and excess.any():
            value -= price * float((excess**2).sum())
            of_y = -2.0 * price * excess * np.sign(y) / self.room
            of_xi[:, :n] += of_y[:, :n]
            of_xi += np.einsum("kmx,km->kx", U, of_y[:, n:])
            by_r += of_y[:, n:]
        return CriterionValue(value, by_r + chain.back(of_xi)[0], float(excess.max()))

    def _criterion(self, F: np.ndarray) -> tuple[float, np.ndarray]:
        """−log det of the delays' covariance, and its derivative by F; −∞ if not identified."""
        unit = 1.0 / np.sqrt(np.maximum(np.diagonal(F), 1e-300))
        scaled = F * unit[:, None] * unit
        first = self.layout.size - self.layout.delays
        if not _is_identified(scaled):
            return -np.inf, np.zeros(F.shape)
        rest, by_F = scaled[:first, :first], np.linalg.inv(scaled)
        value = np.linalg.slogdet(scaled)[1]
        value -= np.linalg.slogdet(rest)[1] + 2.0 * np.log(unit[first:]).sum()
        by_F[:first, :first] -= np.linalg.inv(rest)
        return float(value), by_F * unit[:, None] * unit


def _is_identified(scaled: np.ndarray) -> bool:
    """Whether an information, scaled to a diagonal of ones, is regular."""
    return bool(np.isfinite(scaled).all()) and bool(np.linalg.eigvalsh(scaled)[0] > _UNSEEN)


CLOCKS = (1, 2, 4, 8, 16)  # holding times of binary sequences, times that of the search
_PRICES = (10.0, 1e3)  # penalty weights of excesses over limits, used in turn
_CLIMBED = 5  # best starts from which the criterion is climbed
_ITERATIONS = 60
# Starts lie at this share of the limit, so that bounds are not active at once.
_INSIDE = 0.6
_PACES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)  # sign changes per value of a start
_STRETCH = 20  # most samples whose sign a perturbation changes


def binary_sequence(count: int, limit: Float[np.ndarray, " m"], clock: int) -> Inputs:
    """A maximum-length binary sequence of values held for `clock` samples, shifted for each input.

    Examples
    --------
    >>> binary_sequence(8, np.array([2.0]), 2).ravel()
    array([ 2.,  2.,  2.,  2.,  2.,  2., -2., -2.])
    """
    from scipy.signal import max_len_seq

    values = -(-count // clock)
    bits = int(min(max(np.ceil(np.log2(values + 1)), 2), 16))
    sequence = max_len_seq(bits)[0].astype(float) * 2.0 - 1.0
    shift = sequence.size // limit.size
    columns = [np.resize(np.roll(sequence, -j * shift), values) for j in range(limit.size)]
    return np.repeat(np.column_stack(columns), clock, axis=0)[:count] * limit


def steps(count: int, limit: Float[np.ndarray, " m"]) -> Inputs:
    """A step of every input from −limit to limit, one after the other.

    Examples
    --------
    >>> steps(4, np.array([1.0])).ravel()
    array([-1., -1.,  1.,  1.])
    """
    m = limit.size
    at = np.array([(j + 1) * count // (m + 1) for j in range(m)])
    return np.where(np.arange(count)[:, None] < at, -limit, limit)


def within_limits(prospect: Prospect, r: Inputs) -> np.ndarray:
    """The inputs scaled to keep all limits: the loop is linear."""
    return r / (1.0 + prospect.evaluate(r).excess)


def best_sequence(
    prospect: Prospect, limit: Float[np.ndarray, " m"], hold: int, kicks: int, seed: int
) -> Inputs:
    """The best inputs found within ±limit, each held for `hold` samples.

    The search climbs from the best of binary sequences of all paces. Then it changes the sign of a
    random stretch of the best inputs and climbs again, `kicks` times.
    """
    count, m = prospect.samples, limit.size
    rng = np.random.default_rng(seed)
    values = -(-count // hold)
    starts = [binary_sequence(count, limit, hold * clock)[::hold] for clock in CLOCKS]
    for pace in _PACES:
        turns = np.where(rng.random((values, m)) < pace, -1.0, 1.0)
        starts.append(limit * np.cumprod(turns, axis=0))
    every = [within_limits(prospect, np.repeat(v, hold, axis=0)[:count]) for v in starts]
    order = np.argsort([-prospect.evaluate(r).value for r in every])[:_CLIMBED]
    climbs = [_climb(prospect, _INSIDE * starts[place], limit, hold, _PRICES) for place in order]
    best = max(climbs, key=lambda one: one[0])
    for _ in range(kicks):
        v, length = best[1][::hold].copy(), int(rng.integers(1, min(_STRETCH, values) + 1))
        start = int(rng.integers(values - length + 1))
        v[start : start + length, rng.integers(m)] *= -1.0
        again = _climb(prospect, _INSIDE * v, limit, hold, _PRICES[-1:])
        best = max(best, again, key=lambda one: one[0])
    return best[1]


def _climb(
    prospect: Prospect, first: np.ndarray, limit: np.ndarray, hold: int, prices: tuple[float, ...]
) -> tuple[float, Inputs]:
    """The criterion at the local maximum near a start, and its inputs, scaled to keep limits."""
    from scipy.optimize import minimize

    count, m = prospect.samples, limit.size
    edges = np.arange(0, count, hold)

    def inputs(v: np.ndarray) -> Inputs:
        return np.repeat(v.reshape(-1, m) * limit, hold, axis=0)[:count]

    def downhill(v: np.ndarray, price: float) -> tuple[float, np.ndarray]:
        value, by_r, _ = prospect.evaluate(inputs(v), price)
        if not np.isfinite(value):
            return 1e6, np.zeros(v.size)
        return -value, -(np.add.reduceat(by_r, edges, axis=0) * limit).ravel()

    v = (first / limit).ravel()
    for price in prices if np.isfinite(prospect.room).any() else prices[-1:]:
        result = minimize(
            downhill,
            v,
            (price,),
            method="L-BFGS-B",
            jac=True,
            bounds=[(-1.0, 1.0)] * v.size,
            options={"maxiter": _ITERATIONS},
        )
        v = np.clip(result.x, -1.0, 1.0)
    r = within_limits(prospect, inputs(v))
    return prospect.evaluate(r).value, r
