"""Functional: a law whose belief does not change, as windows on the past inputs.

It is the twin of `Forecast` for a law whose model has several delays, as `Outlook` is for beliefs
that change with the mode; it is filled by `deadtime.laws.tables.windows`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Functional:
    """u(t) = F x(t) + Σ_p C_p ∫ e^{S_p (τ − α_p)} R_p u(t − τ) dτ, τ from α_p to β_p (immutable).

    Attributes
    ----------
    F : (m, n)
        Gain of the state.
    C : (windows, m, n), S : (windows, n, n), R : (windows, n, m)
        Of the windows p.
    near : (windows,), far : (windows,)
        0 ≤ α_p < β_p, seconds.
    """

    F: Float[np.ndarray, "m n"]
    C: Float[np.ndarray, "window m n"]
    S: Float[np.ndarray, "window n n"]
    R: Float[np.ndarray, "window n m"]
    near: Float[np.ndarray, " window"]
    far: Float[np.ndarray, " window"]
