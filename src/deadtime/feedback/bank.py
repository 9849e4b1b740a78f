"""A bank of Kalman filters over a `deadtime.feedback.belief.Belief`, as arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only
from deadtime.feedback.belief import Belief, BeliefState


class BankForm(NamedTuple):
    """How a bank moves: data that no run changes.

    chain : Belief, its noise the covariance that a period adds to x
    C : (modes, p, n), variance : (p,), of y about C x
    gain : (modes, n, p) of observers, or (modes, n, 0) for Kalman's
    estimate : (n,), covariance : (n, n), of x_0 in every mode
    """

    chain: Belief
    C: Float[np.ndarray, "mode p n"]
    variance: Float[np.ndarray, " p"]
    gain: Float[np.ndarray, "mode n p_or_0"]
    estimate: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "n n"]


class BankState(NamedTuple):
    """What of a bank changes from sample to sample, and room to work in.

    chain : BeliefState
    x : (modes, n), P : (modes, n, n), E[x_k | the mode is i, all that was seen] and the covariance
    ahead_x : (modes, modes, n), ahead_P : (modes, modes, n, n), of the pairs before y_k was seen
    pair_x, pair_P : after it
    toward : (modes, modes, n), P c of an output, spread : (modes, modes), cᵀ P c and its noise
    whole_x : (n,), whole_P : (n, n), of all modes together
    spare : (3, n, n), wide : (n,), size : (p,)
    """

    chain: BeliefState
    x: Float[np.ndarray, "mode n"]
    P: Float[np.ndarray, "mode n n"]
    ahead_x: Float[np.ndarray, "first second n"]
    ahead_P: Float[np.ndarray, "first second n n"]
    pair_x: Float[np.ndarray, "first second n"]
    pair_P: Float[np.ndarray, "first second n n"]
    toward: Float[np.ndarray, "first second n"]
    spread: Float[np.ndarray, "first second"]
    whole_x: Float[np.ndarray, " n"]
    whole_P: Float[np.ndarray, "n n"]
    spare: Float[np.ndarray, "3 n n"]
    wide: Float[np.ndarray, " n"]
    size: Float[np.ndarray, " p"]

    @classmethod
    def of(cls, form: BankForm, rows: int) -> BankState:
        """The state at time 0, for a table of so many rows."""
        modes, p, n = form.C.shape
        pairs = modes, modes
        vectors, matrices = np.empty((3, *pairs, n)), np.empty((2, *pairs, n, n))
        square = np.empty((4, n, n))
        return cls(
            BeliefState.of(form.chain, rows, 1),
            np.tile(form.estimate, (modes, 1)),
            np.tile(form.covariance, (modes, 1, 1)),
            vectors[0],
            matrices[0],
            vectors[1],
            matrices[1],
            vectors[2],
            np.empty(pairs),
            np.empty(n),
            square[3],
            square[:3],
            np.empty(n),
            np.empty(p),
        )


def frozen_bank(form: BankForm) -> BankForm:
    """The same with arrays that cannot be written to: one type for compiled loops."""
    chain, *arrays = form
    return BankForm(chain, *map(read_only, arrays))
