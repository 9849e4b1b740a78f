"""An ellipsoid of plants: what is proved of it holds for each of them, by SciPy's exponentials."""

from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import chi2

import certificate_corpus as corpus
import deadtime as dt
from certificate_reference import rewritten
from deadtime.certificates.dwell.evidence_search import Sways
from deadtime.certificates.proof.covering import enclosures_of
from deadtime.certificates.proof.delays import Delays
from deadtime.certificates.proof.step_enclosure import cells_of
from deadtime.certificates.proof.sway import Sway, kronecker
from deadtime.feedback.recurrence import recurrence_of
from deadtime.numerics.precision import precision
from deadtime.plant.plant_set import Polytope

H, D, N = 0.1, 0.234, 3
PLANTS = 4000
MILD, LAW = corpus.MILD, corpus.DELAYED
ONE = dt.SwitchedSystem(MILD.A[:1], MILD.B[:1], D)
ALONE = dt.DelayedStateFeedback(ONE, LAW.gains[:1])


def surface(known, count, rng):
    """(A, B) of plants on the surface of the ellipsoid, from the covariance alone."""
    plant = known.plant
    size = plant.A.size + plant.B.size
    root = np.linalg.cholesky(known.covariance[:size, :size])
    z = rng.standard_normal((count, size))
    z *= np.sqrt(chi2.ppf(0.95, size)) / np.linalg.norm(z, axis=1, keepdims=True)
    moved = z @ root.T
    A = plant.A + moved[:, : plant.A.size].reshape(-1, *plant.A.shape)
    return A, plant.B + moved[:, plant.A.size :].reshape(-1, *plant.B.shape)


def over(A, B, read, k, t):
    """exp of [[A, B at the read], [0, 0]] t, of many plants."""
    n = A.shape[-1]
    Z = np.zeros((len(A), n + k, n + k))
    Z[:, :n, :n], Z[:, :n, n + read] = A, B[..., 0]
    return expm(Z * t[:, None, None])


def periods(A, B, law, mode, after, s, delay):
    """The lifted loop's matrices over a period that switches at s, of one input and N = 3."""
    table, (count, _, n, _) = recurrence_of(law, H), A.shape
    late = np.full(count, delay - (N - 1) * H)
    first, second = np.minimum(s, late), np.maximum(s, late)
    E = over(A[:, mode], B[:, mode], 0, 2, first)
    middle = over(A[:, after], B[:, after], 0, 2, second - first)
    held = over(A[:, mode], B[:, mode], 1, 2, second - first)
    E = np.where((s < late)[:, None, None], middle, held) @ E
    E = (over(A[:, after], B[:, after], 1, 2, H - second) @ E)[:, :n]
    M = np.zeros((count, n + N, n + N))
    M[:, :n, :n], M[:, :n, n + N - 1], M[:, :n, n + N - 2] = E[..., :n], E[..., n], E[..., n + 1]
    M[:, n, :n] = table.state_gain[0, 0]
    M[:, n, n : n + table.input_gain.shape[1]] = table.input_gain[0, :, 0, 0]
    M[:, np.arange(n + 1, n + N), np.arange(n, n + N - 1)] = 1.0
    return M


@cache
def proved(law, delays=None):
    known = corpus.around(law.plant, 0.012)
    return dt.certify(known, law, 0.2, H, delays=delays, search_signals=False)


@pytest.mark.parametrize(
    ("law", "delays"),
    [
        pytest.param(LAW, None, id="known"),
        pytest.param(ALONE, (0.231, 0.237), id="range-alone"),
        pytest.param(LAW, (0.231, 0.237), id="range", marks=pytest.mark.long),
    ],
)
def test_v_falls_on_thousands_of_plants_of_the_surface_wherever_they_switch(law, delays):
    known, rng = corpus.around(law.plant, 0.012), np.random.default_rng(1)
    certificate = proved(law, delays)
    assert certificate.proven
    assert "ellipsoid" in certificate.message
    A, B = surface(known, PLANTS, rng)
    low, high = delays or (D, D)
    for mode, after in product(range(law.plant.modes), repeat=2):
        s = np.where(rng.random(PLANTS) < 0.1, H, rng.uniform(0.0, H, PLANTS)) * (mode != after)
        delay = rng.choice([low, high, 0.5 * (low + high)])
        M = periods(A, B, law, mode, after, s, delay)
        here, there = certificate.lyapunov(mode, 1), certificate.lyapunov(after, int(mode == after))
        less = here - M.transpose(0, 2, 1) @ there @ M / certificate.evidence.rho**2
        assert np.linalg.eigvalsh(less).min() > 0.0


def test_an_ellipsoid_that_holds_an_unstable_plant_is_never_proved():
    rng, refuted = np.random.default_rng(2), 0
    for part in (0.1, 0.3, 1.0):
        known = corpus.around(MILD, part)
        A, B = surface(known, 2000, rng)
        M = [periods(A, B, LAW, i, i, np.zeros(2000), D) for i in (0, 1)]
        if np.abs(np.linalg.eigvals(np.stack(M))).max() > 1.0:
            refuted += 1
            found = dt.certify(known, LAW, 0.2, H, decay_rate=0.0, search_signals=False)
            assert found.stable is not True
    assert refuted


def test_a_mode_that_is_known_is_known_beside_one_that_is_not():
    covariance = corpus.around(MILD, 0.012).covariance.copy()
    sure = [*range(4), 8, 9]
    covariance[sure], covariance[:, sure] = 0.0, 0.0
    found = dt.certify(dt.UncertainPlant(MILD, covariance), LAW, 0.2, H, search_signals=False)
    assert found.proven
    assert not found.evidence.setting.plants.directions[:, 0].any()
    assert found.decay_rate >= proved(LAW).decay_rate


@pytest.mark.parametrize(("n", "k", "d"), [(1, 2, 1), (2, 4, 3), (2, 4, 12), (3, 7, 45)])
def test_w_and_x_bound_every_pair_and_of_a_kronecker_product_are_its_factors(n, k, d):
    rng = np.random.default_rng(d)
    L = rng.standard_normal((n, k, d)) * rng.uniform(0.1, 10.0, (n, k, 1))
    W, X = kronecker(L)
    rows, columns = rng.standard_normal((2000, n)), rng.standard_normal((2000, k))
    seen = (np.einsum("pa,akd,pk->pd", rows, L, columns) ** 2).sum(axis=1)
    most = np.einsum("pa,ab,pb->p", rows, W, rows) * np.einsum("pk,kl,pl->p", columns, X, columns)
    assert (seen <= most).all()
    left, right = rng.standard_normal((n, n)), rng.standard_normal((k, k))
    W, X = kronecker(np.kron(left, right).reshape(n, k, n * k))
    exact = np.kron(left @ left.T, right @ right.T)
    np.testing.assert_allclose(np.kron(W, X), 1.02 * exact, rtol=0.02, atol=0.02 * exact.max())


BOX = np.array([[[0.23], [0.21]], [[0.24], [0.215]]])


@pytest.mark.parametrize("delays", [(D, D), (0.23, 0.24), BOX], ids=["known", "range", "box"])
def test_what_an_ellipsoid_does_to_a_period_lies_within_its_bound(delays):
    known, rng = corpus.around(MILD, 0.05), np.random.default_rng(3)
    axes = known.axes()
    family = Delays(np.array(delays)).family(known.plant_set(), H)
    enclosures = enclosures_of(family)
    tight = 0.0
    for i, j in ((0, 0), (0, 1)):
        for cell in cells_of(family, i, j):
            for part in (cell, cell.halves(0)[0]) if i != j else (cell,):
                with precision():
                    sway = Sway.of(enclosures.of(part).sway, 2)
                for _ in range(60):
                    z = rng.standard_normal(len(axes))
                    moved = np.tensordot(z / np.linalg.norm(z), axes, 1)
                    one = MILD.like(MILD.A + moved[..., :2], MILD.B + moved[..., 2:])
                    other = Delays(np.array(delays)).family(Polytope.of([one]), H)
                    u = rng.uniform(*part.u)
                    f = tuple(rng.uniform(*place) for place in part.f)
                    f = f if isinstance(delays, np.ndarray) else f[0]
                    E = other.sample(part.order, u, f) - family.sample(part.order, u, f)
                    ways = np.linalg.cholesky(sway.W), np.linalg.cholesky(sway.X)
                    inside = np.linalg.solve(ways[0], E) @ np.linalg.inv(ways[1]).T
                    tight = max(tight, np.linalg.norm(inside, 2))
    assert 0.4 < tight <= 1.0
    assert Sways(family).at(cell.order, np.array([0.5]))[0] is not None


def test_a_file_is_about_its_ellipsoid_and_no_wider_one(tmp_path):
    known = corpus.around(ONE, 0.01)
    found = dt.certify(known, ALONE, 0.2, H, decay_rate=0.1)
    path = found.save(tmp_path / "c.json")
    assert dt.verify(path, known, ALONE, dwell_time=0.2).proven
    assert dt.verify(path, ONE, ALONE).proven
    assert dt.verify(path, corpus.around(ONE, 0.005), ALONE).proven
    for other, why in (
        (corpus.around(ONE, 0.0101), "another ellipsoid"),
        (dt.UncertainPlant(ONE, np.diag(np.diag(known.covariance))), "another ellipsoid"),
        (corpus.around(ONE, 0.01, 0.002), "a delay of 0.234 s"),
    ):
        assert why in dt.verify(path, other, ALONE).message
    about = dt.verify(path).about[0]
    assert "an ellipsoid of 6 axes" in about
    alone = dt.certify(ONE, ALONE, 0.2, H).save(tmp_path / "alone.json")
    assert "no ellipsoid" in dt.verify(alone, corpus.around(ONE, 0.01)).message
    rewritten(path, "plant", {"A": [(-ONE.A).tolist()]})
    assert not dt.verify(path).proven


def test_a_plant_without_errors_is_one_plant():
    sure = dt.UncertainPlant(MILD, np.zeros((13, 13)))
    assert sure.axes().shape == (0, 2, 2, 3)
    assert sure.delay_range() is None
    one, other = (dt.certify(plant, LAW, 0.2, H) for plant in (sure, MILD))
    assert one.decay_rate == other.decay_rate
    assert one.evidence.setting.plants.known


@pytest.mark.parametrize("part", [1e-8, 1e-12, 1e-20])
def test_an_ellipsoid_that_is_nearly_a_plant_is_proved_as_fast_as_one(part):
    found, exact = (dt.certify(one, ALONE, 0.2, H) for one in (corpus.around(ONE, part), ONE))
    assert found.proven
    np.testing.assert_allclose(found.decay_rate, exact.decay_rate, rtol=1e-6)


def test_a_refutation_says_that_it_is_of_another_plant_than_the_middle():
    found = dt.certify(corpus.around(ONE, 1.0), ALONE, 0.2, H)
    assert found.stable is False
    assert "at every plant in the ellipsoid" in found.message
    assert np.abs(found.witness.plant.A - ONE.A).max() > 0.1


def test_uncertain_plants_are_certified_one_by_one():
    both: Any = [ONE, corpus.around(ONE, 0.01)]
    with pytest.raises(dt.ArgumentError, match="must be one UncertainPlant"):
        dt.certify(both, ALONE, 0.2, H)
