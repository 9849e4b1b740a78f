"""The expected information of the log of an experiment, period by period.

**The loop.** The state and inputs in flight are ξ_k = (x_k, u_{k−1}, …, u_{k−L}), the input is
u_k = U_k ξ_k + r_k. In period k z_k = (x_k, u_{k−N}, u_{k−N+1}) acts, with N of every input in the
mode of the period:

    ξ_{k+1} = M_k ξ_k + E_k r_k + (w_k, 0),    z_k = Z_k ξ_k + Y_k r_k,    w_k ~ N(0, S_σ),

so means are linear in r, and covariances do not depend on it. A law receives y_k = x_k + v_k, so
v_k, the sensors' noise, enters through U_k.

**The information.** Without noise of sensors the covariance S_σ of a period's noise does not depend
on the unknowns θ, and

    F = Σ_k E[(∂P z_k)ᵀ S⁻¹ (∂P z_k)],    x_{k+1} = P_σ(θ) z_k + w_k,

exactly. In E z zᵀ = z̄ z̄ᵀ + Cov z only the first term depends on the inputs.

With noisy sensors it is the information of the Kalman filter's innovations. With y_k = x_k + v_k,
v ~ N(0, V), these are white, e_k ~ N(0, S_k), and

    F = Σ_k E[∂e_kᵀ S_k⁻¹ ∂e_k] + ½ tr(S_k⁻¹ ∂S_k S_k⁻¹ ∂S_k).

With K its gain and η = ∂x̂, before a sample is measured,

    ∂e_k = −η_k,    η_{k+1} = Φ (I − K_k) η_k + ∂P ẑ_k + Φ ∂K_k e_k,

where ẑ_k is z_k with x̂_k in place of x_k. The mean of η is linear in the mean of z, hence in the
inputs; everything else does not depend on them and is summed once. At the beginning, and after each
period that an identification leaves out, the filter starts from the measurement alone: x̂ = y,
P = V, η = 0. Noise is unknown, too: W, one for all modes, and V. No mean depends on them, so they
are eliminated by a Schur complement once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.feedback import Feedback
from deadtime.feedback.table import ages_along
from deadtime.identification.intervals import left_of
from deadtime.identification.parameters import (
    FisherMatrix,
    Inputs,
    Layout,
    ModeCells,
    Square,
    Squares,
)
from deadtime.identification.sampling import period_weights
from deadtime.identification.transition import noise_tables
from deadtime.plant import SwitchedSystem


class Chain(NamedTuple):
    """The matrices of distinct periods, with their index `kind` at every sample.

    M, E, Z, Y, U : as in the module; S : (modes, n, n); V : variances of sensors
    P : x_{k+1} = P z_k; by_P : of each mode its derivatives by the mode's unknowns,
    (own, n, n + 2 m), with their places in θ
    """

    M: Float[np.ndarray, "kind xi xi"]
    E: Float[np.ndarray, "kind xi m"]
    Z: Float[np.ndarray, "kind z xi"]
    Y: Float[np.ndarray, "kind z m"]
    U: Float[np.ndarray, "kind m xi"]
    kind: Int[np.ndarray, " sample"]
    mode: Int[np.ndarray, " sample"]
    S: Squares
    V: Float[np.ndarray, " n"]
    P: Float[np.ndarray, "mode n z"]
    by_P: list[Float[np.ndarray, "own n z"]]
    place: list[Int[np.ndarray, " own"]]
    open: bool

    @property
    def n(self) -> int:
        return self.S.shape[1]

    def means(self, r: Inputs) -> Float[np.ndarray, "sample xi"]:
        """ξ̄ of every sample, from rest."""
        result = np.zeros((len(r), self.M.shape[1]))
        added = np.einsum("kxm,km->kx", self.E[self.kind], r)
        M = list(self.M)
        for k, kind in enumerate(self.kind[:-1].tolist()):
            result[k + 1] = M[kind] @ result[k] + added[k]
        return result

    def back(
        self, of_xi: Float[np.ndarray, "sample xi"]
    ) -> tuple[Inputs, Float[np.ndarray, "sample xi"]]:
        """The derivative of Σ of_xi · ξ̄ by r_k, by way of the samples after it; and λ_{k+1}."""
        after = np.zeros(of_xi.shape)
        M = [one.T for one in self.M]
        for k in range(len(of_xi) - 2, -1, -1):
            after[k] = of_xi[k + 1] + M[self.kind[k + 1]] @ after[k + 1]
        return np.einsum("kxm,kx->km", self.E[self.kind], after), after

    @property
    def random(self) -> int:
        """The number of random entries of ξ: without a law noise moves the states alone."""
        return self.n if self.open else self.M.shape[1]

    def covariances(self) -> Iterator[Float[np.ndarray, "xi xi"]]:
        """Cov of the random entries of ξ at every sample, from rest."""
        n, use = self.n, self.random
        M = self.M[:, :use, :use]
        measured = (self.E @ self.U[:, :, :n])[:, :use]
        measured = measured * self.V @ measured.swapaxes(1, 2)
        now = np.zeros((use, use))
        for k, kind in enumerate(self.kind.tolist()):
            yield now
            now = M[kind] @ now @ M[kind].T + measured[kind]
            now[:n, :n] += self.S[self.mode[k]]

    def deviations(self) -> Float[np.ndarray, "sample y"]:
        """The standard deviations of states and inputs by noise, (T, n + m), from rest."""
        n, use = self.n, self.random
        U = self.U[:, :, :use]
        measured = np.einsum("cmn,n->cm", self.U[:, :, :n] ** 2, self.V)
        variance = np.zeros((self.kind.size, n + U.shape[1]))
        for k, (kind, now) in enumerate(zip(self.kind.tolist(), self.covariances(), strict=True)):
            variance[k, :n] = np.diagonal(now)[:n]
            variance[k, n:] = np.diagonal(U[kind] @ now @ U[kind].T) + measured[kind]
        return np.sqrt(np.maximum(variance, 0.0))


def chain_of(
    plant: SwitchedSystem,
    step: float,
    mode: Int[np.ndarray, " sample"],
    S: Squares,
    cells: ModeCells,
    layout: Layout,
    table: Feedback | None,
    V: Float[np.ndarray, " n"] | None = None,
) -> Chain:
    """The chain of a plant along modes at samples; `cells` are N of every mode and input."""
    n, m = layout.n, layout.m
    past = int(max(cells.max(), 0 if table is None else table.taps))
    size = n + past * m
    gains, row = np.zeros((1, m, size)), np.zeros(mode.size, np.int64)
    if table is not None:
        every = zip(mode.tolist(), ages_along(mode, 0), strict=True)
        of_sample = [table.row(i, int(age), k) for k, (i, age) in enumerate(every)]
        chosen, row = np.unique(of_sample, return_inverse=True)
        gains = np.zeros((chosen.size, m, size))
        gains[:, :, :n] = table.state_gain[chosen]
        gains[:, :, n : n + table.taps * m] = table.latest_first[chosen]
    pairs, kind = np.unique(np.stack((mode, row)), axis=1, return_inverse=True)
    kind, count = kind.ravel(), pairs.shape[1]
    M, E = np.zeros((count, size, size)), np.zeros((count, size, m))
    Z, Y = np.zeros((count, n + 2 * m, size)), np.zeros((count, n + 2 * m, m))
    weights = [
        period_weights(plant.A[i], plant.B[i], cells[i] * step - plant.delays[i], step)
        for i in range(layout.modes)
    ]
    for c, (i, own) in enumerate(pairs.T.tolist()):
        U = gains[own]
        Z[c, :n, :n] = np.eye(n)
        for j in range(m):
            for place, lag in ((n + j, cells[i, j]), (n + m + j, cells[i, j] - 1)):
                if lag > 0:  # ξ has u_{k−1}, u_{k−2}, … behind x; u_k itself is U ξ + r
                    Z[c, place, n + (lag - 1) * m + j] = 1.0
                else:
                    Z[c, place], Y[c, place, j] = U[j], 1.0
        P = weights[i][0]
        M[c, :n], E[c, :n] = P @ Z[c], P @ Y[c]
        M[c, n : n + m], E[c, n : n + m] = U, np.eye(m)
        M[c, n + m :, n : size - m] = np.eye(size - n - m)
    place = [layout.of_mode(i) for i in range(layout.modes)]
    V = np.zeros(n) if V is None else V
    P, by_P = zip(*weights, strict=True)
    return Chain(
        M, E, Z, Y, gains[pairs[1]], kind, mode, S, V, np.array(P), list(by_P), place, table is None
    )


def require_bounded(chain: Chain) -> None:
    """Refuse a run in which the noise grows without a law that stabilises the plant.

    The product of all M is rescaled at every sample, so that it neither overflows nor underflows.
    """
    use = chain.random
    M, over, growth = chain.M[:, :use, :use], np.eye(use), 0.0
    for kind in chain.kind.tolist():
        over = M[kind] @ over
        size = float(np.abs(over).max())
        if size == 0.0:
            return
        over, growth = over / size, growth + np.log(size)
    growth += np.log(max(float(np.abs(np.linalg.eigvals(over)).max()), 1e-300))
    if growth > _MOST_GROWTH:
        far = f"along its modes it grows by e^{growth:.3g} within the horizon"
        if chain.open:
            raise ArgumentError(
                f"law must be given for a plant that is unstable: {far}. Give a law that "
                "stabilises it, to which the experiment adds its inputs, or shorten the horizon."
            )
        raise ArgumentError(f"law must stabilise the plant: {far}. Give another, or none.")


_MOST_GROWTH = 3.0  # of log |x| within the horizon

Pullback = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class ExactStates(Frozen):
    """F as a function of z̄, with exact states.

    white : of every mode ∂P in units of its noise; place : of these unknowns, of `size` in all
    rows : the periods that count, of every mode; random : Σ Cov z over them
    """

    white: list[Float[np.ndarray, "own n z"]]
    place: list[Int[np.ndarray, " own"]]
    rows: list[Int[np.ndarray, " row"]]
    random: Float[np.ndarray, "mode z z"]
    size: int

    @classmethod
    def of(cls, chain: Chain, used: Bool[np.ndarray, " sample"], size: int) -> ExactStates:
        roots = np.linalg.cholesky(chain.S)
        white = [np.linalg.solve(L, one) for L, one in zip(roots, chain.by_P, strict=True)]
        rows = [np.flatnonzero(used & (chain.mode == i)) for i in range(len(white))]
        random = np.zeros((len(white), *chain.Z.shape[1:2] * 2))
        for k, now in enumerate(chain.covariances()):
            if used[k]:
                Z = chain.Z[chain.kind[k]][:, : len(now)]
                random[chain.mode[k]] += Z @ now @ Z.T
        return cls(white, chain.place, rows, random, size)

    def information(self, z: Float[np.ndarray, "sample z"]) -> tuple[FisherMatrix, Pullback]:
        """F, and the map from a derivative by F to one by z̄."""
        F = np.zeros((self.size, self.size))
        every = list(zip(self.white, self.place, self.rows, strict=True))
        for i, (white, place, own) in enumerate(every):
            moved = white @ (z[own].T @ z[own] + self.random[i])
            F[np.ix_(place, place)] += np.einsum("anz,bnz->ab", moved, white)

        def back(by_F: np.ndarray) -> np.ndarray:
            of_z = np.zeros(z.shape)
            for white, place, own in every:
                theta = np.einsum("ab,anz,bny->zy", by_F[np.ix_(place, place)], white, white)
                of_z[own] = 2.0 * z[own] @ theta
            return of_z

        return F, back


class NoiseTables(NamedTuple):
    """Q of every mode, the unknowns `wide` of Q and sensors, and the derivatives of Q by these.

    After the plant's unknowns follow the lower triangle of L, its diagonal as logarithms, then the
    logarithms of the sensors' standard deviations.
    """

    Q: Squares
    wide: Int[np.ndarray, " q"]
    of_Q: Float[np.ndarray, "mode q n n"]

    @classmethod
    def of(cls, layout: Layout, A: Squares, L: Square, step: float) -> NoiseTables:
        """The tables of periods of `step` seconds, with one W = L Lᵀ for all modes."""
        n, square = layout.n, layout.n**2
        triangle = n * (n + 1) // 2
        wide = np.append(layout.of_A.ravel(), layout.size + np.arange(triangle + n))
        Q, of_Q = np.empty(A.shape), np.zeros((layout.modes, wide.size, n, n))
        of_L = layout.modes * square + np.arange(triangle)
        for i in range(layout.modes):
            (Q[i],), (by_Q,) = noise_tables(A[i], L, np.array([step]))
            of_Q[i, i * square : (i + 1) * square], of_Q[i, of_L] = np.split(by_Q, [square])
        return cls(Q, wide, of_Q)


class FilterSample(NamedTuple):
    """A sample of the filter: its gain, the innovation's covariance and derivatives of both.

    At a start the gain is I, and there is no innovation: S = 0, S⁻¹ = 0.
    """

    K: Square
    S: Square
    inverse: Square
    by_K: Float[np.ndarray, "q n n"]
    by_S: Float[np.ndarray, "q n n"]


@dataclass(frozen=True, eq=False)
class NoisyStates(Frozen):
    """F as a function of z̄, with noisy sensors.

    white : S_k^{-1/2}, 0 at starts; carried : Φ (I − K_k), from η_k to η_{k+1}
    by_P : ∂P of every mode; place : of these unknowns; rows : the periods that count, of every mode
    constant : the part of F that does not depend on the inputs
    """

    white: Float[np.ndarray, "sample n n"]
    carried: Float[np.ndarray, "sample n n"]
    by_P: list[Float[np.ndarray, "own n z"]]
    place: list[Int[np.ndarray, " own"]]
    rows: list[Int[np.ndarray, " row"]]
    constant: FisherMatrix

    @classmethod
    def of(
        cls, chain: Chain, used: Bool[np.ndarray, " sample"], size: int, tables: NoiseTables
    ) -> NoisyStates:
        count, n = used.size, chain.n
        white, carried = np.zeros((2, count, n, n))
        joint = _Joint.of(chain, size, tables)
        F = np.zeros((joint.unknowns, joint.unknowns))
        restarts = np.append(True, ~used[:-1])
        at = np.ix_(tables.wide, tables.wide)
        filtered = _filter(chain, restarts, tables)
        for k, (now, one) in enumerate(zip(chain.covariances(), filtered, strict=True)):
            if restarts[k]:
                joint = joint.at_start(now)
            else:
                white[k] = np.linalg.inv(np.linalg.cholesky(one.S))
                F += np.einsum("aibj,ij->ab", joint.of_eta(), one.inverse)
                moved = one.by_S @ one.inverse
                F[at] += 0.5 * np.einsum("aij,bji->ab", moved, moved)
            if used[k]:
                carried[k] = chain.P[chain.mode[k], :, :n] @ (np.eye(n) - one.K)
                joint = joint.after(k, one, carried[k])
        rows = [np.flatnonzero(used & (chain.mode == i)) for i in range(len(chain.S))]
        return cls(white, carried, chain.by_P, chain.place, rows, left_of(F, np.arange(size)))

    def information(self, z: Float[np.ndarray, "sample z"]) -> tuple[FisherMatrix, Pullback]:
        """F, and the map from a derivative by F to one by z̄."""
        size = len(self.constant)
        every = list(zip(self.by_P, self.place, self.rows, strict=True))
        eta = np.zeros((len(z), size, self.white.shape[1]))
        for by_P, place, own in every:
            eta[own[:, None] + 1, place] = np.einsum("anz,kz->kan", by_P, z[own])
        for k, M in enumerate(self.carried[:-1]):
            eta[k + 1] += eta[k] @ M.T
        scaled = eta @ self.white.swapaxes(1, 2)
        flat = scaled.swapaxes(0, 1).reshape(size, -1)

        def back(by_F: np.ndarray) -> np.ndarray:
            of_eta, of_z = 2.0 * (by_F @ scaled) @ self.white, np.zeros(z.shape)
            for k in range(len(z) - 2, -1, -1):
                of_eta[k] += of_eta[k + 1] @ self.carried[k]
            for by_P, place, own in every:
                of_z[own] = np.einsum("anz,kan->kz", by_P, of_eta[own[:, None] + 1, place])
            return of_z

        return flat @ flat.T + self.constant, back


def _filter(
    chain: Chain, restarts: Bool[np.ndarray, " sample"], tables: NoiseTables
) -> Iterator[FilterSample]:
    """Kalman's filter along a chain, with derivatives by the unknowns `tables.wide`."""
    n, q = chain.n, tables.wide.size
    V, by_V = np.diag(chain.V), np.zeros((q, n, n))
    by_V[q - n + np.arange(n), np.arange(n), np.arange(n)] = 2.0 * chain.V
    P, by_P, none = V, by_V, np.zeros((n, n))
    place = np.full(int(tables.wide[-1]) + 1, -1)
    place[tables.wide] = np.arange(q)
    for k, i in enumerate(chain.mode.tolist()):
        if restarts[k]:
            one = FilterSample(np.eye(n), none, none, np.zeros((q, n, n)), np.zeros((q, n, n)))
        else:
            S, by_S = P + V, by_P + by_V
            inverse = np.linalg.inv(S)
            K = P @ inverse
            one = FilterSample(K, S, inverse, (by_P - K @ by_S) @ inverse, by_S)
        yield one
        keep, Phi = np.eye(n) - one.K, chain.P[i, :, :n]
        P = keep @ P @ keep.T + one.K @ V @ one.K.T
        by_P = Phi @ (keep @ by_P @ keep.T + one.K @ by_V @ one.K.T) @ Phi.T + tables.of_Q[i]
        own = place[chain.place[i]]
        turned = chain.by_P[i][own >= 0, :, :n] @ P @ Phi.T
        by_P[own[own >= 0]] += turned + turned.swapaxes(1, 2)
        P = Phi @ P @ Phi.T + tables.Q[i]


class _Joint(NamedTuple):
    """The covariance of (ξ̂, η) before a sample is measured; ξ̂ = (x̂, inputs in flight)."""

    chain: Chain
    tables: NoiseTables
    by_P: Float[np.ndarray, "mode unknown n z"]
    covariance: Float[np.ndarray, "all all"]
    use: int

    @classmethod
    def of(cls, chain: Chain, size: int, tables: NoiseTables) -> _Joint:
        n, unknowns = chain.n, int(tables.wide[-1]) + 1
        by_P = np.zeros((len(chain.S), unknowns, *chain.by_P[0].shape[1:]))
        for i, (own, place) in enumerate(zip(chain.by_P, chain.place, strict=True)):
            by_P[i, place] = own
        whole = chain.random + unknowns * n
        return cls(chain, tables, by_P, np.zeros((whole, whole)), chain.random)

    @property
    def unknowns(self) -> int:
        return self.by_P.shape[1]

    def of_eta(self) -> Float[np.ndarray, "unknown n unknown n"]:
        """The covariance of η."""
        part, n = self.covariance[self.use :, self.use :], self.chain.n
        return part.reshape(self.unknowns, n, self.unknowns, n)

    def at_start(self, now: Float[np.ndarray, "xi xi"]) -> _Joint:
        """A start: x̂ = y, with Cov ξ = `now`, and η = 0."""
        covariance, states = np.zeros(self.covariance.shape), np.arange(self.chain.n)
        covariance[: self.use, : self.use] = now
        covariance[states, states] += self.chain.V
        return self._replace(covariance=covariance)

    def after(self, k: int, one: FilterSample, carried: Square) -> _Joint:
        """The covariance before the next measurement."""
        n, use, i, kind = self.chain.n, self.use, self.chain.mode[k], self.chain.kind[k]
        Z, M = self.chain.Z[kind][:, :use], self.chain.M[kind][:use, :use]
        P = self.chain.P[i]
        # The effect of e on ẑ, also through the law, which receives y and not x̂.
        measured = self.chain.Z[kind][:, :n].copy()
        measured[:n] = one.K
        of_xi, of_eta = M[:, :n].copy(), self.by_P[i] @ measured
        of_xi[:n] = P @ measured
        of_eta[self.tables.wide] += P[:, :n] @ one.by_K
        by_z = (self.by_P[i] @ Z).reshape(-1, use)

        def over(rows: np.ndarray) -> np.ndarray:
            eta = rows[use:].reshape(self.unknowns, n, -1)
            moved = (carried @ eta).reshape(self.unknowns * n, -1) + by_z @ rows[:use]
            return np.vstack((M @ rows[:use], moved))

        by_e = np.vstack((of_xi, of_eta.reshape(-1, n)))
        covariance = over(over(self.covariance).T) + by_e @ one.S @ by_e.T
        return self._replace(covariance=covariance)
