"""The plant, period by period, under an input sequence and maybe a law: means and covariances.

With what is in flight, ξ_k = (x_k, u_{k−1}, …, u_{k−L}), the input u_k = U_k ξ_k + r_k and what
acts in period k, z_k = (x_k, u_{k−N}, u_{k−N+1}) with N of every input in the mode of the period,

    ξ_{k+1} = M_k ξ_k + E_k r_k + (w_k, 0),    z_k = Z_k ξ_k + Y_k r_k,    w_k ~ N(0, S_σ),

so that means are linear in r and covariances do not depend on it. A law is told y_k = x_k + v_k, so
that v_k, the sensors' noise, enters by it as r_k does.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Feedback
from deadtime.feedback.table import ages_along
from deadtime.identification.parameters import Layout
from deadtime.identification.sampling import period_weights
from deadtime.plant import SwitchedSystem


class GainRows(NamedTuple):
    """U_k of every sample: `kind` (T,) says which of `gains` (kinds, m, n + L m) it is."""

    gains: Float[np.ndarray, "kind m xi"]
    kind: Int[np.ndarray, " sample"]


class Chain(NamedTuple):
    """The matrices of distinct periods, and of every sample which they are.

    M, E, Z, Y as in the module, U that of `GainRows`; S : (modes, n, n), V : variances of sensors,
    P : what a period makes of z, by_P : of each mode its derivatives by its unknowns,
    (own, n, n + 2 m), place : whose they are
    """

    M: Float[np.ndarray, "kind xi xi"]
    E: Float[np.ndarray, "kind xi m"]
    Z: Float[np.ndarray, "kind z xi"]
    Y: Float[np.ndarray, "kind z m"]
    U: Float[np.ndarray, "kind m xi"]
    kind: Int[np.ndarray, " sample"]
    mode: Int[np.ndarray, " sample"]
    S: Float[np.ndarray, "mode n n"]
    V: Float[np.ndarray, " n"]
    P: Float[np.ndarray, "mode n z"]
    by_P: list[Float[np.ndarray, "own n z"]]
    place: list[Int[np.ndarray, " own"]]
    open: bool

    @property
    def n(self) -> int:
        """How many states there are."""
        return self.S.shape[1]

    def means(self, r: Float[np.ndarray, "sample m"]) -> Float[np.ndarray, "sample xi"]:
        """ξ̄ of every sample, from rest."""
        result = np.zeros((len(r), self.M.shape[1]))
        added = np.einsum("kxm,km->kx", self.E[self.kind], r)
        M = list(self.M)
        for k, kind in enumerate(self.kind[:-1].tolist()):
            result[k + 1] = M[kind] @ result[k] + added[k]
        return result

    def back(
        self, of_xi: Float[np.ndarray, "sample xi"]
    ) -> tuple[Float[np.ndarray, "sample m"], Float[np.ndarray, "sample xi"]]:
        """What r_k moves of Σ of_xi · ξ̄, by way of the samples after it; and λ_{k+1}."""
        after = np.zeros(of_xi.shape)
        M = [one.T for one in self.M]
        for k in range(len(of_xi) - 2, -1, -1):
            after[k] = of_xi[k + 1] + M[self.kind[k + 1]] @ after[k + 1]
        return np.einsum("kxm,kx->km", self.E[self.kind], after), after

    @property
    def random(self) -> int:
        """How many of ξ noise moves: the states alone where no law makes inputs of them."""
        return self.n if self.open else self.M.shape[1]

    def covariances(self) -> Iterator[Float[np.ndarray, "xi xi"]]:
        """Cov ξ of every sample, of what is random in it, from rest."""
        n, use = self.n, self.random
        M = self.M[:, :use, :use]
        told = (self.E @ self.U[:, :, :n])[:, :use]
        told = told * self.V @ told.swapaxes(1, 2)
        now = np.zeros((use, use))
        for k, kind in enumerate(self.kind.tolist()):
            yield now
            now = M[kind] @ now @ M[kind].T + told[kind]
            now[:n, :n] += self.S[self.mode[k]]

    def deviations(self) -> Float[np.ndarray, "sample y"]:
        """The standard deviations of states and inputs, (T, n + m), that noise makes from rest."""
        n, use = self.n, self.random
        U = self.U[:, :, :use]
        told = np.einsum("cmn,n->cm", self.U[:, :, :n] ** 2, self.V)
        variance = np.zeros((self.kind.size, n + U.shape[1]))
        for k, (kind, now) in enumerate(zip(self.kind.tolist(), self.covariances(), strict=True)):
            variance[k, :n] = np.diagonal(now)[:n]
            variance[k, n:] = np.diagonal(U[kind] @ now @ U[kind].T) + told[kind]
        return np.sqrt(np.maximum(variance, 0.0))


def rows_along(
    table: Feedback | None, mode: Int[np.ndarray, " sample"], n: int, m: int, past: int
) -> GainRows:
    """What a law adds to r at every sample, from the modes at samples."""
    if table is None:
        return GainRows(np.zeros((1, m, n + past * m)), np.zeros(mode.size, np.int64))
    ages = ages_along(mode, 0)
    row = [
        table.row(int(i), int(age), k) for k, (i, age) in enumerate(zip(mode, ages, strict=True))
    ]
    chosen, kind = np.unique(row, return_inverse=True)
    gains = np.zeros((chosen.size, m, n + past * m))
    gains[:, :, :n] = table.state_gain[chosen]
    gains[:, :, n : n + table.taps * m] = table.latest_first[chosen]
    return GainRows(gains, kind)


def chain_of(
    plant: SwitchedSystem,
    step: float,
    mode: Int[np.ndarray, " sample"],
    S: Float[np.ndarray, "mode n n"],
    cells: Int[np.ndarray, "mode m"],
    layout: Layout,
    table: Feedback | None,
    V: Float[np.ndarray, " n"] | None = None,
) -> Chain:
    """The chain of a plant along modes at samples; `cells` are N of every mode and input."""
    n, m = layout.n, layout.m
    past = int(max(cells.max(), 0 if table is None else table.taps))
    rows = rows_along(table, mode, n, m, past)
    pairs, kind = np.unique(np.stack((mode, rows.kind)), axis=1, return_inverse=True)
    kind = kind.ravel()
    size, count = n + past * m, pairs.shape[1]
    M, E = np.zeros((count, size, size)), np.zeros((count, size, m))
    Z, Y = np.zeros((count, n + 2 * m, size)), np.zeros((count, n + 2 * m, m))
    weights = [
        period_weights(plant.A[i], plant.B[i], cells[i] * step - plant.delays[i], step)
        for i in range(layout.modes)
    ]
    for c, (i, row) in enumerate(pairs.T.tolist()):
        U = rows.gains[row]
        Z[c, :n, :n] = np.eye(n)
        for j in range(m):
            for place, lag in ((n + j, cells[i, j]), (n + m + j, cells[i, j] - 1)):
                if lag > 0:
                    Z[c, place, n + (lag - 1) * m + j] = 1.0
                else:
                    Z[c, place], Y[c, place, j] = U[j], 1.0
        P = weights[i][0]
        M[c, :n], E[c, :n] = P @ Z[c], P @ Y[c]
        M[c, n : n + m], E[c, n : n + m] = U, np.eye(m)
        M[c, n + m :, n : size - m] = np.eye(size - n - m)
    place = [layout.of_mode(i) for i in range(layout.modes)]
    by_P = [one[1] for one in weights]
    U = rows.gains[pairs[1]]
    V = np.zeros(n) if V is None else V
    P = np.array([one[0] for one in weights])
    return Chain(M, E, Z, Y, U, kind, mode, S, V, P, by_P, place, table is None)


def require_bounded(chain: Chain) -> None:
    """Refuse a run that noise alone would carry far away."""
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


_MOST_GROWTH = 3.0  # of log |x|
