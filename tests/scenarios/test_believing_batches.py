"""Laws on a belief, in the batch engine: the runs of `simulate`."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

import deadtime as dt
import plants
from batches import H, require_single_runs
from deadtime.imperfections import (
    Dropout,
    Jitter,
    LateSamples,
    ModeDelay,
    Noise,
    RateLimit,
    Saturation,
    WhiteDisturbance,
    WrongMode,
)
from shares import mostly_long

MARKOV = plants.markov(3)
SEMI = dt.SemiMarkov(stats.expon(loc=0.2, scale=0.3), modes=3)
BELIEVED = plants.generic(0.3, seed=5)
OWN = dt.SwitchedSystem(BELIEVED.A, BELIEVED.B, [[0.3, 0.07], [0.21, 0.1], [0.3, 0.26]])
TRUTH = dt.SwitchedSystem(1.02 * BELIEVED.A, 0.97 * BELIEVED.B, 0.234)


def believing(plant=BELIEVED, model: Any = MARKOV, law=None, **options):
    law = dt.ExpectedPredictor(plant, plants.gains(plant), model) if law is None else law
    filt = dt.ModeFilter(plant, model, H, **{"disturbance": 0.1, "noise": 0.05, **options})
    return dt.BeliefPredictor(law, filt)


LIMITED = [Noise(0.02), Dropout(0.2), RateLimit([3.0, 4.0]), Saturation(-1.0, 1.2)]
AWARE = dt.AveragedPredictor(BELIEVED, plants.gains(BELIEVED), None, 0.31)
CASES = {
    "of another model": (TRUTH, believing(), []),
    "delays of every mode and input": (OWN, believing(OWN), LIMITED),
    "disturbed": (
        TRUTH,
        believing(switches="samples", forgetting=1e-4),
        [WhiteDisturbance(0.05), Noise([0.02, 0.0, 0.03]), Dropout(0.2), RateLimit([3.0, 4.0])],
    ),
    "ages": (BELIEVED, believing(model=SEMI, ages=12), [WhiteDisturbance(0.05), WrongMode(0.3)]),
    "ages of the table alone": (BELIEVED, believing(law=AWARE), [LateSamples(2, 0.2)]),
    "measured within periods": (TRUTH, believing(), [Jitter(0.05), ModeDelay(2), Noise(0.02)]),
}
# Rows by the mode, behind limits; rows by the mode and its age, under a force.
FEW = ("delays of every mode and input", "ages")


@pytest.mark.parametrize("case", mostly_long(list(CASES), *FEW))
def test_scenarios_on_a_belief_are_those_of_single_runs(case):
    truth, law, given = CASES[case]
    require_single_runs(truth, {case: law}, given)


def test_no_scenario_reads_a_mode():
    args = OWN, {"belief": believing(OWN)}, MARKOV, [0.3, -0.6, 0.9], 6.0, H, 20
    told = dt.monte_carlo(*args, imperfections=LIMITED)
    deceived = dt.monte_carlo(*args, imperfections=[WrongMode(0.9), *LIMITED])
    assert np.array_equal(told.cost.values, deceived.cost.values)
