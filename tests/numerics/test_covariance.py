"""Covariances that white noise adds, against Van Loan's exponential and in other units."""

import numpy as np
import pytest
from scipy.linalg import expm

from deadtime.numerics.covariance import noise_covariance, noise_covariances, switched_covariances

RNG = np.random.default_rng(3)
W = np.array([[2.0, 0.3], [0.3, 0.5]])


def van_loan(A: np.ndarray, W: np.ndarray, tau: float) -> np.ndarray:
    """Q(τ) from the corner of the exponential of [[−A, W], [0, Aᵀ]]."""
    n = len(A)
    E = expm(np.block([[-A, W], [np.zeros((n, n)), A.T]]) * tau)
    return E[n:, n:].T @ E[:n, n:]


@pytest.mark.parametrize("tau", [1e-6, 0.03, 1.7])
def test_the_series_is_the_corner_of_van_loan_s_exponential(tau):
    A = RNG.normal(size=(5, 2, 2))
    found = noise_covariances(A, W, np.full(5, tau))
    for one, Q in zip(A, found, strict=True):
        np.testing.assert_allclose(Q, van_loan(one, W, tau), rtol=1e-12)
        assert (Q == Q.T).all()


def test_each_system_takes_its_share_of_the_times():
    A, tau = RNG.normal(size=(2, 2, 2)), np.array([0.1, 0.2, 0.3, 0.4])
    each = [noise_covariance(A[k // 2], W, t) for k, t in enumerate(tau)]
    np.testing.assert_allclose(noise_covariances(A, W, tau), each, rtol=1e-14)


def test_units_that_are_powers_of_two_cost_no_digit():
    # Van Loan's exponential loses five of them here: its halvings count entries, not their balance.
    A, unit = np.array([[0.0, 1.0], [-1.0, -3.0]]), np.array([1.0, 2.0**20])
    scaled = noise_covariance(A * unit / unit[:, None], W / np.outer(unit, unit), 2.0)
    np.testing.assert_allclose(scaled * np.outer(unit, unit), noise_covariance(A, W, 2.0), 1e-15)


def test_what_decays_at_once_has_its_stationary_covariance():
    Q = noise_covariance(np.array([[-1.0]]), np.eye(1), 1e25)
    np.testing.assert_allclose(Q, [[0.5]], rtol=1e-12)


def test_modes_that_are_alike_switch_without_effect():
    A = np.repeat(RNG.normal(size=(1, 2, 2)), 2, axis=0)
    found = switched_covariances(A, np.array([W, W]), 0.3)
    np.testing.assert_allclose(found, np.broadcast_to(van_loan(A[0], W, 0.3), found.shape), 1e-12)
