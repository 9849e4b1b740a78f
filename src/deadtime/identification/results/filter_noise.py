"""The process noise that a problem file's observer is designed on.

Where a log does not tell a disturbance from none, its likeliest intensity may be next to nothing.
A Kalman filter of it trusts its model alone: its error decays at the pace of the plant, or not at
all, whatever the gains. Such a filter is no use to a loop, and the log does not ask for it.

The states are chains of derivatives. White noise of intensity q that acts on the last of each chain
reaches all of its states through integrators, without zeros, so that the error decays the faster
the larger q: like q^(1/2k) in a chain of k states, up to what sampling allows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import amount
from deadtime.estimation import kalman
from deadtime.gains import lqr
from deadtime.plant import SwitchedSystem

if TYPE_CHECKING:
    from deadtime.identification.identified_plant import Findings

_MOST = 60  # factors of 4


def filter_noise(fit: Findings) -> tuple[Float[np.ndarray, "n n"], str]:
    """W for the observer, and a sentence that says why it is not the likeliest; empty where it is.

    Noise on the last derivative of every output is raised from the upper end of its interval, by
    the fewest factors of 4 with which the observer's error decays, in every mode held, at least as
    fast as the loop of the file's gains does.
    """
    W, shape = fit.disturbance[0], fit._found.of_outputs and fit._found.of_outputs.embedding
    if shape is None or not fit.noise.all():
        return W, ""
    ends = np.array([fit.interval(f"disturbance[0][{a},{a}]") for a in shape.last])
    pace = _loop_pace(fit.plant)
    if pace is None or ends[:, 0].all() or not np.isfinite(ends).all():
        return W, ""
    for factors in range(_MOST):
        raised = W.copy()
        raised[shape.last, shape.last] = 4.0**factors * ends[:, 1]
        decay = _decay(fit, raised)
        if decay < pace:
            continue
        each = zip(shape.last, np.diag(raised)[shape.last], strict=True)
        values = ", ".join(f"{amount(value)} for {fit.states[a]}" for a, value in each)
        likeliest, here, loop = (amount(max(r, 0.0)) for r in (_decay(fit, W), decay, pace))
        return raised, (
            "The log does not tell the disturbance from none. An observer designed on its "
            f"likeliest intensity has an error that decays at {likeliest} /s, so that the file's "
            f"is designed on {values}: {here} /s, at least as fast as the loop, {loop} /s."
        )
    return W, ""


def _loop_pace(plant: SwitchedSystem) -> float | None:
    """How fast the slowest mode decays under the file's gains, 1/s; None where there are none."""
    try:
        gains = lqr(plant, np.eye(plant.states), np.eye(plant.inputs))
    except ArgumentError:
        return None
    return -float(np.linalg.eigvals(plant.A + plant.B @ gains).real.max())


def _decay(fit: Findings, W: np.ndarray) -> float:
    """How fast the error of an observer designed on W decays in the slowest mode, 1/s; 0: none."""
    try:
        return -float(kalman(fit.plant, fit.C, W, np.diag(fit.noise**2), fit.step).rates.max())
    except ArgumentError:
        return 0.0
