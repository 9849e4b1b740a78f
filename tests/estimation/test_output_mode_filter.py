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
    outputs, inputs = log_of_a_run(plant, [0, 0, 1, 1, 1, 2, 2], C3)
    found = run(made(plant, model, switches="samples", forgetting=1e-18), outputs, inputs)
    for k in range(7):
        belief, states = by_paths(plant, model.rates, C3, outputs[: k + 1], inputs)
        exact = 1e-12 if k < 2 else 0.01
        assert np.abs(found[k][0] - belief).max() < exact
        assert np.abs(found[k][2] - states).max() < (1e-12 if k < 2 else 0.03)
    assert 0.02 < found[-1][0].min() < found[-1][0].max() < 0.98


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
            x = expm(OSCILLATING[int(signal(a))] * (b - a)) @ x
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
    """Within 0.05 of a probability and 0.03 of the state, for what is merged and to first order."""
    s, v = 0.1, 0.1
    outputs, _, _ = one_output(40, s, v, 4)
    reference = particles(outputs, s, v, count)
    options = {"covariance": 0.01, "disturbance": s**2, "noise": v, "estimate": [1.0, 0.5]}
    running = dt.OutputModeFilter(oscillator(), CHAIN, STEP, [[1.0, 0.0]], **options).start()
    found = np.array([[running.update(y[:1])[1], *running.estimate] for y in outputs])
    print(np.abs(found - reference).max(axis=0), found.min(axis=0), found.max(axis=0))
    assert np.abs(found - reference)[:, 0].max() < 0.05
    assert np.abs(found - reference)[:, 1:].max() < 0.03
    assert found[:, 0].max() - found[:, 0].min() > 0.5
