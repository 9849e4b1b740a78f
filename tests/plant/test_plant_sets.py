"""Sets of plants: what they hold, by plants drawn from them, and what files say of them."""

import numpy as np
import pytest

import certificate_corpus as corpus
import deadtime as dt
from deadtime.plant.plant_set import PlantSet, PlantUncertainty, Polytope
from deadtime.plant.uncertain import Ellipsoid
from deadtime.plant.uncertainties import KEYS, SETS, UNCERTAINTIES, read_set

KNOWN = corpus.around(corpus.MILD, 0.05)
ELLIPSOID = KNOWN.plant_set()
CORNERS = Polytope.of(corpus.corners((1, 1), (1.1, 1), (1, 0.9)))


def entries(plant):
    return np.concatenate((plant.A, plant.B), axis=2)


def test_z_moves_no_entry_by_more_than_the_radius_and_each_by_about_as_much():
    rng, most = np.random.default_rng(1), 0.0
    for _ in range(3000):
        z = rng.standard_normal(len(ELLIPSOID.directions))
        moved = ELLIPSOID.moved(KNOWN.plant, z / np.linalg.norm(z))
        most = np.maximum(most, np.abs(entries(moved) - entries(KNOWN.plant)) / ELLIPSOID.radius)
    assert most.max() <= 1.0
    assert most.min() > 0.6


def test_the_farthest_z_is_in_the_set_and_no_other_one_is_farther():
    rng = np.random.default_rng(2)
    gradient = rng.standard_normal(len(ELLIPSOID.directions))
    z = ELLIPSOID.farthest(gradient)
    others = rng.standard_normal((500, len(z)))
    others /= np.linalg.norm(others, axis=1, keepdims=True)
    assert np.linalg.norm(z) < 1.0
    assert gradient @ z > (1.0 - 1e-8) * np.linalg.norm(gradient) > (others @ gradient).max()


def test_a_set_lacks_what_it_does_not_hold_and_says_what():
    wider, alone = corpus.around(corpus.MILD, 0.06).plant_set(), Polytope.of([corpus.MILD])
    assert ELLIPSOID.lacks(alone) == wider.lacks(ELLIPSOID) == CORNERS.lacks(alone) == ""
    assert ELLIPSOID.lacks(wider) == "another ellipsoid"
    assert CORNERS.lacks(ELLIPSOID) == "no ellipsoid of plants"
    assert alone.lacks(CORNERS) == ELLIPSOID.lacks(CORNERS) == "a plant with other matrices"


def test_only_one_plant_is_known_and_only_an_ellipsoid_leaves_the_polytope():
    alone = dt.UncertainPlant(corpus.MILD, np.zeros((13, 13))).plant_set()
    assert [one.known for one in (alone, CORNERS, ELLIPSOID)] == [True, False, False]
    assert [one.in_polytope for one in (alone, CORNERS, ELLIPSOID)] == [True, True, False]
    assert not alone.directions.size
    assert alone.in_words == ("the plant", "")


def test_without_inputs_a_set_keeps_what_moves_a():
    without = ELLIPSOID.with_inputs(0)
    assert without.sizes == (2, 2, 0)
    np.testing.assert_array_equal(without.directions, ELLIPSOID.directions[..., :2])


@pytest.mark.parametrize("one", [ELLIPSOID, CORNERS], ids=lambda one: one.kind)
def test_a_file_s_arrays_tell_the_kind_of_set(one):
    assert set(one.arrays) <= set(KEYS)
    again = read_set(one.A, one.B, one.arrays)
    assert type(again) is type(one)
    with pytest.raises(ValueError, match="no set of plants has axes and size together"):
        read_set(one.A, one.B, {"axes": one.A, "size": one.A})


def test_an_ellipsoid_has_one_vertex_and_an_axis():
    assert ELLIPSOID.misfit() == CORNERS.misfit() == ""
    none = ELLIPSOID.axes[:0]
    assert "axes are" in Ellipsoid(ELLIPSOID.A, ELLIPSOID.B, none).misfit()
    assert "axes are" in Ellipsoid(CORNERS.A, CORNERS.B, ELLIPSOID.axes).misfit()


def test_every_kind_is_registered_once():
    assert set(SETS) == set(PlantSet.__subclasses__())
    assert set(UNCERTAINTIES) == set(PlantUncertainty.__subclasses__())
    assert len({kind.kind for kind in SETS}) == len(SETS)
    assert len(KEYS) == len(set(KEYS))
