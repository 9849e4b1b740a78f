"""Gains: poles put back, Riccati equations put back, the paper's numbers, python-control's sign."""

import re
from types import SimpleNamespace

import control
import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov, solve_discrete_lyapunov

import deadtime as dt
import plants

DOUBLE = dt.SwitchedSystem([[[0.0, 1.0], [0.0, 0.0]]], [[[0.0], [1.0]]], 1.0)


def closed_loop_poles(plant, gains):
    closed = plant.A + plant.B @ gains
    return np.array([np.sort_complex(np.linalg.eigvals(matrix)) for matrix in closed])


def test_the_paper_s_gains_come_out_to_the_printed_digits():
    gains = dt.place(plants.paper(), [-1, -2])
    assert gains.shape == (2, 1, 2)
    assert gains.round(4).tolist() == [[[-12.0, -6.0]], [[-12.6961, -6.3725]]]
    mean = dt.place(plants.paper().mean(), [-1, -2])[0]
    assert mean.round(4).tolist() == [[-12.3515, -6.1881]]
    assert np.linalg.norm(gains[1] - gains[0]) == pytest.approx(0.7895, abs=5e-5)


def test_placed_poles_are_the_poles_of_a_plus_b_k():
    poles = closed_loop_poles(plants.generic(), dt.place(plants.generic(), [-1, -1.5, -2]))
    plants.close(poles, np.tile([-2.0, -1.5, -1.0], (3, 1)), 1e-10)


def test_every_mode_may_have_its_own_poles():
    wanted = [[-3.0, -1.0], [-4.0, -2.0]]
    poles = closed_loop_poles(plants.paper(), dt.place(plants.paper(), wanted))
    plants.close(poles, wanted, 1e-10)


def test_complex_poles_are_placed_by_real_gains():
    wanted = np.sort_complex([-1 + 2j, -1 - 2j, -3])
    for plant in (
        plants.generic(),
        dt.SwitchedSystem(plants.generic().A, plants.generic().B[:, :, :1], 1.0),
    ):
        gains = dt.place(plant, wanted)
        assert gains.dtype == np.float64
        plants.close(closed_loop_poles(plant, gains), np.tile(wanted, (3, 1)), 1e-8)


def test_a_pole_may_repeat_as_often_as_the_rank_of_b():
    poles = closed_loop_poles(plants.generic(), dt.place(plants.generic(), [-1, -2, -2]))
    plants.close(poles, np.tile([-2.0, -2.0, -1.0], (3, 1)), 1e-6)


def test_python_control_places_minus_our_gains():
    plant = plants.paper()
    for i, K in enumerate(dt.place(plant, [-1, -2])):
        plants.close(K, -np.asarray(control.place(plant.A[i], plant.B[i], [-1, -2])), 1e-10)


def test_python_control_s_lqr_is_minus_ours():
    plant = plants.generic()
    Q, R = np.diag([1.0, 2.0, 3.0]), np.array([[1.0, 0.2], [0.2, 0.5]])
    for i, K in enumerate(dt.lqr(plant, Q, R)):
        plants.close(K, -control.lqr(plant.A[i], plant.B[i], Q, R)[0], 1e-9)


def test_lqr_gains_are_optimal_for_their_own_cost_matrix():
    # Kleinman: X of the cost under K from a Lyapunov equation; K is optimal iff K = −R⁻¹BᵀX.
    plant = plants.generic()
    Q, R = np.diag([1.0, 0.0, 3.0]), np.array([[1.0, 0.2], [0.2, 0.5]])
    for A, B, K in zip(plant.A, plant.B, dt.lqr(plant, Q, R), strict=True):
        closed = A + B @ K
        assert np.linalg.eigvals(closed).real.max() < 0
        X = solve_continuous_lyapunov(closed.T, -(Q + K.T @ R @ K))
        plants.close(-np.linalg.solve(R, B.T @ X), K, 1e-10)


def test_lqr_of_the_double_integrator_is_the_textbook_gain():
    plants.close(dt.lqr(DOUBLE, np.eye(2), [[1.0]]), [[[-1.0, -np.sqrt(3.0)]]], 1e-13)


def test_lqr_takes_weights_that_are_symmetric_to_round_off():
    Q = [[1, 0.5], [0.5 + 5e-14, 1]]
    plants.close(dt.lqr(DOUBLE, Q, [[1.0]]), dt.lqr(DOUBLE, [[1, 0.5], [0.5, 1]], [[1.0]]), 1e-10)


def test_lqr_refuses_a_numerically_singular_weight_by_name():
    two = dt.SwitchedSystem(DOUBLE.A, [[[0.0, 1.0], [1.0, 0.0]]], 1.0)
    with pytest.raises(dt.ArgumentError, match=r"R must be|mode 0"):
        dt.lqr(two, np.eye(2), np.diag([1.0, 1e-17]))


def test_poles_a_thousandth_apart_are_placed_to_round_off_of_their_polynomial():
    rng = np.random.default_rng(1)
    A, B = rng.normal(size=(1, 6, 6)), rng.normal(size=(1, 6, 1))
    poles = -1 - np.arange(6) * 1e-3
    K = dt.place(dt.SwitchedSystem(A, B, 1.0), poles)
    np.testing.assert_allclose(np.poly(A[0] + B[0] @ K[0]), np.poly(poles), rtol=1e-9)


@pytest.mark.parametrize("failure", ["wrong", "raised"])
def test_a_placement_that_fails_is_refused_by_mode(monkeypatch, failure):
    def place_poles(A, B, poles):
        if failure == "raised":
            raise ValueError("the poles cannot be placed")
        return SimpleNamespace(gain_matrix=np.ones((2, 3)))

    monkeypatch.setattr("scipy.signal.place_poles", place_poles)
    with pytest.raises(dt.ArgumentError, match="poles of mode 0 could not be placed"):
        dt.place(plants.generic(), [-1, -2, -3])


def test_poles_that_scipy_improves_slowly_are_placed_without_a_warning():
    rng = np.random.default_rng(0)
    for _ in range(20):
        plant = dt.SwitchedSystem(rng.normal(size=(1, 7, 7)), rng.normal(size=(1, 7, 2)), 1.0)
        poles = -1 - 0.1 * np.arange(7)
        plants.close(
            np.sort(closed_loop_poles(plant, dt.place(plant, poles)).real), [np.sort(poles)], 1e-5
        )


PAPER = plants.paper()
STUCK = dt.SwitchedSystem([np.eye(2), [[1.0, 0.0], [0.0, 2.0]]], [[[1.0], [0.0]]] * 2, 1.0)
STUCK3 = dt.SwitchedSystem([np.eye(3)], [np.eye(3)[:, :2]], 1.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: dt.place(PAPER, ["a", "b"]),
            "poles must be 2 numbers, or one list of 2 per mode, got ['a', 'b'].",
        ),
        (
            lambda: dt.place(PAPER, [[-1, -2], [-1]]),
            "poles must be 2 numbers, or one list of 2 per mode",
        ),
        (
            lambda: dt.place(PAPER, [-1, -2, -3]),
            "poles must have shape (n,) = (2,) or (modes, n) = (2, 2), got (3,).",
        ),
        (
            lambda: dt.place(PAPER, [[-1, -2]] * 3),
            "poles must have shape (n,) = (2,) or (modes, n) = (2, 2), got (3, 2).",
        ),
        (lambda: dt.place(PAPER, [-1, np.nan]), "poles must be finite"),
        (lambda: dt.place(PAPER, [-1, -np.inf]), "poles must be finite"),
        (
            lambda: dt.place(PAPER, [-1 + 1j, -1]),
            "poles of mode 0 must come in conjugate pairs, but -1+1j lacks -1-1j.",
        ),
        (
            lambda: dt.place(PAPER, [[-1, -2], [-1 + 1j, -1 + 1j]]),
            "poles of mode 1 must come in conjugate pairs",
        ),
        (
            lambda: dt.place(PAPER, [-1, -1]),
            "-1+0j is repeated 2 times, but only rank B = 1 equal poles can be placed",
        ),
        (
            lambda: dt.place(STUCK, [-1, -2]),
            "mode 0 is not controllable: rank [B AB] = 1 < 2: no gain can move all its poles.",
        ),
        (
            lambda: dt.place(STUCK3, [-1, -2, -3]),
            "mode 0 is not controllable: rank [B AB A^2B] = 2 < 3",
        ),
        (
            lambda: dt.lqr(PAPER, np.eye(3), [[1.0]]),
            "Q must have shape (n, n) = (2, 2), got (3, 3).",
        ),
        (
            lambda: dt.lqr(PAPER, np.eye(2), np.eye(2)),
            "R must have shape (m, m) = (1, 1), got (2, 2).",
        ),
        (
            lambda: dt.lqr(PAPER, [np.eye(2)], [[1.0]]),
            "Q must have shape (n, n), (n,) or (), got (1, 2, 2): give one matrix, not one",
        ),
        (
            lambda: dt.lqr(PAPER, [[1.0, 1.0], [0.0, 1.0]], [[1.0]]),
            "Q must be symmetric: pass (M + M.T) / 2.",
        ),
        (
            lambda: dt.lqr(PAPER, np.diag([1e10, -1.0]), [[1.0]]),
            "Q must be positive semidefinite, got -1 on its diagonal.",
        ),
        (
            lambda: dt.lqr(PAPER, np.eye(2), [[0.0]]),
            "R must be positive definite, got 0 on its diagonal.",
        ),
        (
            lambda: dt.lqr(STUCK, np.eye(2), [[1.0]]),
            "mode 0 has no stabilising LQR gain: it must be stabilisable",
        ),
        (lambda: dt.lqr(DOUBLE, np.zeros((2, 2)), [[1.0]]), "mode 0 has no stabilising LQR gain"),
    ],
)
def test_a_request_without_an_answer_is_refused_by_name(call, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        call()


GENERIC = plants.generic()


@pytest.mark.parametrize("poles", [[-1, -1.5, -2], [-1 + 2j, -1 - 2j, -2], [-1, -2, -2]])
@pytest.mark.parametrize("step", [0.01, 0.1, 1.0])
def test_with_a_step_the_sampled_loop_has_the_poles(step, poles):
    gains = dt.place(GENERIC, poles, step)
    for A, B, K in zip(GENERIC.A, GENERIC.B, gains, strict=True):
        Phi, Gamma = plants.held(A, B, step)
        found = np.poly(np.linalg.eigvals(Phi + Gamma @ K))
        plants.close(found, np.poly(np.exp(np.array(poles) * step)), 1e-9)


@pytest.mark.parametrize("delay", [0.2, 0.234, 0.05])
def test_the_spectrum_of_the_loop_is_the_rate_that_was_placed(delay):
    plant = plants.generic(delay)
    gains = dt.place(plant, [-1, -1.5, -2], step=0.1)
    for mode in range(3):
        law = dt.SingleModePredictor(plant, gains, mode)
        assert dt.growth_rate(plant, law, mode, step=0.1) == pytest.approx(-1.0, abs=1e-9)
        continuous = dt.SingleModePredictor(plant, dt.place(plant, [-1, -1.5, -2]), mode)
        assert abs(dt.growth_rate(plant, continuous, mode, step=0.1) + 1.0) > 1e-3


def test_sampled_gains_tend_to_the_continuous_ones_with_order_one():
    Q, R, steps = np.diag([1.0, 2.0, 3.0]), np.eye(2), np.array([0.02, 0.01, 0.005])
    for design in (
        lambda h: dt.place(GENERIC, [-1, -1.5, -2], h),
        lambda h: dt.lqr(GENERIC, Q, R, h),
    ):
        errors = [np.abs(design(h) - design(None)).max() for h in steps]
        assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.1)


def test_the_cost_of_a_sampled_loop_is_the_riccati_one_and_no_gain_has_a_lower_one():
    """∫ over t ≥ D of the exact simulation; with S of the cost-to-go by a Lyapunov sum."""
    Q, R, h, x0 = np.eye(3), np.eye(2), 0.1, np.array([1.0, -1.0, 0.5])
    gains = dt.lqr(GENERIC, Q, R, step=h)
    A, D = GENERIC.A[1], GENERIC.delay
    before = x0 @ plants.gramian_by_quadrature(A.T, np.eye(3), D) @ x0

    def cost(K):
        law = dt.SingleModePredictor(GENERIC, K, 1, allow_unstable=True)
        signal = dt.SwitchingSignal.constant(1)
        return dt.simulate(GENERIC, law, signal, x0, 30.0, h).metrics()["cost"] - before

    Phi, Gamma = plants.held(A, GENERIC.B[1], h)
    Z = np.zeros((5, 5))
    Z[:3] = np.hstack((A, GENERIC.B[1]))
    weight = np.diag([1.0, 1.0, 1.0, 1.0, 1.0])
    M = plants.gramian_by_quadrature(Z.T, weight, h)
    closed, lift = Phi + Gamma @ gains[1], np.vstack((np.eye(3), gains[1]))
    X = solve_discrete_lyapunov(closed.T, lift.T @ M @ lift)
    P = expm(A * D) @ x0
    assert cost(gains) == pytest.approx(P @ X @ P, rel=1e-10)
    for row, column in ((0, 0), (1, 2)):
        for change in (0.05, -0.05):
            other = gains.copy()
            other[1, row, column] += change
            assert cost(other) > cost(gains) * (1.0 + 1e-7)


LONG = dt.SwitchedSystem([[[0.0, 4.0], [-4.0, 0.1]]], [[[0.0], [1.0]]], 0.3)
PENDULUM = dt.SwitchedSystem([[[0.0, 1.0], [-1.0, 0.0]]], [[[0.0], [1.0]]], 0.3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: dt.place(PAPER, [-1, -2], 0.0), "step must be positive"),
        (lambda: dt.lqr(PAPER, np.eye(2), [[1.0]], -1.0), "step must be positive"),
        (
            lambda: dt.place(PAPER, [-1 + 4j, -1 - 4j], 1.0),
            "poles of mode 0: -1+4j oscillates faster than a period of 1 s shows",
        ),
        (
            lambda: dt.place(PAPER, [-1, -1], 0.1),
            "-1+0j is repeated 2 times, but only rank B = 1",
        ),
        (
            lambda: dt.place(PENDULUM, [-1, -2], np.pi),
            "mode 0 is not controllable when sampled every 3.14159 s",
        ),
        (
            lambda: dt.lqr(STUCK, np.eye(2), [[1.0]], 0.1),
            "mode 0 has no stabilising LQR gain",
        ),
        (
            lambda: dt.AveragedPredictor(LONG, dt.place(LONG, [-0.1, -0.2], 3.0)),
            "allow_unstable = True accepts it, as gains designed for a long step may need",
        ),
    ],
)
def test_sampled_designs_refuse_what_they_cannot_do(call, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        call()


def test_a_pole_at_rest_is_refused_and_no_other_is_proposed():
    with pytest.raises(dt.ArgumentError, match=r"got 0: a loop with this pole does not decay\.$"):
        dt.place(plants.scalar([0.5]), [0.0])


@pytest.mark.parametrize("step", [None, 0.01, 0.1])
def test_states_that_drive_one_another_and_their_sum_are_controllable(step):
    """The sum acts back on nothing: balancing alone would shrink the others without end."""
    A, B = np.array([[0.1, 1.0, 0.0], [-2.0, -0.6, 0.0], [1.0, 0.0, 0.0]]), [[0.3], [0.8], [0.0]]
    plant, poles = dt.SwitchedSystem([A], [B], 0.27), [-1.0, -2.0, -3.0]
    K = dt.place(plant, poles, step)[0]
    closed, wanted = A + B @ K, np.array(poles)
    if step is not None:
        whole = expm(step * np.block([[A, np.array(B)], [np.zeros((1, 4))]]))
        closed, wanted = whole[:3, :3] + whole[:3, 3:] @ K, np.exp(step * wanted)
    assert np.sort(np.linalg.eigvals(closed).real) == pytest.approx(np.sort(wanted), rel=1e-9)
