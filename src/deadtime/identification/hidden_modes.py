"""What an identification found of modes that were not logged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.frozen import Frozen

SURE = 0.95  # a mode of at least that probability is sure


@dataclass(frozen=True, eq=False, repr=False)
class HiddenModes(Frozen):
    """Which mode was active when, where no log tells: the likeliest path, and how likely it is.

    Modes are numbered in the order in which the path visits them.

    Attributes
    ----------
    time, mode : (samples,) arrays
        Times of all rows, seconds, log after log, and the likeliest path of modes (Viterbi).
    probability : (samples, modes) array
        Of every mode in every row, given all of the log.
    chain : (modes, modes) array
        Probabilities of a switch from one row to the next; of uneven rows within a sampling period.
    numbers, bic : (fits,) arrays
        The numbers of modes that were tried, and Bayes' information criterion of each; less is
        better. Those that the log is too short for are left out.
    likelihoods : (steps,) array
        The log likelihood after every step of expectation–maximisation, which never falls; with
        noisy sensors after every round.
    starts, agreed : int
        How many starts were tried, and how many led to the likeliest.
    widening : float
        How many times longer than with known modes the longest of the plant's intervals is.

    Examples
    --------
    See `identify`.
    """

    time: Float[np.ndarray, " sample"]
    mode: Int[np.ndarray, " sample"]
    probability: Float[np.ndarray, "sample mode"]
    chain: Float[np.ndarray, "mode mode"]
    numbers: Int[np.ndarray, " fit"]
    bic: Float[np.ndarray, " fit"]
    likelihoods: Float[np.ndarray, " step"]
    starts: int
    agreed: int
    widening: float

    @property
    def sure(self) -> float:
        """The share of rows whose mode is at least 95 % sure."""
        return float((self.probability.max(axis=1) >= SURE).mean())

    def __repr__(self) -> str:
        return f"HiddenModes(modes={len(self.chain)}, sure={self.sure:.3f})"
