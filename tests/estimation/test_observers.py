"""Observers: poles put back, Riccati equations put back, and errors that follow them."""

import re
from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

import deadtime as dt
import plants
import reference
from deadtime.loop.running_observer import RunningObserver
from deadtime.plant import SampledPlant

PLANT, C, STEP = plants.generic(), plants.OUTPUTS, 0.1
PER_MODE = np.stack([C, 1.1 * C, C[::-1]])
W, R = np.diag([1.0, 0.2, 0.5]), np.array([[0.04, 0.01], [0.01, 0.09]])


def error_matrices(observer):
    """Φ (I − L C) from SciPy's exponential."""
    plant = observer.plant
    return [
        plants.held(A, B, observer.step)[0] @ (np.eye(plant.states) - L @ Ci)
        for A, B, L, Ci in zip(plant.A, plant.B, observer.gain, observer.C, strict=True)
    ]


@pytest.mark.parametrize("step", [0.01, 0.1, 1.0])
@pytest.mark.parametrize("outputs", [C, C[:1], PER_MODE], ids=["two", "one", "per mode"])
@pytest.mark.parametrize("poles", [[-3, -4, -5], [-2 + 1j, -2 - 1j, -3]])
def test_the_error_of_every_mode_has_the_poles(poles, outputs, step):
    observer = dt.luenberger(PLANT, outputs, poles, step)
    for E, mine in zip(error_matrices(observer), observer.error_matrices, strict=True):
        plants.close(mine, E, 1e-12)
        plants.close(np.poly(E), np.poly(np.exp(np.array(poles) * step)), 1e-9)
    np.testing.assert_allclose(observer.rates, max(np.real(poles)), rtol=1e-6)


def test_every_mode_may_have_its_own_poles():
    observer = dt.luenberger(PLANT, C, [[-1, -2, -3], [-2, -3, -4], [-3, -4, -5]], STEP)
    np.testing.assert_allclose(observer.rates, [-1.0, -2.0, -3.0], rtol=1e-9)


def run_estimator(observer, plant, modes, x0, estimate, inputs, history, outputs=None):
    """x, x̂ at the samples along given inputs; the truth by Taylor series on exact instants."""
    outputs = observer.C if outputs is None else outputs
    step, delay = Fraction(str(observer.step)), Fraction(str(plant.delay))
    model = reference.Model(plant.A.astype(reference.LONG), plant.B, delay)
    zero = np.zeros((plant.modes, plant.inputs, plant.states))
    law = dt.DelayedStateFeedback(observer.plant, zero, allow_unstable=True)
    law = dt.OutputFeedback(law, observer, estimate=estimate)
    estimator = RunningObserver(law.memory(observer.step))
    estimator.begin(history)

    def held(j):
        return inputs[j] if j >= 0 else history[j]

    x, states, estimates = np.array(x0, reference.LONG), [], []
    for k, mode in enumerate(modes):
        y = outputs[mode] @ x.astype(float)
        estimates.append(estimator.update(held(k - 1), y, mode).copy())
        states.append(x.astype(float))
        t = k * step
        x = reference.run_model(model, lambda _, i=mode: i, [], held, step, x, t, t + step)
    return np.array(states), np.array(estimates)


@pytest.mark.parametrize("delay", [0.234, 0.3, 0.05])
def test_the_error_is_the_product_of_the_matrices_whatever_the_inputs(delay):
    """Switches on samples, three modes, an input in two parts, against Taylor series."""
    plant = plants.generic(delay)
    observer = dt.luenberger(plant, PER_MODE, [-3, -4, -5], STEP)
    rng, N = np.random.default_rng(1), SampledPlant(observer.plant, observer.step).longest_lag
    inputs, history = rng.normal(size=(40, 2)), rng.normal(size=(N, 2))
    modes, x0 = rng.integers(0, 3, 40).tolist(), np.array([1.0, -2.0, 0.5])
    states, estimates = run_estimator(observer, plant, modes, x0, np.zeros(3), inputs, history)
    E, before = error_matrices(observer), x0
    for k, mode in enumerate(modes):
        after = before - observer.gain[mode] @ observer.C[mode] @ before
        assert np.abs(states[k] - estimates[k] - after).max() <= 1e-12 * np.abs(states[k]).max()
        before = E[mode] @ before
    right = run_estimator(observer, plant, modes, x0, x0, inputs, history)
    plants.close(right[1], right[0], 1e-13)


def test_without_measurements_it_runs_open_loop():
    plant = plants.near()
    observer = dt.luenberger(plant, C, [-3, -4, -5], STEP)
    inputs = np.random.default_rng(0).normal(size=(20, 2))
    modes = [1] * 20
    nothing = np.full((3, 2, 3), np.nan)
    _, blind = run_estimator(
        observer, plant, modes, np.zeros(3), [1.0, 2.0, 3.0], inputs, np.zeros((3, 2)), nothing
    )
    other, _ = run_estimator(
        observer, plant, modes, [1.0, 2.0, 3.0], np.zeros(3), inputs, np.zeros((3, 2))
    )
    plants.close(blind, other, 1e-13)


def test_the_kalman_filter_solves_its_riccati_equation():
    observer = dt.kalman(PLANT, PER_MODE, W, R, STEP)
    for i, A in enumerate(PLANT.A):
        Phi, Ci, P = plants.held(A, PLANT.B[i], STEP)[0], PER_MODE[i], observer.prior[i]
        Q = plants.gramian_by_quadrature(A, W, STEP)
        L = P @ Ci.T @ np.linalg.inv(Ci @ P @ Ci.T + R)
        plants.close(observer.gain[i], L, 1e-10)
        after = P - L @ Ci @ P
        plants.close(observer.covariance[i], after, 1e-10)
        plants.close(Phi @ after @ Phi.T + Q, P, 1e-10)


def doubled(Phi, C, Q, R):
    """The steady covariance by the doubling algorithm, which has no eigenvalues to sort."""
    A, G, H = Phi.T, C.T @ np.linalg.solve(R, C), Q
    for _ in range(40):
        inner = np.linalg.inv(np.eye(len(A)) + G @ H)
        A, G, H = A @ inner @ A, G + A @ inner @ G @ A.T, H + A.T @ H @ inner @ A
    return H


TANKS = dt.SwitchedSystem([[[0.0, 1.0], [-0.125, -0.75]]], [[[0.0], [0.075]]], 1.1)
CART = dt.SwitchedSystem([[[0.0, 1.0], [0.0, -0.5]]], [[[0.0], [1.0]]], 0.73)
CHAIN = dt.SwitchedSystem([np.diag([1.0, 2.0], 1) - 0.01 * np.eye(3)], [np.eye(3)[:, 2:]], 0.5)


@pytest.mark.parametrize("ratio", [1e-14, 1e-8, 1.0, 1e6])
@pytest.mark.parametrize("units", [(1.0, 1.0, 1.0), (1e5, 1e-3, 1.0), (1e-6, 1.0, 1e4)])
@pytest.mark.parametrize("plant", [TANKS, CART, CHAIN], ids=["tanks", "cart", "chain"])
def test_neither_units_nor_small_noises_keep_a_kalman_filter_from_its_gain(plant, units, ratio):
    n, unit, noise = plant.states, np.array(units[: plant.states]), 1e-4
    process = ratio * noise * np.diag([1.0, 0.01, 0.3][:n])
    outputs = np.eye(n)[:1]
    found = dt.kalman(
        dt.SwitchedSystem(plant.A / unit[:, None] * unit, plant.B / unit[:, None], plant.delay),
        outputs * unit,
        process / np.outer(unit, unit),
        [[noise]],
        STEP,
    )
    Phi = plants.held(plant.A[0], plant.B[0], STEP)[0]
    Q = plants.gramian_by_quadrature(plant.A[0], process, STEP)
    P = doubled(Phi, outputs, Q, np.array([[noise]]))
    deviations = np.sqrt(np.diag(P))
    wrong = found.prior[0] * np.outer(unit, unit) - P
    assert np.abs(wrong / np.outer(deviations, deviations)).max() < 1e-7
    assert found.rates[0] < 0.0


def test_covariances_of_a_kalman_filter_are_numbers_diagonals_or_matrices():
    whole = dt.kalman(PLANT, C, 0.2 * np.eye(3), 0.01 * np.eye(2), STEP)
    for process, measurement in ((0.2, 0.01), ([0.2] * 3, [0.01] * 2)):
        short = dt.kalman(PLANT, C, process, measurement, STEP)
        np.testing.assert_array_equal(short.gain, whole.gain)
    with pytest.raises(dt.ArgumentError, match="measurement must be positive definite, got 0"):
        dt.kalman(PLANT, C, 1.0, 0.0, STEP)


def test_a_filter_may_serve_a_plant_that_nothing_disturbs_and_that_decays():
    observer = dt.kalman(TANKS, [[1.0, 0.0]], np.zeros((2, 2)), [[1.0]], STEP)
    assert not observer.gain.any()
    assert observer.rates[0] == pytest.approx(-0.25, abs=1e-9)


def steady_covariance(observer, i, gain):
    """Of x − x̂ under any gain, by a Lyapunov equation."""
    A = observer.plant.A[i]
    rest = np.eye(3) - gain @ observer.C[i]
    Q = plants.gramian_by_quadrature(A, W, STEP)
    F = rest @ plants.held(A, observer.plant.B[i], STEP)[0]
    return solve_discrete_lyapunov(F, rest @ Q @ rest.T + gain @ R @ gain.T)


def test_no_other_gain_has_a_smaller_covariance_in_a_mode_that_lasts():
    observer, rng = dt.kalman(PLANT, C, W, R, STEP), np.random.default_rng(3)
    for i in range(3):
        best = steady_covariance(observer, i, observer.gain[i])
        plants.close(best, observer.covariance[i], 1e-9)
        for _ in range(10):
            other = steady_covariance(
                observer, i, observer.gain[i] + 0.02 * rng.normal(size=(3, 2))
            )
            assert np.linalg.eigvalsh(other - best)[0] >= -1e-12
            assert np.trace(other) > np.trace(best)


@pytest.mark.long
def test_the_steady_covariance_is_the_riccati_one_within_monte_carlo_error():
    """Errors of exact noisy runs, thinned until they forget each other; bounds at 5 sigma."""
    plant = plants.near()
    observer = dt.kalman(plant, C, W, R, STEP)
    law = dt.SingleModePredictor(plant, plants.gains(plant), 2)
    mode, every = 2, 1 + int(3.5 / (-observer.rates[2] * STEP))
    kinds = [dt.imperfections.WhiteDisturbance(W), _correlated(R)]
    run = dt.simulate(
        plant, dt.OutputFeedback(law, observer), dt.SwitchingSignal.constant(mode),
        np.zeros(3), 4000.0, STEP, imperfections=kinds, seed=11,
    )  # fmt: skip
    errors = (run.states - run.estimates)[:, 200::every].T
    count = len(errors)
    assert count > 1500
    root = np.linalg.inv(np.linalg.cholesky(observer.covariance[mode]))
    white = errors @ root.T
    found = white.T @ white / count
    bound = 5.0 * np.sqrt((1.0 + np.eye(3)) / count)
    assert (np.abs(found - np.eye(3)) <= bound).all()
    assert (np.abs(white.mean(axis=0)) <= 5.0 / np.sqrt(count)).all()
    # The bound is narrow enough to tell the covariance before a correction from the one after it.
    prior = root @ observer.prior[mode] @ root.T
    assert (np.abs(prior - np.eye(3)) > bound).any()


def _correlated(covariance):
    """Measurement noise with a covariance, as an imperfection."""
    root = np.linalg.cholesky(covariance)

    class Correlated(dt.imperfections.SensorImperfection):
        kind = 101

        def sensor(self, sizes, rng):
            assert sizes.states == len(root)
            return lambda seen: seen._replace(x=seen.x + root @ rng.standard_normal(len(root)))

    return Correlated()


HIDDEN = dt.SwitchedSystem([np.eye(2), [[1.0, 0.0], [0.0, 2.0]]], [[[1.0], [1.0]]] * 2, 0.3)
DECAYS = dt.SwitchedSystem([[[-1.0, 0.0], [0.0, 0.5]]], [[[1.0], [1.0]]], 0.3)
PENDULUM = dt.SwitchedSystem([[[0.0, 1.0], [-1.0, 0.0]]], [[[0.0], [1.0]]], 0.3)


def test_a_hidden_state_that_decays_is_no_obstacle_to_a_kalman_filter():
    observer = dt.kalman(DECAYS, [[0.0, 1.0]], np.eye(2), [[1.0]], STEP)
    assert observer.rates[0] == pytest.approx(-1.0, abs=1e-9) or observer.rates[0] > -1.0
    assert observer.rates[0] < 0.0
    with pytest.raises(dt.ArgumentError, match=r"mode 0 is not observable: rank \[C; CA\] = 1 < 2"):
        dt.luenberger(DECAYS, [[0.0, 1.0]], [-1, -2], STEP)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: dt.luenberger(HIDDEN, [[1.0, 0.0]], [-1, -2], STEP),
            "mode 0 is not observable: rank [C; CA] = 1 < 2: no gain can move all poles",
        ),
        (
            lambda: dt.kalman(HIDDEN, [[1.0, 0.0]], np.eye(2), [[1.0]], STEP),
            "mode 0 is not observable: rank [C; CA] = 1 < 2, and what C does not see (eigenvalue 1",
        ),
        (
            lambda: dt.luenberger(PENDULUM, [[1.0, 0.0]], [-1, -2], np.pi),
            "mode 0 is not observable when sampled every 3.14159 s",
        ),
        (
            lambda: dt.luenberger(PLANT, C[:1], [-1, -1, -2], STEP),
            "-1+0j is repeated 2 times, but only rank C = 1",
        ),
        (lambda: dt.luenberger(PLANT, C, [-1, -2, 0.5], STEP), "poles must have negative real"),
        (lambda: dt.luenberger(PLANT, C, [-1, -2], STEP), "poles must have shape (n,) = (3,)"),
        (
            lambda: dt.luenberger(PLANT, C, [-1, -1 + 40j, -1 - 40j], STEP),
            "oscillates faster than a period of 0.1 s shows",
        ),
        (lambda: dt.luenberger(PLANT, C, [-1, -2, -3], 0.0), "step must be positive"),
        (lambda: dt.luenberger(PLANT, [1.0, 0.0, 0.0], [-1], STEP), "C must have shape (p, n)"),
        (
            lambda: dt.luenberger(PLANT, C.T, [-1, -2, -3], STEP),
            "C must have n = 3 columns, shape (p, n) or (modes, p, n), got (3, 2).",
        ),
        (
            lambda: dt.luenberger(PLANT, PER_MODE[:2], [-1, -2, -3], STEP),
            "C must have shape (modes, p, n) = (3, 2, 3), got (2, 2, 3)",
        ),
        (
            lambda: dt.kalman(PLANT, C, W, np.zeros((2, 2)), STEP),
            "measurement must be positive",
        ),
        (lambda: dt.kalman(PLANT, C, W, np.ones((2, 2)), STEP), "measurement must be positive"),
        (lambda: dt.kalman(PLANT, C, W, np.eye(3), STEP), "measurement must have shape (p, p)"),
        (
            lambda: dt.kalman(PLANT, C, np.eye(2), R, STEP),
            "process must have shape (n, n)",
        ),
        (lambda: dt.kalman(PLANT, C, -W, R, STEP), "process must be positive semidefinite"),
        (
            lambda: dt.kalman(plants.resting(), C, np.zeros((3, 3)), R, STEP),
            "mode 0 has no stabilising Kalman gain: `process` must reach every state",
        ),
        (
            lambda: dt.Observer(PLANT, C, np.zeros((3, 2)), STEP),
            "] leaves the estimation error of mode",
        ),
        (
            lambda: dt.Observer(PLANT, C, np.zeros((2, 3)), STEP),
            "gain must have shape (n, p) = (3, 2), got (2, 3): pass the transpose",
        ),
        (lambda: dt.Observer(PLANT, [[1.0], [1.0, 2.0]], [[1.0]], STEP), "C must hold real"),
        (
            lambda: dt.luenberger(plants.paper(), [[1.0, 0.0]], [-1, -2], 1e4),
            "step = 10000 s is too",
        ),
        (
            lambda: dt.Observer(PLANT, C, np.full((3, 2), np.nan), STEP),
            "gain[0, 0] must be finite",
        ),
    ],
)
def test_what_cannot_be_observed_is_refused_by_name(call, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        call()


def test_an_unstable_observer_may_be_asked_for():
    observer = dt.Observer(PLANT, C, np.zeros((3, 2)), STEP, allow_unstable=True)
    assert observer.rates.max() > 0.0
    assert repr(observer) == "Observer(modes=3, states=3, outputs=2, step=0.1)"
