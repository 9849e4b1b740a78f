"""The theorem's constants are ordered, invariant and finite, or refused by name."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import quad

import deadtime as dt
import plants
from deadtime.base.errors import ArgumentError, InfeasibleError
from deadtime.certificates import theorem_bound
from deadtime.certificates.theorem.sharp import logarithmic_norm
from deadtime.gains import common_lyapunov, stabilize
from deadtime.numerics.logarithms import log_integral, log_inverse, log_one_plus, log_sum
from theorem_cases import CASES, FORMS, PAPER, PROVEN, bound_of, each_case, quick, seeds


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


@pytest.mark.few(1)
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
