"""The theorem's constants are those of fifty digits, of quadrature, and of a plant by hand."""

import math

import mpmath
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize_scalar

import deadtime as dt
import plants
from deadtime.certificates import theorem_bound
from deadtime.gains import common_lyapunov
from theorem_cases import CASES, PAPER, bound_of, each_case


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
