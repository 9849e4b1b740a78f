"""What an experiment promises of noisy sensors: the information by dense Gaussians, the errors."""

from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import cholesky, expm

import deadtime as dt
from promises import prospect
from synthetic_logs import Plant, oscillator

H, T = 0.05, 40
W2 = 1e-3 * np.array([[1.0, 0.3], [0.3, 2.0]])
A3 = [[[0.0, 1.0], [-2.0, -1.0]], [[0.1, 1.0], [-3.0, -0.5]], [[-1.0, 0.4], [0.2, -2.0]]]
B3 = [[[0.2, 1.0], [1.0, 0.0]], [[0.0, 0.7], [1.3, -0.4]], [[1.0, 0.0], [0.3, 0.8]]]
D3 = [[0.112, 0.16], [0.07, 0.183], [0.135, 0.021]]
TRUE = Plant(A3, B3, D3, W2)
SENSORS = np.array([0.01, 0.03])
MODE = (np.arange(T) // 5) % 3
R = np.random.default_rng(5).choice([-1.0, 1.0], (T, 2))
TIME = H * np.arange(T)
USED = (np.arange(T) >= 8) & (np.arange(T) != 24) & (np.arange(T) < T - 1)  # two stretches
W_ENTRIES = ((0, 0), (0, 1), (1, 1))


def without_noise(F, size):
    """Of the first unknowns, where the others are unknown, too."""
    return F[:size, :size] - F[:size, size:] @ np.linalg.solve(F[size:, size:], F[size:, :size])


def agree(found, F):
    unit = np.sqrt(np.diagonal(F))
    assert np.abs((found - F) / unit / unit[:, None]).max() < 1e-6


def stretch(vector, layout, first, last):
    """Of measurements after `first`: what that one's does to their mean, all else in it; and Σ."""
    size = layout.size
    W: Any = np.zeros((2, 2))
    for value, (a, b) in zip(vector[size : size + 3], W_ENTRIES, strict=True):
        W[a, b] = W[b, a] = value
    A, B, D = layout.split(vector[:size])
    V, plant = np.diag(vector[size + 3 :]), Plant(A, B, D, W)
    over, mean, count = np.eye(2), np.zeros(2), last - first
    P = [V]
    rows, means, blocks = [], [], np.zeros((count, 2, count, 2))
    for k in range(count):
        Phi, added = plant.period(TIME, R, MODE, first + k)
        over, mean = Phi @ over, Phi @ mean + added
        rows.append(over)
        means.append(mean)
        P = [Phi @ one for one in P]  # of x and those before it
        P[0] = P[0] @ Phi.T + plant.covariance(MODE[first + k], H)
        for j in range(k):
            blocks[k, :, k - 1 - j] = P[j + 1]
            blocks[k - 1 - j, :, k] = P[j + 1].T
        blocks[k, :, k] = P[0] + V
        P = [P[0], *P]
    return np.vstack(rows), np.concatenate(means), blocks.reshape(2 * count, -1)


def test_the_information_of_noisy_sensors_is_that_of_dense_gaussians():
    """Two stretches, three modes, two inputs, six delays, by differences; W and V unknown, too."""
    promise = prospect(TRUE, MODE, USED, H, sensors=SENSORS)
    layout = promise.layout
    noise = [*(W2[a, b] for a, b in W_ENTRIES), *SENSORS**2]
    vector = np.concatenate((layout.join(TRUE.A, TRUE.B, TRUE.D), noise))
    small = np.full(vector.size, 1e-5)
    small[layout.size :] = 1e-4 * np.array([1e-3, 1e-3, 1e-3, *SENSORS**2])
    x, P, F = np.zeros(2), np.zeros((2, 2)), np.zeros((vector.size, vector.size))
    for k in range(T):
        if k in (8, 25):
            last = 24 if k == 8 else T - 1
            inverse = np.linalg.inv(stretch(vector, layout, k, last)[2])
            by_mean, by_cov = [], []
            second = np.outer(x, x) + P + np.diag(SENSORS**2)
            for a in range(vector.size):
                step = np.where(np.arange(vector.size) == a, small, 0.0)
                ends = [stretch(vector + s * step, layout, k, last) for s in (1, -1)]
                over, mean, cov = ((u - d) / (2 * small[a]) for u, d in zip(*ends, strict=True))
                by_mean.append((over, mean))
                by_cov.append(inverse @ cov)
            for a, (over, mean) in enumerate(by_mean):
                for b, (more, other) in enumerate(by_mean):
                    F[a, b] += np.trace(over.T @ inverse @ more @ second)
                    F[a, b] += mean @ inverse @ (more @ x + other) + x @ over.T @ inverse @ other
                    F[a, b] += 0.5 * np.trace(by_cov[a] @ by_cov[b])
        Phi, added = TRUE.period(TIME, R, MODE, k) if k < T - 1 else (np.eye(2), np.zeros(2))
        x, P = Phi @ x + added, Phi @ P @ Phi.T + TRUE.covariance(MODE[k], H)
    agree(promise.information(R), without_noise(F, layout.size))


def test_in_a_closed_loop_the_law_is_told_what_noisy_sensors_say():
    """dx/dt = 0.5 x + u(t − 0.123), u_k = −1.2 y_k + r_k: innovations by a dense triangle."""
    plant, K = Plant([[[0.5]]], [[[1.0]]], 0.123, 1e-3 * np.eye(1)), -1.2
    count, v, first = 30, 0.02, 5
    r = np.random.default_rng(1).choice([-1.0, 1.0], (count, 1))

    def weights(a, b, D):
        E = [expm(np.array([[a, b], [0.0, 0.0]]) * s) for s in (H, 3 * H - D)]
        return np.array([E[0][0, 0], E[0][0, 1] - E[1][0, 1], E[1][0, 1]])

    P = weights(0.5, 1.0, 0.123)

    def loop(r, w, v, anew=None):
        """y and u; with `anew`, the state at `first` is known by its measurement alone."""
        x, u, y = 0.0, np.zeros(count + 3), np.zeros(count)
        for k in range(count):
            y[k] = x + v[k]
            if k == first and anew is not None:
                x = y[k] + anew
            u[k + 3] = K * y[k] + r[k]
            x = P @ [x, u[k], u[k + 1]] + w[k]
        return y, u

    def innovations(y, u, a, b, D, W, V):
        """e and their variances: Σ of what follows y[first] is L d Lᵀ, L with ones."""
        phi, old, new = weights(a, b, D)
        Q, size = W * np.expm1(2.0 * a * H) / (2.0 * a), count - first - 1
        mean, x = [], y[first]
        for k in range(first, count - 1):
            x = phi * x + old * u[k] + new * u[k + 1]
            mean.append(x)
        step = phi ** np.arange(size + 1)
        reach = np.array(
            [[step[i - j] if i >= j else 0.0 for j in range(size)] for i in range(size)]
        )
        cov = V * np.outer(step[1:], step[1:]) + Q * reach @ reach.T + V * np.eye(size)
        L = cholesky(cov, lower=True)
        return np.linalg.solve(L / np.diagonal(L), y[first + 1 :] - mean), np.diagonal(L) ** 2

    none, S = np.zeros(count), plant.covariance(0, H)[0, 0]
    truth = np.array([0.5, 1.0, 0.123, 1e-3, v**2])
    small = np.diag([1e-5, 1e-5, 1e-5, 1e-7, 1e-7])
    noises = [(np.sqrt(S) * one, none) for one in np.eye(count)]
    noises += [(none, v * one) for one in np.eye(count)]
    runs = [loop(r[:, 0], none, none, 0.0), loop(none, none, none, v)]
    runs += [loop(none, *noise, 0.0) for noise in noises]
    s = innovations(*runs[0], *truth)[1]
    by_e, by_s = np.zeros((2, 5, len(runs), s.size))
    for a, e in enumerate(small):
        for c, run in enumerate(runs):
            up, down = innovations(*run, *(truth + e)), innovations(*run, *(truth - e))
            by_e[a, c], by_s[a, c] = ((u - d) / (2.0 * e[a]) for u, d in zip(up, down, strict=True))
    F = np.einsum("ack,bck->ab", by_e / s, by_e)
    F += 0.5 * np.einsum("ak,bk->ab", by_s[:, 0] / s, by_s[:, 0] / s)
    law: Any = dt.DelayedStateFeedback(dt.SwitchedSystem(plant.A, plant.B, 0.123), [[[K]]])
    used = (np.arange(count) >= first) & (np.arange(count) < count - 1)
    promise = prospect(plant, np.zeros(count, int), used, H, law=law, sensors=v)
    agree(promise.information(r), without_noise(F, 3))
    apart = np.array([np.stack((y, u[3:])) for y, u in (loop(none, *one) for one in noises)])
    expected = promise.deviation.T**2 + np.array([[v**2], [0.0]])
    np.testing.assert_allclose((apart**2).sum(axis=0), expected, rtol=1e-9)


def test_the_gradient_of_the_search_is_the_derivative_with_noisy_sensors():
    law: Any = dt.DelayedStateFeedback(
        dt.SwitchedSystem(TRUE.A, TRUE.B, TRUE.D), np.full((3, 2, 2), -0.1), allow_unstable=True
    )
    promise = prospect(TRUE, MODE, USED, H, law=law, sensors=SENSORS)
    way = np.random.default_rng(2).standard_normal(R.shape)
    ends = [promise.evaluate(R + s * way).value for s in (1e-6, -1e-6)]
    by_hand = (ends[0] - ends[1]) / 2e-6
    assert (promise.evaluate(R).by_r * way).sum() == pytest.approx(by_hand, rel=1e-5)


def test_nearly_exact_sensors_lose_only_that_their_noise_is_unknown():
    """Of one mode: W of several that is one for all tells of A, as S of each would not."""
    one = Plant(A3[:1], B3[:1], D3[:1], W2)
    used = (np.arange(T) >= 8) & (np.arange(T) < T - 1)
    errors = [prospect(one, 0 * MODE, used, H, sensors=v).errors(R) for v in (0.0, 1e-6)]
    ratio = errors[1] / errors[0]
    assert ratio.min() > 1.0 - 1e-6
    assert ratio.max() < 1.01


TWO = oscillator()
PLANT = dt.SwitchedSystem(TWO.A, TWO.B, TWO.D)
SIGNAL = dt.SwitchingSignal.periodic([1.0, 1.0], [0, 1], 20.0)


def designed(horizon=6.0, **how) -> dt.Experiment:
    given: dict = {"disturbance": 1e-3, "noise": 0.01, "signal": SIGNAL, "effort": 0, **how}
    return dt.design_experiment(PLANT, horizon, H, 1.0, **given)


def test_noise_makes_logs_worth_less_and_none_of_it_changes_nothing():
    exact, none, noisy = designed(noise=0.0), designed(noise=[0.0, 0.0]), designed()
    np.testing.assert_array_equal(none.inputs, exact.inputs)
    np.testing.assert_array_equal(none.errors, exact.errors)
    assert noisy.standard_error("delay") > 1.5 * exact.standard_error("delay")
    assert noisy.sentences[-1] == "Sensors are taken to be noisy, with deviations of 0.01, 0.01."
    assert len(exact.sentences) == len(noisy.sentences) - 1


def test_sensors_alone_may_be_noisy():
    """Without any process noise; and one of two sensors."""
    errors = [designed(disturbance=W).standard_error("delay") for W in (0.0, 1e-8)]
    assert errors[0] == pytest.approx(errors[1], rel=0.01)
    part = designed(noise=[0.0, 0.01]).standard_error("delay")
    assert designed(noise=0.0).standard_error("delay") < part < designed().standard_error("delay")


def test_noises_of_modes_are_averaged_over_the_rows_and_that_is_said():
    """As identify saves one of every mode where its sensors were exact."""
    W, signal = W2 * np.array([1.0, 4.0])[:, None, None], SIGNAL.periodic([1.5, 0.5], [0, 1], 6.0)
    each, mean = (designed(disturbance=one, signal=signal) for one in (W, 1.75 * W2))
    np.testing.assert_allclose(each.errors, mean.errors, rtol=1e-9)
    assert "the mean of theirs over the rows" in each.sentences[-1]
    assert each.sentences[:-1] == mean.sentences


REFUSED: list[tuple[dict, str]] = [
    ({"noise": -0.1}, "noise must be the standard deviation of every state's sensor"),
    ({"noise": np.inf}, "noise must be the standard deviation of every state's sensor"),
    ({"noise": [0.1, 0.1, 0.1]}, r"noise must have shape \(m,\) = \(2,\)"),
    ({"disturbance": 0.0, "noise": [0.01, 0.0]}, "disturbance must move every state within"),
]


@pytest.mark.parametrize(("how", "message"), REFUSED, ids=[m[:22] for _, m in REFUSED])
def test_what_cannot_be_is_refused_by_name(how, message):
    with pytest.raises(dt.ArgumentError, match=message):
        designed(**how)


@pytest.mark.long  # with switches at samples only, of exact states: `test_experiment.py`
def test_the_error_of_the_delay_from_noisy_logs_is_the_one_that_was_promised():
    found, errors = designed(20.0, switches="anywhere"), []
    for seed in range(240):
        u = np.ascontiguousarray(found.inputs.T)
        y, _ = TWO.log(found.time, u, np.random.default_rng(seed), found.mode, sensor=0.01)
        columns = {"t": found.time, "x1": y[:, 0], "x2": y[:, 1], "u1": u[:, 0]}
        log = pd.DataFrame({**columns, "mode": found.mode})
        fit = dt.identify(log, delay=(0.2, 0.5), noise=True, switches="anywhere")
        errors.append(fit.delays[0, 0] - 0.312)
    measured = np.sqrt(np.mean(np.square(errors)))
    assert measured == pytest.approx(found.standard_error("delay"), rel=0.12)


@pytest.mark.long
def test_in_a_closed_loop_it_is_too():
    plant, K = Plant([[[0.5]]], [[[1.0]]], 0.233, 1e-3 * np.eye(1)), -1.2
    known = dt.SwitchedSystem(plant.A, plant.B, 0.233)
    law = dt.DelayedStateFeedback(known, [[[K]]])
    how: dict = {"disturbance": 1e-3, "noise": 0.02, "law": law, "effort": 0}
    found, errors = dt.design_experiment(known, 15.0, H, 1.0, **how), []
    for seed in range(240):
        u, rng = np.ascontiguousarray(found.inputs.T), np.random.default_rng(seed)
        y, u = plant.log(found.time, u, rng, None, 0.02, np.array([[K]]))
        log = pd.DataFrame({"t": found.time, "x": y[:, 0], "u": u[:, 0]})
        fit = dt.identify(log, modes=None, delay=(0.1, 0.4), noise=True)
        errors.append(fit.delays[0, 0] - 0.233)
    measured = np.sqrt(np.mean(np.square(errors)))
    assert measured == pytest.approx(found.standard_error("delay"), rel=0.12)
