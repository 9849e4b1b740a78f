"""The mode filter of a controller in C: its tables, memory and bounds.

The C has the operations of `loop/belief_steps.py` and `loop/bank_steps.py`, and its own
exp, log and square root: the results agree to the round-off of these.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.controller.controller_state import ModeBelief
from deadtime.controller.export.c_text import literal

_BOUND = 2.0**100  # of states and inputs: {P}_BELIEF_BOUND of controller.h.j2
_LARGEST = 2.0**190  # of predictions and variances: their squares do not overflow
_BYTES, _COUNTERS = 8, 8

# By field of a filter's form: the name of its table in ROM and a comment.
_TABLES = {
    "Phi": ("MODEL_X", "the model over a period, by mode: gains of the state"),
    "Gamma": ("MODEL_U", "gains of inputs, by mode and lag"),
    "noise": ("MODEL_NOISE", "covariance of the prediction error"),
    "hazard": ("HAZARD", "probability that a mode of this age ends within a period"),
    "jump": ("JUMP", "probabilities of the next mode"),
    "start": ("PRIOR", "the initial belief"),
    "bend_x": (
        "BEND_X",
        "gains of the state: x after a change in mid-period, less the mean of both modes",
    ),
    "bend_u": ("BEND_U", "likewise, gains of inputs, by lag"),
    "C": ("OUTPUT_X", "the output matrix, by mode"),
    "variance": ("OUTPUT_NOISE", "noise variance of the outputs"),
    "gain": ("OBSERVER_GAIN", "observer gains, by mode"),
    "estimate": ("FIRST_X", "the initial estimate"),
    "covariance": ("FIRST_P", "covariance of the initial state about it"),
}


def _parts(belief: ModeBelief) -> dict[str, Any]:
    """The fields of a filter's form: of its chain, and of its bank where it has one."""
    return belief.form._asdict() | ({} if belief.bank is None else belief.bank._asdict())


def arrays(belief: ModeBelief) -> dict[str, tuple[np.ndarray, str]]:
    """The constant arrays in ROM, with a comment each, without empty ones."""
    parts = _parts(belief)
    if not by_end(belief):
        parts["noise"] = parts["noise"][:, 0]
    own = {field: table for field, table in _TABLES.items() if field in parts}
    return {name: (parts[k], comment) for k, (name, comment) in own.items() if parts[k].size}


def by_end(belief: ModeBelief) -> bool:
    """Whether the noise of a period depends on the mode in which it ends."""
    return belief.form.noise.shape[1] > 1


def values(belief: ModeBelief) -> dict[str, Any]:
    """The values that fill the templates: the numbers and switches of the form, and its sizes."""
    form = belief.form
    lags = form.lag.tolist()
    return {
        "forgetting": literal(float(form.forgetting), "double"),
        "within": bool(form.within),
        "lags": lags,
        "ages": form.hazard.shape[1],
        "sent": max(lags) + 1,
        "observed": belief.bank is not None and belief.bank.gain.size > 0,
    }


def outputs_of(belief: ModeBelief | None) -> int:
    """How many outputs are measured; 0 if the state is."""
    return 0 if belief is None or belief.bank is None else belief.bank.variance.size


def ram_bytes(belief: ModeBelief) -> int:
    """Bytes of the belief, the estimates or the last state, and the inputs of the filter."""
    form = belief.form
    modes, _, n, m = form.Gamma.shape
    beside = n if belief.bank is None else modes * n * (1 + n)
    return _BYTES * (form.start.size + beside + (int(form.lag.max()) + 1) * m) + _COUNTERS


def require_bounded(belief: ModeBelief) -> None:
    """Refuse a model whose predictions could overflow in C, within the bound of states."""
    form = belief.form
    reach = np.abs(form.Phi).sum(axis=2) + np.abs(form.Gamma).sum(axis=(1, 3))
    if reach.max() * _BOUND > _LARGEST or np.abs(form.noise).max() > _LARGEST:
        raise ArgumentError(
            f"law's filter has no C: over one period its model grows by "
            f"{reach.max():.0e}, its variances are up to {np.abs(form.noise).max():.0e}. Take a "
            "shorter step, or units in which the numbers are of about 1."
        )
    if belief.bank is not None:
        bank, most = belief.bank, _LARGEST / _BOUND
        given = {"C": bank.C, "noise": bank.variance, "covariance": bank.covariance}
        given |= {"gain": bank.gain, "estimate": bank.estimate}
        for name, array in given.items():
            size = float(np.abs(array).max(initial=0.0))
            if size * array.shape[-1] > most:
                raise ArgumentError(
                    f"law's filter has no C: its {name} is as large as {size:.0e}: take "
                    "units in which the numbers are of about 1."
                )
