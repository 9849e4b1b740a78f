"""A law between sensors and actuators that are not perfect."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deadtime.feedback.law import Remembering, Update, require_input
from deadtime.feedback.table import age_after
from deadtime.imperfections import (
    ActuatorImperfection,
    Imperfection,
    Seen,
    SensorImperfection,
    Sizes,
)
from deadtime.simulation.imperfection_arrays import MeasurementLags, tells_commands


class Told(NamedTuple):
    """What a law was told at the samples of a run, and what it made of it.

    measured : (samples, n) or (samples, p), x or y, NaN where nothing arrived
    commanded : (samples, m), what it asked for
    estimates : (samples, states), of a law with a memory, what it took the state to be
    """

    measured: np.ndarray
    commanded: np.ndarray
    estimates: np.ndarray | None = None


class ImperfectLaw:
    """An `Update` that senses and acts through imperfections.

    Where nothing usable arrives and the law has no answer, its last input is asked for again.
    Before any mode is known the first is assumed. The law's past inputs are those applied, or with
    predict = "commanded" those asked for. A law that measures outputs is told y = C_σ x, `outputs`
    being the C of every mode.

    Attributes
    ----------
    update : Update
        The law.
    lags : Lags or None
        How long before each sample its state is to be measured.
    measured : (samples, n) or (samples, p)
        What the law was told of x or y, NaN where nothing arrived.
    commanded : (samples, m)
        What it asked for.
    """

    def __init__(
        self,
        update: Update,
        sizes: Sizes,
        pairs: Sequence[tuple[Imperfection, np.random.Generator]],
        predict: str,
        samples: int,
        outputs: np.ndarray | None = None,
    ) -> None:
        self._tells_commands = tells_commands(predict)
        self._outputs = outputs
        self._sensors = [
            each.sensor(sizes, rng) for each, rng in pairs if isinstance(each, SensorImperfection)
        ]
        self._actuators = [
            each.actuator(sizes) for each, _ in pairs if isinstance(each, ActuatorImperfection)
        ]
        self.lags = MeasurementLags.of(pairs, sizes, samples)
        self.update = update
        self._line: np.ndarray | None = None
        self._mode, self._age = -1, 0
        self.measured: list[np.ndarray] = []
        self.commanded: list[np.ndarray] = []

    def __call__(self, x: np.ndarray, past: np.ndarray, mode: int, age: int) -> np.ndarray:
        seen = Seen(x if self._outputs is None else self._outputs[mode] @ x, mode)
        for sense in self._sensors:
            seen = sense(seen)
        self._follow(seen.mode, age)
        if self._line is None:
            self._line = past.copy()
        asked = self._ask_law(seen.x, self._line if self._tells_commands else past)
        self._line[:-1] = self._line[1:]
        self._line[-1] = asked
        self.measured.append(seen.x)
        self.commanded.append(asked)
        for act in self._actuators:
            asked = act(asked, past[-1])
        return asked

    def _follow(self, mode: int, age: int) -> None:
        """The sampled mode as the law sees it, and its age."""
        self._age = age if self._mode < 0 else age_after(self._mode, self._age, mode)
        self._mode = self._mode if mode < 0 else mode

    def record(self, kept: int) -> Told:
        """What the law was told at the first samples, and made of it."""
        estimates = self.update.estimates if isinstance(self.update, Remembering) else None
        return Told(
            np.array(self.measured[:kept]),
            np.array(self.commanded[:kept]),
            None if estimates is None else np.array(estimates[:kept]),
        )

    def _ask_law(self, x: np.ndarray, past: np.ndarray) -> np.ndarray:
        asked = self.update(x, past, max(self._mode, 0), self._age)
        asked = require_input(asked, past.shape[1])
        if np.isfinite(asked).all() or (np.isfinite(x).all() and self._mode >= 0):
            return asked
        return self.commanded[-1] if self.commanded else past[-1].copy()
