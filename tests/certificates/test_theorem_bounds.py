"""No run and no window contradicts the theorem's bounds."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

import deadtime as dt
import plants
import windows
from deadtime.certificates.theorem.sharp import (
    closed_loop_mismatch,
    euclidean,
    logarithmic_norm,
    weighted_norm,
)
from deadtime.gains import common_lyapunov
from theorem_cases import CASES, FORMS, PROVEN, bound_of, each_case, quick, seeds


@functools.cache
def known(name, form, pieces=3):
    """The bound of a named case, for signals with at most `pieces` pieces in a window."""
    return bound_of(CASES[name], form, CASES[name][0].delay / pieces)


def shrunk(case, factor):
    """Modes and gains pulled towards their means."""
    plant, gains = case

    def towards_mean(M):
        return M.mean(axis=0) + factor * (M - M.mean(axis=0))

    A, B = towards_mean(plant.A), towards_mean(plant.B)
    return dt.SwitchedSystem(A, B, plant.delay), towards_mean(gains)


@functools.cache
def close_enough(name, form):
    """The case with modes pulled together until ε < ε*, and its bound."""
    case, factor = CASES[name], 1.0
    while True:
        pulled = shrunk(case, factor)
        bound = bound_of(pulled, form)
        if bound.holds:
            return pulled, bound
        factor *= min(0.9, 0.9 * bound.epsilon_star / bound.epsilon)


names = st.sampled_from(sorted(CASES))


@quick
@given(seeds, names, st.sampled_from([1, 4]))
def test_the_mismatch_of_every_window_is_within_delta1_and_delta2(seed, name, pieces):
    window = windows.random_window(*CASES[name], seed, pieces)
    mismatch = float(np.linalg.norm(window.mismatch()))
    state, (inputs, _) = float(np.linalg.norm(window.x)), window.input_norms()
    for form in FORMS:
        bound = known(name, form, pieces)
        eps = bound.epsilon
        assert mismatch <= bound.delta1(eps) * state + bound.delta2(eps) * inputs
        assert mismatch <= bound.lam(eps) * (state + inputs)


def test_the_sharp_bound_of_the_mismatch_is_nearly_attained():
    bound = known("scalar", "sharp")
    ratios = []
    for mode in range(2):
        for x, u in ((1.0, 0.0), (0.0, 1.0)):
            inputs, modes = np.array([[u], [0.0]]), np.array([mode, mode])
            lengths = np.array([0.01, 0.99]) * 0.25
            window = windows.Window(*CASES["scalar"], np.array([x]), lengths, modes, inputs, mode)
            allowed = bound.delta1(bound.epsilon) * x
            allowed += bound.delta2(bound.epsilon) * window.input_norms()[0]
            ratios.append(abs(float(window.mismatch()[0])) / allowed)
    assert 0.5 < max(ratios) <= 1.0


@quick
@given(seeds, names, st.booleans())
def test_nu1_and_nu2_bound_the_transformations_of_every_window(seed, name, quiet):
    window = windows.random_window(*CASES[name], seed, quiet=quiet)
    state, (_, inputs) = float(window.x @ window.x), window.input_norms()
    _, weights, sizes, _ = window.transformed()
    transformed = float(weights @ sizes**2)
    for form in FORMS:
        bound = known(name, form)
        assert inputs <= bound.nu1 * (state + transformed)
        assert transformed <= bound.nu2 * (state + inputs)


@quick
@given(seeds, names, st.sampled_from([1, 4, 12]), st.booleans())
def test_the_mismatch_along_the_closed_loop_is_within_its_kernel(seed, name, pieces, quiet):
    plant, gains = CASES[name]
    window = windows.random_window(plant, gains, seed, pieces, quiet)
    ages, weights, sizes, _ = window.transformed()
    mismatch = float(np.linalg.norm(window.mismatch()))
    pair = known(name, "sharp").lyapunov
    for norm, S in (
        (euclidean(plant, gains, pair), np.eye(plant.states)),
        (weighted_norm(plant, gains, pair), pair.P),
    ):
        log_c1, kernel = closed_loop_mismatch(plant, gains, norm)
        k = sum(np.exp(coefficient + exponent * ages) for coefficient, exponent in kernel)
        state = math.exp(log_c1) * math.sqrt(window.x @ S @ window.x)
        assert mismatch <= known(name, "sharp").epsilon * (state + weights @ (k * sizes))


@each_case
def test_both_routes_split_the_derivative_of_v_as_the_theory_says(case):
    # max over w of 2XᵀP(HX + Bw) − b|w|² is Xᵀ(HᵀP + PH + PBBᵀP/b)X ≤ −(b/γ²)|X|_S² ≤ −ωXᵀPX.
    plant, gains = case
    pair = common_lyapunov(plant, gains)
    P, H = pair.P, plant.A + plant.B @ gains
    for norm, S in (
        (euclidean(plant, gains, pair), np.eye(plant.states)),
        (weighted_norm(plant, gains, pair), P),
    ):
        b, share = math.exp(norm.log_b), math.exp(norm.log_b - norm.log_gamma2)
        for h, B in zip(H, plant.B, strict=True):
            rest = -(h.T @ P + P @ h) - P @ B @ B.T @ P / b - share * S
            assert np.linalg.eigvalsh(rest)[0] >= -1e-12 * np.linalg.norm(h, 2)
        assert np.linalg.eigvalsh(share * S - norm.omega * P)[0] >= -1e-12


@quick
@given(seeds, names, st.sampled_from(PROVEN), st.booleans())
def test_v_decreases_at_the_rate_mu_from_every_window(seed, name, form, quiet):
    case, bound = close_enough(name, form)
    plant, gains = case
    assert bound.epsilon < bound.epsilon_star
    window = windows.random_window(*case, seed, quiet=quiet)
    P, b, c = bound.lyapunov.P, bound.b, bound.weight
    x, i = window.x, window.modes[0]
    ages, weights, sizes, oldest = window.transformed()
    past = float(weights @ (np.exp(c * (plant.delay - ages)) * sizes**2))
    newest = window.mismatch()
    flow = (plant.A[i] + plant.B[i] @ gains[i]) @ x + plant.B[i] @ oldest
    V = x @ P @ x + b * past
    slope = 2.0 * x @ P @ flow - b * float(oldest @ oldest) - b * c * past
    slope += b * math.exp(c * plant.delay) * float(newest @ newest)
    assert bound.mu is not None
    assert slope <= -bound.mu * V


@quick
@given(seeds, names)
def test_products_of_exponentials_differ_by_no_more_than_the_bounds(seed, name):
    plant, gains = CASES[name]
    window = windows.random_window(plant, gains, seed)
    i, D = int(window.modes[-1]), plant.delay
    distance = max(np.linalg.norm(A - C, 2) for A in plant.A for C in plant.A)
    M_A = max(np.linalg.norm(A, 2) for A in plant.A)
    a = logarithmic_norm(plant.A)
    true = windows.product(plant.A, window.lengths, window.modes)
    one = windows.product(plant.A, window.lengths, np.full_like(window.modes, i))
    gap, k = np.linalg.norm(one - true, 2), len(window.modes) - 1
    assert gap <= distance * D * math.exp(a * D) * (1.0 + 1e-12) + 1e-14
    assert gap <= distance * (k + 1) * D * math.exp((M_A + distance) * D)  # (45)
    for tau, m in zip(window.lengths, window.modes, strict=True):
        step = (
            plants.held(plant.A[i], plant.B[i], tau)[0]
            - plants.held(plant.A[m], plant.B[m], tau)[0]
        )
        assert np.linalg.norm(step, 2) <= distance * tau * math.exp(a * tau) + 1e-14


@pytest.mark.parametrize("form", PROVEN)
@pytest.mark.parametrize("name", CASES)
def test_runs_stay_below_the_theorem_s_envelope(name, form):
    (plant, gains), bound = close_enough(name, form)
    law = dt.AveragedPredictor(plant, gains)
    step, horizon = plant.delay / 100.0, 6.0 * plant.delay + 4.0
    n = round(plant.delay / step)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        signal = dt.SwitchingSignal.random(plant.modes, horizon, dwell_time=0.2, seed=seed)
        past = rng.normal(size=(plant.inputs, n))
        x0 = rng.normal(size=plant.states)
        run = dt.simulate(plant, law, signal, x0, horizon, step, u0=past)
        squares = np.sum(np.hstack([past, run.inputs]) ** 2, axis=0) * step
        total = np.concatenate([[0.0], np.cumsum(squares)])
        energy = np.sqrt(np.maximum(total[n : n + run.time.size] - total[: run.time.size], 0.0))
        size = np.linalg.norm(run.states, axis=0) + energy
        assert bound.rho is not None
        assert bound.xi is not None
        assert (size <= bound.rho * np.exp(-bound.xi * run.time) * size[0]).all()
        assert size[-1] < size.max()


def test_an_example_with_modes_far_apart_holds_and_converges():
    # Not only tiny differences: a slow plant with weak gains has a useful ε*.
    case = plants.scalar([0.02, 0.05], 1.0, 0.5), np.array([[[-0.1]], [[-0.13]]])
    bound = bound_of(case, "sharp")
    assert bound.epsilon == pytest.approx(0.03)
    assert bound.holds
