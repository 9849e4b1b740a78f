"""The averaged law tuned to the worst constant mode: optimality, symmetry, what a gain buys."""

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.laws.minimax import GAIN_LIMIT, minimax as search
from deadtime.spectrum import growth_rate
from shares import mostly_long

H = 0.05


def minimax(plant, *setting):
    def tables(K, weights, step, /):
        return dt.AveragedPredictor(plant, K, weights, allow_unstable=True).digital(step)

    return search(tables, plant, *setting)


def rates(plant, gains, weights, step=H):
    law = dt.AveragedPredictor(plant, gains, weights, allow_unstable=True)
    return np.array([growth_rate(plant, law, mode, step) for mode in range(plant.modes)])


def test_the_paper_s_weights_make_both_modes_grow_alike_and_slower_than_equal_ones():
    plant = plants.paper()
    weights, gains, growth = minimax(plant, plants.gains(plant), 0.01, False, False)
    assert np.array_equal(gains, plants.gains(plant))
    plants.close(weights, [0.4148, 0.5852], 1e-3)
    assert growth == pytest.approx(rates(plant, gains, weights, 0.01), abs=1e-9)
    assert growth == pytest.approx([0.1652, 0.1652], abs=1e-4)
    assert rates(plant, gains, None, 0.01).max() == pytest.approx(0.2817, abs=1e-4)


@pytest.mark.parametrize(
    "problem", mostly_long(["two modes", "three modes", "three modes, two inputs"], "two modes")
)
def test_no_other_weights_leave_the_worst_mode_slower(problem):
    plant, gains = {
        "two modes": (plants.paper(), plants.gains(plants.paper())),
        "three modes": (dt.problems.three_mode().plant, dt.problems.three_mode().gains),
        "three modes, two inputs": (plants.generic(), plants.gains(plants.generic())),
    }[problem]
    weights, _, growth = minimax(plant, gains, H, False, False)
    assert weights.min() >= 0.0
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)
    rng = np.random.default_rng(0)
    others = [*rng.dirichlet(np.ones(plant.modes), 300), *np.eye(plant.modes)]
    # Near the best ones, too.
    others += [w / w.sum() for w in np.abs(weights + 0.01 * rng.normal(size=(100, plant.modes)))]
    assert growth.max() <= min(rates(plant, gains, w).max() for w in others) + 1e-5


def test_two_modes_that_mirror_each_other_get_equal_weights():
    A = np.array([[0.3, 1.0], [0.2, -0.4]])
    B = np.array([[1.0], [0.4]])
    plant = dt.SwitchedSystem([A, A[::-1, ::-1]], [B, B[::-1]], 0.8)
    weights, _, growth = minimax(plant, dt.place(plant, [-1, -2]), H, False, False)
    assert weights == pytest.approx([0.5, 0.5], abs=1e-5)
    assert growth[0] == pytest.approx(growth[1], abs=1e-5)


def test_one_mode_keeps_its_law():
    plant = plants.scalar(0.5, delay=0.4)
    weights, gains, growth = minimax(plant, [[[-1.5]]], H, False, False)
    assert weights.tolist() == [1.0]
    assert gains.tolist() == [[[-1.5]]]
    single = dt.SingleModePredictor(plant, [[[-1.5]]], 0)
    assert growth[0] == pytest.approx(growth_rate(plant, single, 0, H), abs=1e-12)


@pytest.mark.parametrize("common_gain", mostly_long([False, True], False))
def test_the_search_is_reproducible(common_gain):
    plant = plants.paper()
    first, second = (minimax(plant, plants.gains(plant), 0.1, common_gain, False) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        assert np.array_equal(a, b)


@pytest.mark.long
def test_one_gain_for_all_modes_makes_the_paper_s_example_stable_in_every_mode():
    plant, own = plants.paper(), plants.gains(plants.paper())
    weights, gains, growth = minimax(plant, own, H, True, False)
    assert np.array_equal(gains[0], gains[1])
    largest = max(np.linalg.norm(K, 2) for K in own)
    assert np.linalg.norm(gains[0], 2) <= GAIN_LIMIT * largest * (1.0 + 1e-12)
    assert np.linalg.eigvals(plant.A + plant.B @ gains).real.max() < 0.0
    assert growth == pytest.approx(rates(plant, gains, weights), abs=1e-9)
    assert growth.max() < -0.01 < rates(plant, own, None).max()
    law = dt.AveragedPredictor(plant, gains, weights)
    for mode in (0, 1):
        signal = dt.SwitchingSignal.constant(mode)
        run = dt.simulate(plant, law, signal, [-1.0, 1.0], 400.0, step=H)
        assert run.metrics()["final_norm"] < 1e-2 * run.metrics()["peak"]


@pytest.mark.long
def test_where_the_averaged_loop_is_unstable_one_gain_makes_long_sojourns_cheaper():
    plant, own = plants.paper(), plants.gains(plants.paper())
    weights, gains, _ = minimax(plant, own, H, True, False)
    laws = {
        "averaged": dt.AveragedPredictor(plant, own),
        "one gain": dt.AveragedPredictor(plant, gains, weights),
    }
    signals = [dt.SwitchingSignal.random(2, 16.0, dwell_time=0.8, seed=i) for i in range(60)]
    data = dt.monte_carlo(plant, laws, signals, [-1.0, 1.0], 15.0, step=H)
    averaged, one_gain = data.cost.median("scenario").values
    assert one_gain < 0.4 * averaged


def test_a_gain_that_no_two_modes_can_share_is_refused():
    plant = plants.scalar([1.0, 1.0], np.array([1.0, -1.0]), 0.2)
    own = np.array([[[-2.0]], [[2.0]]])
    with pytest.raises(dt.InfeasibleError, match=r"no common gain was found that leaves every"):
        minimax(plant, own, H, True, False)


@pytest.mark.long
def test_where_modes_may_be_left_unstable_it_is_found_all_the_same():
    plant = plants.scalar([1.0, 1.0], np.array([1.0, -1.0]), 0.2)
    own = np.array([[[-2.0]], [[2.0]]])
    weights, gains, growth = minimax(plant, own, H, True, True)
    assert growth == pytest.approx(rates(plant, gains, weights), abs=1e-9)
    assert growth.max() > 0.0


def test_gains_and_steps_that_do_not_fit_are_refused():
    plant = plants.paper()
    with pytest.raises(dt.ArgumentError, match=r"gains\[0\] leaves A \+ B K of mode 0 unstable"):
        minimax(plant, -plants.gains(plant), H, False, False)
    with pytest.raises(dt.ArgumentError, match=r"step must be positive, in s, got 0\."):
        minimax(plant, plants.gains(plant), 0.0, False, False)
