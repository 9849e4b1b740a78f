"""Laws on a belief, for controllers: three modes, two inputs, a delay of each in every mode."""

import numpy as np
from scipy import stats

import deadtime as dt
import plants

STEP = 0.05
GENERIC = plants.generic()
DELAYS = [[0.17, 0.05], [0.23, 0.11], [0.12, 0.2]]
PLANT = dt.SwitchedSystem(GENERIC.A, GENERIC.B, DELAYS)
GAINS = plants.gains(GENERIC)
SEMI = dt.SemiMarkov(stats.expon(loc=0.3, scale=0.2), modes=3)
MARKOV = plants.markov(3)


def on_belief(law, model, plant=PLANT, step=STEP, disturbance=0.02, **options):
    """A law on a filter with noise of both kinds."""
    filt = dt.ModeFilter(plant, model, step, disturbance=disturbance, noise=0.01, **options)
    return dt.BeliefPredictor(law, filt)


LAWS = {
    "mode": lambda: on_belief(dt.ExpectedPredictor(PLANT, GAINS, MARKOV), MARKOV),
    "ages": lambda: on_belief(dt.ExpectedPredictor(PLANT, GAINS, SEMI), SEMI),
    "at samples": lambda: on_belief(
        dt.AveragedPredictor(PLANT, GAINS, None, 0.31), SEMI, switches="samples"
    ),
}


OUTPUTS = np.array([[1.0, 0.0, 0.2], [0.0, 1.0, 0.0]]) + 0.05 * np.arange(3)[:, None, None]
X0 = [1.0, -1.0, 0.5]


def from_outputs(model=MARKOV, C=OUTPUTS, **options):
    """The same on a bank of filters, told two outputs, other ones in every mode."""
    given = {"covariance": 0.1, "disturbance": 0.02, "noise": 0.01, "estimate": X0, **options}
    filt = dt.OutputModeFilter(PLANT, model, STEP, C, **given)
    return dt.BeliefPredictor(dt.ExpectedPredictor(PLANT, GAINS, model), filt)


def paper(step=0.02):
    """The paper's plant: two modes, two states."""
    plant, model = plants.paper(), dt.Markov([[0.0, 1.25], [1.25, 0.0]])
    law = dt.ExpectedPredictor(plant, plants.gains(plant), model)
    return on_belief(law, model, plant, step, 1e-4)


def record(law, horizon, plant=None, seed=0):
    """A run of the loop with forces and noise."""
    kinds = [dt.imperfections.WhiteDisturbance(0.02), dt.imperfections.Noise(0.01)]
    signal, x0 = plants.off_grid(), np.array([1.0, -1.0, 0.5])
    return dt.simulate(
        plant or law.plant,
        law,
        signal,
        x0,
        horizon,
        law.filter.step,
        imperfections=kinds,
        seed=seed,
    )
