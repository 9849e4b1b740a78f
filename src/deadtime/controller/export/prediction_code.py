"""The prediction of a controller in C: its rows, memory and bounds.

`{name}_predict` returns x̂(t_k + D_j) at the last sample, the mean over the modes in which the
forecast may end. It uses the past inputs of the controller and changes nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

if TYPE_CHECKING:
    from deadtime.controller.running import RunningLaw


class PredictionForm(NamedTuple):
    """Rows by context, horizon and state; taps with the latest input first.

    state : (rows, horizons, n, n), input : (rows, horizons, n, N, m)
    of_input : (m,), the horizon of each
    """

    state: Float[np.ndarray, "row horizon n n"]
    input: Float[np.ndarray, "row horizon n N m"]
    of_input: Int[np.ndarray, " m"]

    @classmethod
    def of(cls, controller: RunningLaw) -> PredictionForm:
        """Of a controller; `ArgumentError` if its law has no prediction."""
        table, m = controller.prediction_table, controller.law.plant.inputs
        taps = table.input.sum(axis=2)
        taps = taps.reshape(*taps.shape[:3], -1, m)[..., ::-1, :]
        return cls(table.state.sum(axis=2), np.ascontiguousarray(taps), table.of_input)


def arrays(form: PredictionForm) -> dict[str, tuple[np.ndarray, str]]:
    """The constant arrays in ROM, with a comment each."""
    rows, horizons, n = form.state.shape[:3]
    taps = form.input.reshape(rows, horizons * n, *form.input.shape[3:])
    return {
        "FORECAST_X": (
            form.state.reshape(rows, horizons * n, n),
            "the predicted state: gains of the state",
        ),
        "FORECAST_U": (taps, "the predicted state: gains of past inputs, the latest first"),
    }


def values(form: PredictionForm) -> dict[str, Any]:
    """The values that fill the templates."""
    return {"horizons": form.state.shape[1], "of_input": form.of_input.tolist()}


def gain(form: PredictionForm, rows: int) -> float:
    """The largest gain from terms to sums over this many rows, for `bounds`."""
    each = np.abs(form.state).sum(axis=3) + np.abs(form.input).sum(axis=(3, 4))
    return 2.0 * rows * float(each.max())
