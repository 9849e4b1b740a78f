"""The mode filter on outputs: against sums over paths of modes, particles, and in its limits."""

import itertools

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import multivariate_normal

import deadtime as dt
import mode_paths
import plants
from shares import mostly_long

STEP = 0.1
DELAYS = [[0.234, 0.1], [0.15, 0.31], [0.05, 0.27]]
W, V = np.diag([0.3, 0.2, 0.4]) + 0.05, np.array([0.05, 0.1])
C3 = np.array([[[1.0, 0.0, 0.2], [0.0, 1.0, 0.0]]] * 3) + 0.1 * np.arange(3)[:, None, None]
X0, P0 = np.array([1.0, -1.0, 0.5]), np.diag([0.2, 0.1, 0.3]) + 0.05


def log_of_a_run(plant, modes, C, seed=5):
    """Outputs and inputs of a noisy run with the modes of its periods."""
    rng = np.random.default_rng(seed)
    inputs = {k: rng.normal(size=plant.inputs) for k in range(-4, len(modes))}
    x, outputs = X0.copy(), []
    for k, mode in enumerate(modes):
        outputs.append(C[mode] @ x + V * rng.normal(size=2))
        x = mode_paths.ahead(plant, STEP, mode, x, inputs, k) + 0.15 * rng.normal(size=3)
    return np.array(outputs), inputs


def run(filt, outputs, inputs):
    """Belief, merged estimate, estimates and covariances of the modes, at every sample."""
    running = filt.start(np.array([inputs[k] for k in range(-filt.longest_lag, 0)]).T)
    found = []
    for k, y in enumerate(outputs):
        belief = running.update(y, inputs[k - 1])
        found.append((belief, running.estimate, running.estimates, running.covariances))
    return found


def conditioned(plant, path, C, outputs, inputs):
    """log p(y), mean and covariance of the last state, given a path of modes: no recursion.

    The states of a path are jointly normal; the outputs are a linear image of them.
    """
    n, p, many = 3, 2, len(outputs)
    mean, x = [], X0
    for k in range(many):
        mean.append(x)
        x = mode_paths.ahead(plant, STEP, path[k], x, inputs, k)
    E = [expm(STEP * A) for A in plant.A]
    Q = [plants.gramian_by_quadrature(A, W, STEP) for A in plant.A]
    noise = [P0] + [Q[i] for i in path[: many - 1]]
    reach = np.zeros((many * n, many * n))  # of x_0 and of the noise of every period in x_k
    for k, s in itertools.product(range(many), range(many)):
        if s <= k:
            moved = np.eye(n)
            for i in path[s:k]:
                moved = E[i] @ moved
            reach[k * n : k * n + n, s * n : s * n + n] = moved
    whole = np.zeros_like(reach)
    for k, block in enumerate(noise):
        whole[k * n : k * n + n, k * n : k * n + n] = block
    cov = reach @ whole @ reach.T
    H = np.zeros((many * p, many * n))
    for k in range(many):
        H[k * p : k * p + p, k * n : k * n + n] = C[path[k]]
    m, seen = np.concatenate(mean), np.isfinite(outputs).ravel()
    H, y = H[seen], outputs.ravel()[seen]
    S = H @ cov @ H.T + np.diag(np.tile(V**2, many)[seen])
    gain = np.linalg.solve(S, H @ cov).T
    state, P = m + gain @ (y - H @ m), cov - gain @ H @ cov
    return multivariate_normal.logpdf(y, H @ m, S), state[-n:], P[-n:, -n:]


def by_paths(plant, rates, C, outputs, inputs):
    """The belief and E[x | mode] by summing over every path of modes."""
    modes, many = plant.modes, len(outputs)
    Lam = rates - np.diag(rates.sum(axis=1))
    P, weight, mean = expm(STEP * Lam), [], []
    paths = list(itertools.product(range(modes), repeat=many))
    for path in paths:
        log, state, _ = conditioned(plant, path, C, outputs, inputs)
        prior = sum(np.log(P[a, b]) for a, b in itertools.pairwise(path))
        weight.append(log + prior)
        mean.append(state)
    weight = np.exp(np.array(weight) - max(weight))
    last = np.array([path[-1] for path in paths])
    total = np.array([weight[last == i].sum() for i in range(modes)])
    states = [
        np.average(np.array(mean)[last == i], axis=0, weights=weight[last == i])
        for i in range(modes)
    ]
    return total / total.sum(), np.array(states)


def made(plant, model, C=C3, **options):
    given = {"covariance": P0, "disturbance": W, "noise": V, "estimate": X0} | options
    return dt.OutputModeFilter(plant, model, STEP, C, **given)


@pytest.mark.parametrize("switches", ["samples", "anywhere"])
def test_of_one_mode_it_is_the_conditional_density(switches):
    """With outputs missing, one and all."""
    plant = plants.generic(DELAYS)
    plant = dt.SwitchedSystem(plant.A[:1], plant.B[:1], DELAYS[:1])
    outputs, inputs = log_of_a_run(plant, [0] * 9, C3)
    outputs[3, 1], outputs[5] = np.nan, np.nan
    found = run(made(plant, dt.Markov([[0.0]]), C3[:1], switches=switches), outputs, inputs)
    for k in (0, 1, 3, 5, 8):
        _, mean, P = conditioned(plant, [0] * (k + 1), C3, outputs[: k + 1], inputs)
        plants.close(found[k][1], mean, 1e-12)
        plants.close(found[k][3][0], P, 1e-12)
        assert found[k][0] == pytest.approx(1.0, abs=1e-15)


def test_the_first_two_beliefs_are_the_sums_over_all_paths_and_later_ones_near_them():
    """One normal density per mode is exact until paths have been merged; C differs by mode."""
    plant, model = plants.generic(DELAYS).apart(0.4), plants.markov(3)
    outputs, inputs = log_of_a_run(plant, [0, 0, 1, 1, 1], C3)
    found = run(made(plant, model, switches="samples", forgetting=1e-18), outputs, inputs)
    for k in range(5):
        belief, states = by_paths(plant, model.rates, C3, outputs[: k + 1], inputs)
        assert np.abs(found[k][0] - belief).max() < (1e-12 if k < 2 else 0.001)
        assert np.abs(found[k][2] - states).max() < (1e-12 if k < 2 else 0.005)


@pytest.mark.parametrize("switches", ["samples", "anywhere"])
@pytest.mark.parametrize("name", ["markov", "semi-markov"])
def test_states_without_noise_give_the_belief_of_the_mode_filter(switches, name):
    plant = plants.generic(DELAYS).apart(0.4)
    model = plants.markov(3) if name == "markov" else dt.SemiMarkov([0.3, 0.5, 0.4])
    outputs, inputs = log_of_a_run(plant, [0, 0, 0, 1, 1, 1, 1, 2, 2, 2], C3)
    states = np.hstack((outputs, outputs[:, :1] - 0.3))
    options = {"disturbance": W, "switches": switches}
    filt = dt.OutputModeFilter(plant, model, STEP, np.eye(3), covariance=P0, **options)
    plain = dt.ModeFilter(plant, model, STEP, **options)
    past = np.array([inputs[k] for k in range(-plain.longest_lag, 0)]).T
    one, other = filt.start(past), plain.start(past)
    for k, x in enumerate(states):
        u = inputs[k - 1]
        plants.close(one.update(x, u), other.update(x, u), 1e-9)
        plants.close(one.estimate, x, 1e-9)


OSCILLATING = np.array([[[-0.5, 2.0], [-2.0, -0.5]], [[-0.7, 2.6], [-1.6, -0.6]]])
SPECTRA = [np.linalg.eig(A) for A in OSCILLATING]
CHAIN = dt.Markov([[0.0, 0.8], [1.3, 0.0]])


def one_output(count, s, v, seed):
    """Outputs x_1 + noise of a plant that switches at instants of its own, and the modes there."""
    rng, signal = np.random.default_rng(seed), CHAIN.sample(count * STEP + 1.0, seed=seed)
    x, outputs, modes, states = np.array([1.0, 0.5]), [], [], []
    for k in range(count):
        start, end = k * STEP, (k + 1) * STEP
        modes.append(int(signal(start)))
        outputs.append(x + v * rng.normal(size=2))
        states.append(x)
        times = signal.times[(signal.times > start) & (signal.times < end)]
        for a, b in itertools.pairwise([start, *times, end]):
            values, vectors = SPECTRA[int(signal(a))]
            x = (vectors * np.exp(values * (b - a)) @ np.linalg.solve(vectors, x)).real
        x = x + s * np.sqrt(STEP) * rng.normal(size=2)
    return np.array(outputs), np.array(modes), np.array(states)


def particles(outputs, s, v, count, seed=3):
    """P(mode 1) and E[x] by particles with switches at instants of their own."""
    rng = np.random.default_rng(seed)
    values, vectors = np.linalg.eig(OSCILLATING)
    inverse, leave = np.linalg.inv(vectors), CHAIN.rates.sum(axis=1)
    Q = [plants.gramian_by_quadrature(A, s**2 * np.eye(2), STEP) for A in OSCILLATING]
    roots, mode = np.linalg.cholesky(Q), rng.integers(2, size=count)
    z, found = np.array([1.0, 0.5]) + 0.1 * rng.normal(size=(count, 2)), []
    for k, y in enumerate(outputs):
        if k:
            noise = np.einsum("pij,pj->pi", roots[mode], rng.normal(size=(count, 2)))
            left = np.full(count, STEP)
            while (left > 0.0).any():
                stay = np.minimum(rng.exponential(1.0 / leave[mode]), left)
                turned = np.einsum("pij,pj->pi", inverse[mode], z) * np.exp(
                    values[mode] * stay[:, None]
                )
                z, left = np.einsum("pij,pj->pi", vectors[mode], turned).real, left - stay
                mode = np.where(left > 0.0, 1 - mode, mode)
            z = z + noise
        weight = np.exp(-0.5 * ((y[0] - z[:, 0]) / v) ** 2)
        chosen = rng.choice(count, count, p=weight / weight.sum())
        z, mode = z[chosen], mode[chosen]
        found.append([mode.mean(), *z.mean(axis=0)])
    return np.array(found)


def oscillator():
    return dt.SwitchedSystem(OSCILLATING, [[[1.0], [0.5]]] * 2, 0.3)


@pytest.mark.parametrize("count", mostly_long([20_000, 100_000], 20_000))
def test_particles_with_switches_of_their_own_believe_the_same(count):
    """Within 0.1 of a probability and 0.03 of the state: 0.1 s is long here for first order."""
    s, v = 0.05, 0.03
    outputs, _, _ = one_output(25, s, v, 5)
    reference = particles(outputs, s, v, count)
    options = {"covariance": 0.01, "disturbance": s**2, "noise": v, "estimate": [1.0, 0.5]}
    running = dt.OutputModeFilter(oscillator(), CHAIN, STEP, [[1.0, 0.0]], **options).start()
    found = np.array([[running.update(y[:1])[1], *running.estimate] for y in outputs])
    assert np.abs(found - reference)[:, 0].max() < 0.1
    assert np.abs(found - reference)[:, 1:].max() < 0.03
    assert np.ptp(reference[:, 0]) > 0.5


@pytest.mark.parametrize("count", mostly_long([80, 600], 80))
def test_noisy_states_are_weighed_as_they_should_be_and_better_than_by_their_differences(count):
    """By quarters of [0, 1], how far shares are from probabilities; and the squared error."""
    s, v, samples = 0.05, 0.03, 20
    options = {"disturbance": s**2, "noise": v}
    plain = dt.ModeFilter(oscillator(), CHAIN, STEP, **options)
    bank = dt.OutputModeFilter(oscillator(), CHAIN, STEP, np.eye(2), covariance=1.0, **options)
    given, there = np.empty((2, count, samples)), np.empty((count, samples))
    wrong = np.empty((2, count, samples, 2))
    for seed in range(count):
        outputs, there[seed], states = one_output(samples, s, v, seed)
        running = plain.start(), bank.start()
        for k, y in enumerate(outputs):
            given[:, seed, k] = [one.update(y)[1] for one in running]
            wrong[:, seed, k] = y - states[k], running[1].estimate - states[k]
    apart = []
    for believed in given:
        quarter = np.minimum((4.0 * believed).astype(int), 3)
        sums = [(there - believed)[quarter == q].sum() for q in range(4)]
        apart.append(np.abs(sums).sum() / there.size)
    assert apart[1] < (0.03 if count > 300 else 0.06)
    assert apart[1] < apart[0]
    error = ((given - there) ** 2).mean(axis=(1, 2))
    assert error[1] < 0.96 * error[0]
    assert wrong[1].std() < 0.75 * wrong[0].std()


def test_missing_outputs_leave_the_belief_to_the_switching_model():
    plant, model = plants.generic(DELAYS).apart(0.4), plants.markov(3)
    outputs, inputs = log_of_a_run(plant, [0, 0, 1, 1, 1, 1], C3)
    outputs[3] = np.nan
    found = run(made(plant, model, forgetting=1e-18), outputs, inputs)
    P = expm(STEP * model.generator)
    plants.close(found[3][0], found[2][0] @ P, 1e-12)
    assert np.abs(found[4][0] - found[3][0] @ P).max() > 0.01
    assert (np.diagonal(found[3][3], axis1=1, axis2=2).sum(axis=1) > 0.1).all()


@pytest.mark.parametrize("switches", ["samples", "anywhere"])
@pytest.mark.parametrize("C", [[[1.0, 0.0]], np.eye(2), [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]])
def test_without_noise_nothing_is_divided_by_and_no_mode_is_ruled_out(switches, C):
    plant, C = plants.paper(), np.array(C)
    filt = dt.OutputModeFilter(plant, CHAIN, STEP, C, covariance=1.0, switches=switches)
    running, x = filt.start(), np.array([1.0, 1.0])
    running.update(C @ x)
    E = [expm(A * STEP) for A in plant.A]
    for k in range(40):
        x = E[(k // 8) % 2] @ x
        found = running.update(C @ x)
        assert abs(found.sum() - 1.0) < 1e-12
        assert found.min() >= 0.4e-9
        assert k % 8 < 4 or found.argmax() == (k // 8) % 2
    plants.close(running.estimate, x, 1e-3)
    for y in (0.0, 0.0, 1e300, -1e300, 1e-300, np.inf, np.nan, 1.0, 1.0):
        found = running.update(np.full(len(C), y))
        assert abs(found.sum() - 1.0) < 1e-12
        assert np.isfinite(running.estimate).all()


def test_scaling_states_outputs_and_noise_alike_leaves_the_belief_as_it_is():
    plant = plants.generic(DELAYS).apart(0.4)
    outputs, inputs = log_of_a_run(plant, [0, 0, 1, 1, 1, 2, 2], C3)
    T, S = np.diag([1e4, 1e-3, 7.0]), np.diag([1e-2, 50.0])
    back = np.linalg.inv(T)
    scaled = dt.SwitchedSystem(T @ plant.A @ back, T @ plant.B, plant.delays)
    options = {"covariance": T @ P0 @ T, "disturbance": T @ W @ T, "noise": S @ V}
    one = run(made(plant, plants.markov(3)), outputs, inputs)
    many = made(scaled, plants.markov(3), S @ C3 @ back, estimate=T @ X0, **options)
    other = run(many, outputs @ S, inputs)
    for (belief, x, _, _), (same, y, _, _) in zip(one, other, strict=True):
        np.testing.assert_allclose(belief, same, rtol=1e-9)
        np.testing.assert_allclose(T @ x, y, rtol=1e-9)


def test_a_belief_from_elsewhere_replaces_the_filters():
    running = dt.OutputModeFilter(oscillator(), CHAIN, STEP, [[1.0, 0.0]], covariance=1.0).start()
    plants.close(running.update([1.0], belief=[0.2, 0.8]), np.array([0.2, 0.8]), 1e-15)
    assert running.belief.shape == (2, 1)


def test_an_output_that_only_one_mode_shows_tells_the_mode_at_once():
    C = np.array([[[1.0, 0.0]], [[0.0, 1.0]]])
    options = {"covariance": 1e-4, "noise": 0.01, "estimate": [1.0, 0.0]}
    running = dt.OutputModeFilter(oscillator(), CHAIN, STEP, C, **options).start()
    assert running.update([0.0])[1] > 1.0 - 1e-9
