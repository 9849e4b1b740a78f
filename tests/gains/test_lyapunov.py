"""Common Lyapunov functions and joint designs: put back exactly, optimal, refused by name."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import solve_continuous_lyapunov

import deadtime as dt
import plants
from deadtime.base.errors import ArgumentError, InfeasibleError, SolverError
from deadtime.gains import CommonLyapunov, common_lyapunov, stabilize
from deadtime.gains.lyapunov import check_lyapunov, decaying_lyapunov, growth_in_norm
from deadtime.gains.state_feedback import check_gains
from deadtime.numerics import lmi

PROBLEM = dt.problems.paper()
seeds = st.integers(0, 2**32 - 1)


def given_gains(plant, value):
    return check_gains(plant, value, allow_unstable=True)


def without_common_p(a=8.0):
    """Two Hurwitz matrices, as modes with zero gains; a common P exists only for a < 3 + √8."""
    A = [[[-1.0, -1.0], [1.0, -1.0]], [[-1.0, -a], [1.0 / a, -1.0]]]
    plant = dt.SwitchedSystem(A, [[[0.0], [1.0]]] * 2, 1.0)
    return plant, np.zeros((2, 1, 2))


def exact(matrix):
    return [[Fraction(float(v)) for v in row] for row in matrix]


def times(X, Y):
    return [
        [sum(a * b for a, b in zip(r, c, strict=True)) for c in zip(*Y, strict=True)] for r in X
    ]


def is_positive_definite(M):
    """All pivots of Gaussian elimination positive, in rational arithmetic."""
    M = [row[:] for row in M]
    for k in range(len(M)):
        if M[k][k] <= 0:
            return False
        for i in range(k + 1, len(M)):
            factor = M[i][k] / M[k][k]
            M[i] = [a - factor * b for a, b in zip(M[i], M[k], strict=True)]
    return True


def holds_exactly(plant, gains, P, Q):
    """HᵀP + PH + Q negative definite for H = A + BK, without any rounding."""
    P, Q, n = exact(P), exact(Q), range(plant.states)
    for A, B, K in zip(plant.A, plant.B, gains, strict=True):
        BK = times(exact(B), exact(K))
        H = [[a + b for a, b in zip(r, s, strict=True)] for r, s in zip(exact(A), BK, strict=True)]
        PH = times(P, H)
        if not is_positive_definite([[-PH[i][j] - PH[j][i] - Q[i][j] for j in n] for i in n]):
            return False
    return is_positive_definite(P) and is_positive_definite(Q)


def random_plant(seed):
    rng = np.random.default_rng(seed)
    modes, n, m = rng.integers(1, 4), rng.integers(1, 4), rng.integers(1, 3)
    A = rng.normal(size=(n, n)) + 0.2 * rng.normal(size=(modes, n, n))
    B = rng.normal(size=(n, m)) + 0.1 * rng.normal(size=(modes, n, m))
    return dt.SwitchedSystem(A * 10.0 ** rng.uniform(-1, 1), B * 10.0 ** rng.uniform(-1, 1), 0.5)


def test_the_paper_s_example_has_the_known_ratio_of_q_to_p():
    found = common_lyapunov(PROBLEM.plant, PROBLEM.gains)
    assert np.linalg.norm(found.P, 2) == pytest.approx(1.0, abs=1e-15)
    assert np.linalg.eigvalsh(found.Q)[0] == pytest.approx(0.0582052, abs=1e-6)
    assert not found.P.flags.writeable
    assert not found.Q.flags.writeable


def test_for_one_mode_q_is_the_best_that_lyapunov_equations_allow():
    # H diagonal: P = I and q = 2·(slowest) are optimal by hand.
    plant = dt.SwitchedSystem([np.diag([-1.0, -3.0])], [[[0.0], [1.0]]], 1.0)
    found = common_lyapunov(plant, np.zeros((1, 1, 2)))
    assert np.linalg.eigvalsh(found.Q)[0] == pytest.approx(2.0, rel=1e-7)


def test_no_pair_from_random_search_has_a_larger_ratio():
    best = np.linalg.eigvalsh(common_lyapunov(PROBLEM.plant, PROBLEM.gains).Q)[0]
    H = PROBLEM.plant.A + PROBLEM.plant.B @ PROBLEM.gains
    rng = np.random.default_rng(0)
    for _ in range(2000):
        root = rng.normal(size=(2, 2))
        P = solve_continuous_lyapunov(H[rng.integers(2)].T, -root @ root.T)
        P /= np.linalg.norm(P, 2)
        assert min(np.linalg.eigvalsh(-(h.T @ P + P @ h))[0] for h in H) <= best * (1 + 1e-8)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seeds)
def test_a_design_and_its_common_p_hold_in_exact_arithmetic(seed):
    plant = random_plant(seed)
    try:
        design = stabilize(plant, 0.3)
        found = common_lyapunov(plant, design.gains)
    except InfeasibleError:
        return
    assert design.decay_rate >= 0.3
    assert holds_exactly(plant, design.gains, design.P, 0.599999 * design.P)
    assert np.linalg.norm(found.P, 2) == pytest.approx(1.0, abs=1e-14)
    assert holds_exactly(plant, design.gains, found.P, found.Q)


def test_hurwitz_modes_without_a_common_p_are_infeasible_with_the_solver_s_verdict():
    with pytest.raises(InfeasibleError, match=r"no common P: .*CLARABEL: infeasible"):
        common_lyapunov(*without_common_p())
    with pytest.raises(ValueError):
        common_lyapunov(*without_common_p())
    common_lyapunov(*without_common_p(3.0 + np.sqrt(8.0) - 1e-3))


def test_those_modes_do_diverge_under_some_switching():
    plant, _ = without_common_p(40.0)
    steps = [
        plants.held(A, B, tau)[0] for A, B, tau in zip(plant.A, plant.B, (0.8, 0.8), strict=True)
    ]
    assert np.abs(np.linalg.eigvals(steps[0] @ steps[1])).max() > 1.0


def test_gains_that_leave_a_mode_unstable_are_refused_by_name():
    with pytest.raises(ArgumentError, match=r"gains\[1\] leaves A \+ B K of mode 1 unstable"):
        common_lyapunov(PROBLEM.plant, [PROBLEM.gains[0], -PROBLEM.gains[1]])


def test_another_tolerance_takes_over_when_the_solver_fails(monkeypatch):
    solve = lmi.solve

    class PanicError(BaseException):
        """What a panic in compiled code looks like: no Exception."""

    def failing(solver, program, tolerance):
        if tolerance != 1e-6:
            raise PanicError("index out of bounds")
        return solve(solver, program, tolerance)

    monkeypatch.setattr(lmi, "solve", failing)
    found = common_lyapunov(PROBLEM.plant, PROBLEM.gains)
    assert np.linalg.eigvalsh(found.Q)[0] == pytest.approx(0.0582052, rel=1e-2)
    assert holds_exactly(PROBLEM.plant, PROBLEM.gains, found.P, found.Q)


def test_no_exception_from_inside_a_solver_reaches_the_user(monkeypatch):
    def failing(*_):
        raise RuntimeError("out of luck")

    monkeypatch.setattr(lmi, "solve", failing)
    with pytest.raises(SolverError, match=r"CLARABEL: failed \(RuntimeError\)\)"):
        common_lyapunov(PROBLEM.plant, PROBLEM.gains)
    with pytest.raises(SolverError, match=r"CLARABEL: failed \(RuntimeError\)\)"):
        stabilize(PROBLEM.plant, 1.0)
    assert decaying_lyapunov(PROBLEM.plant, PROBLEM.gains, 0.1) is None


def test_a_wrong_answer_of_a_solver_is_not_believed(monkeypatch):
    monkeypatch.setattr("deadtime.gains.lyapunov.symmetric_value", lambda *_: np.eye(2))
    with pytest.raises(InfeasibleError, match="CLARABEL: optimal, but it fails when put back"):
        common_lyapunov(PROBLEM.plant, PROBLEM.gains)


def test_ctrl_c_still_stops_a_solver(monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(lmi, "solve", interrupted)
    with pytest.raises(KeyboardInterrupt):
        common_lyapunov(PROBLEM.plant, PROBLEM.gains)


def test_a_user_s_pair_is_accepted_and_still_holds_exactly():
    K = given_gains(PROBLEM.plant, PROBLEM.gains)
    found = common_lyapunov(PROBLEM.plant, K)
    again = check_lyapunov(PROBLEM.plant, K, found)
    assert holds_exactly(PROBLEM.plant, K, again.P, again.Q)
    # A Lyapunov equation satisfies the inequality with equality, up to rounding.
    plant = dt.SwitchedSystem(PROBLEM.plant.A[:1], PROBLEM.plant.B[:1], 1.0)
    H = plant.A[0] + plant.B[0] @ K[0]
    P = solve_continuous_lyapunov(H.T, -np.eye(2))
    pair = check_lyapunov(plant, K[:1], (P, np.eye(2)))
    assert holds_exactly(plant, K[:1], pair.P, pair.Q)
    plants.close(pair.Q, np.eye(2), 1e-10)


@pytest.mark.parametrize(
    ("lyapunov", "message"),
    [
        (np.eye(2), r"lyapunov must be what common_lyapunov returns, or a pair \(P, Q\)"),
        ((np.eye(3), np.eye(2)), r"lyapunov: P must have shape \(n, n\) = \(2, 2\), got \(3, 3\)"),
        (([[1, 2], [0, 1]], np.eye(2)), "lyapunov: P must be symmetric"),
        (([[1, 2], [2, 1]], np.eye(2)), "lyapunov: P must be positive definite, got an eigen"),
        ((np.eye(2), np.diag([1.0, 0.0])), "lyapunov: Q must be positive definite"),
        ((np.eye(2), np.eye(2)), r"do not satisfy \(A \+ B K\)ᵀP .* in mode [01]: .* > 0: lower Q"),
        ((np.full((2, 2), np.nan), np.eye(2)), r"lyapunov: P\[0, 0\] must be finite"),
    ],
)
def test_a_user_s_pair_is_refused_by_name(lyapunov, message):
    with pytest.raises(ArgumentError, match=message):
        check_lyapunov(PROBLEM.plant, given_gains(PROBLEM.plant, PROBLEM.gains), lyapunov)


def test_a_q_too_small_for_rounding_is_refused():
    plant = dt.SwitchedSystem([np.diag([-1.0, -1e-16])], [[[0.0], [1.0]]], 1.0)
    pair = CommonLyapunov(np.eye(2), np.diag([1e-16, 1e-16]))
    with pytest.raises(ArgumentError, match="only up to rounding errors"):
        check_lyapunov(plant, given_gains(plant, np.zeros((1, 1, 2))), pair)


def test_growth_in_the_norm_of_p_bounds_products_of_exponentials():
    K = given_gains(PROBLEM.plant, PROBLEM.gains)
    found = decaying_lyapunov(PROBLEM.plant, K, 0.7)
    assert found is not None
    h = growth_in_norm(PROBLEM.plant, K, found.P)
    assert -0.7 - 1e-3 <= h <= -0.7 + 1e-6
    L = np.linalg.cholesky(found.P)
    H = PROBLEM.plant.A + PROBLEM.plant.B @ K
    rng = np.random.default_rng(1)
    product, total = np.eye(2), 0.0
    for _ in range(30):
        tau, i = rng.exponential(0.2), rng.integers(2)
        product, total = plants.held(H[i], np.zeros((2, 1)), tau)[0] @ product, total + tau
        assert np.linalg.norm(L.T @ product @ np.linalg.inv(L).T, 2) <= np.exp(h * total)


def test_no_p_decays_faster_than_the_slowest_pole():
    assert decaying_lyapunov(PROBLEM.plant, given_gains(PROBLEM.plant, PROBLEM.gains), 1.01) is None


@pytest.mark.parametrize("rate", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("problem", dt.problems.NAMED.values(), ids=dt.problems.NAMED)
def test_a_design_decays_at_the_rate_asked_for(problem, rate):
    plant = problem().plant
    design = stabilize(plant, rate)
    assert design.gains.shape == (plant.modes, plant.inputs, plant.states)
    assert rate <= design.decay_rate <= 1.1 * rate
    assert holds_exactly(plant, design.gains, design.P, 2.0 * (rate * (1 - 1e-9)) * design.P)
    assert np.linalg.eigvals(plant.A + plant.B @ design.gains).real.max() <= -rate


def test_a_design_scales_with_the_units_of_time_and_input():
    plant = PROBLEM.plant
    scaled = dt.SwitchedSystem(10.0 * plant.A, 30.0 * plant.B, plant.delay)
    base, other = stabilize(plant, 0.5), stabilize(scaled, 5.0)
    plants.close(other.gains * 3.0, base.gains, 1e-4)
    plants.close(other.P, base.P, 1e-4)


@pytest.mark.parametrize("unit", [1e-4, 1e-2, 1e2, 1e3])
def test_states_in_very_different_units_still_have_their_common_p(unit):
    T = np.diag([1.0, unit])
    A, B = T @ PROBLEM.plant.A @ np.linalg.inv(T), T @ PROBLEM.plant.B
    plant, gains = dt.SwitchedSystem(A, B, 1.0), PROBLEM.gains @ np.linalg.inv(T)
    found = common_lyapunov(plant, gains)
    assert holds_exactly(plant, gains, found.P, found.Q)
    assert stabilize(plant, 0.5).decay_rate >= 0.5


def test_an_unreachable_decay_rate_is_infeasible_with_the_solver_s_verdict():
    plant = dt.SwitchedSystem([[[1.0, 0.0], [0.0, -1.0]]], [[[0.0], [1.0]]], 1.0)
    with pytest.raises(InfeasibleError, match=r"decay rate of 0\.1 1/s .*CLARABEL: infeasible"):
        stabilize(plant, 0.1)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan")])
def test_a_decay_rate_must_be_a_positive_number(rate):
    with pytest.raises(ArgumentError, match="decay_rate must be"):
        stabilize(PROBLEM.plant, rate)
