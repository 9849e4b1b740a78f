"""Φ, Γ and Gramians over cut steps, against 50-digit arithmetic, SciPy and quadrature."""

import mpmath
import numpy as np
import pytest

import plants
from deadtime.numerics.exponential import discretise, discretise_modes, gramian

rng = np.random.default_rng(3)
NILPOTENT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
CASES = {
    "random": (rng.normal(size=(4, 4)), rng.normal(size=(4, 2)), 0.7),
    "one state": (np.array([[1.5]]), np.array([[0.3, -2.0]]), 0.2),
    "B of 1e8": (rng.normal(size=(3, 3)), 1e8 * rng.normal(size=(3, 2)), 0.5),
    "B of 1e-8": (rng.normal(size=(3, 3)), 1e-8 * rng.normal(size=(3, 2)), 0.5),
    "columns of B far apart": (rng.normal(size=(3, 3)), rng.normal(size=(3, 2)) * [1e8, 1e-8], 0.5),
    "nilpotent A": (NILPOTENT, rng.normal(size=(3, 1)), 2.0),
    "zero A": (np.zeros((2, 2)), np.eye(2), 3.0),
    "rank-one A": (np.outer([1.0, 2.0, -1.0], [0.5, 0.1, 0.3]), rng.normal(size=(3, 1)), 1.0),
    "large norm, unstable": (10 * rng.normal(size=(3, 3)), rng.normal(size=(3, 1)), 2.0),
    "large norm, stable": (-200 * np.eye(2) + [[0, 30], [-30, 0]], rng.normal(size=(2, 1)), 1.0),
    "oscillator": (np.array([[0.0, 100.0], [-100.0, 0.0]]), np.array([[0.0], [1.0]]), 1.0),
    "short": (rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), 1e-9),
}


def extended(A, B):
    n, m = B.shape
    Z = np.zeros((n + m, n + m))
    Z[:n, :n], Z[:n, n:] = A, B
    return Z


DIGITS = 120  # for 50 that are right, whatever cancels


def precise(M, tau):
    """e^{Mτ} of a numpy matrix in extended precision."""
    with mpmath.workdps(DIGITS):
        return mpmath.expm(mpmath.matrix(M.tolist()) * mpmath.mpf(tau))


def rounded(M):
    return np.array(M.tolist(), dtype=float).reshape(M.rows, M.cols)


@pytest.fixture(params=CASES, scope="module")
def case(request):
    return CASES[request.param]


def test_held_equals_50_digit_arithmetic(case):
    A, B, tau = case
    n = A.shape[0]
    whole = rounded(precise(extended(A, B), tau))
    Phi, Gamma = discretise(A, B, tau)
    tolerance = 2e-16 * (20 + 4 * np.linalg.norm(A, 2) * tau)
    plants.close(Phi, whole[:n, :n], tolerance)
    for column, reference in zip(Gamma.T, whole[:n, n:].T, strict=True):
        plants.close(column, reference, tolerance)


def test_held_equals_scipy_s_exponential_of_the_extended_matrix(case):
    A, B, tau = case
    Phi, Gamma = discretise(A, B, tau)
    # SciPy itself loses digits on a badly scaled B: compare in units in which it is not.
    unit = np.maximum(np.abs(B).max(axis=0), 1e-300)
    tolerance = 1e-13 * (10 + np.linalg.norm(A, 2) * tau)
    plants.close(Phi, plants.held(A, B / unit, tau)[0], tolerance)
    plants.close(Gamma / unit, plants.held(A, B / unit, tau)[1], tolerance)


def test_nothing_happens_in_no_time():
    Phi, Gamma = discretise(*CASES["random"][:2], 0.0)
    assert np.array_equal(Phi, np.eye(4))
    assert not Gamma.any()
    assert not gramian(*CASES["random"][:2], 0.0, np.eye(len(CASES["random"][0]))).any()


def test_a_nilpotent_plant_has_polynomials():
    B = np.array([[0.0], [0.0], [1.0]])
    Phi, Gamma = discretise(NILPOTENT, B, 2.0)
    plants.close(Phi, [[1, 2, 2], [0, 1, 2], [0, 0, 1]], 1e-15)
    plants.close(Gamma, [[4 / 3], [2], [2]], 1e-15)


def test_two_pieces_make_the_whole(case):
    A, B, tau = case
    (P, G), (P1, G1), (P2, G2) = (discretise(A, B, t) for t in (tau, 0.3 * tau, 0.7 * tau))
    plants.close(P2 @ P1, P, 1e-12)
    plants.close(P2 @ G1 + G2, G, 1e-12)


def test_held_modes_is_held_for_every_mode():
    plant = plants.generic()
    Phi, Gamma = discretise_modes(plant.A, plant.B, 0.1)
    for i in range(3):
        assert np.array_equal(Phi[i], discretise(plant.A[i], plant.B[i], 0.1)[0])
        assert np.array_equal(Gamma[i], discretise(plant.A[i], plant.B[i], 0.1)[1])


@pytest.mark.few(4)
def test_the_gramian_equals_van_loan_s_in_50_digits(case):
    A, B, tau = case
    n, size = A.shape[0], sum(B.shape)
    E = np.diag(np.arange(size) < n).astype(float)
    Z = extended(A, B)
    whole = precise(np.block([[-Z.T, E], [np.zeros_like(Z), Z]]), tau)
    with mpmath.workdps(DIGITS):
        reference = rounded(whole[size:, size:].T * whole[:size, size:])
    Q = gramian(A, B, tau, np.eye(len(A)))
    # The scale of an entry is that of its diagonal: B of 1e8 must not hide the other entries.
    scale = np.sqrt(np.outer(np.diag(reference), np.diag(reference)))
    assert (np.abs(Q - reference) <= 1e-12 * scale).all()
    assert np.array_equal(Q, Q.T) or np.abs(Q - Q.T).max() <= 1e-15 * np.abs(Q).max()


def test_a_negative_time_undoes_a_positive_one():
    A = np.array([[0.0, 1.0, 0.0], [0.0, -0.3, 4e4], [0.0, -2e-5, -1.5]])
    for tau in (0.1, 3.0, 30.0):
        there, _ = discretise(A, np.zeros((3, 1)), tau)
        back, _ = discretise(A, np.zeros((3, 1)), -tau)
        np.testing.assert_allclose(back, np.linalg.inv(there), rtol=1e-9)
