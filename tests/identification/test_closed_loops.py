"""Loops that only regulate, with noisy sensors: what their logs tell, and what they do not."""

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import solve_discrete_lyapunov

import deadtime as dt
from deadtime.identification.identifiability import fed_back
from deadtime.identification.log.read_recording import read_recording
from synthetic_logs import Plant

H = 0.05
LAG = Plant([[[-1.0]]], [[[1.0]]], 0.3091, 5e-3 * np.eye(1))
CART = Plant([[[0.0, 1.0], [-2.0, -1.0]]], [[[0.0], [1.0]]], 0.1613, 4e-3 * np.eye(2))


def p(k):
    return lambda y, u: k * y[-1, 0]


def pi(k, k_i):
    """From differences, as drives compute it."""
    return lambda y, u: u[-1] + k * (y[-1, 0] - y[-2, 0]) + k_i * H * y[-1, 0]


def pd_of_states(*k):
    return lambda y, u: float(np.dot(k, y[-1]))


def pd_of_differences(k, k_d):
    return lambda y, u: k * y[-1, 0] + k_d / H * (y[-1, 0] - y[-2, 0])


def late(k):
    """A controller that answers a period later."""
    return lambda y, u: k * y[-2, 0]


def run(plant, law, added, sensor, seed=0, count=300):
    """A log of a loop, after 100 rows of it."""
    rng, n = np.random.default_rng(seed), plant.A.shape[1]
    total = count + 100
    t, u = H * np.arange(total), np.zeros((total, 1))
    x, y = np.zeros((total, n)), np.zeros((total, n))
    Q = np.linalg.cholesky(plant.covariance(0, H))
    for k in range(total):
        y[k] = x[k] + sensor * rng.standard_normal(n)
        u[k] = law(y[max(k - 1, 0) : k + 1][[0, -1]], u[max(k - 1, 0), :])
        u[k] += added[k - 100] if k >= 100 else 0.0
        if k + 1 < total:
            Phi, moved = plant.period(t, u, np.zeros(total, int), k)
            x[k + 1] = Phi @ x[k] + moved + Q @ rng.standard_normal(n)
    columns = {"t": t[:count]} | {f"x{i + 1}": one[100:] for i, one in enumerate(y.T)}
    return pd.DataFrame(columns | {"u1": u[100:, 0]})


NOTHING = np.zeros(300)
STEPS = np.repeat(np.random.default_rng(5).choice([-0.5, 0.5], 10), 30)
DITHER = 0.25 * np.random.default_rng(6).choice([-1.0, 1.0], 300)
REGULATED = {
    "P": (LAG, p(-1.5), 0.03, 0),
    "PI": (LAG, pi(-1.0, -0.8), 0.03, 1),
    "PD of states": (CART, pd_of_states(-0.8, -0.6), 0.02, 2),
    "PD of differences": (LAG, pd_of_differences(-1.0, -0.1), 0.02, 3),
    "a period late": (LAG, late(-1.2), 0.03, 4),
}


@pytest.mark.parametrize("name", REGULATED)
def test_a_law_that_only_regulates_is_seen_and_others_are_not(name):
    plant, law, sensor, seed = REGULATED[name]
    for added, follows in ((NOTHING, True), (10.0 * STEPS, False), (4.0 * DITHER, False)):
        record = read_recording(run(plant, law, added, sensor, seed), None)
        assert fed_back(record).tolist() == [follows]


def test_inputs_of_no_loop_are_not_taken_for_a_law():
    rng, t = np.random.default_rng(3), H * np.arange(300)
    inputs = {
        "held": np.repeat(rng.choice([-1.0, 1.0], 15), 20),
        "white": rng.standard_normal(300),
        "sine": np.sin(1.3 * t),
        "step": (t > 3.0).astype(float),
    }
    for u in inputs.values():
        y, _ = LAG.log(t, u[:, None], rng, sensor=0.02)
        table = pd.DataFrame({"t": t, "x1": y[:, 0], "u1": u})
        assert fed_back(read_recording(table, None)).tolist() == [False]


def test_without_sensor_noise_a_short_delay_predicts_better_than_the_true_one():
    """By covariances of the loop, from Lyapunov's equation: no log, no code of the package."""
    K, N, Phi, rest = -1.5, 7, np.exp(-H), 7 * H - 0.3091
    new, whole, V = 1.0 - np.exp(-rest), 1.0 - np.exp(-H), 0.03**2
    Q = 5e-3 * (1.0 - np.exp(-2.0 * H)) / 2.0
    size = 11  # x_k, then v_k, then y_{k−1}, …, y_{k−9}
    M, R = np.zeros((size, size)), np.diag([Q, V, *[0.0] * 9])
    M[0, 0], M[0, 1 + N], M[0, N] = Phi, K * (whole - new), K * new
    M[2, :2] = 1.0
    M[3:, 2:-1] = np.eye(8)
    S = solve_discrete_lyapunov(M, R)
    rows = np.eye(size)[1:]  # y_k, y_{k−1}, … as functions of the state
    rows[0] = np.eye(size)[0] + np.eye(size)[1]
    ahead = rows[0] @ M
    left, weight = {}, {}
    for cell in range(2, 9):
        z = rows[[0, cell, cell - 1]]
        G, g = z @ S @ z.T, z @ S @ ahead
        b = np.linalg.solve(G, g)
        left[cell] = ahead @ S @ ahead + R[0, 0] + V - g @ b
        weight[cell] = (b[1] + b[2]) / K
    assert min(left, key=lambda cell: left[cell]) == 2
    assert left[2] < 0.98 * left[N]
    assert weight[2] < 0.0  # where the plant has 0.049, with any delay


@pytest.mark.few(3)
@pytest.mark.parametrize("name", REGULATED)
def test_a_loop_that_only_regulates_has_no_narrow_wrong_answer(name):
    plant, law, sensor, seed = REGULATED[name]
    log = run(plant, law, NOTHING, sensor, seed)
    fit = dt.identify(log, modes=None, delay=(0.0, 0.6))
    low, high = fit.interval("delay")
    assert low <= plant.D.item() <= high
    row = plant.A.shape[1] - 1
    low, high = fit.interval(f"B[0][{row},0]")
    assert low <= 1.0 <= high
    assert "hardly tells the delay" in fit.message
    assert "the log determines A + B K rather than A and B" in fit.message
    assert "the log hardly tells the delay" in fit.doubts


def test_as_if_sensors_were_exact_the_same_log_has_a_wrong_sign():
    plant, law, sensor, seed = REGULATED["P"]
    fit = dt.identify(run(plant, law, NOTHING, sensor, seed), None, (0.0, 0.6), noise=False)
    assert fit.interval("B[0][0,0]")[1] < 0.0


@pytest.mark.few(2)
@pytest.mark.parametrize("added", [STEPS, DITHER], ids=["steps", "dither"])
@pytest.mark.parametrize("name", REGULATED)
def test_a_loop_whose_law_asks_for_something_else_is_answered(name, added):
    plant, law, sensor, seed = REGULATED[name]
    log = run(plant, law, 2.0 * added, sensor, seed)
    fit = dt.identify(log, modes=None, delay=(0.0, 0.6))
    low, high = fit.interval("delay")
    assert low - (high - low) < plant.D.item() < high + (high - low)
    assert high - low < 3.0 * H
    assert "hardly tells" not in fit.message


@pytest.mark.parametrize(
    ("law", "unit"), [(p(-1.5), 100.0), (p(-0.8), 1e3), (pi(-0.5, -0.3), 30.0)]
)
def test_a_loop_about_0_is_answered_in_any_unit(law, unit):
    """Without the level that it does not need a delay lies elsewhere in the vector of unknowns."""
    log = run(LAG, law, NOTHING, 0.02, seed=4)
    log[["x1", "u1"]] *= unit
    fit = dt.identify(log, modes=None, delay=(0.0, 1.0))
    low, high = fit.interval("delay")
    assert low <= fit.delays[0, 0] <= high
    assert low - 0.02 < 0.3091 < high + 0.02
