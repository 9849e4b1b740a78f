"""The mode filter of a controller in C: its tables, its room and its bounds.

The C does what `estimation/belief_kernel.py` does in the same order, so that both agree to the
round-off of exp, log and the square root, of which it has its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.controller.export.literals import literal
from deadtime.feedback.belief import Belief

_BOUND = 2.0**100  # of states and inputs, {P}_BELIEF_BOUND of controller.h.j2
_LARGEST = 2.0**190  # of predictions and of variances: their squares leave room
_BYTES, _COUNTERS = 8, 8


def arrays(form: Belief) -> dict[str, tuple[np.ndarray, str]]:
    """What goes into ROM, with a comment each."""
    return {
        "MODEL_X": (form.Phi, "the model over a period in each mode: what becomes of x"),
        "MODEL_U": (form.Gamma, "what becomes of inputs, by lag"),
        "MODEL_NOISE": (form.noise, "covariance of what a prediction misses"),
        "HAZARD": (form.hazard, "probability that a mode of that age ends within a period"),
        "JUMP": (form.jump, "probabilities of the next mode"),
        "PRIOR": (form.start, "the belief before anything is seen"),
    }


def values(form: Belief) -> dict[str, Any]:
    """What the templates are filled with."""
    lags = form.lag.tolist()
    return {
        "forgetting": literal(form.forgetting, "double"),
        "within": form.within,
        "lags": lags,
        "ages": form.hazard.shape[1],
        "sent": max(lags) + 1,
    }


def rom_bytes(form: Belief) -> int:
    """Of the filter's tables."""
    return _BYTES * sum(array.size for array, _ in arrays(form).values())


def ram_bytes(form: Belief) -> int:
    """Of the belief, the last state and the inputs that the filter reads."""
    n, m = form.Gamma.shape[2:]
    return _BYTES * (form.start.size + n + (int(form.lag.max()) + 1) * m) + _COUNTERS


def require_bounded(form: Belief) -> None:
    """Refuse a model whose predictions could overflow in C, within the bound of states."""
    reach = np.abs(form.Phi).sum(axis=2) + np.abs(form.Gamma).sum(axis=(1, 3))
    if reach.max() * _BOUND > _LARGEST or np.abs(form.noise).max() > _LARGEST:
        raise ArgumentError(
            f"law's filter cannot be held in C: over one period its model grows by "
            f"{reach.max():.0e}, its variances are up to {np.abs(form.noise).max():.0e}. Take a "
            "shorter step, or units in which the numbers are of about 1."
        )
