"""Observers of saved files keep up with the loop, also where a log tells no disturbance."""

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm, solve_continuous_are

import deadtime as dt
from deadtime.identification.problem_text import filter_noise
from deadtime.problems import load_problem

H, DELAY = 0.1, 0.73
CART = np.array([[0.0, 1.0], [0.0, -0.5]]), np.array([[0.0], [1.0]])
SLIDE = np.array([[0.0, 1.0], [0.0, -0.05]]), np.array([[0.0], [10.0]])
SWING = np.array([[0.0, 1.0], [-0.04, -0.1]]), np.array([[0.0], [0.3]])
C = np.array([[1.0, 0.0]])


def held(A, B, length):
    """Φ and Γ of a held input, from SciPy's exponential."""
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[:2, 2:] = A, B
    E = expm(length * whole)
    return E[:2, :2], E[:2, 2:]


def period(A, B, delay, x, older, newer):
    """x a period on, the input changing from older to newer in between."""
    before = delay - np.floor(delay / H) * H
    for length, u in ((before, older), (H - before, newer)):
        Phi, Gamma = held(A, B, length)
        x = Phi @ x + Gamma @ u
    return x


def earlier(inputs, back):
    return inputs[-back] if back <= len(inputs) else np.zeros(1)


def log_of(plant, samples=400):
    """Of a plant that nothing disturbs, and a sensor that is noisy."""
    A, B = plant
    rng, x, ys = np.random.default_rng(1), np.zeros(2), []
    t = H * np.arange(samples)
    u = np.select([t < 2, t < 8, t < 16, t < 25], [0.0, 1.0, -1.0, 0.7], 0.0)[:, None]
    for k in range(samples):
        ys.append(x[0] + 0.01 * B[1, 0] * rng.standard_normal())
        x = period(A, B, DELAY, x, earlier(u[:k], 8), earlier(u[:k], 7))
    return pd.DataFrame({"t": t, "y1": ys, "u1": u[:, 0]})


def run_on_the_plant(plant, problem, start, length):
    """|x| of the true plant under the file's gains, its observer, and a predictor of its model."""
    model, gain = problem.plant, problem.laws["averaged"].observer.gain[0]
    A, B, D = model.A[0], model.B[0], float(model.delay)
    K = -B.T @ solve_continuous_are(A, B, np.eye(2), np.eye(1))
    back, x, prior, inputs, norm = int(D / H), np.array(start), np.zeros(2), [], []
    for _ in range(int(length / H)):
        estimate = prior + gain @ (C @ x - C @ prior)
        ahead = held(A, B, D - back * H)
        ahead = ahead[0] @ estimate + ahead[1] @ earlier(inputs, back + 1)
        Phi, Gamma = held(A, B, H)
        for j in range(back, 0, -1):
            ahead = Phi @ ahead + Gamma @ earlier(inputs, j)
        inputs.append(K @ ahead)
        norm.append(np.linalg.norm(x))
        x = period(*plant, DELAY, x, earlier(inputs, 9), earlier(inputs, 8))
        prior = period(A, B, D, estimate, earlier(inputs, back + 2), earlier(inputs, back + 1))
    return np.array(norm)


@pytest.mark.parametrize("plant", [CART, SLIDE, SWING], ids=["cart", "slide", "swing"])
def test_a_loop_with_the_saved_observer_settles_at_its_pace_on_the_true_plant(plant, tmp_path):
    fit = dt.identify(log_of(plant), modes=None, delay=(0.0, 2.0), order=2, zeros=False)
    assert fit.interval("disturbance[0][1,1]")[0] == 0.0
    fit.save(tmp_path / "plant.toml")
    text, problem = (
        (tmp_path / "plant.toml").read_text("utf-8"),
        load_problem(tmp_path / "plant.toml"),
    )
    observer, (A, B) = problem.laws["averaged"].observer, plant
    K = -B.T @ solve_continuous_are(A, B, np.eye(2), np.eye(1))
    pace = -np.linalg.eigvals(A + B @ K).real.max()
    assert -observer.rates[0] > 0.98 * pace
    (said,) = [one for one in fit.sentences if "cannot show whether there is process noise" in one]
    assert f"# {said}\nprocess = " in text
    start = np.array([5.0, 0.0]) * B[1, 0]
    norm = run_on_the_plant(plant, problem, start, 30.0)
    settled = DELAY + 8.0 / pace
    assert norm[int(settled / H) :].max() < 0.05 * norm[0]


def test_the_intensity_is_the_least_of_factors_of_4_above_its_interval():
    fit = dt.identify(log_of(CART), modes=None, delay=(0.0, 2.0), order=2, zeros=False)
    W, why = filter_noise(fit)
    factors = np.log2(W[1, 1] / fit.interval("disturbance[0][1,1]")[1]) / 2.0
    assert why
    assert factors == pytest.approx(round(factors), abs=1e-9)
    slower = np.diag([W[0, 0], W[1, 1] / 4.0])
    sensor = np.diag(fit.noise**2)
    rates = [dt.kalman(fit.plant, fit.C, V, sensor, fit.step).rates[0] for V in (slower, W)]
    loop = fit.plant.A[0] + fit.plant.B[0] @ dt.lqr(fit.plant, np.eye(2), [[1.0]])[0]
    assert rates[1] <= np.linalg.eigvals(loop).real.max() < rates[0]


@pytest.mark.parametrize("unit", [1000.0, 0.01])
def test_units_in_which_the_gains_do_not_suit_the_period_leave_the_observer_fast(unit):
    """In mm the gains of least ∫|x|² + |u|² are too fast for the period; the observer is not."""
    plant = CART[0], unit * CART[1]
    fit = dt.identify(log_of(plant), modes=None, delay=(0.0, 2.0), order=2, zeros=False)
    W, why = filter_noise(fit)
    loop = fit.plant.A[0] + fit.plant.B[0] @ dt.lqr(fit.plant, np.eye(2), [[1.0]])[0]
    rate = dt.kalman(fit.plant, fit.C, W, np.diag(fit.noise**2), fit.step).rates[0]
    assert why
    assert rate <= np.linalg.eigvals(loop).real.max() < -1e-3


def test_a_disturbance_that_the_log_tells_is_what_the_observer_is_designed_on():
    A, B = CART
    rng, x, ys = np.random.default_rng(2), np.zeros(2), []
    u = np.sign(np.sin(0.11 * np.arange(400.0) ** 1.1))[:, None]
    for k in range(400):
        ys.append(x[0] + 0.01 * rng.standard_normal())
        pushed = np.array([0.0, 0.1 * rng.standard_normal()])
        x = period(A, B, DELAY, x, earlier(u[:k], 8), earlier(u[:k], 7)) + pushed
    log = pd.DataFrame({"t": H * np.arange(400), "y1": ys, "u1": u[:, 0]})
    fit = dt.identify(log, modes=None, delay=(0.0, 2.0), order=2, zeros=False)
    assert fit.interval("disturbance[0][1,1]")[0] > 0.0
    W, why = filter_noise(fit)
    assert why == ""
    assert (fit.disturbance[0] == W).all()
