"""Where a delay loses a constant mode: two other methods, touches by hand, closed forms."""

import numpy as np
import pytest
from scipy.linalg import block_diag, expm
from scipy.optimize import brentq, minimize_scalar, root

import deadtime as dt
import encirclements
import plants
from deadtime.base.wording import error_percent, inwards
from shares import mostly_long


def touching(omega=1.0, damping=0.5, factor=1.0, delay=1.0):
    """x'' + 2ζω x' + ω² x = −2ζω c x'(t − D): the gain c is reached at ω only."""
    A = [[[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]]]
    plant = dt.SwitchedSystem(A, [[[0.0], [1.0]]], delay)
    return plant, dt.DelayedStateFeedback(plant, [[[0.0, -2.0 * damping * omega * factor]]])


def crossing_pair(omega, damping, factor):
    """Of the same loop, the first delays of both frequencies at which the gain is 1, c > 1."""
    found = []
    for sign in (1.0, -1.0):
        half = sign * damping * omega * np.sqrt(factor**2 - 1.0)
        w = half + np.sqrt(half**2 + omega**2)
        # 1 + L = 0: the phase of iω'/(ω² − ω'² + 2iζωω') is turned to π by the delay.
        open_loop = np.angle(1j * w / (omega**2 - w**2 + 2j * damping * omega * w))
        found.append((np.pi + open_loop) / w)
    return np.array(found)


# -- touches -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("omega", "damping"), [(1.0, 0.5), (0.02, 0.1), (37.0, 0.9), (3.0, 0.01)])
def test_a_root_that_touches_the_axis_and_goes_back_ends_the_margin(omega, damping):
    for turns, (lower, upper) in ((0.3, (0.0, 1.0)), (1.7, (1.0, 3.0)), (3.1, (3.0, 5.0))):
        plant, law = touching(omega, damping, delay=turns * np.pi / omega)
        margin = dt.delay_margin(plant, law, None)
        assert margin.lower == pytest.approx(lower * np.pi / omega, rel=1e-9)
        assert margin.upper == pytest.approx(upper * np.pi / omega, rel=1e-9)
        assert margin.upper_frequency == pytest.approx(omega, rel=1e-7)


@pytest.mark.parametrize("factor", [1.0 + 1e-7, 1.0001, 1.3])
@pytest.mark.parametrize(("omega", "damping"), [(1.0, 0.5), (11.0, 0.02)])
def test_a_gain_just_above_one_ends_the_margin_at_the_nearer_of_two_delays(omega, damping, factor):
    margin = dt.delay_margin(*touching(omega, damping, factor, 0.2 / omega), None)
    assert margin.upper == pytest.approx(crossing_pair(omega, damping, factor).min(), rel=1e-9)


@pytest.mark.parametrize("factor", [1.0 - 1e-7, 0.999, 0.5])
def test_a_gain_just_below_one_tolerates_any_delay(factor):
    margin = dt.delay_margin(*touching(2.0, 0.3, factor), None)
    assert (margin.lower, margin.upper) == (0.0, np.inf)
    assert margin.message.endswith("whatever the true delay")


def test_a_touch_in_one_of_two_inputs_is_found_in_mixed_coordinates():
    one, other = touching(1.0)[0], touching(5.0, 0.4)[0]
    A, B = block_diag(one.A[0], other.A[0]), block_diag(one.B[0], other.B[0])
    K = block_diag([[0.0, -1.0]], [[0.0, -0.9 * 4.0]])
    T = np.array([[1.0, 0.4, 0, 0.2], [0, 2.0, 0.3, 0], [0.1, 0, 1.0, 0.5], [0, 0.7, 0, 1.5]])
    U = np.array([[1.0, 0.6], [-0.3, 2.0]])
    plant = dt.SwitchedSystem([T @ A @ np.linalg.inv(T)], [T @ B @ np.linalg.inv(U)], 0.8)
    law = dt.DelayedStateFeedback(plant, [U @ K @ np.linalg.inv(T)])
    assert dt.delay_margin(plant, law, None).upper == pytest.approx(np.pi, rel=1e-6)


@pytest.mark.long
def test_a_sampled_loop_whose_root_comes_close_and_goes_back_is_not_said_to_cross():
    plant, law = touching()
    margin = dt.delay_margin(plant, law, 0.01, upto=20.0)
    assert (margin.upper, margin.upper_mode) == (20.0, None)
    near = np.linspace(3.13, 3.145, 4)
    rates = [dt.growth_rate(dt.SwitchedSystem(plant.A, plant.B, D), law, 0) for D in near]
    assert -1e-4 < max(rates) < 0.0


def test_a_sampled_loop_ends_where_its_root_first_touches_the_circle():
    step = 0.1

    def closest(factor):
        """The delay near π at which the largest root is largest, and its modulus less 1."""
        plant, law = touching(factor=factor)
        table = law.digital(step)
        radius = lambda D: -radius_of(plant, table, 0, D)  # noqa: E731
        cells = np.linspace(3.0, 3.2, 41)
        best = cells[np.argmin([radius(D) for D in cells])]
        found = minimize_scalar(radius, (best - 0.01, best, best + 0.01), options={"xtol": 1e-10})
        return found.x, -found.fun - 1.0

    factor = brentq(lambda c: closest(c)[1], 1.0, 1.01, xtol=1e-13)
    delay, _ = closest(factor)
    crosses = dt.delay_margin(*touching(factor=factor + 1e-9), step)
    assert crosses.upper == pytest.approx(delay, abs=3e-4)
    assert dt.delay_margin(*touching(factor=factor - 1e-7), step).upper > 9.0


# -- a second method: eigenvalues of lifted loops, one delay after the other ----------------------


def lifted(plant, table, row, mode, delay):
    """The lifted loop by SciPy's exponentials and the definition alone."""
    h, A, B = table.step, plant.A[mode], plant.B[mode]
    n, m = B.shape
    N = max(1, int(np.ceil(delay / h - 1e-9)))
    phase = delay - (N - 1) * h
    taps = max(table.taps, N)
    L = np.zeros((n + taps * m, n + taps * m))
    F, G = table.state_gain[row], table.input_gain[row]
    L[n : n + m, :n] = F
    for j in range(table.taps):
        L[n : n + m, n + j * m : n + (j + 1) * m] = G[j]
    L[n + m :, n:-m] = np.eye((taps - 1) * m)
    L[:n, :n] += expm(A * h)
    late = plants.held(A, B, h - phase)[1]
    L[:n, n + (N - 1) * m : n + N * m] += expm(A * (h - phase)) @ plants.held(A, B, phase)[1]
    if N == 1:
        L[:n] += late @ L[n : n + m]
    else:
        L[:n, n + (N - 2) * m : n + (N - 1) * m] += late
    return L


def radius_of(plant, table, mode, delay):
    row = int(table.rows(np.full(1, mode), table.ages)[0])
    return np.abs(np.linalg.eigvals(lifted(plant, table, row, mode, delay))).max()


@pytest.mark.parametrize("seed", mostly_long(range(12), 0, 6, 8))
def test_sampled_loops_are_lost_where_the_eigenvalues_of_the_lifted_loop_say(seed):
    plant, law = encirclements.random_loop(seed)
    h, nominal = 0.1, plant.delay
    table = law.digital(h)
    margin = dt.delay_margin(plant, law, h, upto=3.0 * nominal)
    excess = lambda D: radius_of(plant, table, 0, D) - 1.0  # noqa: E731
    for end, found, lost in (
        (3.0 * nominal, margin.upper, margin.upper_mode),
        (1e-9, margin.lower, margin.lower_mode),
    ):
        delays = np.linspace(nominal, end, int(abs(end - nominal) / (h / 16.0)) + 2)
        over = np.flatnonzero([excess(D) > 0.0 for D in delays])
        if over.size:
            known = brentq(excess, *sorted(delays[over[0] - 1 : over[0] + 1]), xtol=1e-12)
            assert found == pytest.approx(known, rel=1e-7)
        else:
            assert lost is None


def test_two_inputs_whose_eigenvalues_change_with_the_delay_are_both_followed():
    # The gain at 21.5 rad/s grows from 0.6 to 1 within the period; the other eigenvalue passes 0.6.
    near = plants.generic().apart(0.1)
    plant = dt.SwitchedSystem(near.A + 2.5 * np.eye(3), near.B, 0.234)
    law = dt.AveragedPredictor(plant, dt.lqr(plant, np.eye(3), np.eye(2)))
    margin, table = dt.delay_margin(plant, law, 0.1), law.digital(0.1)
    known = brentq(lambda D: radius_of(plant, table, 0, D) - 1.0, 0.234, 0.295, xtol=1e-13)
    assert margin.upper == pytest.approx(known, rel=1e-8)
    assert margin.upper_mode == 0


def first_lost(plant, law, end):
    """The first delay from the nominal one towards `end` at which roots are on the right."""
    stable = plant.delay
    for unstable in np.linspace(stable, end, 120)[1:]:
        if encirclements.unstable_roots(plant, law, unstable):
            break
        stable = unstable
    else:
        return None
    while abs(unstable - stable) > 1e-3 * plant.delay:
        middle = 0.5 * (stable + unstable)
        lost = encirclements.unstable_roots(plant, law, middle)
        stable, unstable = (stable, middle) if lost else (middle, unstable)

    def equations(at):
        value = encirclements.determinant(plant, law, np.array([1j * at[0]]), at[1])[0]
        return value.real, value.imag

    axis = encirclements.AXIS
    frequency = axis.imag[np.abs(encirclements.determinant(plant, law, axis, stable)).argmin()]
    solved = root(equations, (frequency, stable), tol=1e-13)
    assert solved.success
    assert abs(solved.x[1] - stable) < 3e-3 * plant.delay
    return solved.x[1]


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", mostly_long(range(12), 0, 1, 3))
def test_ideal_loops_are_lost_where_roots_begin_to_be_encircled(seed):
    plant, law = encirclements.random_loop(seed + 100)
    margin = dt.delay_margin(plant, law, None, upto=3.0 * plant.delay)
    assert encirclements.unstable_roots(plant, law, plant.delay) == 0
    for end, found, mode in (
        (3.0 * plant.delay, margin.upper, margin.upper_mode),
        (1e-9, margin.lower, margin.lower_mode),
    ):
        known = first_lost(plant, law, end)
        assert (known is None) == (mode is None)
        if known is not None:
            assert found == pytest.approx(known, rel=1e-8)


# -- how far to look, and how to say it ------------------------------------------------------------


def test_longer_delays_are_tried_as_far_as_asked():
    # The gain of x' = −x − 1.01 x(t − D) is 1 at a low frequency, at a delay far away.
    plant = plants.scalar(-1.0, delay=0.1)
    law = dt.DelayedStateFeedback(plant, [[[-1.01]]])
    frequency = np.sqrt(1.01**2 - 1.0)
    limit = (np.pi - np.arctan(frequency)) / frequency
    for step, off in ((None, 0.0), (0.01, 0.005)):
        found = dt.delay_margin(plant, law, step, upto=30.0)
        assert found.upper == pytest.approx(limit - off, rel=1e-4 if step else 1e-12)
        short = dt.delay_margin(plant, law, step, upto=0.5 * limit)
        assert (short.upper, short.upper_mode) == (0.5 * limit, None)
        assert short.message.endswith("(longer ones were not tried)")


def test_margins_in_sentences_never_claim_more_than_was_computed():
    rng = np.random.default_rng(0)
    for nominal in 10.0 ** rng.uniform(-12.0, 3.0, 200):
        apart = 10.0 ** rng.uniform(-6.0, 0.0)
        for value in (nominal * (1.0 + 8.0 * apart), nominal * (1.0 - 0.999 * apart)):
            said, sign = float(inwards(value, nominal)), 1.0 if value > nominal else -1.0
            least = min(abs(value - nominal), value)
            assert -1e-15 * value <= sign * (value - said) <= 1.0001e-2 * least
            percent = float(error_percent(value, nominal).replace("−", "-").rstrip(" %"))
            exact = 100.0 * (value / nominal - 1.0)
            assert 0.99 * abs(exact) <= abs(percent) <= abs(exact) * (1.0 + 1e-9) + 1e-12
    assert inwards(0.10017, 5.0) == "0.101"
    plant, law = touching()
    assert "below 3.14 s (+214 %)" in dt.delay_margin(plant, law, None).message


@pytest.mark.parametrize(
    ("upto", "message"),
    [
        (1.0, r"upto must be longer than the nominal delay, 1 s, got 1: it is the longest true"),
        (-2.0, r"upto must be positive, in s, got -2"),
    ],
)
def test_a_search_that_ends_before_it_begins_is_refused(upto, message):
    with pytest.raises(dt.ArgumentError, match=message):
        dt.delay_margin(*touching(), None, upto=upto)
