"""Generators of many seeds at once, against NumPy's, one by one."""

from decimal import Decimal

import numpy as np
import pytest
from scipy.integrate import quad

from deadtime.numerics import generators
from deadtime.numerics.streams import stream

SEEDS = np.array([0, 7, 2**32 - 1, 2**32, 2**64 - 1], np.uint64)


@pytest.mark.parametrize("seed", [0, 5, 2**32 + 1, 2**64 - 1])
@pytest.mark.parametrize("spawned", [(), (0,), (2, 1)])
def test_generators_of_many_seeds_begin_where_those_of_numpy_do(seed, spawned):
    rng = stream(seed, "Noise", 3)
    for i in spawned:
        rng = rng.spawn(i + 1)[i]
    many, room = generators.Streams(np.array([seed], np.uint64), "Noise", 3), np.empty((1, 7))
    for i in spawned:
        many = many.spawned_as(i)
    many.draw_compiled(0, False, room)
    np.testing.assert_array_equal(room[0], rng.random(7))


def test_uniform_numbers_are_those_of_numpy_in_all_bits():
    many, room = generators.Streams(SEEDS, "Dropout", 2), np.empty((4, 3000))
    many.draw_compiled(1, False, room)
    for row, seed in zip(room, SEEDS[1:], strict=True):
        np.testing.assert_array_equal(row, stream(int(seed), "Dropout", 2).random(3000))


def test_normal_numbers_are_those_of_numpy_but_for_the_round_off_of_its_tables():
    many, room = generators.Streams(SEEDS, "Noise", 0), np.empty((5, 400_000))
    many.draw_compiled(0, True, room)
    for row, seed in zip(room, SEEDS, strict=True):
        wanted = stream(int(seed), "Noise").standard_normal(row.size)
        np.testing.assert_allclose(row, wanted, rtol=2e-14, atol=0.0)
    assert np.abs(room).max() > 4.5  # the tail was drawn from, too


def test_layers_have_one_area_and_end_where_the_curve_does():
    width, below, height = generators.layers()
    edges, r = width * 2.0**52, float(generators.TAIL)
    area = r * np.exp(-0.5 * r * r) + quad(lambda x: np.exp(-0.5 * x * x), r, np.inf)[0]
    assert edges[0] * height[255] == pytest.approx(area, rel=1e-13)
    np.testing.assert_allclose(height, np.exp(-0.5 * np.append(0.0, edges[1:]) ** 2), rtol=1e-13)
    rises = height[1:-1] - height[2:]
    np.testing.assert_allclose(edges[2:] * rises, area, rtol=1e-12)
    assert edges[1] * (1.0 - height[1]) == pytest.approx(area, rel=1e-12)
    np.testing.assert_allclose(below[2:] / 2.0**52, edges[1:-1] / edges[2:], rtol=1e-15)
    assert isinstance(generators.TAIL, Decimal)
    assert below[1] == 0


def test_a_numpy_that_draws_otherwise_is_asked_itself(monkeypatch):
    many, mine, theirs = generators.Streams(SEEDS, "Noise", 0), np.empty((2, 50)), np.empty((2, 50))
    assert generators.draws_as_numpy()
    many.draw(0, True, mine)
    monkeypatch.setattr(generators, "draws_as_numpy", lambda: False)
    many.draw(0, True, theirs)
    wanted = [stream(int(seed), "Noise").standard_normal(50) for seed in SEEDS[:2]]
    np.testing.assert_array_equal(theirs, wanted)
    np.testing.assert_allclose(mine, theirs, rtol=2e-14, atol=0.0)
