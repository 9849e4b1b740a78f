"""What an experiment promises: its information by a second method, its limits, its optimum."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

import deadtime as dt
from promises import prospect
from synthetic_logs import Plant, oscillator

H = 0.05
W2 = 1e-3 * np.array([[1.0, 0.3], [0.3, 2.0]])
A3 = [[[0.0, 1.0], [-2.0, -1.0]], [[0.1, 1.0], [-3.0, -0.5]], [[-1.0, 0.4], [0.2, -2.0]]]
B3 = [[[0.2, 1.0], [1.0, 0.0]], [[0.0, 0.7], [1.3, -0.4]], [[1.0, 0.0], [0.3, 0.8]]]
D3 = [[0.112, 0.16], [0.07, 0.183], [0.135, 0.021]]
TRUE = Plant(A3, B3, D3, W2)
T, FIRST = 48, 8
MODE = (np.arange(T) // 5) % 3
R = np.random.default_rng(5).choice([-1.0, 1.0], (T, 2))


def promised(law=None, plant=TRUE, mode=MODE, first=FIRST):
    used = np.arange(mode.size) >= first
    used[-1] = False
    return prospect(plant, mode, used, H, law=law)


def dense(theta, layout, start, covariance):
    """Mean and covariance of all states after FIRST, of which x there is known in distribution.

    What noise adds in a period is that of the truth: it is not tied to the unknowns.
    """
    plant, t = Plant(*layout.split(theta)), H * np.arange(T)
    mean, cov = np.zeros((T - FIRST, 2)), np.zeros((T - FIRST, 2, T - FIRST, 2))
    mean[0], cov[0, :, 0] = start, covariance
    for k in range(T - FIRST - 1):
        Phi, added = plant.period(t, R, MODE, FIRST + k)
        mean[k + 1] = Phi @ mean[k] + added
        for j in range(k + 1):
            cov[k + 1, :, j] = Phi @ cov[k, :, j]
            cov[j, :, k + 1] = cov[k + 1, :, j].T
        cov[k + 1, :, k + 1] = Phi @ cov[k, :, k] @ Phi.T + TRUE.covariance(MODE[FIRST + k], H)
    return mean.ravel(), cov.reshape(mean.size, -1)


def test_the_information_is_that_of_the_dense_gaussian_of_the_whole_log():
    """F = ∂μᵀ Σ⁻¹ ∂μ + ½ tr(Σ⁻¹ ∂Σ Σ⁻¹ ∂Σ): three modes, two inputs, six delays, by differences."""
    promise = promised()
    theta = promise.layout.join(TRUE.A, TRUE.B, TRUE.D)
    t, x, P = H * np.arange(T), np.zeros(2), np.zeros((2, 2))
    for k in range(FIRST):
        Phi, added = TRUE.period(t, R, MODE, k)
        x, P = Phi @ x + added, Phi @ P @ Phi.T + TRUE.covariance(MODE[k], H)
    _, cov = dense(theta, promise.layout, x, P)
    inverse, by_mean, by_cov = np.linalg.inv(cov), [], []
    for a in range(theta.size):
        step = np.where(np.arange(theta.size) == a, 1e-5, 0.0)
        ends = [dense(theta + s * step, promise.layout, x, P) for s in (1, -1)]
        by_mean.append((ends[0][0] - ends[1][0]) / 2e-5)
        by_cov.append(inverse @ (ends[0][1] - ends[1][1]) / 2e-5)
    means = np.array(by_mean)
    F = means @ inverse @ means.T + 0.5 * np.einsum("aij,bji->ab", by_cov, by_cov)
    found = promise.information(R)
    unit = np.sqrt(np.diagonal(F))
    assert np.abs((found - F) / unit / unit[:, None]).max() < 1e-6


def test_in_a_closed_loop_the_information_is_that_of_impulse_responses():
    """dx/dt = 0.5 x + u(t − 0.123), u_k = −1.2 x_k + r_k: noise moves u, too."""
    plant, K, count = Plant([[[0.5]]], [[[1.0]]], 0.123, 1e-3 * np.eye(1)), -1.2, 40
    r = np.random.default_rng(1).choice([-1.0, 1.0], (count, 1))

    def weights(a, b, D):
        E = [expm(np.array([[a, b], [0.0, 0.0]]) * s) for s in (H, 3 * H - D)]
        return np.array([E[0][0, 0], E[0][0, 1] - E[1][0, 1], E[1][0, 1]])

    P = weights(0.5, 1.0, 0.123)

    def loop(r, w):
        """z of every period: x_k, u_{k−3}, u_{k−2}."""
        x, u, z = 0.0, np.zeros(count + 3), np.zeros((count, 3))
        for k in range(count):
            u[k + 3] = K * x + r[k]
            z[k] = x, u[k], u[k + 1]
            x = P @ z[k] + w[k]
        return z

    none, S = np.zeros(count), plant.covariance(0, H)[0, 0]
    steps = np.array([(1e-5, 0, 0), (0, 1e-5, 0), (0, 0, 1e-5)])
    truth = np.array([0.5, 1.0, 0.123])
    by_P = np.array([(weights(*(truth + e)) - weights(*(truth - e))) / 2e-5 for e in steps])
    mean = loop(r[:, 0], none)
    apart = [np.sqrt(S) * loop(none, one) for one in np.eye(count)]
    F = np.zeros((3, 3))
    for k in range(5, count - 1):
        second = np.outer(mean[k], mean[k]) + sum(np.outer(z[k], z[k]) for z in apart)
        F += by_P @ second @ by_P.T / S
    law: Any = dt.DelayedStateFeedback(dt.SwitchedSystem(plant.A, plant.B, 0.123), [[[K]]])
    promise = promised(law=law, plant=plant, mode=np.zeros(count, int), first=5)
    found = promise.information(r)
    np.testing.assert_allclose(found, F, rtol=1e-6)
    np.testing.assert_allclose(promise.chain.means(r)[:, 0], mean[:, 0], atol=1e-12)


def test_the_gradient_of_the_search_is_the_derivative():
    law: Any = dt.DelayedStateFeedback(
        dt.SwitchedSystem(TRUE.A, TRUE.B, TRUE.D), np.full((3, 2, 2), -0.1), allow_unstable=True
    )
    promise = promised(law)
    promise = replace(promise, room=0.2 + np.abs(promise.reach(0.5 * R)) / 2.0)
    way = np.random.default_rng(2).standard_normal(R.shape)
    ends = [promise.evaluate(R + s * way, 30.0).value for s in (1e-6, -1e-6)]
    assert promise.evaluate(R).excess > 0.1
    by_hand = (ends[0] - ends[1]) / 2e-6
    assert (promise.evaluate(R, 30.0).by_r * way).sum() == pytest.approx(by_hand, rel=1e-5)


TWO = oscillator()
PLANT = dt.SwitchedSystem(TWO.A, TWO.B, TWO.D)
SIGNAL = dt.SwitchingSignal.periodic([1.0, 1.0], [0, 1], 20.0)


def designed(**how) -> dt.Experiment:
    given: dict = {"disturbance": 1e-3, "signal": SIGNAL, "effort": 2, **how}
    return dt.design_experiment(PLANT, 20.0, H, 1.0, **given)


def test_the_optimum_beats_binary_sequences_and_a_step_by_its_own_criterion():
    found = designed()
    errors = {name: float(one[0]) for name, one in found.delay_errors.items()}
    assert errors["experiment"] < 0.97 * errors["prbs"] < 0.2 * errors["step"]
    assert found.standard_error("delay") == errors["experiment"]


@pytest.mark.long
def test_limits_hold_and_then_the_optimum_is_worth_much_more():
    """Binary sequences must be made smaller until the states keep their limits."""
    found = designed(state_limit=[0.2, 0.3], hold=2)
    u = found.inputs[0]
    assert np.abs(u).max() <= 1.0
    assert (u[::2] == u[1::2]).all()
    x, P, t = np.zeros(2), np.zeros((2, 2)), found.time
    for k in range(t.size - 1):
        Phi, added = TWO.period(t, u[:, None], found.mode, k)
        x, P = Phi @ x + added, Phi @ P @ Phi.T + TWO.covariance(found.mode[k], H)
        assert (np.abs(x) + 3.0 * np.sqrt(np.diagonal(P)) <= np.array([0.2, 0.3]) + 1e-9).all()
    errors = found.delay_errors
    assert errors["experiment"][0] < 0.6 * errors["prbs"][0]


def test_an_unstable_plant_stays_bounded_about_a_law():
    plant = dt.SwitchedSystem([[[0.5]]], [[[1.0]]], 0.23)
    law = dt.AveragedPredictor(plant, [[[-1.5]]])
    found = dt.design_experiment(plant, 15.0, H, 1.0, disturbance=1e-3, law=law, effort=0)
    assert found.added
    assert found.largest[1] <= 1.0 + 1e-9
    assert found.largest[0] < 2.0
    assert list(found.to_pandas().columns) == ["t", "add_u1", "mode"]


def replayed(found, plant, rng, law=None):
    """A log of the plant under an experiment."""
    t, u = found.time, np.ascontiguousarray(found.inputs.T)
    y, sent = plant.log(t, u, rng, found.mode, feedback=law)
    return pd.DataFrame(
        {"t": t, "x1": y[:, 0], "x2": y[:, -1], "u1": sent[:, 0], "mode": found.mode}
    )


def test_a_table_is_replayed_and_its_log_identified(tmp_path):
    found = designed(effort=0)
    found.to_csv(tmp_path / "experiment.csv")
    table = pd.read_csv(tmp_path / "experiment.csv")
    np.testing.assert_allclose(table["u1"], found.inputs[0], rtol=1e-11)
    np.testing.assert_allclose(table["t"], H * np.arange(400), rtol=1e-11)
    fit = dt.identify(replayed(found, TWO, np.random.default_rng(0)), switches="samples")
    assert list(found.names) == list(fit.names)[: len(found.names)]
    width = np.diff(fit.delay_interval[0, 0])[0] / 3.93
    assert width == pytest.approx(found.standard_error("delay"), rel=0.15)


@pytest.mark.long
def test_the_error_of_the_delay_is_the_one_that_was_promised():
    found = designed()
    errors = [
        dt.identify(
            replayed(found, TWO, np.random.default_rng(seed)),
            delay=(0.2, 0.5),
            noise=False,
            switches="samples",
        ).delays[0, 0]
        - 0.312
        for seed in range(250)
    ]
    measured = np.sqrt(np.mean(np.square(errors)))
    assert measured == pytest.approx(found.standard_error("delay"), rel=0.1)


REFUSED: list[tuple[dict, str]] = [
    ({"switches": "never"}, "switches must be"),
    ({"signal": None}, "signal must be given for a plant of 2 modes"),
    ({"signal": dt.SwitchingSignal.constant(0)}, "signal must hold mode 1 for at least 9 periods"),
    ({"disturbance": 0.0}, "disturbance must move every state"),
    ({"disturbance": np.eye(3)}, "disturbance must have shape"),
    ({"disturbance": [[1e-3, 5e-4], [0.0, 1e-3]]}, "disturbance must be symmetric"),
    ({"disturbance": [1e10, -1.0]}, "disturbance must be positive semidefinite"),
    ({"hold": 1000}, "horizon must leave inputs that identify all unknowns"),
    ({"state_limit": 0.01}, r"state_limit\[0\] must be above"),
    ({"law": dt.OutputFeedback}, "law must be a Law"),
]


@pytest.mark.parametrize(("how", "message"), REFUSED, ids=[m[:22] for _, m in REFUSED])
def test_what_cannot_be_is_refused_by_name(how, message):
    with pytest.raises(dt.ArgumentError, match=message):
        designed(**how)


def test_an_unstable_plant_needs_a_law_and_an_input_a_limit():
    unstable = dt.SwitchedSystem([[[0.5]]], [[[1.0]]], 0.23)
    with pytest.raises(dt.ArgumentError, match="law must be given for a plant that is unstable"):
        dt.design_experiment(unstable, 15.0, H, 1.0, disturbance=1e-3)
    with pytest.raises(dt.ArgumentError, match="horizon must have at least 7 periods after the"):
        dt.design_experiment(unstable, 0.6, H, 1.0, disturbance=1e-3)
    with pytest.raises(dt.ArgumentError, match=r"horizon must have at least 7 .* got 0"):
        dt.design_experiment(unstable, 0.01, H, 1.0, disturbance=1e-3)
    with pytest.raises(dt.ArgumentError, match=r"horizon must be at most 20,000 .* got inf"):
        dt.design_experiment(unstable, 1e300, 1e-300, 1.0, disturbance=1e-3)
    with pytest.raises(dt.ArgumentError, match="input_limit must be positive"):
        dt.design_experiment(PLANT, 20.0, H, 0.0, disturbance=1e-3, signal=SIGNAL)
    with pytest.raises(dt.ArgumentError, match="horizon must be at most 20,000 periods"):
        dt.design_experiment(PLANT, 2e4, H, 1.0, disturbance=1e-3, signal=SIGNAL)
    with pytest.raises(dt.ArgumentError, match="name must be one of"):
        designed(effort=0).standard_error("lag")


def test_stable_modes_between_which_switching_is_unstable_need_a_law_too():
    A = [[[-0.1, 1.0], [-10.0, -0.1]], [[-0.1, 10.0], [-1.0, -0.1]]]
    plant = dt.SwitchedSystem(A, [[[0.0], [1.0]]] * 2, 0.13)
    signal = dt.SwitchingSignal.periodic([0.5, 0.5], [0, 1], 20.0)
    with pytest.raises(dt.ArgumentError, match=r"law must be given .* along its modes it grows"):
        dt.design_experiment(plant, 20.0, H, 1.0, disturbance=1e-3, signal=signal)


def test_a_mode_in_which_the_input_does_nothing_is_no_crash():
    """There sequences that stand still for long tell nothing of B; others do."""
    plant = dt.SwitchedSystem([[[-1.0]], [[-2.0]]], [[[1.0]], [[0.0]]], 0.13)
    signal = dt.SwitchingSignal.periodic([1.0, 1.0], [0, 1], 10.0)
    found = dt.design_experiment(plant, 10.0, 0.1, 1.0, disturbance=1e-3, signal=signal, effort=0)
    assert np.isfinite(found.errors).all()
