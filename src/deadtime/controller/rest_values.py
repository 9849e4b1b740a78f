"""Where the plant of a controller rests, as the arguments of its calls have it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import instance, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.plant import OperatingPoint


class RestValues(NamedTuple):
    """Values of a call while the plant rests: a law works on deviations from them."""

    given: Float[np.ndarray, " measured"]  # x₀, or y₀ = C x₀
    u: Float[np.ndarray, " m"]
    reference: Float[np.ndarray, " r"]  # H y₀
    z: Float[np.ndarray, " law"]  # what the law's table reads

    @classmethod
    def of(
        cls,
        law: Law,
        size: int,
        tracked: Float[np.ndarray, "r p"] | None,
        point: OperatingPoint | None,
    ) -> RestValues:
        """Of a law whose table reads `size` numbers beside inputs; 0 without a point.

        tracked : H, of the outputs that follow a reference; None of a law without an observer
        """
        n, m = law.plant.states, law.plant.inputs
        if point is None:
            point = OperatingPoint(np.zeros(n), np.zeros(m))
        instance("operating_point", point, OperatingPoint)
        x = require_shape("operating_point.x", point.x, (n,), "(n,)")
        u = require_shape("operating_point.u", point.u, (m,), "(m,)")
        given, reference = x, np.zeros(0)
        if law.outputs is not None:
            each = law.outputs[:, :, :n] @ x
            if not np.allclose(each, each[0], rtol=1e-9, atol=0.0):
                raise ArgumentError(
                    "operating_point must have the same outputs in every mode, got "
                    f"{each.tolist()}: where the sensors differ by mode, give the controller "
                    "deviations, and no operating point."
                )
            given = each[0]
        if tracked is not None:
            reference = tracked @ given
        between = np.zeros(size - n - reference.size)  # estimated disturbances, sums of errors
        return cls(given, u, reference, np.concatenate((x, between, reference)))
