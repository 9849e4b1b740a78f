"""Controllers that have served a few samples, to be asked what they predict."""

import numpy as np
from scipy import stats

import belief_laws
import deadtime as dt
import plants

STEP = 0.1
GENERIC = plants.generic()
OWN = dt.SwitchedSystem(GENERIC.A, GENERIC.B, belief_laws.DELAYS)
K = plants.gains(GENERIC)
SEMI = dt.SemiMarkov(stats.expon(loc=0.3, scale=0.2), modes=3)


def served(law, step=STEP, samples=9, seed=0, **options):
    """A controller after a few samples, with inputs that were applied; modes change."""
    controller, rng = dt.Controller(law, step, **options), np.random.default_rng(seed)
    for k in range(samples):
        mode = k // 4 % law.plant.modes
        x, applied = rng.normal(size=controller.measured), rng.normal(size=law.plant.inputs)
        controller.update(x, mode, applied if k else None)
    return controller, x


def past_of(law, samples=9, seed=0):
    """The inputs that `served` applied, the latest first."""
    rng, m, n = np.random.default_rng(seed), law.plant.inputs, law.plant.states
    sent = [(rng.normal(size=n), rng.normal(size=m))[1] for _ in range(samples)]
    return sent[:0:-1]
