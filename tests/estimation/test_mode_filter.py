"""The mode filter against the sum over all paths of modes, and in its limits."""

import itertools

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import expm

import deadtime as dt
import mode_paths
import plants
from shares import mostly_long

STEP, W = 0.1, np.diag([0.3, 0.2, 0.4]) + 0.05
STD = np.array([0.05, 0.02, 0.1])
DELAYS = [[0.234, 0.1], [0.15, 0.31], [0.05, 0.27]]  # per mode and input, none of them alike
LEAST = 1e-18  # of forgetting: below what the sums are compared to
SOJOURNS = [stats.expon(loc=0.15, scale=0.3), stats.gamma(3.0, scale=0.12), stats.uniform(0.2, 0.7)]
TRANSITION = np.array([[0.0, 0.3, 0.7], [0.6, 0.0, 0.4], [0.5, 0.5, 0.0]])


def log_of_a_run(samples=13, seed=5):
    """States and inputs of a noisy run of a plant whose modes are close enough to be confused."""
    plant, rng = plants.generic(DELAYS).apart(0.4), np.random.default_rng(seed)
    inputs = {k: rng.normal(size=2) for k in range(-4, samples)}
    states, modes = [np.array([1.0, -1.0, 0.5])], [0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 0, 0, 0]
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
    for periods in (1, 2, 6, 12):
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


def test_a_first_state_and_a_missing_one_leave_the_belief_to_the_switching_model():
    plant, states, inputs = log_of_a_run(6)
    filt = dt.ModeFilter(plant, plants.markov(3), STEP, disturbance=W, forgetting=LEAST)
    P = expm(STEP * filt.model.generator)
    states[3, 1] = np.nan
    found = beliefs_of(filt, states, inputs)
    plants.close(found[0], np.full(3, 1 / 3), 1e-15)
    plants.close(found[3], found[2] @ P, 1e-12)
    plants.close(found[4], found[2] @ P @ P, 1e-12)
    assert np.abs(found[5] - found[4] @ P).max() > 0.01


def test_under_a_semi_markov_model_ages_go_on_while_states_are_missing():
    model = dt.SemiMarkov([0.3, 0.5])  # fixed: 3 and 5 samples
    filt = dt.ModeFilter(plants.paper(), model, STEP, initial=[1.0, 0.0], forgetting=LEAST)
    running = filt.start()
    likely = [int(running.update([np.nan, 1.0]).argmax()) for _ in range(16)]
    assert likely == [0] * 3 + [1] * 5 + [0] * 3 + [1] * 5


@pytest.mark.parametrize("disturbance", [0.0, 1e-4])
@pytest.mark.parametrize("switches", ["samples", "anywhere"])
def test_no_mode_is_ever_ruled_out_and_nothing_is_ever_not_a_number(switches, disturbance):
    plant, model = plants.paper(), dt.SemiMarkov([1.0, 1.0])  # no hazard for ten samples
    filt = dt.ModeFilter(plant, model, STEP, disturbance=disturbance, switches=switches)
    running, x = filt.start(), np.array([1.0, 1.0])
    running.update(x)
    E = [expm(A * STEP) for A in plant.A]
    for k in range(40):
        x = E[(k // 6) % 2] @ x  # sooner than the model allows
        found = running.update(x)
        assert abs(found.sum() - 1.0) < 1e-12
        assert found.min() >= 0.4e-9
        assert k % 6 < 2 or found.argmax() == (k // 6) % 2
    for x in ([0.0, 0.0], [0.0, 0.0], [1e300, -1e300], [1e-300, 0.0], [np.inf, 0.0], [1.0, 1.0]):
        found = running.update(x)
        assert abs(found.sum() - 1.0) < 1e-12


def test_without_noise_round_off_tells_the_mode_whatever_the_units():
    plant, x = plants.paper(), np.array([1.0, 1.0])
    for T in (np.eye(2), np.diag([1e9, 1e-9])):
        A = T @ plant.A @ np.linalg.inv(T)
        filt = dt.ModeFilter(dt.SwitchedSystem(A, T @ plant.B, 1.0), plants.markov(2), STEP)
        running, y = filt.start(), T @ x
        running.update(y)
        found = running.update(expm(A[1] * STEP) @ y)
        assert found[1] > 1.0 - 1e-6


def test_scaling_states_and_noise_alike_leaves_the_belief_as_it_is():
    plant, states, inputs = log_of_a_run(8)
    T = np.diag([1e4, 1e-3, 7.0])
    A = T @ plant.A @ np.linalg.inv(T)
    scaled = dt.SwitchedSystem(A, T @ plant.B, plant.delays)
    one = dt.ModeFilter(plant, plants.markov(3), STEP, disturbance=W, noise=STD)
    other = dt.ModeFilter(scaled, plants.markov(3), STEP, disturbance=T @ W @ T, noise=STD @ T)
    found = beliefs_of(one, states, inputs), beliefs_of(other, states @ T, inputs)
    np.testing.assert_allclose(*found, rtol=1e-9)


def test_a_belief_from_elsewhere_replaces_the_filters_and_keeps_the_ages():
    plant, states, inputs = log_of_a_run(5)
    filt = dt.ModeFilter(plant, dt.SemiMarkov(SOJOURNS, TRANSITION), STEP, disturbance=W)
    running = filt.start()
    for k, x in enumerate(states):
        running.update(x, inputs[k - 1])
    before = running.belief.copy()
    found = running.update(states[-1], belief=[0.2, 0.3, 0.5])
    plants.close(found, np.array([0.2, 0.3, 0.5]), 1e-15)
    assert running.belief.shape == before.shape == (3, filt.ages)
    assert (running.belief > 0.0).sum() > 3
    whole = np.full(before.shape, 1.0 / before.size)
    plants.close(running.update(states[-1], belief=whole), np.full(3, 1 / 3), 1e-14)


OSCILLATING = np.array([[[-0.5, 2.0], [-2.0, -0.5]], [[-0.7, 2.6], [-1.6, -0.6]]])


def given_and_there(switches, filter_switches, runs, step=0.1, s=0.05, samples=20):
    """The belief in mode 1 and whether it is there, over runs with switches at samples or anywhere.

    Every tenth period ends with a switch here, and one period tells little.
    """
    plant = dt.SwitchedSystem(OSCILLATING, [[[1.0], [0.5]]] * 2, 0.3)
    model, rng = dt.Markov([[0.0, 0.8], [1.3, 0.0]]), np.random.default_rng(8)
    filt = dt.ModeFilter(plant, model, step, disturbance=s**2, switches=filter_switches)
    spectra = [np.linalg.eig(A) for A in OSCILLATING]
    Q = [plants.gramian_by_quadrature(A, np.eye(2), step) for A in OSCILLATING]
    roots, P = s * np.linalg.cholesky(Q), expm(step * model.generator)

    def move(mode, time, x):
        values, vectors = spectra[mode]
        return (vectors * np.exp(values * time) @ np.linalg.solve(vectors, x)).real

    given, there = [], []
    for run in range(runs):
        signal = model.sample(samples * step + 1.0, seed=run)
        x, mode, running = rng.normal(size=2), int(signal(0.0)), filt.start()
        for k in range(samples):
            given.append(running.update(x)[1])
            there.append(mode)
            noise = roots[mode] @ rng.normal(size=2)
            if switches == "samples":
                x, mode = move(mode, step, x) + noise, int(rng.random() >= P[mode, 0])
                continue
            start, end = k * step, (k + 1) * step
            times = signal.times[(signal.times > start) & (signal.times < end)]
            for a, b in itertools.pairwise([start, *times, end]):
                x = move(int(signal(a)), b - a, x)
            x, mode = x + noise, int(signal(end))
    return np.array(given), np.array(there)


def shares_apart(given, there, samples=20):
    """By quarters of [0, 1], how far a share is from its probability, and the error of that.

    Samples of one run are not independent: errors are those of the runs' sums.
    """
    quarters = np.minimum((4.0 * given).astype(int), 3)
    apart = np.where(quarters == np.arange(4)[:, None], there - given, 0.0)
    count = np.bincount(quarters)
    errors = np.sqrt((apart.reshape(4, -1, samples).sum(axis=2) ** 2).sum(axis=1)) / count
    return np.abs(apart.sum(axis=1)) / count, errors


@pytest.mark.few(1)
@pytest.mark.parametrize("switches", ["samples", "anywhere"])
def test_what_is_given_a_probability_happens_as_often_within_the_error_of_few_runs(switches):
    apart, errors = shares_apart(*given_and_there(switches, switches, 300))
    assert (apart < 3.0 * errors).all()
    assert (errors < 0.04).all()


@pytest.mark.long
@pytest.mark.parametrize("switches", ["samples", "anywhere"])
def test_what_is_given_a_probability_happens_as_often(switches):
    apart, errors = shares_apart(*given_and_there(switches, switches, 3000))
    assert (apart < 0.03).all()
    assert (errors < 0.012).all()


@pytest.mark.long
def test_what_switches_anywhere_and_is_taken_to_switch_at_samples_happens_otherwise():
    assert shares_apart(*given_and_there("anywhere", "samples", 3000))[0].max() > 0.03


def particles(model, states, u, step, W, switches, count=100_000, seed=3):
    """P(mode 1) by particles whose modes switch at instants of their own, and their error.

    Each starts a period from the state that was seen and is weighed by the next one; two or more
    switches may fall into a period. Its noise is that of the mode it starts in.
    """
    rng = np.random.default_rng(seed)
    whole = np.zeros((2, 3, 3))
    whole[:, :2, :2], whole[:, :2, 2] = OSCILLATING, [1.0, 0.5]
    values, vectors = np.linalg.eig(whole)
    inverse = np.linalg.inv(vectors)
    leave, P = model.rates.sum(axis=1), expm(step * model.generator)
    precision = [np.linalg.inv(plants.gramian_by_quadrature(A, W, step)) for A in OSCILLATING]
    scale = [np.sqrt(np.linalg.det(each)) for each in precision]
    mode, found = rng.integers(2, size=count), [0.5]
    for x, after in itertools.pairwise(states):
        z, left, now = np.tile([*x, u], (count, 1)), np.full(count, step), mode.copy()
        while (left > 0.0).any():
            stay = np.minimum(rng.exponential(1.0 / leave[now]), left)
            stay = left if switches == "samples" else stay
            turned = np.einsum("pij,pj->pi", inverse[now], z) * np.exp(values[now] * stay[:, None])
            z, left = np.einsum("pij,pj->pi", vectors[now], turned).real, left - stay
            now = np.where(left > 0.0, 1 - now, now)
        if switches == "samples":
            now = (rng.random(count) >= P[mode, 0]).astype(int)
        r = after - z[:, :2]
        weight = np.empty(count)
        for i in range(2):
            at = mode == i
            square = np.einsum("pi,ij,pj->p", r[at], precision[i], r[at])
            weight[at] = scale[i] * np.exp(-0.5 * square)
        mode = now[rng.choice(count, count, p=weight / weight.sum())]
        found.append(mode.mean())
    return np.array(found)


@pytest.mark.parametrize(("switches", "apart"), [("samples", 0.0), ("anywhere", 0.015)])
@pytest.mark.parametrize("count", mostly_long([20_000, 100_000], 20_000))
def test_particles_with_switches_of_their_own_believe_the_same(switches, apart, count):
    """Within four errors of so many; with switches anywhere, to first order in 0.1 s as well."""
    step, s = 0.1, 0.05
    model, rng = dt.Markov([[0.0, 0.8], [1.3, 0.0]]), np.random.default_rng(2)
    signal = model.sample(4.0, seed=4)
    x, states = np.array([1.0, 0.5]), []
    root = np.linalg.cholesky(plants.gramian_by_quadrature(OSCILLATING[0], np.eye(2), step))
    for k in range(25):
        states.append(x)
        Phi, Gamma = plants.held(OSCILLATING[int(signal(k * step))], np.array([[1.0], [0.5]]), step)
        x = Phi @ x + Gamma[:, 0] * 0.4 + s * root @ rng.normal(size=2)
    reference = particles(model, states, 0.4, step, s**2 * np.eye(2), switches, count)
    plant = dt.SwitchedSystem(OSCILLATING, [[[1.0], [0.5]]] * 2, 0.3)
    filt = dt.ModeFilter(plant, model, step, disturbance=s**2, switches=switches)
    running = filt.start(np.full((1, 3), 0.4))
    found = np.array([running.update(x, [0.4])[1] for x in states])
    assert np.abs(found - reference).max() < apart + 4.0 * 0.5 * np.sqrt(2.0 / count)
    assert found.min() < 0.1
    assert found.max() > 0.8


# The variance that a bend leaves is a square of the whole, that of round-off of 1e-12 of it.
@pytest.mark.parametrize(("switches", "most"), [("samples", 2.0**540), ("anywhere", 2.0**500)])
def test_a_belief_is_the_same_in_every_unit_whose_variances_are_numbers_else_it_is_the_chain(
    switches, most
):
    plant, states, inputs = log_of_a_run()

    def belief(unit, known=1.0):
        own = dt.SwitchedSystem(plant.A, unit * plant.B, plant.delays)
        exact = dt.ModeFilter(own, plants.markov(3), STEP, switches=switches)
        return np.array(beliefs_of(exact, unit * known * states, inputs))

    for unit in (2.0**-400, most):
        np.testing.assert_allclose(belief(unit), belief(1.0), rtol=1e-9)
    for unit in (2.0**-600, 2.0**600):
        np.testing.assert_array_equal(belief(unit), belief(unit, known=np.nan))
