"""Each slip of docs/errata.md: what is printed fails, what it should be holds.

Equation numbers are those of the printed paper, arXiv 2503.08446.
"""

import math
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import deadtime as dt
import plants
import windows
from deadtime.certificates import theorem_bound

ERRATA = Path(__file__).parents[2] / "docs" / "errata.md"
THREE = dt.problems.three_mode()
# Modes that do not commute, three different ones in one window, and one more afterwards.
PLANT = dt.SwitchedSystem(
    [[[0.2, 1.0], [-1.0, 0.1]], [[-0.3, 0.4], [0.9, 0.5]], [[0.5, -0.8], [0.1, -0.6]]],
    [[[0.0], [1.0]], [[0.3], [0.8]], [[-0.4], [1.2]]],
    delay=1.0,
)
GAINS = np.array([[[-1.0, -2.0]], [[-2.0, -1.5]], [[-1.5, -2.5]]])
WINDOW = windows.Window(
    PLANT,
    GAINS,
    x=np.array([1.0, -0.7]),
    lengths=np.array([0.3, 0.45, 0.25]),
    modes=np.array([2, 0, 1]),
    inputs=np.array([[1.0], [-2.0], [0.5]]),
    last=1,
)


def reached(window):
    """x(t + D) by a Runge-Kutta method: no matrix exponential."""
    x, plant = window.x, window.plant
    for length, i, u in zip(window.lengths, window.modes, window.inputs, strict=True):
        forcing = plant.B[i] @ u
        x = solve_ivp(
            lambda _, y, i=i, f=forcing: plant.A[i] @ y + f,
            (0.0, length),
            x,
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
        ).y[:, -1]
    return x


def pieces(window, model=None):
    """Per piece e^{Aτ} and ∫e^{A(…)}B U; with `model`, of that one mode."""
    modes = window.modes if model is None else np.full_like(window.modes, model)
    steps = []
    for length, i, u in zip(window.lengths, modes, window.inputs, strict=True):
        Phi, Gamma = plants.held(window.plant.A[i], window.plant.B[i], length)
        steps.append((Phi, Gamma @ u))
    return steps


def spectral(matrix):
    return float(np.linalg.norm(matrix, 2))


# --- the predictor ---------------------------------------------------------------------------


def test_equation_3_needs_the_integration_variable_in_its_exponent():
    A, B, D = PLANT.A[0], PLANT.B[0], 1.0
    window = windows.Window(
        PLANT, GAINS, WINDOW.x, WINDOW.lengths, np.zeros(3, int), WINDOW.inputs, 0
    )
    truth = reached(window)
    plants.close(window.future(0), truth, 1e-9)
    area = float(WINDOW.lengths @ WINDOW.inputs[:, 0])
    for s in np.linspace(-D, 0.0, 101):  # t − s with any one s in the window
        printed = expm(A * D) @ WINDOW.x + expm(A * -s) @ B[:, 0] * area
        assert np.abs(printed - truth).max() > 0.01


def test_equation_7_needs_the_latest_mode_leftmost():
    truth, steps = reached(WINDOW), pieces(WINDOW)
    latest_left, printed = np.zeros(2), np.zeros(2)
    for n in range(4):  # n = 0: the state; n ≥ 1: the input of piece n
        start = WINDOW.x if n == 0 else steps[n - 1][1]
        ordered = reverse = np.eye(2)
        for Phi, _ in steps[n:]:
            ordered, reverse = Phi @ ordered, reverse @ Phi
        latest_left, printed = latest_left + ordered @ start, printed + reverse @ start
    plants.close(latest_left, truth, 1e-9)
    assert np.abs(printed - truth).max() > 0.1 * np.abs(truth).max()


def test_equation_11_starts_at_the_last_switch():
    # From x(t + s_k) only the inputs since t − D + s_k still act; t − D − s_k is further back.
    s, t, D = 0.75, 0.0, 1.0
    A, B = PLANT.A[1], PLANT.B[1]
    at_switch = WINDOW.x
    for (Phi, drive), _ in zip(pieces(WINDOW), range(2), strict=False):
        at_switch = Phi @ at_switch + drive

    def predicted(start):
        """(11) with inputs as in WINDOW, and constant before it."""
        edges = np.array([start, *[e for e in (-1.0, -0.7, -0.25) if e > start], t])
        result = expm(A * (D - s)) @ at_switch
        for a, b in pairwise(edges):
            u = WINDOW.inputs[int(np.searchsorted([-0.7, -0.25], a, side="right"))]
            Gamma = plants.held(A, B, b - a)[1]
            result = result + expm(A * (t - b)) @ Gamma @ u
        return result

    truth = reached(WINDOW)
    plants.close(predicted(t - D + s), truth, 1e-9)
    assert np.abs(predicted(t - D - s) - truth).max() > 0.1


def test_equation_11_uses_the_mode_m_k_plus_1_not_mode_k_plus_1():
    # Two switches, k = 2, the last piece in mode m_3 = 1: the paper's A_{k+1} = A_3 is another
    # mode (2 when counting from 0), or none at all.
    x = WINDOW.x
    for Phi, drive in pieces(WINDOW)[:2]:
        x = Phi @ x + drive
    ends = []
    for i in (1, 2):
        Phi, Gamma = plants.held(PLANT.A[i], PLANT.B[i], 0.25)
        ends.append(Phi @ x + Gamma @ WINDOW.inputs[2])
    truth = reached(WINDOW)
    plants.close(ends[0], truth, 1e-9)
    assert np.abs(ends[1] - truth).max() > 0.1


def test_before_equation_24_the_last_mode_is_not_sigma_of_t_plus_d_at_a_switch():
    # A switch exactly at t + D: the mode before it moves the state, the one after it names K.
    signal = dt.SwitchingSignal([0.0, 1.5], [0, 2])
    law = dt.AveragedPredictor(THREE.plant, THREE.gains)
    run = dt.simulate(THREE.plant, law, signal, [1.0, -1.0], 2.0, step=0.01)
    k = 50  # t = 0.5, t + D = 1.5
    x, u = run.states[:, 150], run.inputs[:, k]
    plants.close(run.mismatch[:, k], u - THREE.gains[2] @ x, 1e-9)
    printed = u - THREE.gains[0] @ x  # m_{k+1} = 0, the mode on [t + s_k, t + D)
    assert np.abs(printed - run.mismatch[:, k]).max() > 0.01


# --- the mismatch ----------------------------------------------------------------------------


def test_equation_29_multiplies_the_gain_difference_by_the_true_mode_s_integral():
    truth = sum(
        GAINS[i] @ sum_of_inputs(WINDOW, i) - GAINS[1] @ sum_of_inputs(WINDOW) for i in range(3)
    )
    corrected = printed = np.zeros(1)
    for i in range(3):
        one, true = sum_of_inputs(WINDOW, i), sum_of_inputs(WINDOW)
        corrected = corrected + GAINS[i] @ (one - true) + (GAINS[i] - GAINS[1]) @ true
        printed = printed + GAINS[i] @ (one - true) + (GAINS[i] - GAINS[1]) @ one
    plants.close(corrected, truth, 1e-12)
    assert abs(float((printed - truth)[0])) > 0.01


def sum_of_inputs(window, model=None):
    """The part of the predictor that the inputs make."""
    result = np.zeros(window.plant.states)
    for Phi, drive in pieces(window, model):
        result = Phi @ result + drive
    return result


def test_before_equation_34_y2_is_the_mode_minus_the_true_one():
    tau, i, m = 0.4, 0, 1
    difference = PLANT.A[i] - PLANT.A[m]  # ΔA_{i,m} of (25)
    plants.close(expm(PLANT.A[m] * tau + difference * tau), expm(PLANT.A[i] * tau), 1e-12)
    printed = expm(PLANT.A[m] * tau - difference * tau)
    assert spectral(printed - expm(PLANT.A[i] * tau)) > 0.1


def test_proposition_a1_has_y2_in_front():
    Y1, Y2 = np.zeros((2, 2)), np.array([[0.0, 1.0], [0.0, 0.0]])
    left = spectral(expm(Y1 + Y2) - expm(Y1))
    growth = math.exp(spectral(Y1) + spectral(Y2))
    assert left == pytest.approx(1.0)
    assert left > spectral(Y1) * growth  # printed: 1 ≤ 0
    assert left <= spectral(Y2) * growth
    rng = np.random.default_rng(0)
    for _ in range(200):
        Y1, Y2 = rng.normal(size=(2, 3, 3)) * 10.0 ** rng.uniform(-3, 1, (2, 1, 1))
        left = spectral(expm(Y1 + Y2) - expm(Y1))
        growth = math.exp(spectral(Y1) + spectral(Y2))
        assert left <= spectral(Y2) * growth * (1.0 + 1e-9)


def test_proposition_a1_needs_a_submultiplicative_norm():
    # "An arbitrary matrix norm" includes the largest entry, for which |XY| > |X||Y| may be.
    Y2 = np.ones((10, 10))
    left = np.abs(expm(Y2) - np.eye(10)).max()
    assert left > np.abs(Y2).max() * math.exp(np.abs(Y2).max())
    assert spectral(expm(Y2) - np.eye(10)) <= spectral(Y2) * math.exp(spectral(Y2))


def test_equation_44_needs_an_induced_norm():
    # |e^{Aτ}| ≤ e^{|A|τ} at A = 0: the Frobenius norm of I is √n.
    A = np.zeros((2, 2))
    assert np.linalg.norm(expm(A)) > math.exp(np.linalg.norm(A))
    assert spectral(expm(A)) <= math.exp(spectral(A))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_equation_52_holds_with_k_and_without_the_second_exponential(count):
    # k switches: the product of n = 1 has k factors; k = 0 leaves Z₃ = 0.
    window = windows.Window(
        PLANT, GAINS, WINDOW.x, WINDOW.lengths[:count], WINDOW.modes[:count], WINDOW.inputs, 1
    )
    k, D = count - 1, float(window.lengths.sum())
    window.inputs = WINDOW.inputs[:count]
    steps, total, i = pieces(window), 0.0, 0
    lengths, modes = window.lengths, window.modes
    for n, (_, drive) in enumerate(steps):
        rest, chosen = lengths[n + 1 :], modes[n + 1 :]
        one = windows.product(PLANT.A, rest, np.full_like(chosen, i))
        total += float(np.linalg.norm((one - windows.product(PLANT.A, rest, chosen)) @ drive))
    distance = max(spectral(PLANT.A[i] - A) for A in PLANT.A)
    M_A, M_B = (max(map(spectral, M)) for M in (PLANT.A, PLANT.B))
    area = window.input_norms()[0]
    mended = distance * k * D * math.exp((M_A + distance) * D) * M_B * area
    printed = distance * (k + 1) * D * math.exp((2.0 * M_A + distance) * D) * M_B * area
    assert total <= mended
    assert (total == mended == 0.0) == (k == 0)
    assert printed > mended
    # (54) has D/τ_d + 1, the bound of k in (48): with (52) as printed it would be D/τ_d + 2.


# --- the theorem -----------------------------------------------------------------------------

# One mode wants u = −2x, the other u = +2x: the mean gain is 0 and stabilises neither.
OPPOSED = dt.SwitchedSystem([[[1.0]], [[1.0]]], [[[1.0]], [[-1.0]]], delay=1e-3)
OPPOSED_GAINS = np.array([[[-2.0]], [[2.0]]])


def second_line_of_71(bound):
    """½λ_min(Q) − 2be^D λ²(Dν₁ + 1) at the ε of the plant."""
    q, D = np.linalg.eigvalsh(bound.lyapunov.Q)[0], OPPOSED.delay
    forced = 2.0 * bound.b * math.exp(D) * bound.lam(bound.epsilon) ** 2
    return 0.5 * q - forced * (D * bound.nu1 + 1.0)


def test_equation_62_drops_a_one_and_does_not_give_71():
    printed = theorem_bound(OPPOSED, OPPOSED_GAINS, 1.0, form="printed")
    assert printed.epsilon < printed.epsilon_star
    assert second_line_of_71(printed) < 0.0
    assert printed.mu is None
    assert "lacks the + 1" in printed.message
    corrected = theorem_bound(OPPOSED, OPPOSED_GAINS, 1.0, form="corrected")
    assert corrected.epsilon > corrected.epsilon_star
    at_the_edge = corrected.lam(corrected.epsilon_star)
    q, D = np.linalg.eigvalsh(corrected.lyapunov.Q)[0], OPPOSED.delay
    forced = 2.0 * corrected.b * math.exp(D) * at_the_edge**2 * (D * corrected.nu1 + 1.0)
    assert forced == pytest.approx(0.5 * q, rel=1e-9)


def test_equation_62_as_printed_calls_a_diverging_loop_stable():
    printed = theorem_bound(OPPOSED, OPPOSED_GAINS, 1.0, form="printed")
    assert printed.holds
    for form in ("corrected", "sharp"):
        assert not theorem_bound(OPPOSED, OPPOSED_GAINS, 1.0, form=form).holds
    law = dt.AveragedPredictor(OPPOSED, OPPOSED_GAINS)
    signal = dt.SwitchingSignal([0.0, 2.0, 4.0], [0, 1, 0])
    run = dt.simulate(OPPOSED, law, signal, [1.0], 6.0, step=1e-3)
    plants.close(run.states[0], np.exp(run.time), 1e-9)


WEAK = dt.SwitchedSystem([[[-1.0]], [[-1.0]]], [[[10.0]], [[10.0]]], delay=0.1)
WEAK_GAINS = np.full((2, 1, 1), -1e-3)


def test_equation_75_as_printed_is_below_one_and_fails_at_time_zero():
    printed, corrected, sharp = (
        theorem_bound(WEAK, WEAK_GAINS, 1.0, form=form)
        for form in ("printed", "corrected", "sharp")
    )
    assert printed.holds
    assert printed.rho is not None
    assert printed.rho == pytest.approx(math.sqrt(2 * printed.nu1 * printed.nu2 / printed.kappa))
    assert printed.rho < 1.0  # |X(0)| ≤ ρ|X(0)| is then false
    law = dt.AveragedPredictor(WEAK, WEAK_GAINS)
    run = dt.simulate(WEAK, law, dt.SwitchingSignal.constant(0), [1.0], 1.0, step=0.01)
    size = np.abs(run.states[0])  # √∫U² only adds to it
    assert printed.xi is not None
    assert (size > printed.rho * np.exp(-printed.xi * run.time))[:50].all()
    for bound in (corrected, sharp):
        assert bound.rho is not None
        assert bound.xi is not None
        assert bound.rho >= math.sqrt(2.0 * bound.kappa)
        assert (size <= bound.rho * np.exp(-bound.xi * run.time)).all()


def test_section_3_reports_an_epsilon_star_nine_orders_too_large():
    problem = dt.problems.paper()
    bounds = [
        theorem_bound(problem.plant, problem.gains, 0.2, form=form)
        for form in ("printed", "corrected")
    ]
    for bound in bounds:
        assert 7e-5 / bound.epsilon_star > 1e9
        assert bound.epsilon == pytest.approx(0.7895, abs=5e-5)


# --- the list --------------------------------------------------------------------------------


def test_errata_name_the_tests_of_this_file_and_no_others():
    named = set(re.findall(r"`(test_\w+)`", ERRATA.read_text(encoding="utf-8")))
    here = {name for name in globals() if name.startswith("test_")}
    assert named == here - {"test_errata_name_the_tests_of_this_file_and_no_others"}
