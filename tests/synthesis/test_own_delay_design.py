"""Limits and designs for delay margin where inputs and modes have delays of their own."""

import numpy as np
import pytest

import deadtime as dt
from deadtime.synthesis.design_measures import estimated_margin
from shares import mostly_long

A, B = np.array([[[1.0, 1.0], [0.0, 0.5]]]), np.array([[[1.0, 0.0], [0.2, 1.0]]])


def parts(delays):
    """Two inputs, each with a pole of its own."""
    plant = dt.SwitchedSystem(np.diag([1.0, 0.7])[None], np.eye(2)[None], delays)
    alone = [
        dt.SwitchedSystem([[[pole]]], [[[1.0]]], delay)
        for pole, delay in zip((1.0, 0.7), plant.delays[0], strict=True)
    ]
    return plant, alone


def in_seconds(limit, unit):
    """Where no limit is, the search ended at the delay itself."""
    return [unit * min(value, 1.0) for value in (limit.reached, limit.most)]


@pytest.mark.parametrize("delays", [[2.0, 3.0], [3.0, 2.0], [2.5, 2.5]])
def test_limits_of_parts_that_share_nothing_contain_what_is_true_of_each(delays):
    plant, alone = parts(delays)
    reached, most = in_seconds(dt.delay_limit(plant), min(delays))
    each = [
        in_seconds(dt.delay_limit(part), delay) for part, delay in zip(alone, delays, strict=True)
    ]
    assert reached <= min(low for low, _ in each) * (1.0 + 1e-9)
    assert most >= min(min(high for _, high in each), min(delays)) * (1.0 - 1e-9)
    assert reached < most


def test_limits_are_those_of_the_longest_and_of_the_shortest_delay_for_all():
    own = dt.delay_limit(dt.SwitchedSystem(A, B, [3.0, 2.0]))
    longest, shortest = (dt.delay_limit(dt.SwitchedSystem(A, B, delay)) for delay in (3.0, 2.0))
    assert own.reached * 2.0 == pytest.approx(longest.reached * 3.0, rel=1e-9)
    assert own.most == pytest.approx(shortest.most, rel=1e-9)


def test_the_limits_of_a_mode_with_a_delay_of_its_own_are_its_own_in_seconds():
    A, B = [[[1.0]], [[0.8]]], [[[1.0]], [[1.0]]]
    plant = dt.SwitchedSystem(A, B, [[3.0], [2.0]])
    for mode, delay in enumerate((3.0, 2.0)):
        own = dt.delay_limit(plant, mode)
        alone = dt.delay_limit(dt.SwitchedSystem([A[mode]], [B[mode]], delay))
        assert own.reached * 2.0 == pytest.approx(alone.reached * delay, rel=1e-9)
        assert own.most * 2.0 == pytest.approx(alone.most * delay, rel=1e-9)


@pytest.mark.long
def test_no_gains_have_a_margin_beyond_what_no_linear_controller_has():
    plant = dt.SwitchedSystem(A, B, [2.5, 2.0])
    limit, rng = dt.delay_limit(plant), np.random.default_rng(0)
    margins = []
    for _ in range(12):
        weights = np.exp(rng.uniform(-3.0, 2.0, 4))
        K = dt.lqr(plant, np.diag(weights[:2]), np.diag(weights[2:]))
        law = dt.SingleModePredictor(plant, K, 0)
        margins.append(dt.delay_margin(plant, law, 0.1).relative)
    assert 0.5 * limit.reached < max(margins) < limit.most


@pytest.mark.parametrize("delays", [[0.6, 0.3], [0.2, 0.5]])
def test_the_estimate_is_the_margin_that_the_search_for_crossings_finds(delays):
    plant = dt.SwitchedSystem(A, B, delays)
    K = dt.lqr(plant, np.eye(2), np.eye(2))
    for law in (dt.SingleModePredictor(plant, K, 0), dt.DelayedStateFeedback(plant, 0.5 * K)):
        margin = dt.delay_margin(plant, law, 0.02)
        if margin.lower is None:
            continue
        estimate = estimated_margin(plant, law.digital(0.02), 0)
        assert estimate == pytest.approx(margin.relative, rel=1e-4)


@pytest.mark.parametrize("several", mostly_long(["inputs", "modes"], "modes"))
def test_a_design_meets_its_margin_where_all_delays_err_alike(several):
    if several == "inputs":
        plant, asked = dt.SwitchedSystem(A, B, [1.0, 0.6]), 0.3
    else:
        A_i, B_i = [[[0.5, 1.0], [0.0, 0.2]], [[0.6, 1.0], [0.0, 0.2]]], [[[0.0], [1.0]]] * 2
        plant, asked = dt.SwitchedSystem(A_i, B_i, [[0.5], [0.7]]), 0.4
    found = dt.design(plant, delay_margin=asked, step=0.05, budget=60)
    assert found.reached
    assert (found.margin.relative or 0.0) >= asked > found.plain.margin
    shortest = plant.delays.min()
    for share in np.linspace(-1.0, 1.0, 9) * asked:
        shifted = dt.SwitchedSystem(plant.A, plant.B, plant.delays + share * shortest)
        for mode in range(plant.modes):
            assert dt.growth_rate(shifted, found.law, mode, found.step) < 0.0
    assert "while all true delays err alike, by less than" in found.message
    assert "% of the shortest" in found.message


def test_the_theorem_says_which_of_its_forms_takes_several_delays():
    plant = dt.SwitchedSystem(A, B, [0.3, 0.1])
    K = dt.lqr(plant, np.eye(2), np.eye(2))
    with pytest.raises(dt.ArgumentError, match=r"sharp.*where inputs have several delays"):
        dt.theorem_bound(plant, K, 0.5)
