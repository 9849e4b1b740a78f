"""What imperfect sensors tell the laws of a block of scenarios, drawn before they run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deadtime.feedback import Feedback
from deadtime.feedback.table import follow
from deadtime.imperfections import Heard, Imperfection, Sizes, streams
from deadtime.plant.steps import snap_all
from deadtime.scenarios.layout import Told
from deadtime.scenarios.loop import OLDEST, Loop
from deadtime.scenarios.source import scenario_seed
from deadtime.simulation.compiled import Arrays
from deadtime.switching import SignalBatch
from deadtime.switching.grid import modes_at


@dataclass(frozen=True, eq=False)
class HeardBlock:
    """What is heard in scenarios first, first + 1, …, the same under every law.

    Attributes
    ----------
    signals : SignalBatch
        Those of the scenarios.
    """

    loop: Loop
    imperfections: Sequence[Imperfection]
    signals: SignalBatch
    seed: int
    first: int

    def told(self, feedback: Feedback | None, begin: int, count: int) -> Told:
        """What a law with this table hears in `count` scenarios of the block from `begin` on."""
        part = slice(begin, begin + count)
        sample = np.stack([heard.sample for heard in self._heard[part]])
        noise = np.stack([heard.noise for heard in self._heard[part]])
        back = np.arange(sample.shape[1]) - sample
        row = np.zeros(0)
        if feedback is not None and feedback.context != "none" and self._renamed:
            modes, ages = (each[part] for each in self._followed)
            row = in_groups(feedback.rows_at(modes, ages).astype(float))
        return Told(
            in_groups(sample.astype(np.int32)),
            int(back[sample >= 0].max(initial=0)),
            in_groups(noise),
            in_groups((sample < 0).astype(float)),
            row,
        )

    @cached_property
    def _heard(self) -> list[Heard]:
        """What reaches the law of every scenario."""
        plant, step, samples = self.loop.plant, self.loop.window.step, self.loop.whole + 1
        sizes, heard = Sizes.of(plant, step), []
        for i in range(len(self.signals)):
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
        step, samples = self.loop.window.step, self.loop.whole + 1
        times = np.arange(samples) * step
        ages = np.floor(snap_all(np.minimum(self.signals.initial_age / step, OLDEST)))
        found = []
        for i, signal in enumerate(self.signals):
            sampled = modes_at(signal, times, step)
            found.append(follow(self._heard[i].modes(sampled), sampled, int(ages[i])))
        modes, since = zip(*found, strict=True)
        return np.array(modes), np.array(since)


def in_groups(values: np.ndarray) -> np.ndarray:
    """Numbers (scenario, sample, …) as (group, sample, …, 8), flat, the last group filled up.

    Examples
    --------
    >>> in_groups(np.array([[1, 2], [3, 4]])).reshape(2, 8)[:, :3]
    array([[1, 3, 0],
           [2, 4, 0]])
    """
    from deadtime.numerics.lanes import LANES

    count, *others = values.shape
    groups = -(-count // LANES)
    padded = np.zeros((groups * LANES, *others), values.dtype)
    padded[:count] = values
    return np.moveaxis(padded.reshape(groups, LANES, *others), 1, -1).ravel()
