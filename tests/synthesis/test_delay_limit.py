"""What any linear controller could reach: closed forms, quadrature, and loops that try."""

import itertools
import math

import mpmath
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import deadtime as dt
import plants
from deadtime.synthesis.limits import delay_weight, half_angle_weight


def one_mode(A, B, delay):
    return dt.SwitchedSystem(np.asarray(A, float)[None], np.asarray(B, float)[None], delay)


def weight(q):
    """W at a number, by adaptive quadrature."""
    near = quad(lambda x: np.log(2.0 * np.sin(x / 2.0) / x) * q / (q * q + x * x), 0.0, np.pi)[0]
    far = quad(
        lambda t: np.log(2.0 * t / np.pi) * np.pi * q / (q * q * t * t + np.pi**2), 0.0, 1.0
    )[0]
    return q * np.exp(2.0 / np.pi * (near + far))


@pytest.mark.parametrize("q", [0.01, 0.3, 2.0, 9.0])
def test_weights_are_the_outer_functions_of_their_moduli(q):
    assert delay_weight(np.array([[q]])).item() == pytest.approx(weight(q), rel=1e-8)

    def integrand(angle):
        level = np.log(np.tan(np.pi / 4.0 + angle / 4.0))
        return level * q / (q**2 * np.cos(angle) ** 2 + np.sin(angle) ** 2)

    value = np.exp(2.0 / np.pi * quad(integrand, 0.0, np.pi / 2.0, points=[min(q, 1.0)])[0])
    assert half_angle_weight(np.array([[q]])).item() == pytest.approx(value, rel=1e-8)


@pytest.mark.parametrize("x", [0.5, 2.0, 3.0, 5.0])
def test_on_the_axis_weights_have_their_moduli(x):
    q = np.array([[1e-5, x], [-x, 1e-5]])  # eigenvalues 1e-5 ± xi
    value = np.abs(np.linalg.eigvals(delay_weight(q)))[0]
    modulus = 2.0 * np.sin(x / 2.0) if x < np.pi else 2.0
    assert value == pytest.approx(modulus, rel=1e-3)
    value = np.abs(np.linalg.eigvals(half_angle_weight(q)))[0]
    assert value == pytest.approx(np.tan(np.pi / 4.0 + np.arctan(x) / 4.0), rel=1e-3)


@pytest.mark.parametrize("delay", [1.0, 2.0, 3.0])
def test_small_gain_of_one_pole_is_its_closed_form(delay):
    limit = dt.delay_limit(plants.scalar(1.0, 1.0, delay))
    expected = brentq(lambda part: weight(part * delay) * np.exp(delay) - 1.0, 1e-6, 1.0)
    assert limit.reached == pytest.approx(expected, rel=1e-8)
    assert limit.reached < limit.most


@pytest.mark.parametrize("p", [0.4, 1.0, 5.0])
def test_without_a_nominal_delay_the_interval_is_two_over_the_pole(p):
    # Middleton and Miller, theorem 4. D just above 1/p: delays from about 0 on.
    limit = dt.delay_limit(plants.scalar(p, 1.0, 1.02 / p))
    assert limit.most * 1.02 == pytest.approx(1.0, rel=1e-9)
    assert dt.delay_limit(plants.scalar(p, 1.0, 0.98 / p)).most == math.inf


def test_two_poles_are_worse_than_the_worse_of_them_and_two_inputs_take_them_apart():
    poles, delay = (1.0, 2.0), 1.5
    alone = [dt.delay_limit(plants.scalar(p, 1.0, delay)) for p in poles]
    together = dt.delay_limit(one_mode(np.diag(poles), [[1.0], [1.0]], delay))
    apart = dt.delay_limit(one_mode(np.diag(poles), np.eye(2), delay))
    assert together.reached < 0.7 * alone[1].reached
    assert together.most < 0.7 * alone[1].most
    assert apart.reached == pytest.approx(alone[1].reached, rel=1e-8)
    assert apart.most == pytest.approx(alone[1].most, rel=1e-8)


def test_a_double_pole_is_the_limit_of_two():
    double = dt.delay_limit(one_mode([[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]], 2.0))
    close = dt.delay_limit(one_mode([[1.0, 1.0], [0.0, 1.00001]], [[0.0], [1.0]], 2.0))
    assert double.reached == pytest.approx(close.reached, rel=1e-4)
    assert double.most == pytest.approx(close.most, rel=1e-4)


def test_limits_do_not_depend_on_units_or_on_stable_poles():
    plant = dt.problems.paper().plant
    limit = dt.delay_limit(plant, 1)
    V = np.array([[2.0, 0.3], [-1.0, 0.5]])
    A, B = V @ plant.A[1] @ np.linalg.inv(V) / 60.0, 7.0 * V @ plant.B[1]
    A = np.block([[A, np.zeros((2, 1))], [np.ones((1, 2)), -0.2 * np.eye(1)]])
    other = dt.delay_limit(one_mode(A, np.concatenate((B, [[0.3]])), 60.0))
    assert other.reached == pytest.approx(limit.reached, rel=1e-7)
    assert other.most == pytest.approx(limit.most, rel=1e-7)


@pytest.mark.parametrize("mode", [0, 1])
def test_no_gains_have_a_margin_beyond_what_no_linear_controller_has(mode):
    paper = dt.problems.paper().plant
    plant = one_mode(paper.A[mode], paper.B[mode], 1.0)
    limit, rng = dt.delay_limit(plant), np.random.default_rng(mode)
    found = [
        dt.delay_margin(plant, dt.SingleModePredictor(plant, dt.place(plant, poles), 0)).relative
        for poles in -np.exp(rng.uniform(-3.0, 2.0, (15, 2)))
    ]
    assert max(found) < limit.most
    assert max(found) > 0.5 * limit.reached


def test_the_exact_law_s_sensitivity_is_tied_to_the_unstable_poles_and_gives_its_margin():
    """T = −e^{−sD} K (sI − A − BK)⁻¹ e^{AD} B, against the spectrum of the ideal loop."""
    paper = dt.problems.paper()
    plant, K = one_mode(paper.plant.A[0], paper.plant.B[0], 1.0), paper.gains[0]
    A, B = plant.A[0], plant.B[0]

    def free(s):
        closed = s * np.eye(2) - A - B @ K
        return (-K @ np.linalg.solve(closed, plants.expm(A) @ B)).item()

    for pole in (1.0, 2.0):
        assert free(pole) == pytest.approx(np.exp(pole), rel=1e-9)
    margin = dt.delay_margin(plant, dt.SingleModePredictor(plant, [K], 0), None)
    for delay, omega in (
        (margin.lower, margin.lower_frequency),
        (margin.upper, margin.upper_frequency),
    ):
        turn = np.exp(-1j * omega * (delay - 1.0)) - 1.0
        assert abs(1.0 + turn * free(1j * omega) * np.exp(-1j * omega)) < 1e-6


def test_poles_on_the_axis_limit_only_what_small_gain_promises():
    assert dt.delay_limit(dt.problems.follower().plant).reached == math.inf
    limit = dt.delay_limit(one_mode([[0.0, 2.0], [-2.0, 0.0]], [[0.0], [1.0]], 1.0))
    assert limit.reached == pytest.approx(np.pi / 6.0)
    assert limit.most == math.inf


# -- poles that nearly coincide ------------------------------------------------------------------


def log_outer(level, p, points):
    """log of the outer function of log modulus level(x), at p, in many digits."""
    kernel = [
        mpmath.quad(lambda x: level(x) * p / (p * p + x * x), [a, b])
        for a, b in itertools.pairwise(points)
    ]
    return 2 / mpmath.pi * sum(kernel)


def small_gain_values(poles, delay, Delta):
    def near(x):
        return mpmath.log(mpmath.sinc(x / 2)) if x else mpmath.mpf(0)

    for p in poles:
        q = p * Delta
        far = mpmath.quad(
            lambda t, q=q: mpmath.log(2 * t / mpmath.pi) * mpmath.pi * q
            / (q * q * t * t + mpmath.pi**2), [0, 1]
        )  # fmt: skip
        log_W = log_outer(near, q, [0, q, 1, 3, mpmath.pi]) + 2 / mpmath.pi * far
        yield q * mpmath.exp(log_W + p * delay)


def necessary_values(poles, delay, Delta):
    def level(angle, q):
        log = mpmath.log(mpmath.tan(mpmath.pi / 4 + angle / 4))
        return log * q / (q**2 * mpmath.cos(angle) ** 2 + mpmath.sin(angle) ** 2)

    for p in poles:
        q = p * Delta
        corner = min(mpmath.atan(q), 1)
        ends = [0, corner, mpmath.pi / 2]
        log_O = 2 / mpmath.pi * mpmath.quad(lambda angle, q=q: level(angle, q), ends)
        yield mpmath.tan(mpmath.asin(q) / 2) * mpmath.exp(p * (delay - Delta) - log_O)


def pick_is_positive(values, poles):
    f, size = list(values), range(len(poles))
    entries = [[(1 - f[i] * f[j]) / (poles[i] + poles[j]) for j in size] for i in size]
    return min(mpmath.eigsy(mpmath.matrix(entries), eigvals_only=True)) >= 0


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("poles", "delay"),
    [
        ((1.0, 1.0 + 1e-7), 1.0),
        (tuple(1.0 + 0.03 * np.arange(5)), 0.2),
        (tuple(np.linspace(1.0, 1.001, 6)), 0.6),
    ],
)
def test_limits_of_nearly_equal_poles_are_those_of_a_pick_matrix_in_many_digits(poles, delay):
    limit = dt.delay_limit(one_mode(np.diag(poles), np.ones((len(poles), 1)), delay))
    with mpmath.workdps(50):
        exact = [mpmath.mpf(pole) for pole in poles]
        for values, found in ((small_gain_values, limit.reached), (necessary_values, limit.most)):
            if math.isinf(found):
                continue
            for factor, expected in ((1 - 1e-8, True), (1 + 1e-8, False)):
                at = values(exact, delay, mpmath.mpf(found * factor) * delay)
                assert pick_is_positive(at, exact) is expected


def test_with_several_inputs_the_pick_matrix_has_the_directions_of_the_rows():
    poles, delay = np.array([1.0, 1.7, 2.0]), 1.0
    B = np.array([[1.0, 0.2], [0.3, -1.0], [0.8, 0.5]])
    limit = dt.delay_limit(one_mode(np.diag(poles), B, delay))

    def least(error):
        f = np.array([weight(p * error) * np.exp(p * delay) for p in poles])
        X1 = (B @ B.T) / np.add.outer(poles, poles)
        return np.linalg.eigvalsh(X1 - f[:, None] * X1 * f).min()

    assert limit.reached == pytest.approx(brentq(least, 1e-3, 0.2), rel=1e-8)
    turn, scale = np.array([[0.6, 0.8], [-0.8, 0.6]]), np.diag([1e4, 1.0, 1e-5])
    same = dt.delay_limit(one_mode(np.diag(poles), scale @ B @ turn, delay))
    assert same.reached == pytest.approx(limit.reached, rel=1e-8)


def test_rows_of_several_inputs_that_cannot_be_told_apart_are_refused():
    B = np.random.default_rng(0).normal(size=(6, 2))
    with pytest.raises(dt.ArgumentError, match="mode 0 has unstable poles too close to each other"):
        dt.delay_limit(one_mode(np.diag(np.linspace(1.0, 1.001, 6)), B, 0.3))


@pytest.mark.parametrize("growth", [20.0, 50.0, 300.0])
def test_tiny_limits_are_their_asymptotes(growth):
    # W → pΔ and tan(½ asin pΔ) → pΔ/2 as Δ → 0.
    limit = dt.delay_limit(plants.scalar(1.0, 1.0, growth))
    assert limit.reached == pytest.approx(np.exp(-growth) / growth, rel=1e-7)
    assert limit.most == pytest.approx(2.0 * limit.reached, rel=1e-7)


def test_a_limit_too_small_for_a_number_is_rounded_to_its_safe_side():
    limit = dt.delay_limit(plants.scalar(1.0, 1.0, 800.0))
    assert limit.reached == 0.0
    assert 0.0 < limit.most < 1e-300


@pytest.mark.parametrize("fixed", [[[0.0]], [[0.0, 2.0], [-2.0, 0.0]]])
def test_a_pole_on_the_axis_that_no_input_reaches_is_refused(fixed):
    size = len(fixed)
    A = np.zeros((size + 1, size + 1))
    A[:size, :size], A[size, size] = fixed, 1.0
    with pytest.raises(dt.ArgumentError, match="mode 0 cannot be stabilised: no input reaches"):
        dt.delay_limit(one_mode(A, [[0.0]] * size + [[1.0]], 1.0))


def test_an_unstable_pole_that_no_input_reaches_is_refused():
    with pytest.raises(dt.ArgumentError, match="mode 0 cannot be stabilised"):
        dt.delay_limit(one_mode(np.diag([1.0, 2.0]), [[1.0], [0.0]], 1.0))
    calm = dt.delay_limit(one_mode(np.diag([1.0, -2.0]), [[1.0], [0.0]], 2.0))
    assert calm.reached < 0.08
    with pytest.raises(dt.ArgumentError, match=r"mode must be in 0..0"):
        dt.delay_limit(plants.scalar(1.0), 1)
