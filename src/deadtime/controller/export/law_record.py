"""A controller as tables and sizes, from which all templates are filled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from deadtime.controller.export import belief_code, observer_code, prediction_code, rest_code
from deadtime.controller.export.bounds import bounds, largest, require_limits
from deadtime.controller.export.forms import Form, Precision
from deadtime.controller.export.observer_code import ObserverForm
from deadtime.controller.export.prediction_code import PredictionForm

if TYPE_CHECKING:
    from deadtime.controller.running import RunningLaw


class LawRecord(NamedTuple):
    """Tables and sizes of a controller, by name.

    arrays : constant arrays, with a comment each; F of the state, then those of the `Form`
    sizes : numbers of states, inputs, rows, …, and flags of what is used
    bounds : of all arguments and results, and of sums over past inputs
    belief, observer, prediction : values of these parts, None without them
    """

    arrays: dict[str, tuple[np.ndarray, str]]
    sizes: dict[str, Any]
    bounds: dict[str, float]
    belief: dict[str, Any] | None
    observer: dict[str, Any] | None
    prediction: dict[str, Any] | None

    @classmethod
    def of(
        cls, controller: RunningLaw, form: Form, precision: Precision, prediction: bool = False
    ) -> LawRecord:
        """Of a controller whose taps take a form; refused where sums could overflow."""
        table, plant, belief = controller.table, controller.law.plant, controller.mode_belief
        observer = None if controller.observing is None else ObserverForm.of(controller.observing)
        ahead = PredictionForm.of(controller) if prediction else None
        rows, more = len(table.state_gain) if belief else 1, 1.0
        if observer is not None:
            more = observer_code.gain(observer, largest(precision))
        if ahead is not None:
            more = max(more, prediction_code.gain(ahead, rows))
        limits = bounds(table, form, precision, rows, more)
        most = limits["bound"]
        require_limits(controller, most)
        if observer is not None:
            observer_code.require_within(observer, most)
        # Limits beyond the bound never act: the C refuses commands beyond the bound.
        low, high = (np.clip(limit, -most, most) for limit in (controller.low, controller.high))
        arrays = {
            "F": (table.state_gain, "gains of the state"),
            **form.arrays,
            "LOW": (_inside(low, precision, np.inf), "limits of the inputs"),
            "HIGH": (_inside(high, precision, -np.inf), "limits of the inputs"),
            **rest_code.arrays(controller, prediction),
            **({} if belief is None else belief_code.arrays(belief)),
            **({} if observer is None else observer_code.arrays(observer)),
            **({} if ahead is None else prediction_code.arrays(ahead)),
        }
        sizes = {
            "n": table.state_gain.shape[2],
            "m": plant.inputs,
            "modes": plant.modes,
            "reads": int(controller.reads_mode),
            "by_mode": table.context != "none" and belief is None,
            "by_end": belief is not None and belief_code.by_end(belief),
            "outputs": belief_code.outputs_of(belief),
            "ages": table.ages,
            "rows": len(table.state_gain),
            "taps": table.taps,
            "windows": form.windows,
            "starts": np.cumsum([0, *form.windows])[:-1].tolist(),
            **form.sizes,
        }
        return cls(
            arrays,
            sizes,
            limits,
            None if belief is None else belief_code.values(belief),
            None if observer is None else observer_code.values(observer, precision),
            None if ahead is None else prediction_code.values(ahead),
        )


def _inside(limit: np.ndarray, precision: Precision, towards: float) -> np.ndarray:
    """The limit in a precision, rounded inwards."""
    if precision == "double":
        return limit
    single = limit.astype(np.float32)
    outside = single < limit if towards > 0 else single > limit
    return np.where(outside, np.nextafter(single, np.float32(towards)), single)
