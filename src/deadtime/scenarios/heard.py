"""What imperfect sensors tell the laws of a block of scenarios, drawn before they run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deadtime.feedback import Feedback
from deadtime.feedback.table import follow
from deadtime.imperfections import Heard, Imperfection, Sizes, streams
from deadtime.scenarios.layout import Told
from deadtime.scenarios.loop import Loop
from deadtime.scenarios.records import Laid
from deadtime.scenarios.source import scenario_seed
from deadtime.simulation.compiled import Arrays

_FEW = 32  # scenarios that are gone through at a time, so that they stay in the caches


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
        heard, part = self._heard[begin : begin + count], slice(begin, begin + count)
        sample = np.array([each.sample for each in heard], np.int32)
        back = np.arange(sample.shape[1], dtype=np.int32) - sample
        noise, row = np.zeros(0), np.zeros(0, np.int32)
        if any(each.noise.any() for each in heard):
            noise = np.array([each.noise for each in heard]).ravel()
        if feedback is not None and feedback.context != "none" and self._renamed:
            modes, ages = (each[part] for each in self._followed)
            row = feedback.rows_at(modes, ages).astype(np.int32).ravel()
        reach = int(back[sample >= 0].max(initial=0))
        return Told(sample.ravel(), reach, noise, row)

    @cached_property
    def _heard(self) -> list[Heard]:
        """What reaches the law of every scenario."""
        plant, step, samples = self.loop.plant, self.loop.window.step, self.loop.whole + 1
        sizes, heard = Sizes.of(plant, step), []
        for i in range(self.laid.scenarios):
            generators = streams(self.imperfections, scenario_seed(self.seed, self.first + i))
            pairs = list(zip(self.imperfections, generators, strict=True))
            heard.append(Arrays.of(pairs, sizes, samples, "applied").heard)
        return heard

    @cached_property
    def _renamed(self) -> bool:
        """Whether any mode is told late, wrong or not at all."""
        samples, modes = np.arange(self.loop.whole + 1), np.arange(self.loop.plant.modes)
        return any(
            (heard.mode_of != samples).any() or (heard.named != modes).any()
            for heard in self._heard
        )

    @cached_property
    def _followed(self) -> tuple[np.ndarray, np.ndarray]:
        """The mode that laws go by at every sample, and its age."""
        sampled, found = self.laid.records.modes(self.loop.whole + 1), []
        for begin in range(0, len(self._heard), _FEW):
            part = slice(begin, begin + _FEW)
            pairs = zip(self._heard[part], sampled[part], strict=True)
            told = np.array([heard.modes(own) for heard, own in pairs])
            found.append(follow(told, sampled[part], self.laid.age[part]))
        modes, ages = zip(*found, strict=True)
        return np.concatenate(modes), np.concatenate(ages)
