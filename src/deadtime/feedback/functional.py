"""Functional: a law as windows on the past inputs, with gains by the mode in force or for all.

It is the twin of `Forecast` for a law whose model has several delays and which believes in no
particular switch, as `Outlook` is for laws that do; it is filled by `deadtime.laws.tables.windows`
and `deadtime.laws.tables.markov_windows`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class Functional:
    """u(t) = F_c x(t) + Σ_p C_c,p ∫ e^{S_p (τ − α_p)} R_p u(t − τ) dτ, τ from α_p to β_p.

    c is the row that applies at t. Immutable.

    Attributes
    ----------
    F : (rows, m, n)
        Gain of the state.
    C : (rows, windows, m, q), S : (windows, q, q), R : (windows, q, m)
        Of the windows p.
    near : (windows,), far : (windows,)
        0 ≤ α_p < β_p, seconds.
    row : callable
        From times (T,) to the rows that apply there; where it changes the signal switches.
    """

    F: Float[np.ndarray, "row m n"]
    C: Float[np.ndarray, "row window m q"]
    S: Float[np.ndarray, "window q q"]
    R: Float[np.ndarray, "window q m"]
    near: Float[np.ndarray, " window"]
    far: Float[np.ndarray, " window"]
    row: Callable[[Float[np.ndarray, " T"]], Int[np.ndarray, " T"]]
