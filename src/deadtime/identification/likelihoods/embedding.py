"""States from outputs alone: of every output itself, and what follows from it.

From y = C x with fewer outputs than states, A and B are known only up to a change of states. It is
fixed by `order`, how many states n_j each output y_j has, in one chain:

    x_j,1 = y_j,    dx_j,k/dt = x_j,k+1 + (b u)_j,k,    k < n_j,

so that row k of a chain is known but for B, and its last row of A is free. Any plant has such
states in which the rows C_j A^k, k < n_j, are independent (overlapping observability indices:
van Overbeek and Ljung, Automatica 18(5), 1982). Without `zeros` B acts on the last state of a chain
alone: then the states are the outputs and their derivatives.

Several modes have the same states if all share the C_j A^k, k < n_j, as position and speed do; else
a chain of each mode jumps at a switch. So with `jumps` the chains are those of the first mode, and
all of A is free in the others, where of B the inputs' weights in y_j' alone are known to be 0.

W is diagonal, but for the last states of all chains, whose forces may be correlated: with a
deviation of each sensor no more numbers than what outputs tell, n p + p (p + 1)/2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.frozen import Frozen
from deadtime.identification.parameters import Layout


@dataclass(frozen=True, eq=False)
class Embedding(Frozen):
    """Which states outputs have.

    order : how many of each output; zeros : whether inputs act on all of them
    size : (n,), how large each state is about, for a state of which nothing is known
    lead : the order by which first measurements are left out, that likelihoods of several orders
        are of the same ones; its own by default
    jumps : whether chains are those of the first mode alone
    """

    order: tuple[int, ...]
    zeros: bool
    size: Float[np.ndarray, " n"]
    lead: tuple[int, ...] | None = None
    jumps: bool = False

    @property
    def last(self) -> Int[np.ndarray, " p"]:
        """The last state of every chain."""
        return np.cumsum(self.order) - 1

    @property
    def C(self) -> Float[np.ndarray, "p n"]:
        """The outputs: the first state of every chain."""
        return np.eye(sum(self.order))[self.last - np.array(self.order) + 1]

    @property
    def upper(self) -> Int[np.ndarray, " row"]:
        """The states that are not last in a chain."""
        return np.setdiff1d(np.arange(sum(self.order)), self.last)

    def shift(self) -> Float[np.ndarray, "n n"]:
        """A of chains of integrators: what is known of A, and 0 elsewhere."""
        n = sum(self.order)
        A = np.zeros((n, n))
        A[self.upper, self.upper + 1] = 1.0
        return A

    def known(
        self, layout: Layout
    ) -> tuple[Int[np.ndarray, " known"], Float[np.ndarray, " known"]]:
        """Which unknowns of a layout with W's triangle are none, and what they are."""
        n, upper = layout.n, self.upper
        chained = 1 if self.jumps else layout.modes
        at_A = layout.of_A[:chained, upper].reshape(-1)
        values = np.tile(self.shift()[upper], (chained, 1, 1)).reshape(-1)
        at_B = layout.of_constant[:chained, upper].reshape(-1)  # it would only shift a state
        if not self.zeros:
            first = np.intersect1d(upper, self.last - np.array(self.order) + 1)
            at_B = layout.of_B[:chained, upper].reshape(-1)
            at_B = np.append(at_B, layout.of_B[chained:, first, : layout.m].reshape(-1))
        i, j = np.tril_indices(n)
        off = (i != j) & ~(np.isin(i, self.last) & np.isin(j, self.last))
        at_W = layout.size + np.flatnonzero(off)
        places = np.concatenate((at_A, at_B, at_W))
        return places, np.concatenate((values, np.zeros(at_B.size + at_W.size)))

    def initial(
        self, output: Float[np.ndarray, "sample p"], start: Bool[np.ndarray, " sample"]
    ) -> Bool[np.ndarray, "sample p"]:
        """The measurements that only tell where the state begins: until output j has n_j of them.

        They are left out of the likelihood, which is that of all others given these: how vague the
        state is at a start then does not matter, nor does it depend on the states' coordinates.
        """
        measured = np.isfinite(output)
        before = np.cumsum(measured, axis=0) - measured
        latest = np.maximum.accumulate(np.where(start, np.arange(start.size), 0))
        lead = np.array(self.lead or self.order)
        few = np.any(before - before[latest] < lead, axis=1, keepdims=True)
        return measured & few
