"""The covariance of a prediction: disturbances, estimates, and futures that differ."""

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad_vec, solve_ivp
from scipy.linalg import expm

import belief_laws
import deadtime as dt
import plants
from predictions import GENERIC, OWN, SEMI, STEP, K, past_of, served

W = np.array([[0.3, 0.1, 0.0], [0.1, 0.5, -0.2], [0.0, -0.2, 0.4]])
EACH = np.stack([W, 3.0 * np.diag([0.0, 1.0, 0.2]), 0.1 * W])  # of every mode
P0 = np.diag([0.2, 0.0, 0.1])
MARKOV = plants.markov(3)
STRETCHES = ((0.034, 3), (0.1, 2), (0.1, 1))


def added(A, W, tau):
    """∫₀^τ e^{As} W e^{Aᵀs} ds by quadrature."""
    return quad_vec(lambda s: expm(A * s) @ W @ expm(A * s).T, 0.0, tau, epsrel=1e-11)[0]


def carried(A, P, tau):
    return expm(A * tau) @ P @ expm(A * tau).T


@pytest.mark.parametrize("plant", [GENERIC, OWN], ids=["one delay", "delays of their own"])
def test_a_mode_that_is_held_spreads_what_noise_adds_and_the_state_lacked(plant):
    found = served(dt.AveragedPredictor(plant, K, [0.2, 0.3, 0.5]))[0].prediction
    own = found.covariance_by_mode(W, P0)
    for mode, A in enumerate(plant.A):
        for j, tau in enumerate(plant.delays[mode]):
            plants.close(own[j, mode], carried(A, P0, tau) + added(A, W, tau), 1e-9)
    apart = found.by_mode - found.states[:, None]
    spread = np.einsum("ji,jia,jib->jab", found.probabilities, apart, apart)
    within = np.einsum("ji,jiab->jab", found.probabilities, own)
    plants.close(found.covariance(W, P0), within + spread, 1e-12)


def test_a_mode_that_is_held_has_its_own_noise():
    found = served(dt.AveragedPredictor(OWN, K, [0.2, 0.3, 0.5]))[0].prediction
    own = found.covariance_by_mode(EACH)
    for mode, A in enumerate(OWN.A):
        for j, tau in enumerate(OWN.delays[mode]):
            plants.close(own[j, mode], added(A, EACH[mode], tau), 1e-9)
    found = served(dt.MeanPredictor(GENERIC, plants.mean_gain(GENERIC)))[0].prediction
    plants.close(found.covariance(EACH), found.covariance(EACH.mean(axis=0)), 1e-12)
    found = served(dt.SingleModePredictor(GENERIC, K, 1))[0].prediction
    plants.close(found.covariance(EACH)[0], added(GENERIC.A[1], EACH[1], 0.234), 1e-9)
    with pytest.raises(dt.ArgumentError, match="disturbance must have shape"):
        found.covariance(EACH[:2])


def test_a_single_mode_without_noise_is_certain():
    found = served(dt.SingleModePredictor(GENERIC, K, 1))[0].prediction
    assert not found.covariance().any()


def test_a_dwell_is_spread_in_its_mode_and_then_in_each():
    law, dwell = dt.AveragedPredictor(GENERIC, K, None, 0.3634), 0.3634
    controller, _ = served(law, samples=8)
    rest = dwell - controller._age * STEP
    assert 0.0 < rest < 0.234
    mode = controller._mode
    for given in (W, EACH):
        each = np.broadcast_to(given, EACH.shape)
        own = controller.prediction.covariance_by_mode(given, P0)
        now = carried(GENERIC.A[mode], P0, rest) + added(GENERIC.A[mode], each[mode], rest)
        for i, A in enumerate(GENERIC.A):
            after = carried(A, now, 0.234 - rest) + added(A, each[i], 0.234 - rest)
            plants.close(own[0, i], after, 1e-9)


def test_a_fictitious_mean_mode_has_the_spread_of_that_mode_alone():
    found = served(dt.MeanPredictor(GENERIC, plants.mean_gain(GENERIC)))[0].prediction
    A = GENERIC.A.mean(axis=0)
    plants.close(found.covariance(W)[0], added(A, W, 0.234), 1e-9)


@pytest.mark.parametrize("given", [W, EACH], ids=["one noise", "of every mode"])
def test_rates_spread_as_the_second_moments_of_all_modes_together(given):
    """The raw moments E[x xᵀ 1{σ = i}], by another integrator."""
    controller, x = served(dt.ExpectedPredictor(GENERIC, K, MARKOV))
    mode, past, rates = 2, past_of(controller.law), MARKOV.generator
    assert controller._mode == mode

    def rate(_, flat, u):
        p, X, S = flat[:3], flat[3:12].reshape(3, 3), flat[12:].reshape(3, 3, 3)
        dX, dS = rates.T @ X, np.tensordot(rates.T, S, 1)
        for i, (A, B) in enumerate(zip(GENERIC.A, GENERIC.B, strict=True)):
            dX[i] += A @ X[i] + B @ u * p[i]
            moved = A @ S[i] + np.outer(B @ u, X[i])
            dS[i] += moved + moved.T + np.broadcast_to(given, EACH.shape)[i] * p[i]
        return np.concatenate((rates.T @ p, dX.ravel(), dS.ravel()))

    p, X, S = np.eye(3)[mode], np.zeros((3, 3)), np.zeros((3, 3, 3))
    X[mode], S[mode] = x, np.outer(x, x) + P0
    flat = np.concatenate((p, X.ravel(), S.ravel()))
    for length, lag in STRETCHES:
        options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-12, "args": (past[lag - 1],)}
        flat = solve_ivp(rate, (0.0, length), flat, **options).y[:, -1]
    p, X, S = flat[:3], flat[3:12].reshape(3, 3), flat[12:].reshape(3, 3, 3)
    found, whole = controller.prediction, X.sum(axis=0)
    plants.close(found.covariance(given, P0)[0], S.sum(axis=0) - np.outer(whole, whole), 1e-8)
    for i in range(3):
        own = S[i] / p[i] - np.outer(X[i], X[i]) / p[i] ** 2
        plants.close(found.covariance_by_mode(given, P0)[0, i], own, 1e-8)


@pytest.mark.parametrize("given", [W, EACH], ids=["one noise", "of every mode"])
def test_sojourns_spread_as_all_paths_of_modes_do(given):
    controller, x = served(dt.ExpectedPredictor(GENERIC, K, SEMI), samples=7)
    mode, age, past = controller._mode, controller._age, past_of(controller.law, 7)
    hazard = SEMI.hazard(STEP, 20)
    paths = [(1.0, (mode,), age)]
    for _ in range(2):
        grown = []
        for p, modes, age in paths:
            ends = hazard[modes[-1], age]
            grown.append((p * (1.0 - ends), (*modes, modes[-1]), age + 1))
            others = [j for j in range(3) if j != modes[-1]]
            grown += [(p * ends / 2, (*modes, j), 0) for j in others]
        paths = grown
    pieces = ((0.034, 3, 0), (0.066, 2, 0), (0.034, 2, 1), (0.066, 1, 1), (0.034, 1, 2))
    ends = []
    for p, modes, _ in paths:
        mean, C = x, P0
        for length, lag, place in pieces:
            A, B = GENERIC.A[modes[place]], GENERIC.B[modes[place]]
            Phi, Gamma = plants.held(A, B, length)
            noise = np.broadcast_to(given, EACH.shape)[modes[place]]
            mean, C = (
                Phi @ mean + Gamma @ past[lag - 1],
                carried(A, C, length) + added(A, noise, length),
            )
        ends.append((p, modes[-1], mean, C))
    found = controller.prediction
    weights = np.array([end[0] for end in ends])
    assert 0.0 < weights[0] < 1.0
    means, C = np.array([end[2] for end in ends]), np.array([end[3] for end in ends])
    apart = means - weights @ means
    whole = np.tensordot(weights, C, 1) + (weights[:, None] * apart).T @ apart
    plants.close(found.covariance(given, P0)[1], whole, 1e-8)
    plants.close(found.states[1], weights @ means, 1e-12)


def test_many_runs_scatter_as_the_covariance_says():
    """Exact paths of a Markov chain and of the noise, drawn by NumPy and SciPy alone."""
    plant, runs = plants.paper(0.4), 4000
    law = dt.ExpectedPredictor(plant, plants.gains(plant), dt.Markov([[0.0, 3.0], [4.0, 0.0]]))
    controller = dt.Controller(law, 0.2)
    for x, u in (([1.0, 0.0], 0.0), ([0.5, -1.0], 2.0), ([1.0, -0.5], -3.0)):
        controller.update(x, 0, [u])
    x, W = np.array([1.0, -0.5]), np.diag([0.02, 0.05])
    rng, ends = np.random.default_rng(1), np.empty((runs, 2))
    root = {}
    for run in range(runs):
        state, mode, left = x, 0, rng.exponential(1.0 / 3.0)
        for u in (2.0, -3.0):
            rest = 0.2
            while rest > 0.0:
                tau = min(left, rest)
                Phi, Gamma = plants.held(plant.A[mode], plant.B[mode], tau)
                if tau == 0.2 and mode in root:
                    L = root[mode]
                else:
                    J = np.block([[-plant.A[mode], W], [np.zeros((2, 2)), plant.A[mode].T]])
                    L = np.linalg.cholesky(Phi @ expm(J * tau)[:2, 2:])
                    if tau == 0.2:
                        root[mode] = L
                state = Phi @ state + Gamma[:, 0] * u + L @ rng.normal(size=2)
                rest, left = rest - tau, left - tau
                if left <= 0.0:
                    mode, left = 1 - mode, rng.exponential(0.25 if mode == 0 else 1.0 / 3.0)
        ends[run] = state
    found = controller.prediction
    C = found.covariance(W)[0]
    white = np.linalg.solve(np.linalg.cholesky(C), (ends - found.states[0]).T)
    assert np.abs(white.mean(axis=1)).max() < 4.0 / np.sqrt(runs)
    assert np.abs(white @ white.T / runs - np.eye(2)).max() < 6.0 / np.sqrt(runs)


def test_a_belief_spreads_by_what_each_mode_now_would():
    law = belief_laws.LAWS["mode"]()
    plain = dt.SwitchedSystem(GENERIC.A, GENERIC.B, 0.17)
    inner = dt.ExpectedPredictor(plain, K, MARKOV)
    law = belief_laws.on_belief(inner, MARKOV, plain, STEP)
    controller, x = served(law)
    own = [dt.Controller(inner, STEP) for _ in range(3)]
    rng = np.random.default_rng(0)
    for k in range(9):
        x, applied = rng.normal(size=3), rng.normal(size=2)
        for mode, each in enumerate(own):
            each.update(x, mode, applied if k else None)
    states = np.array([each.prediction.states[0] for each in own])
    spreads = np.array([each.prediction.covariance(0.02)[0] for each in own])
    apart = states - controller.belief @ states
    whole = np.tensordot(controller.belief, spreads, 1)
    whole += (controller.belief[:, None] * apart).T @ apart
    # The filter's own disturbance is the one that counts where none is given.
    plants.close(controller.prediction.covariance()[0], whole, 1e-10)
    plants.close(controller.prediction.states[0], controller.belief @ states, 1e-12)


def test_a_bank_brings_the_covariance_of_every_mode():
    plain = dt.SwitchedSystem(GENERIC.A, GENERIC.B, 0.17)
    given = {"covariance": 0.1, "disturbance": 0.02, "noise": 0.01}
    filt = dt.OutputModeFilter(plain, MARKOV, STEP, belief_laws.OUTPUTS, **given)
    law = dt.BeliefPredictor(dt.ExpectedPredictor(plain, K, dt.Markov(np.zeros((3, 3)))), filt)
    controller, _ = served(law)
    found = controller.prediction
    x, P = controller.mode_belief.running.x, controller.mode_belief.running.P
    for mode, A in enumerate(plain.A):  # which stays: the law believes in no switches
        want = carried(A, P[mode], 0.17) + added(A, 0.02 * np.eye(3), 0.17)
        plants.close(found.covariance_by_mode()[0, mode], want, 1e-9)
    assert np.allclose(found.probabilities[0], controller.belief, rtol=1e-12)
    assert x.shape == (3, 3)
    with pytest.raises(dt.ArgumentError, match="estimate must be left out"):
        found.covariance(0.0, 1.0)


def test_a_kalman_filter_says_how_sure_the_estimate_is():
    plant = plants.paper(0.25)
    law = dt.SingleModePredictor(plant, plants.gains(plant), 1)
    observer = dt.kalman(plant, [[1.0, 0.0]], 0.1 * np.eye(2), [[0.01]], step=STEP)
    controller = dt.Controller(dt.OutputFeedback(law, observer), STEP)
    for y in (1.0, 0.9, 1.1):
        controller.update([y], 0)
    A = plant.A[1]
    want = carried(A, observer.covariance[0], 0.25) + added(A, 0.1 * np.eye(2), 0.25)
    plants.close(controller.prediction.covariance(0.1)[0], want, 1e-9)


def test_what_has_no_covariance_is_refused():
    plant = plants.paper(0.25)
    law = dt.AveragedPredictor(plant, plants.gains(plant))
    observer = dt.luenberger(plant, [[1.0, 0.0]], [-4.0, -5.0], step=STEP)
    controller = dt.Controller(dt.OutputFeedback(law, observer), STEP)
    controller.update([1.0], 0)
    with pytest.raises(dt.ArgumentError, match="estimate must be given, the covariance of the"):
        controller.prediction.covariance(0.1)
    assert controller.prediction.covariance(0.1, 0.0).shape == (1, 2, 2)
    for inner in (dt.ExpectedPredictor(OWN, K, MARKOV), dt.ExpectedPredictor(OWN, K, SEMI)):
        with pytest.raises(dt.ArgumentError, match="one delay for a prediction's covariance"):
            served(inner)[0].prediction.covariance(0.1)
    with pytest.raises(dt.ArgumentError, match="disturbance must be positive semidefinite"):
        served(dt.AveragedPredictor(GENERIC, K))[0].prediction.covariance(-1.0)


def test_a_small_spread_about_a_large_state_keeps_its_digits():
    """Of 1e6 with a deviation of 1e-6, a difference of raw moments would leave nothing."""
    model = dt.Markov(1e-9 * (np.ones((2, 2)) - np.eye(2)))
    plant = plants.scalar([-1.0, -1.0 - 1e-9], delay=0.3)
    law = dt.ExpectedPredictor(plant, [[[-0.5]], [[-0.5]]], model)
    controller = dt.Controller(law, STEP)
    controller.update([1e6], 0)
    want = 1e-12 * (1.0 - np.exp(-0.6)) / 2.0
    assert controller.prediction.covariance(1e-12)[0, 0, 0] == pytest.approx(want, rel=1e-3)


def test_sure_sojourns_leave_nothing_to_chance():
    law = dt.ExpectedPredictor(GENERIC, K, dt.SemiMarkov(stats.uniform(4.0, 1.0), modes=3))
    assert np.abs(served(law, samples=4)[0].prediction.covariance()).max() < 1e-25
