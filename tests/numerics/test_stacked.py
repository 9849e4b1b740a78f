"""Many pieces at once: the bits of the kernels, piece by piece."""

import numpy as np
import pytest

from deadtime.numerics.exponential import (
    congruence_all,
    discretise,
    discretise_all,
    gramian,
    gramian_all,
    product_all,
)


@pytest.fixture(params=[(1, 1, 1, 1.0), (2, 3, 1, 30.0), (3, 4, 2, 1e-3)])
def pieces(request):
    """Modes badly scaled; lengths of many sizes, none at all and beyond what floats hold."""
    modes, n, m, scale = request.param
    rng = np.random.default_rng(5)
    A, B = scale * rng.normal(size=(modes, n, n)), rng.normal(size=(modes, n, m))
    A[0, 0] *= 1e5
    B[0, :, -1] = 0.0
    mode = rng.integers(0, modes, 40)
    tau = rng.uniform(size=40) * 10.0 ** rng.integers(-4, 2, 40)
    tau[:2] = 0.0, 1e308
    return A, B, mode, tau


def test_pieces_at_once_are_the_pieces_one_by_one(pieces):
    A, B, mode, tau = pieces
    one_by_one = [discretise(A[i], B[i], t) for i, t in zip(mode, tau, strict=True)]
    for found, expected in zip(discretise_all(*pieces), zip(*one_by_one, strict=True), strict=True):
        assert np.array_equal(found, np.array(expected), equal_nan=True)


@pytest.mark.few(1)
def test_gramians_at_once_are_the_gramians_one_by_one(pieces):
    A, B, mode, tau = pieces
    Q = np.eye(A.shape[1]) + 0.1
    one_by_one = [gramian(A[i], B[i], t, Q) for i, t in zip(mode, tau, strict=True)]
    assert np.array_equal(gramian_all(*pieces, Q), np.array(one_by_one), equal_nan=True)


def test_products_are_those_of_every_piece():
    rng = np.random.default_rng(2)
    X, Y = rng.normal(size=(7, 3, 3)), rng.normal(size=(7, 3, 2))
    np.testing.assert_allclose(product_all(X, Y), X @ Y, rtol=1e-12)
    M = rng.normal(size=(7, 3, 3))
    np.testing.assert_allclose(congruence_all(X, M), X.transpose(0, 2, 1) @ M @ X, rtol=1e-12)


def test_no_pieces_are_none(pieces):
    A, B, *_ = pieces
    none = np.zeros(0, np.int64), np.zeros(0)
    assert [part.size for part in discretise_all(A, B, *none)] == [0, 0]
    assert gramian_all(A, B, *none, np.eye(A.shape[1])).size == 0
