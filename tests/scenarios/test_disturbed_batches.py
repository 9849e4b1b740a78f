"""Disturbances in the batch engine: the runs of `simulate`, whatever else is imperfect."""

import numpy as np
import pytest

import plants
from batches import require_single_runs
from deadtime.imperfections import (
    ColouredDisturbance,
    Disturbance,
    Dropout,
    Jitter,
    MeasurementDelay,
    Noise,
    RateLimit,
    Saturation,
    StepDisturbance,
    WhiteDisturbance,
)

BELIEVED = plants.generic(0.3, seed=5)
LAWS = {name: plants.LAWS[name](BELIEVED) for name in ("averaged", "exact")}
W = np.array([[0.5, 0.2, 0.0], [0.2, 0.3, 0.1], [0.0, 0.1, 0.1]])
E = np.array([[0.4, 1.0], [-1.0, 0.0], [0.7, 0.3]])


class Alternating(Disturbance):
    """A force of a user's own, of a random size and a sign that alternates."""

    def draws(self, sizes, lengths, steps, rng):
        sign = (-1.0) ** np.arange(steps)
        return sign[:, None, None] * rng.random((1, len(lengths), 1)) * np.ones((steps, 1, 1))

    def spread(self, sizes, pieces):
        return np.full((sizes.states, 1), sum(tau for _, tau in pieces))


WHITE, STEP = WhiteDisturbance(W), StepDisturbance([0.4, -1.0, 0.7], 0.55, 4.0)
COLOURED = ColouredDisturbance([0.4, 0.2], [0.3, 2.0], E)
CASES = {
    "white": [WHITE],
    "white in one state": [WhiteDisturbance([0.0, 0.3, 0.0])],
    "coloured": [COLOURED],
    "step": [STEP],
    "of one's own": [Alternating()],
    "two of a kind": [WHITE, WhiteDisturbance(0.1)],
    "beside other imperfections": [
        WHITE, Noise(0.02), COLOURED, Saturation([-2.0, -1.0], 1.5), STEP, Dropout(0.1),
        RateLimit([9.0, 12.0]),
    ],
    "measured within periods": [WHITE, Jitter(0.08), MeasurementDelay(0.133), COLOURED],
}  # fmt: skip


# Two of them are beside other imperfections in `test_imperfect_batches`. What disturbs does not
# depend on the law, but for one whose model is sampled between samples.
@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_disturbed_scenarios_are_those_of_single_runs(case):
    names = ("averaged", "exact") if case == "measured within periods" else ("averaged",)
    require_single_runs(plants.generic(0.234), {name: LAWS[name] for name in names}, CASES[case])


@pytest.mark.long
@pytest.mark.parametrize("case", ["white", "beside other imperfections"])
def test_so_are_they_with_a_delay_per_input(case):
    plant, own = plants.generic([0.234, 0.11]), plants.generic([0.3, 0.07], seed=5)
    require_single_runs(plant, {"averaged": plants.LAWS["averaged"](own)}, CASES[case])
