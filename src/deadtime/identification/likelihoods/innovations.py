"""Innovations of a log as a linear regression, and their responses to inputs of any form.

For given A and noise the prediction of a measurement is linear in the measurements before it and in
the inputs. So the response of all predictions to a change of the inputs is the prediction of a log
with these inputs and measurements of 0. Score tests compare such responses with the innovations.

The likelihood of innovations e of variance s has the score and the information of a least-squares
problem with residuals r and slopes D, both of white unit noise:

    r = (e/√s, (e²/s − 1)/√2),    D = (−∂e/√s, ∂s/(s √2)),    score = Dᵀ r,    F = Dᵀ D.

Where states are exact, s does not depend on the plant, and the second half is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from deadtime.identification.log.recording import Part
from deadtime.identification.parameters import Layout, Vector

Changes = Sequence[Float[np.ndarray, "many sample m"]]  # inputs of every part
Signals = Sequence[Float[np.ndarray, "many sample"]]


@runtime_checkable
class Innovations(Protocol):
    """The innovations of a likelihood, row by row of all parts; 0 where nothing was predicted."""

    def residuals(self, vector: Vector) -> Float[np.ndarray, "row p"]:
        """Innovations over their deviations."""
        ...

    def slopes(self, vector: Vector) -> Float[np.ndarray, "datum size"]:
        """D of the module, over all unknowns."""
        ...

    def stacked(self, residuals: Float[np.ndarray, "row p"]) -> Float[np.ndarray, " datum"]:
        """r of the module."""
        ...

    def responses(self, vector: Vector, inputs: Changes) -> Float[np.ndarray, "datum many"]:
        """Predictions from inputs alone, one column for each of `many` inputs of the log."""
        ...

    def to_signals(self, vector: Vector, signals: Signals) -> Float[np.ndarray, "datum many"]:
        """The responses to signals in place of the first input, whose delay is nearly 0."""
        ...


def without_constants(layout: Layout, vector: Vector) -> Vector:
    plain = vector.copy()
    plain[layout.of_constant] = 0.0
    return plain


def with_inputs(parts: Sequence[Part], inputs: Changes) -> list[list[Part]]:
    """The log with measurements of 0 and each of many inputs; missing rows stay missing."""
    return [
        [
            part._replace(output=np.where(np.isfinite(part.output), 0.0, np.nan), input=own[one])
            for part, own in zip(parts, inputs, strict=True)
        ]
        for one in range(len(inputs[0]))
    ]
