"""The theorem's constants: second methods, and bounds that no run and no window contradicts."""

import functools
import math

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import quad
from scipy.optimize import minimize_scalar

import deadtime as dt
import plants
import windows
from deadtime.base.errors import ArgumentError, InfeasibleError
from deadtime.certificates import theorem_bound
from deadtime.certificates.theorem.sharp import (
    closed_loop_mismatch,
    euclidean,
    logarithmic_norm,
    weighted_norm,
)
from deadtime.gains import common_lyapunov, stabilize
from deadtime.numerics.logs import log_integral, log_inverse, log_one_plus, log_sum

FORMS = ("printed", "corrected", "sharp")
PROVEN = ("corrected", "sharp")
PAPER, THREE = dt.problems.paper(), dt.problems.three_mode()
CASES = {
    "paper": (PAPER.plant, PAPER.gains),
    "three-mode": (THREE.plant, THREE.gains),
    "follower": (dt.problems.follower().plant, dt.problems.follower().gains),
    "scalar": (plants.scalar([0.3, 0.5], [1.0, 1.2]), np.array([[[-1.0]], [[-1.2]]])),
    "stable": (plants.scalar([-1.0, -1.1, -0.9], 1.0, 2.0), np.full((3, 1, 1), -0.1)),
}
each_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES)
seeds = st.integers(0, 2**32 - 1)
quick = settings(max_examples=40, deadline=None, derandomize=True)


def bound_of(case, form, dwell_time=0.2, lyapunov=None):
    return theorem_bound(*case, dwell_time, lyapunov, form)


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


def random_case(seed):
    """A random plant with a joint design, or None where there is none."""
    rng = np.random.default_rng(seed)
    modes, n, m = rng.integers(2, 4), rng.integers(1, 4), rng.integers(1, 3)
    spread = 10.0 ** rng.uniform(-6, 0)
    A = 10.0 ** rng.uniform(-2, 0.7) * rng.normal(size=(n, n))
    B = 10.0 ** rng.uniform(-1, 1) * rng.normal(size=(n, m))
    plant = dt.SwitchedSystem(
        A + spread * rng.normal(size=(modes, n, n)),
        B + spread * rng.normal(size=(modes, n, m)),
        10.0 ** rng.uniform(-3, 0.7),
    )
    try:
        return plant, stabilize(plant, 10.0 ** rng.uniform(-2, 0.5)).gains
    except InfeasibleError:
        return None


# --- the paper's example, and second methods -------------------------------------------------


def test_the_paper_s_example_has_the_known_constants():
    bound = bound_of(CASES["paper"], "printed")
    assert bound.epsilon == pytest.approx(0.7895, abs=5e-5)
    assert bound.epsilon_star == pytest.approx(1.741e-14, rel=1e-3)
    assert bound.nu1 == pytest.approx(1.730e15, rel=1e-3)
    assert not bound.holds
    assert (bound.mu, bound.rho, bound.xi, bound.log10_rho) == (None, None, None, None)
    assert "does not apply" in bound.message
    assert "does not apply" in repr(bound)


def test_the_sharp_epsilon_star_is_ten_orders_above_the_printed_one():
    printed, sharp = (bound_of(CASES["paper"], form) for form in ("printed", "sharp"))
    assert sharp.epsilon_star > 1e10 * printed.epsilon_star
    assert sharp.epsilon_star > 1.4e-3
    given_p = bound_of(CASES["paper"], "sharp", lyapunov=common_lyapunov(*CASES["paper"]))
    assert 1e-4 < given_p.epsilon_star < sharp.epsilon_star


@pytest.mark.parametrize("corrected", [False, True])
@pytest.mark.parametrize("delay", [0.01, 1.0, 300.0])
def test_the_paper_s_formulas_in_fifty_digits_give_the_same_constants(delay, corrected):
    plant = dt.SwitchedSystem(PAPER.plant.A, PAPER.plant.B, delay)
    pair = common_lyapunov(plant, PAPER.gains)
    bound = theorem_bound(plant, PAPER.gains, 0.2, pair, "corrected" if corrected else "printed")
    H = plant.A + plant.B @ PAPER.gains
    with mpmath.workdps(50):
        M_A, M_B, M_K, M_H = (
            mpmath.mpf(max(np.linalg.norm(m, 2) for m in M))
            for M in (plant.A, plant.B, PAPER.gains, H)
        )
        D, q, e = mpmath.mpf(delay), mpmath.mpf(np.linalg.eigvalsh(pair.Q)[0]), mpmath.exp
        small, large = map(mpmath.mpf, np.linalg.eigvalsh(pair.P))

        def nu(M):
            return 2 * max(
                2 * M_K**2 * D * e(2 * M * D), 1 + 2 * M_K**2 * D**2 * e(2 * M * D) * M_B**2
            )

        def lam(eps):
            first = eps * e(M_A * D) * (M_K * (D / 0.2 + 2) * D * e(eps * D) + 1)
            tail = e(eps * D) * D * M_B * (1 + e(M_A * D) * (D / 0.2 + 1)) + 1
            return max(first, eps * e(M_A * D) * (M_K * tail + M_B))

        b = 2 * (M_B * large) ** 2 / q
        allowed = min(
            1 / mpmath.sqrt(2 * e(D) * D * nu(M_H)),
            q / (2 * M_B * large * mpmath.sqrt(2 * e(D) * (D * nu(M_H) + corrected))),
        )
        kappa = max(large, b * e(D)) / min(small, b)
        star = mpmath.mpf(10) ** bound.log10_epsilon_star
        expected = {
            "log10_nu1": mpmath.log10(nu(M_H)),
            "log10_nu2": mpmath.log10(nu(M_A)),
            "log10_kappa": mpmath.log10(kappa),
        }
        for name, value in expected.items():
            assert getattr(bound, name) == pytest.approx(float(value), rel=1e-12, abs=1e-12)
        assert float(mpmath.log10(lam(star)) - mpmath.log10(allowed)) == pytest.approx(0, abs=1e-9)
        assert bound.b == pytest.approx(float(b), rel=1e-12)
        for eps in (1e-9, 1e-3, 0.5):
            value = float(mpmath.log10(lam(mpmath.mpf(eps))))
            ours = bound.constants.log_lambda(math.log(eps)) / math.log(10)
            assert ours == pytest.approx(value, rel=1e-12, abs=1e-12)


@each_case
def test_the_sharp_epsilon_star_by_quadrature_and_search_is_the_same(case):
    plant, gains = case
    pair = common_lyapunov(plant, gains)
    D, P, q = plant.delay, pair.P, np.linalg.eigvalsh(pair.Q)[0]
    H = plant.A + plant.B @ gains
    root = np.linalg.cholesky(P).T

    def norm(stack):
        return max(np.linalg.norm(m, 2) for m in stack)

    share, M_K = 1.0 - 1.0 / plant.modes, norm(gains)
    a = max(np.linalg.eigvalsh(A + A.T)[-1] / 2.0 for A in plant.A)
    best = []
    for S in (np.eye(plant.states), root):
        inverse = np.linalg.inv(S)
        flows = S @ H @ inverse
        h = max(np.linalg.eigvalsh(G + G.T)[-1] / 2.0 for G in flows)
        thin, entry, gain = np.linalg.norm(inverse, 2), norm(S @ plant.B), norm(gains @ inverse)
        gamma = 2.0 * norm(P @ plant.B) / q if S is not root else entry / -h
        spread = min(D, 1.0 / abs(a - h))

        def kernel(r, a=a, h=h, thin=thin, entry=entry, gain=gain, spread=spread):
            state = M_K * (thin + gain) * spread * np.exp(max(a, h) * r) + thin * np.exp(h * r)
            return share * (entry * state + M_K * np.exp(a * r)), share * state

        def inverse_square(log_c, kernel=kernel, gamma=gamma):
            c = np.exp(log_c)
            window = quad(lambda r: kernel(r)[0] ** 2 * np.exp(-c * (D - r)), 0.0, D)[0]
            return np.exp(c * D) * (kernel(D)[1] ** 2 * gamma**2 + window / c)

        found = minimize_scalar(
            lambda z, f=inverse_square: math.log(f(z)),
            bounds=(-5.0 - math.log(D), 5.0 - math.log(D)),
            method="bounded",
            options={"xatol": 1e-9},
        )
        best.append(math.exp(-found.fun / 2.0))
    assert theorem_bound(plant, gains, 1.0, pair, "sharp").epsilon_star == pytest.approx(
        max(best), rel=1e-6
    )


def test_one_scalar_plant_by_hand():
    # One mode, a = −1, b = 1, K = −1, D = 1: H = −2, so P = 1, Q = 4; M_H = 2, M_A = M_K = M_B = 1.
    case = plants.scalar([-1.0], 1.0, 1.0), np.array([[[-1.0]]])
    bound = bound_of(case, "corrected")
    nu1, nu2 = 2.0 + 4.0 * math.exp(4.0), 2.0 + 4.0 * math.exp(2.0)
    assert bound.nu1 == pytest.approx(nu1, rel=1e-12)
    assert bound.nu2 == pytest.approx(nu2, rel=1e-12)
    assert bound.b == pytest.approx(0.5, rel=1e-7)
    assert bound.kappa == pytest.approx(math.e / 1.0, rel=1e-7)
    assert bound.mu == pytest.approx(1.0, rel=1e-12)
    assert (
        bound.rho
        == pytest.approx(
            math.sqrt(2.0 * (1.0 + nu1) * (1.0 + nu2) * max(1.0, 0.5 * math.e) / 0.5), rel=1e-7
        )
        or bound.rho is None
    )
    sharp = bound_of(case, "sharp")
    assert sharp.nu1 == pytest.approx(
        (1 + (1 - math.exp(-2)) / 2) ** 2 + (1 - math.exp(-4)) / 4, rel=1e-9
    )
    assert sharp.epsilon_star == math.inf
    assert sharp.lam(1.0) == 0.0


# --- never contradicted ----------------------------------------------------------------------


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


# --- order, monotonicity, invariance ---------------------------------------------------------


@settings(max_examples=10, deadline=None, derandomize=True)
@given(seeds)
def test_the_forms_are_ordered_on_random_plants(seed):
    case = random_case(seed)
    if case is None:
        return
    try:
        printed, corrected, sharp = (bound_of(case, form, case[0].delay) for form in FORMS)
    except InfeasibleError:
        return
    assert corrected.log10_epsilon_star <= printed.log10_epsilon_star
    assert sharp.log10_epsilon_star > corrected.log10_epsilon_star
    slack = 1e-9
    assert sharp.log10_nu1 <= corrected.log10_nu1 + slack
    assert sharp.log10_nu2 <= corrected.log10_nu2 + slack
    assert corrected.log10_nu1 == printed.log10_nu1
    for eps in (1e-6, printed.epsilon):
        assert sharp.delta1(eps) <= printed.delta1(eps)
        assert sharp.delta2(eps) <= printed.delta2(eps)


@each_case
def test_lambda_increases_from_zero(case):
    for form in FORMS:
        bound = bound_of(case, form)
        values = [bound.lam(eps) for eps in (0.0, 1e-300, 1e-9, 1e-3, 0.1, 1.0)]
        assert values[0] == 0.0
        assert (np.diff(values) > 0.0).all()
        assert bound.lam(0.1) == max(bound.delta1(0.1), bound.delta2(0.1))


@pytest.mark.parametrize("form", FORMS)
def test_a_longer_delay_leaves_less_room(form):
    stars = [
        theorem_bound(
            dt.SwitchedSystem(PAPER.plant.A, PAPER.plant.B, D), PAPER.gains, 0.2, form=form
        ).log10_epsilon_star
        for D in (0.01, 0.1, 1.0, 3.0, 10.0)
    ]
    assert (np.diff(stars) < 0.0).all()


@pytest.mark.parametrize("form", ["printed", "corrected"])
def test_dwell_times_down_to_the_least_float_scale_epsilon_star_with_them(form):
    # While D/τ_d is large, δ₁ and δ₂ are proportional to it.
    of = functools.partial(bound_of, CASES["paper"], form)
    known = of(1e-100).log10_epsilon_star + 100.0
    for dwell_time in (1e-300, 1e-308, 5e-324):
        found = of(dwell_time)
        assert found.log10_epsilon_star - math.log10(dwell_time) == pytest.approx(known, abs=1e-9)
        assert not found.holds
        assert math.isinf(found.delta1(0.1)) == (dwell_time < 1e-306)


def test_only_the_sharp_constants_do_not_depend_on_the_dwell_time():
    for form in FORMS:
        stars = [bound_of(CASES["paper"], form, tau).epsilon_star for tau in (0.1, 1.0)]
        assert (stars[0] == stars[1]) == (form == "sharp")
        assert stars[0] <= stars[1]


@pytest.mark.parametrize("form", FORMS)
def test_rotating_the_state_changes_nothing(form):
    plant, gains = CASES["follower"]
    R = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    turned = dt.SwitchedSystem(R @ plant.A @ R.T, R @ plant.B, plant.delay), gains @ R.T
    one, other = bound_of((plant, gains), form), bound_of(turned, form)
    for name in ("epsilon", "epsilon_star", "nu1", "nu2"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-4)


@pytest.mark.parametrize("form", PROVEN)
def test_scaling_p_and_q_together_changes_no_epsilon_star(form):
    pair = common_lyapunov(*CASES["paper"])
    one = bound_of(CASES["paper"], form, lyapunov=pair)
    other = bound_of(CASES["paper"], form, lyapunov=(pair.P / 7.0, pair.Q / 7.0))
    assert one.log10_epsilon_star == pytest.approx(other.log10_epsilon_star, rel=1e-9)
    assert one.log10_kappa == pytest.approx(other.log10_kappa, rel=1e-9)


def test_identical_modes_always_satisfy_the_theorem():
    plant = plants.identical()
    gains = np.tile(plants.gains(plant)[:1], (plant.modes, 1, 1))
    for form in FORMS:
        bound = bound_of((plant, gains), form)
        assert bound.epsilon == 0.0
        assert bound.holds
        assert bound.mu is not None
        assert bound.mu > 0.0


# --- overflow --------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("delay", [50.0, 1e3, 1e6])
def test_long_delays_neither_overflow_nor_warn(delay, form):
    plant = dt.SwitchedSystem(PAPER.plant.A, PAPER.plant.B, delay)
    bound = theorem_bound(plant, PAPER.gains, 0.2, form=form)
    M_A = logarithmic_norm(plant.A) if form == "sharp" else np.linalg.norm(plant.A[1], 2)
    assert bound.log10_nu2 == pytest.approx(2.0 * M_A * delay / math.log(10.0), rel=0.2)
    assert math.isfinite(bound.log10_epsilon_star)
    assert bound.log10_epsilon_star < -0.9 * M_A * delay / math.log(10.0)
    if delay >= 1e3:
        assert bound.epsilon_star == 0.0
        assert bound.nu2 == bound.lam(0.1) == math.inf
        assert not bound.holds
    for eps in (0.0, 1e-300, 1.0, 1e300):
        assert bound.lam(eps) >= 0.0


def test_log_sums_and_integrals():
    assert log_sum((1000.0, 1000.0)) == pytest.approx(1000.0 + math.log(2.0))
    assert log_sum((-math.inf, -math.inf)) == -math.inf
    assert log_sum((math.inf, 0.0)) == math.inf
    assert log_one_plus(-math.inf) == 0.0
    for rate in (-3.0, -1e-12, 0.0, 1e-12, 2.0):
        value = quad(lambda t, r=rate: math.exp(r * t), 0.0, 1.5)[0]
        assert log_integral(rate, 1.5) == pytest.approx(math.log(value), abs=1e-12)
    assert log_integral(1e4, 1.0) == pytest.approx(1e4 - math.log(1e4), rel=1e-12)


@quick
@given(st.floats(-2000.0, 2.0), st.floats(-5.0, 5.0))
def test_the_inverse_is_put_back_and_is_the_largest(target, slope):
    def function(x):
        return x + slope + math.exp(min(x, 600.0))

    x = log_inverse(function, target)
    assert function(x) <= target
    assert function(x + 1e-9 * max(1.0, abs(x))) > target


# --- bad input -------------------------------------------------------------------------------


@pytest.mark.parametrize("dwell_time", [0.0, -0.1, math.nan, math.inf])
def test_a_dwell_time_must_be_positive_and_finite(dwell_time):
    with pytest.raises(ArgumentError, match="dwell_time must be"):
        bound_of(CASES["paper"], "corrected", dwell_time)


def test_an_unknown_form_is_refused_with_the_known_ones():
    with pytest.raises(ArgumentError, match="form must be one of 'printed', 'corrected', 'sharp'"):
        bound_of(CASES["paper"], "exact")


@pytest.mark.parametrize("form", FORMS)
def test_a_p_that_is_no_lyapunov_matrix_is_refused(form):
    with pytest.raises(ArgumentError, match="P must be positive definite"):
        bound_of(CASES["paper"], form, lyapunov=(np.diag([1.0, -1.0]), np.eye(2)))
    with pytest.raises(ArgumentError, match="do not satisfy"):
        bound_of(CASES["paper"], form, lyapunov=(np.eye(2), np.eye(2)))


@pytest.mark.parametrize("form", FORMS)
def test_modes_without_a_common_p_are_infeasible(form):
    A = [[[-1.0, -1.0], [1.0, -1.0]], [[-1.0, -8.0], [0.125, -1.0]]]
    plant = dt.SwitchedSystem(A, [[[0.0], [1.0]]] * 2, 1.0)
    with pytest.raises(InfeasibleError, match=r"no common P: .*infeasible"):
        theorem_bound(plant, np.zeros((2, 1, 2)), 1.0, form=form)


def test_gains_of_the_wrong_sign_and_a_plant_without_input_are_refused():
    with pytest.raises(ArgumentError, match=r"leaves A \+ B K of mode 1 unstable"):
        theorem_bound(PAPER.plant, -PAPER.gains, 0.2)
    plant = dt.SwitchedSystem(-np.ones((2, 1, 1)), np.zeros((2, 1, 1)), 1.0)
    with pytest.raises(ArgumentError, match="no input acts"):
        theorem_bound(plant, np.zeros((2, 1, 1)), 0.2)


@pytest.mark.parametrize("eps", [-0.1, math.nan])
def test_a_distance_must_not_be_negative(eps):
    bound = bound_of(CASES["paper"], "corrected")
    for function in (bound.delta1, bound.delta2, bound.lam):
        with pytest.raises(ArgumentError, match="eps must be"):
            function(eps)
