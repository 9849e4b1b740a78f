"""The enclosures of the check hold, and definite is said of no matrix that is not."""

import itertools
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from flint import arb
from hypothesis import given, settings, strategies as st

import certificate_reference as reference
from deadtime.certificates.proof.balls import is_positive_definite
from deadtime.certificates.proof.box import FIRST, POLYTOPE, U
from deadtime.certificates.proof.family import Family
from deadtime.certificates.proof.step_enclosure import Enclosures, cells_of
from deadtime.numerics.precision import precision
from deadtime.plant.plant_set import Polytope
from shares import mostly_long

DELAYS = [(0.3, 0.3), (0.234, 0.234), (0.034, 0.034), (0.2, 0.29)]


@pytest.mark.parametrize(
    ("delays", "corners"),
    mostly_long(itertools.product(DELAYS, [1, 3]), ((0.234, 0.234), 1), ((0.2, 0.29), 3)),
)
def test_enclosures_hold_the_plant_and_its_derivatives(delays, corners):
    rng = np.random.default_rng(3)
    A = rng.normal(size=(2, 3, 3)) + 0.1 * rng.normal(size=(corners, 2, 3, 3))
    B = rng.normal(size=(2, 3, 2)) + 0.1 * rng.normal(size=(corners, 2, 3, 2))
    family = Family.of_range(Polytope(A, B), *delays, 0.1)

    def value(cell, point, reading="decimal"):
        E = reference.at_point(A, B, delays, 0.1, cell.order, *point, reading)
        return E[:, : 3 + len(family.reads)]

    def holds(matrix, values):
        exact = [arb(mpmath.nstr(y, 60, strip_zeros=False)) for y in values.flat]
        return all(x.contains(y) for x, y in zip(matrix.entries(), exact, strict=True))

    for cell in [*cells_of(family, 0, 0), *cells_of(family, 0, 1)]:
        for _ in range(3):
            ways = (U, FIRST, POLYTOPE)[: 3 if corners > 1 else 2]
            cell = cell.halves(ways[int(rng.integers(len(ways)))])[int(rng.integers(2))]
        with precision():
            found = Enclosures(family).of(cell)
        mean, weights = cell.corners.mean(axis=0), rng.dirichlet(np.ones(corners))
        point = [rng.uniform(*cell.u), rng.uniform(*cell.f[0]), 0.9 * weights @ cell.corners]
        point[2] = point[2] + 0.1 * mean
        with mpmath.workdps(60), precision(256):
            for reading in ("decimal", "binary"):
                middle = [np.mean(cell.u), np.mean(cell.f[0]), mean]
                assert holds(found.centre, value(cell, middle, reading))
            ways = iter(cell.corners)
            for direction, slope in found.slopes:
                # By the mean value theorem a difference, as long as half of the cell.
                ahead = point.copy()
                if direction == POLYTOPE:
                    ahead[2], scale = point[2] + 2.0**-5 * (next(ways) - mean), Fraction(32)
                else:
                    at = (U, FIRST).index(direction)
                    low, high = (cell.u, cell.f[0])[at]
                    ahead[at] = rng.uniform(low, high)
                    scale = Fraction(high - low) / 2
                    scale /= Fraction(ahead[at]) - Fraction(point[at])
                change = value(cell, ahead) - value(cell, point)
                assert holds(slope, change * reference.precise(scale))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_definite_is_said_of_no_matrix_that_is_not(seed):
    rng = np.random.default_rng(seed)
    d = int(rng.integers(1, 9))
    C = rng.integers(-3, 4, (d, max(d - 1, 1))).astype(float)
    X, none = C @ C.T * (d > 1), np.zeros(d)  # singular, and exact
    nudge = 2.0 ** -int(rng.integers(1, 40))
    assert not is_positive_definite(X, none)
    assert not is_positive_definite(X + nudge * np.eye(d), nudge + none)
    assert not is_positive_definite(X - nudge * np.eye(d), none)
    some = X + nudge * np.diag(rng.integers(-1, 4, d))
    exact = np.vectorize(Fraction, otypes=[object])(some)
    assert reference.is_positive(exact) or not is_positive_definite(some, none)
    assert not is_positive_definite(some * np.nan, none)
    assert not is_positive_definite(some, none + np.nan)


@pytest.mark.parametrize("d", [1, 2, 10, 100])
def test_definite_is_said_of_matrices_that_clearly_are(d):
    Q = np.linalg.qr(np.random.default_rng(5).normal(size=(d, d)))[0]
    X = Q * np.geomspace(1.0, 1e-9 * d, d) @ Q.T
    unit = 1.0 / np.sqrt(np.diag(X))
    X = 0.5 * (X + X.T) * unit * unit[:, None]
    least = float(np.linalg.eigvalsh(X)[0])
    assert is_positive_definite(X, np.full(d, 0.5 * least))
    assert not is_positive_definite(X, np.full(d, 1.01 * least))
