"""A law's prediction as a table: x(t + D) in every future of its forecast, and how likely that is.

A law is u = Σ_i p_i K_i P_i over the systems i in which its forecast may end, P_i the state that is
expected when the input of now arrives if it ends there. So any law is a prediction if its gains are
replaced by others that select one future: with further inputs v that act on nothing and have the
delay of input j, and one more state that stays 1,

    v = p_i (P_i, 1)    under the gains  K_i = I of v in future i, K_l = 0 of v in all others.

The rows of v in the table of that law are those wanted; the true inputs keep their gains, by which
a law with several delays predicts its own inputs until input j arrives.
Derived in docs/theory/prediction.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.feedback.law import Law
from deadtime.feedback.table import side_by_side
from deadtime.switching import SwitchingSignal


class PredictionTable(NamedTuple):
    """p_i P_i = `state` x_k + `input` (past inputs, the oldest first), by row of the law's table.

    Inputs that arrive together in every mode share a horizon; `of_input` says which each has.

    state : (rows, horizons, futures, n, n)
    input : (rows, horizons, futures, n, N m)
    probability : (rows, horizons, futures), p_i
    of_input : (m,)
    """

    state: Float[np.ndarray, "row horizon future n n"]
    input: Float[np.ndarray, "row horizon future n past"]
    probability: Float[np.ndarray, "row horizon future"]
    of_input: Int[np.ndarray, " m"]


def prediction_table(
    law: Law, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
) -> PredictionTable:
    """The prediction of a law at a sampling period; `signal` and `steps` as in `Law.digital`.

    Raises `ArgumentError` for a law without a prediction.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[0.0]], [[0.0]]], [[[1.0]], [[3.0]]], delay=0.2)
    >>> law = dt.AveragedPredictor(plant, [[[-1.0]], [[-1.0]]])
    >>> table = prediction_table(law, 0.1)
    >>> table.probability, table.input.round(12).tolist()
    (array([[[0.5, 0.5]]]), [[[[[0.05, 0.05]], [[0.15, 0.15]]]]])
    """
    plant, n, m = law.plant, law.plant.states, law.plant.inputs
    _, first, of_input = np.unique(plant.delays, axis=1, return_index=True, return_inverse=True)
    futures = len(law.horizons)
    parts = []
    for j in first.tolist():
        # A state that stays 1, and n + 1 inputs v as late as input j that act on nothing:
        #     A → [[A, 0], [0, 0]],    B → [[B, 0], [0, 0]],    delays → (D, D_j, …, D_j)
        late = np.repeat(plant.delays[:, j : j + 1], n + 1, axis=1)
        larger = plant.like(
            np.pad(plant.A, ((0, 0), (0, 1), (0, 1))),
            np.pad(plant.B, ((0, 0), (0, 1), (0, n + 1))),
            np.concatenate((plant.delays, late), axis=1),
        )
        for i in range(futures):
            rows = np.zeros((futures, n + 1, n + 1))
            rows[i] = np.eye(n + 1)
            table = law.extend(larger, rows).digital(step, signal, steps)
            # The rows of v, and their taps on the inputs that act, oldest first.
            taps = side_by_side(table.input_gain[:, ::-1, m:, :m])
            parts.append((table.state_gain[:, m:], taps))
    F, G = (np.stack(kind, axis=1) for kind in zip(*parts, strict=True))
    F = F.reshape(-1, first.size, futures, n + 1, n + 1)
    G = G.reshape(-1, first.size, futures, n + 1, G.shape[-1])
    # The state that stays 1 is the last row and column: its own entry is p_i.
    state, taps = np.ascontiguousarray(F[..., :n, :n]), np.ascontiguousarray(G[..., :n, :])
    return PredictionTable(state, taps, F[..., n, n].copy(), of_input.reshape(-1))


def extended_gains(
    gains: Float[np.ndarray, "future m n"], rows: Float[np.ndarray, "future r more"]
) -> Float[np.ndarray, "future m+r more"]:
    """The gains of inputs and, below, the rows of further ones; gains of further states are 0.

    Examples
    --------
    >>> extended_gains(np.array([[[2.0]]]), np.array([[[1.0, 3.0]]]))
    array([[[2., 0.],
            [1., 3.]]])
    """
    more = rows.shape[2] - gains.shape[2]
    return np.concatenate((np.pad(gains, ((0, 0), (0, 0), (0, more))), rows), axis=1)
