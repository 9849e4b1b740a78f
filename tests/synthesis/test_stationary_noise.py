"""Inputs under noise that goes on for ever, beside a Lyapunov equation, closed forms and runs."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm, solve_discrete_lyapunov
from scipy.special import erf

import deadtime as dt
from deadtime.imperfections import Noise, WhiteDisturbance
from deadtime.reports.design import design_record
from deadtime.synthesis import input_peak
from deadtime.synthesis.input_peak import input_covariance

# Three modes, two inputs whose delays are of no whole number of periods and go by the mode.
H = 0.1
A = np.array([[[0.3, 1.0], [0.0, -0.5]], [[0.1, 1.1], [-0.4, 0.3]], [[-0.2, 0.9], [0.0, 0.2]]])
B = np.array([[[0.5, 0.0], [0.2, 1.0]], [[0.4, 0.1], [0.0, 0.8]], [[0.6, 0.0], [0.1, 1.2]]])
DELAYS = np.array([[0.34, 0.07], [0.3, 0.12], [0.05, 0.21]])
MODEL = dt.SwitchedSystem(A, B, DELAYS)
TRUTH = dt.SwitchedSystem(A + 0.02, 1.05 * B, DELAYS + np.array([0.013, 0.004]))
LAW = dt.AveragedPredictor(MODEL, dt.place(MODEL, [-1.5, -2.0], step=H), allow_unstable=True)
W, V = np.array([[0.02, 0.005], [0.005, 0.04]]), np.array([[0.003, -0.001], [-0.001, 0.002]])
PROBABILITY = 0.9
NOISE = dt.StationaryNoise(W, V, PROBABILITY)


def lyapunov(mode):
    """Var u of z = (x, u_{k−1}, …), from exponentials of the truth and the law's table alone."""
    table = LAW.digital(H)
    F, G = table.state_gain[table.row(mode, 10**6, 0)], table.input_gain[table.row(mode, 10**6, 0)]
    a, b, delays = TRUTH.A[mode], TRUTH.B[mode], TRUTH.delays[mode]
    past = max(len(G), int(delays.max() / H) + 2)
    size = 2 + 2 * past
    row = np.zeros((2, size))
    row[:, :2] = F
    for j, tap in enumerate(G):
        row[:, 2 + 2 * j : 4 + 2 * j] = tap
    L, error = np.zeros((size, size)), np.zeros((size, 2))
    L[2:4], error[2:4] = row, F
    L[4:, 2:-2] = np.eye(size - 4)
    L[:2, :2] = expm(a * H)
    for i, delay in enumerate(delays):
        whole = int(delay / H)
        change = delay - whole * H  # until then u_{k−whole−1} acts, then u_{k−whole}
        for lag, begin, end in ((whole + 1, 0.0, change), (whole, change, H)):
            push = quad_vec(lambda s: expm(a * (H - s)) @ b[:, i], begin, end)[0]  # noqa: B023
            if lag == 0:
                L[:2] += np.outer(push, row[i])
                error[:2] += np.outer(push, F[i])
            else:
                L[:2, 2 + 2 * (lag - 1) + i] += push
    added = error @ V @ error.T
    added[:2, :2] += quad_vec(lambda s: expm(a * s) @ W @ expm(a * s).T, 0.0, H)[0]
    return solve_discrete_lyapunov(L, added)[2:4, 2:4]


@pytest.mark.parametrize("mode", range(3))
def test_the_covariance_solves_the_lyapunov_equation_of_the_lifted_loop(mode):
    found = input_covariance(TRUTH, LAW.digital(H), mode, NOISE)
    assert found == pytest.approx(lyapunov(mode), rel=1e-8)


def test_levels_are_those_of_a_normal_input_and_keep_their_probability():
    found = input_peak(TRUTH, LAW, H, NOISE)
    for mode in range(3):
        deviation = np.sqrt(np.diag(lyapunov(mode)))
        kept = erf(found.level[mode] / (np.sqrt(2.0) * deviation))
        assert kept == pytest.approx(PROBABILITY, rel=1e-8)
    assert np.array_equal(found.level, found.least)
    assert np.isnan(found.time).all()


@pytest.mark.parametrize("mode", [0, pytest.param(1, marks=pytest.mark.long)])
def test_runs_stay_within_their_levels_as_often_as_is_said(mode):
    """Shares of 12 runs of 200 s, within five of their own standard errors."""
    deviations = np.array([0.06, 0.04])
    level = input_peak(TRUTH, LAW, H, dt.StationaryNoise(W, deviations**2, PROBABILITY)).level[mode]
    faults, signal = [WhiteDisturbance(W), Noise(deviations)], dt.SwitchingSignal.constant(mode)
    shares = []
    for seed in range(12):
        start = np.zeros(2)
        run = dt.simulate(TRUTH, LAW, signal, start, 220.0, H, imperfections=faults, seed=seed)
        shares.append((np.abs(run.inputs[:, 200:]) <= level[:, None]).mean(axis=1))
    error = np.std(shares, axis=0, ddof=1) / np.sqrt(len(shares))
    assert (np.abs(np.mean(shares, axis=0) - PROBABILITY) < 5.0 * error).all()
    assert (error < 0.01).all()


def test_one_state_and_no_delay_is_the_first_order_process():
    """x_{k+1} = a x_k + b u_k + w, u = K (x + v): σ_x² = (q + (bK)² V)/(1 − (a + bK)²)."""
    plant = dt.SwitchedSystem([[[0.7]]], [[[2.0]]], delay=1e-9)
    law = dt.DelayedStateFeedback(plant, [[[-1.1]]])
    a, b, K, v = np.exp(0.07), 2.0 * (np.exp(0.07) - 1.0) / 0.7, -1.1, 0.04
    q = 0.3 * (np.exp(0.14) - 1.0) / 1.4
    x = (q + (b * K) ** 2 * v) / (1.0 - (a + b * K) ** 2)
    found = input_covariance(plant, law.digital(H), 0, dt.StationaryNoise(0.3, v))
    assert found is not None
    assert found.item() == pytest.approx(K**2 * (x + v), rel=1e-6)


@pytest.mark.parametrize("delay", [0.16, 0.997, 1.0])
def test_an_error_of_a_sample_that_comes_back_after_a_long_delay_counts(delay):
    """u = K x: between an error that was sent and its effect on x all inputs are 0."""
    h, a, K, v = 0.01, -0.05, -0.5, 0.04
    law = dt.DelayedStateFeedback(dt.SwitchedSystem([[[a]]], [[[1.0]]], delay), [[[K]]])
    whole = int(delay / h + 1e-9)
    late = delay - whole * h
    L, added = np.zeros((whole + 2, whole + 2)), np.zeros(whole + 2)
    L[0, 0], L[1, 0], added[1] = np.exp(a * h), K, K
    L[0, whole] += np.expm1(a * (h - late)) / a
    L[0, whole + 1] += np.expm1(a * h) / a - np.expm1(a * (h - late)) / a
    L[2:, 1:-1] += np.eye(whole)
    variance = solve_discrete_lyapunov(L, v * np.outer(added, added))[1, 1]
    assert variance > 1.002 * K**2 * v
    found = input_covariance(law.plant, law.digital(h), 0, dt.StationaryNoise(measurement=v))
    assert found is not None
    assert found.item() == pytest.approx(variance, rel=1e-8)


def test_a_loop_that_grows_has_no_level_and_noise_adds_up():
    idle = dt.DelayedStateFeedback(MODEL, np.zeros((3, 2, 2)), allow_unstable=True)
    assert np.isinf(input_peak(MODEL, idle, H, NOISE).level).all()
    table = LAW.digital(H)

    def covariance(noise):
        found = input_covariance(TRUTH, table, 1, noise)
        assert found is not None
        return found

    both, process, measured = map(
        covariance, (NOISE, dt.StationaryNoise(W), dt.StationaryNoise(measurement=V))
    )
    assert both == pytest.approx(process + measured, rel=1e-12)
    diagonal, whole = dt.StationaryNoise([0.2, 0.2], 0.1), dt.StationaryNoise(0.2, 0.1 * np.eye(2))
    assert covariance(diagonal) == pytest.approx(covariance(whole), rel=1e-14)


def test_a_design_keeps_its_limit_under_noise_and_says_how_often():
    plant = dt.SwitchedSystem([[[1.0]], [[0.6]]], [[[1.0]], [[1.1]]], delay=0.4)
    noise = dt.StationaryNoise(0.05, 0.001, 0.95)
    quick = dt.place(plant, [-6.0])
    plain = dt.AveragedPredictor(plant, quick)
    limit = 0.7 * input_peak(plant, plain, 0.05, noise).level.max()
    found = dt.design(plant, step=0.05, gains=quick, budget=60, initial=noise, input_limit=limit)
    assert found.reached
    assert found.input_peak is not None
    own = input_peak(plant, found.law, 0.05, noise).level.max(axis=0)
    assert found.input_peak == pytest.approx(own, rel=1e-12)
    assert own.item() <= limit
    assert "for stationary noise, 95 % of the time: it reaches" in found.message
    record = design_record(found)["initial"]
    assert record == {"kind": "noise", "process": 0.05, "measurement": 0.001, "probability": 0.95}


def test_bad_noise_is_refused_by_name():
    slips: list[tuple[dict[str, Any], str]] = [
        ({}, "must not both be 0"),
        ({"process": 0.1, "probability": 1.0}, "probability must be above 0 and below 1, got 1"),
        ({"process": [[1.0, 0.5], [0.0, 1.0]]}, "process must be symmetric"),
        ({"measurement": [-1.0, 1.0]}, "measurement must be positive semidefinite"),
    ]
    for arguments, said in slips:
        with pytest.raises(dt.ArgumentError, match=said):
            dt.StationaryNoise(**arguments)
    with pytest.raises(dt.ArgumentError, match="measurement must be of n = 2 states, got a matrix"):
        input_peak(MODEL, LAW, H, dt.StationaryNoise(0.1, np.eye(3)))


def test_a_predictor_of_one_state_has_a_closed_form():
    """u_k = K P_k, P_{k+1} = (φ + γK) P_k + e^{aD} w_k: σ_u² = K² e^{2aD} q/(1 − (φ + γK)²)."""
    plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], delay=0.2)
    law = dt.SingleModePredictor(plant, [[[-2.0]]], 0)
    h, pole = 0.05, 2.0 - np.exp(0.05)
    q = 0.1 * np.expm1(2.0 * h) / 2.0
    variance = 4.0 * np.exp(0.4) * q / (1.0 - pole**2)
    found = input_covariance(plant, law.digital(h), 0, dt.StationaryNoise(0.1))
    assert found is not None
    assert found.item() == pytest.approx(variance, rel=1e-9)
