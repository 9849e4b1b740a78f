"""Laws on a belief, in the batch engine: the runs of `simulate`."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

import deadtime as dt
import plants
from batches import HORIZON, H, require_single_runs
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


def on_belief(plant=BELIEVED, model: Any = MARKOV, law=None, **options):
    law = dt.ExpectedPredictor(plant, plants.gains(plant), model) if law is None else law
    filt = dt.ModeFilter(plant, model, H, **{"disturbance": 0.1, "noise": 0.05, **options})
    return dt.BeliefPredictor(law, filt)


LIMITED = [Noise(0.02), Dropout(0.2), RateLimit([3.0, 4.0]), Saturation(-1.0, 1.2)]
AWARE = dt.AveragedPredictor(BELIEVED, plants.gains(BELIEVED), None, 0.31)
# Made when they are asked for: their filters compile.
CASES = {
    "delays of every mode and input": lambda: (OWN, on_belief(OWN), LIMITED),
    "disturbed": lambda: (
        TRUTH,
        on_belief(switches="samples", forgetting=1e-4),
        [WhiteDisturbance(0.05), Noise([0.02, 0.0, 0.03]), Dropout(0.2), RateLimit([3.0, 4.0])],
    ),
    "ages": lambda: (
        BELIEVED,
        on_belief(model=SEMI, ages=12),
        [WhiteDisturbance(0.05), WrongMode(0.3)],
    ),
    "ages of the table alone": lambda: (BELIEVED, on_belief(law=AWARE), [LateSamples(2, 0.2)]),
    "measured within periods": lambda: (
        TRUTH,
        on_belief(),
        [Jitter(0.05), ModeDelay(2), Noise(0.02)],
    ),
}


# Others on the same kernel are below.
@pytest.mark.parametrize("case", mostly_long(list(CASES), "delays of every mode and input"))
def test_scenarios_on_a_belief_are_those_of_single_runs(case):
    truth, law, given = CASES[case]()
    # Measured within periods, that loop is chaotic: after 4 s a rounding of x0 grows to 1e-12.
    end = 4.03 if case == "measured within periods" else HORIZON
    require_single_runs(truth, {case: law}, given, horizon=end)


NEAR = plants.generic(0.3, seed=5)
NEAR = dt.SwitchedSystem(NEAR.A - 1.5 * np.eye(3), NEAR.B, 0.3)  # so that no error grows
C = [[1.0, 0.0, 0.2], [0.0, 1.0, 0.0]]
BY_MODE = np.array(C) + 0.1 * np.arange(3)[:, None, None]


def observing(C, **options):
    filt = dt.OutputModeFilter(
        NEAR, MARKOV, H, C, **{"covariance": 1.0, "disturbance": 0.1, "noise": 0.05, **options}
    )
    return dt.BeliefPredictor(dt.ExpectedPredictor(NEAR, plants.gains(NEAR), MARKOV), filt)


OUTPUTS = {
    "outputs of every mode, lost and limited": lambda: (
        observing(BY_MODE),
        [WhiteDisturbance(0.05), Noise([0.02, 0.01]), Dropout(0.2), Saturation(-1.0, 1.2)],
    ),
    "observers": lambda: (
        observing(dt.luenberger(NEAR, C, [-3.0, -4.0, -5.0], H), switches="samples"),
        [Noise(0.02)],
    ),
    "measured within periods": lambda: (observing(C), [Jitter(0.05), ModeDelay(2), Noise(0.02)]),
}


@pytest.mark.long
@pytest.mark.parametrize("case", mostly_long([*OUTPUTS], "outputs of every mode, lost and limited"))
def test_scenarios_on_a_belief_from_outputs_are_those_of_single_runs(case):
    law, given = OUTPUTS[case]()
    require_single_runs(NEAR, {case: law}, given)


def test_without_noise_scenarios_are_single_runs_as_no_belief_is_left_to_round_off():
    law = on_belief(OWN, disturbance=0.0, noise=0.0)
    require_single_runs(OWN, {"exact": law}, [Noise(0.0), Saturation(-1.0, 1.2)], horizon=4.03)


def test_a_row_without_noise_in_one_mode_and_without_size_is_left_out():
    """x₁ follows x₂, which alone is disturbed of both, in mode 0 only; and both rest at 0."""
    A = np.array([np.diag([-1.0, -1.0, own]) for own in (0.3, -0.2, 0.6)])
    A[0, 0, 1] = 1.0
    plant = dt.SwitchedSystem(A, [[[0.0, 0.0], [0.0, 0.0], [1.0, 0.5]]] * 3, OWN.delays)
    law = dt.ExpectedPredictor(plant, [[[0.0, 0.0, -1.5], [0.0, 0.0, 0.0]]] * 3, MARKOV)
    believed = on_belief(plant, law=law, disturbance=[0.0, 0.1, 0.1], noise=0.0)
    given = [Noise(0.0), Saturation(-1.0, 1.2)]
    require_single_runs(plant, {"one": believed}, given, (0, 8), 2.03, (0.0, 0.0, 0.9))


def test_no_scenario_reads_a_mode():
    args = OWN, {"belief": on_belief(OWN)}, MARKOV, [0.3, -0.6, 0.9], 6.0, H, 20
    told = dt.monte_carlo(*args, imperfections=LIMITED)
    deceived = dt.monte_carlo(*args, imperfections=[WrongMode(0.9), *LIMITED])
    assert np.array_equal(told.cost.values, deceived.cost.values)
