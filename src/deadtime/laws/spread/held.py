"""How uncertain a prediction is whose futures hold one system each, from some instant on.

In such a future nothing is left to chance but the state now and the disturbance: over τ seconds in
a system the covariance P becomes e^{Aτ} P e^{Aᵀτ} + ∫₀^τ e^{As} W e^{Aᵀs} ds, whatever the inputs,
W one for all systems or that of each.
Inputs that are still to be computed count as predicted: a law's answer to a disturbance that has
not happened yet is not part of it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.feedback.known_state import Known
from deadtime.numerics.covariance import noise_covariances, transitions
from deadtime.plant import SwitchedSystem
from deadtime.plant.sampling import snap


def held_spread(
    plant: SwitchedSystem, known: Known, W: Float[np.ndarray, "*mode n n"]
) -> Float[np.ndarray, "case input future n n"]:
    """Of futures each of which holds one mode of a plant, up to its own delays.

    Examples
    --------
    >>> plant = SwitchedSystem([[[0.0]], [[0.0]]], [[[1.0]], [[1.0]]], [[0.5], [2.0]])
    >>> known = Known(np.zeros(1, int), np.ones(1), np.zeros((1, 1)), np.eye(1)[None], np.eye(1))
    >>> held_spread(plant, known, np.eye(1)).ravel()
    array([1.5, 3. ])
    """
    return np.stack([_moved(P, plant, plant.delays, W) for P in known.P])


def dwelling_spread(
    plant: SwitchedSystem,
    after: SwitchedSystem,
    dwell_time: float,
    step: float,
    known: Known,
    W: Float[np.ndarray, "*mode n n"],
    after_W: Float[np.ndarray, "*future n n"],
) -> Float[np.ndarray, "case input future n n"]:
    """Of futures that stay in the mode for the rest of its dwell, then each in one of `after`."""
    delay = plant.one_delay("a prediction's covariance under a law with a dwell time")
    periods = snap(dwell_time / step)
    ages, found = int(np.ceil(periods)) + 1, []
    for row, P in zip(known.row.tolist(), known.P, strict=True):
        mode, age = divmod(row, ages)
        rest = min(max(0.0, periods - age) * step, delay)
        own = plant.like(plant.A[mode : mode + 1], plant.B[mode : mode + 1], plant.delays[:1])
        own_W = W if W.ndim == 2 else W[mode]
        P = _moved(P, own, np.full((1, 1), rest), own_W)[0, 0]
        found.append(_moved(P, after, after.delays - rest, after_W))
    return np.stack(found)


def _moved(
    P: Float[np.ndarray, "n n"],
    plant: SwitchedSystem,
    seconds: Float[np.ndarray, "mode m"],
    W: Float[np.ndarray, "*mode n n"],
) -> Float[np.ndarray, "m mode n n"]:
    """The covariance after so long in every mode."""
    modes, m = seconds.shape
    A, tau = np.tile(plant.A, (m, 1, 1)), seconds.T.reshape(-1)
    Phi, W = transitions(A, tau), W if W.ndim == 2 else np.tile(W, (m, 1, 1))
    moved = Phi @ P @ Phi.swapaxes(1, 2) + noise_covariances(A, W, tau)
    return moved.reshape(m, modes, *P.shape)
