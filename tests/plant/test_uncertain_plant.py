"""What an uncertain plant may be: draws have its covariance."""

import numpy as np
import pytest

import deadtime as dt

# Three modes, two inputs, delays of their own.
RNG = np.random.default_rng(0)
OWN = dt.SwitchedSystem(
    RNG.standard_normal((3, 2, 2)), RNG.standard_normal((3, 2, 2)), [[0.3, 0.1], [0.2, 0.4], [1, 2]]
)
SIZE = 12 + 12 + 6
ROOT = 0.01 * RNG.standard_normal((SIZE, SIZE))
SMALL = dt.SwitchedSystem([[[-1.0]], [[0.4]]], [[[1.0]], [[2.0]]], 0.237)


def vector(plant):
    return np.concatenate((plant.A.ravel(), plant.B.ravel(), plant.delays.ravel()))


def test_draws_have_the_covariance_and_the_mean():
    known = dt.UncertainPlant(OWN, ROOT @ ROOT.T)
    drawn = np.array([vector(one) for one in known.draw(4000, seed=3)])
    z = np.linalg.solve(
        np.linalg.cholesky(ROOT @ ROOT.T), (drawn - vector(OWN)).T
    )  # white, if they have it
    np.testing.assert_allclose(z.mean(axis=1), 0.0, atol=4.5 / np.sqrt(4000))
    np.testing.assert_allclose(np.cov(z), np.eye(SIZE), atol=4.5 * np.sqrt(2.0 / 4000))


def test_a_direction_that_is_certain_stays_and_delays_that_modes_share_are_shared():
    sizes = np.array([0.0, 0.1, 0.0, 0.1, 0.2])
    drawn = dt.UncertainPlant(SMALL, np.diag(sizes**2)).draw(300)
    A, B, D = (np.array([getattr(one, name) for one in drawn]) for name in ("A", "B", "delays"))
    assert (A[:, 0] == -1.0).all()
    assert (B[:, 0] == 1.0).all()
    assert A[:, 1].std() > 0.05
    assert (D[:, 0] == D[:, 1]).all()
    assert D.min() == pytest.approx(1e-3 * 0.237)  # no delay below 0, however wide


def test_a_proof_is_of_every_plant_within():
    known = dt.UncertainPlant(SMALL, 4e-6 * np.eye(5))
    law = dt.AveragedPredictor(SMALL, [[[-0.5]], [[-0.7]]])
    ends = 0.235, 0.239
    certificate = dt.certify(known, law, 0.5, 0.1, delays=ends)
    assert certificate.proven
    for one in known.draw(3):
        assert dt.certify(one, law, 0.5, 0.1).stable


@pytest.mark.parametrize(
    ("covariance", "said"),
    [
        (np.eye(4), r"as many rows and columns .* 5 or 6, got \(4, 4\)"),
        (-np.eye(5), "semidefinite, got -1 on its diagonal"),
        (np.eye(5) + np.eye(5, k=1), "must be symmetric"),
        (np.eye(5) + 2.0 * (1.0 - np.eye(5)), "positive semidefinite"),
        (
            [[1.0, 0, 0, 0, 0.1], *4 * [[0.0] * 5]] + np.eye(5, k=-4) / 10,
            "beside a 0 on its diagonal",
        ),
    ],
)
def test_what_is_no_covariance_is_refused(covariance, said):
    with pytest.raises(dt.ArgumentError, match=said):
        dt.UncertainPlant(SMALL, covariance)


def test_delays_of_their_own_need_a_covariance_of_each():
    with pytest.raises(dt.ArgumentError, match="one of every mode's delays"):
        dt.UncertainPlant(OWN, np.eye(26))


def test_a_level_of_one_is_refused():
    with pytest.raises(dt.ArgumentError, match="level must be above 0 and below 1"):
        dt.UncertainPlant(SMALL, np.eye(5)).axes(1.0)
