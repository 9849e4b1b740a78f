"""Chains that nobody sees, against every path that there is, one by one."""

import itertools

import numpy as np
import pytest

from deadtime.identification.likelihoods.chain import likeliest, smooth

RNG = np.random.default_rng(5)
PERIODS = 7


def chain_of(modes, within, spread):
    """Log densities, the chain and its start; `within`: a change has a density of its own."""
    stay = spread * RNG.standard_normal((PERIODS, modes))
    move = np.tile(spread * RNG.standard_normal((PERIODS, 1)), modes) if within else stay
    P = RNG.dirichlet(np.ones(modes), modes)
    return stay, move, np.log(P), np.log(RNG.dirichlet(np.ones(modes)))


def of_one_kind(stay, move, chain, first):
    """The same for kernels: every period has one chain."""
    return stay, move[..., None], chain[None], np.zeros(len(stay), np.int64), first


def every_path(stay, move, chain, first):
    """All paths, and the log probability of each with the log."""
    modes = len(first)
    paths = np.array(list(itertools.product(range(modes), repeat=PERIODS + 1)))
    value = first[paths[:, 0]]
    for k in range(PERIODS):
        i, j = paths[:, k], paths[:, k + 1]
        value = value + chain[i, j] + np.where(i == j, stay[k, i], move[k, i])
    return paths, value


@pytest.mark.parametrize("within", [False, True])
@pytest.mark.parametrize(("modes", "spread"), [(2, 1.0), (3, 4.0), (2, 400.0)])
def test_forward_and_back_is_the_sum_over_all_paths(modes, within, spread):
    given = chain_of(modes, within, spread)
    paths, value = every_path(*given)
    weight = np.exp(value - value.max())
    total = value.max() + np.log(weight.sum())
    weight /= weight.sum()
    same, node = np.empty((PERIODS, modes)), np.empty((PERIODS + 1, modes))
    pairs = np.empty((1, modes, modes))
    assert smooth(*of_one_kind(*given), same, node, pairs) == pytest.approx(
        total, rel=1e-12, abs=1e-10
    )
    expected = np.zeros(pairs[0].shape)
    for k in range(PERIODS):
        for i in range(modes):
            alone = weight[(paths[:, k] == i) & (paths[:, k + 1] == i)].sum()
            assert same[k, i] == pytest.approx(alone, abs=1e-10)
        np.add.at(expected, (paths[:, k], paths[:, k + 1]), weight)
    for i in range(modes):
        of_i = weight @ (paths == i)
        np.testing.assert_allclose(node[:, i], of_i, atol=1e-10)
    np.testing.assert_allclose(pairs[0], expected, atol=1e-10)


@pytest.mark.parametrize("within", [False, True])
@pytest.mark.parametrize(("modes", "spread"), [(2, 1.0), (3, 4.0)])
def test_the_likeliest_path_is_the_best_of_all(modes, within, spread):
    given = chain_of(modes, within, spread)
    paths, value = every_path(*given)
    path = np.empty(PERIODS + 1, np.int64)
    assert likeliest(*of_one_kind(*given), path) == pytest.approx(value.max(), abs=1e-10)
    last = -1 if within else -2  # at samples the last row says nothing of its mode
    np.testing.assert_array_equal(path[:last], paths[value.argmax()][:last])


def test_densities_that_are_e_to_the_1e12_apart_are_no_trouble():
    stay = np.array([[0.0, -1e12], [-1e12, 0.0], [0.0, -1e12]])
    chain, first = np.log([[0.9, 0.1], [0.2, 0.8]]), np.log([0.5, 0.5])
    same, node, pairs = np.empty((3, 2)), np.empty((4, 2)), np.empty((1, 2, 2))
    value = smooth(*of_one_kind(stay, stay, chain, first), same, node, pairs)
    assert value == pytest.approx(np.log(0.5 * 0.1 * 0.2))
    np.testing.assert_allclose(node[:3], [[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(node[3], [0.9, 0.1], atol=1e-12)
