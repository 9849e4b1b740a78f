"""The mode filter against the sum over all paths of modes, and in its limits."""

import numpy as np
import pytest
from scipy import stats

import deadtime as dt
import mode_paths
import plants

STEP, W = 0.1, np.diag([0.3, 0.2, 0.4]) + 0.05
STD = np.array([0.05, 0.02, 0.1])
DELAYS = [[0.234, 0.1], [0.15, 0.31], [0.05, 0.27]]  # per mode and input, none of them alike
LEAST = 1e-18  # of forgetting: below what the sums are compared to
SOJOURNS = [stats.expon(loc=0.15, scale=0.3), stats.gamma(3.0, scale=0.12), stats.uniform(0.2, 0.7)]
TRANSITION = np.array([[0.0, 0.3, 0.7], [0.6, 0.0, 0.4], [0.5, 0.5, 0.0]])


def log_of_a_run(samples=12, seed=5):
    """States and inputs of a noisy run of a plant whose modes are close enough to be confused."""
    plant, rng = plants.generic(DELAYS).apart(0.4), np.random.default_rng(seed)
    inputs = {k: rng.normal(size=2) for k in range(-4, samples)}
    states, modes = [np.array([1.0, -1.0, 0.5])], [0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 0, 0]
    for k in range(samples - 1):
        x = mode_paths.ahead(plant, STEP, modes[k], states[-1], inputs, k)
        states.append(x + 0.15 * rng.normal(size=3))
    return plant, np.array(states), inputs


def beliefs_of(filt, states, inputs):
    running = filt.start(np.array([inputs[k] for k in range(-filt.longest_lag, 0)]).T)
    return [running.update(x, inputs[k - 1]) for k, x in enumerate(states)]


@pytest.mark.parametrize("switches", ["samples", "anywhere"])
def test_a_markov_belief_is_the_sum_over_all_paths_of_modes(switches):
    plant, states, inputs = log_of_a_run()
    model = plants.markov(3)
    options = {"switches": switches, "forgetting": LEAST}
    filt = dt.ModeFilter(plant, model, STEP, disturbance=W, noise=STD, **options)
    found = beliefs_of(filt, states, inputs)
    within = switches == "anywhere"
    density = mode_paths.densities(plant, STEP, states, inputs, W, STD, within)
    prior = mode_paths.markov_prior(model.rates, STEP)
    for periods in (1, 2, 6, 11):
        plants.close(found[periods], mode_paths.beliefs(density[:periods], prior), 1e-12)
    assert 0.02 < np.min(found[-1]) < np.max(found[-1]) < 0.98


@pytest.mark.parametrize("switches", ["samples", "anywhere"])
def test_a_semi_markov_belief_is_the_sum_over_all_paths_of_modes(switches):
    plant, states, inputs = log_of_a_run(9)
    model = dt.SemiMarkov(SOJOURNS, TRANSITION)
    options = {"switches": switches, "forgetting": LEAST}
    filt = dt.ModeFilter(plant, model, STEP, disturbance=W, noise=STD, **options)
    found = beliefs_of(filt, states, inputs)
    density = mode_paths.densities(plant, STEP, states, inputs, W, STD, switches == "anywhere")
    prior = mode_paths.semi_markov_prior(SOJOURNS, TRANSITION, STEP)
    for periods in (1, 4, 8):
        plants.close(found[periods], mode_paths.beliefs(density[:periods], prior), 1e-12)
