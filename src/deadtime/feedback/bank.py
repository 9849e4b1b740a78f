"""A bank of Kalman filters over a `deadtime.feedback.belief.Belief`, as arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only
from deadtime.feedback.belief import Belief


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


def frozen_bank(form: BankForm) -> BankForm:
    """The same with arrays that cannot be written to: one type for compiled loops."""
    chain, *arrays = form
    return BankForm(chain, *map(read_only, arrays))
