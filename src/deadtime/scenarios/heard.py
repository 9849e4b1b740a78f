"""What imperfect sensors tell the laws of a block of scenarios, drawn before they run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from deadtime.feedback import Feedback
from deadtime.feedback.table import follow
from deadtime.imperfections import Imperfection, Sizes, streams
from deadtime.scenarios.layout import Told
from deadtime.scenarios.loop import Loop
from deadtime.scenarios.records import Laid
from deadtime.scenarios.source import scenario_seed
from deadtime.simulation.compiled import heard_of

_FEW = 32  # scenarios that are gone through at a time, so that they stay in the caches


class _Stack(NamedTuple):
    """What is heard in all scenarios.

    sample : (scenario, sample), whose measurement, −1 for none
    reach : (scenario,), how many samples back these go, at most
    noise : (scenario, sample·n), or (scenario, 0) where there is none
    modes : (scenario, sample), the modes told, or None where they are the plant's
    """

    sample: np.ndarray
    reach: np.ndarray
    noise: np.ndarray
    modes: np.ndarray | None


@dataclass(frozen=True, eq=False)
class HeardBlock:
    """What is heard in scenarios first, first + 1, …, the same under every law.

    Attributes
    ----------
    laid : Laid
        Their signals.
    """

    loop: Loop
    imperfections: Sequence[Imperfection]
    laid: Laid
    seed: int
    first: int

    def told(self, feedback: Feedback | None, begin: int, count: int) -> Told:
        """What a law with this table hears in `count` scenarios of the block from `begin` on."""
        heard, part, row = self._heard, slice(begin, begin + count), np.zeros(0, np.int32)
        if feedback is not None and feedback.context != "none" and heard.modes is not None:
            modes, ages = (each[part] for each in self._followed)
            row = feedback.rows_at(modes, ages).astype(np.int32).ravel()
        reach = int(heard.reach[part].max())
        return Told(heard.sample[part].ravel(), reach, heard.noise[part].ravel(), row)

    @cached_property
    def _heard(self) -> _Stack:
        """What reaches the law of every scenario."""
        plant, step, samples = self.loop.plant, self.loop.step, self.loop.whole + 1
        sizes, count = Sizes.of(plant, step), self.laid.scenarios
        each, modes = np.arange(samples), np.arange(plant.modes)
        sample, told = np.empty((count, samples), np.int32), None
        noise, reach = np.zeros((count, 0)), np.empty(count, np.int64)
        for i in range(count):
            generators = streams(self.imperfections, scenario_seed(self.seed, self.first + i))
            heard = heard_of(list(zip(self.imperfections, generators, strict=True)), sizes, samples)
            sample[i] = heard.sample
            reach[i] = (each - heard.sample)[heard.sample >= 0].max(initial=0)
            if not noise.size and heard.noise.any():
                noise = np.zeros((count, samples * plant.states))
            if noise.size:
                noise[i] = heard.noise.ravel()
            if (heard.mode_of != each).any() or (heard.named != modes).any():
                told = self._sampled.copy() if told is None else told
                told[i] = heard.modes(self._sampled[i])
        return _Stack(sample, reach, noise, told)

    @cached_property
    def _sampled(self) -> np.ndarray:
        """The modes of the plant at the samples."""
        return self.laid.records.modes(self.loop.whole + 1).astype(np.int32)

    @cached_property
    def _followed(self) -> tuple[np.ndarray, np.ndarray]:
        """The mode that laws go by at every sample, and its age."""
        sampled, told = self._sampled, self._heard.modes
        assert told is not None
        modes, ages = np.empty_like(sampled), np.empty_like(sampled)
        for begin in range(0, len(sampled), _FEW):
            part = slice(begin, begin + _FEW)
            modes[part], ages[part] = follow(told[part], sampled[part], self.laid.age[part])
        return modes, ages
