"""`Controller` of a law on a belief: the inputs of `simulate`, whatever comes in."""

import math
import tracemalloc

import numpy as np
import pytest

import deadtime as dt
import plants
from belief_laws import GAINS, GENERIC, LAWS, MARKOV, PLANT, STEP, on_belief, paper, record
from deadtime.controller import Status


def controller(name="mode", **options):
    return dt.Controller(LAWS[name](), STEP, **options)


def sum_of_terms(table, run, u0):
    """Σ|terms| of an input at every sample, of the row where it is largest."""
    F, G = (np.abs(part).max(axis=0) for part in (table.state_gain, table.input_gain))
    past, taps = np.abs(np.concatenate((u0.T, run.inputs.T))), table.taps
    sums = [
        F @ np.abs(x) + np.einsum("tij,tj->i", G, past[k : k + taps][::-1])
        for k, x in enumerate(run.measured.T)
    ]
    return np.array(sums).max(axis=1)


def loop(law, plant, u0, horizon, seed=3):
    """A noisy run, and what a controller gives on its measurements."""
    step = law.filter.step
    kinds = [dt.imperfections.WhiteDisturbance(0.02), dt.imperfections.Noise(0.01)]
    args = plant, law, plants.off_grid(), [1.0, -1.0, 0.5], horizon, step, u0
    run = dt.simulate(*args, imperfections=kinds, seed=seed)
    one, told = dt.Controller(law, step, u0=u0), dt.Controller(law, step, u0=u0)
    u = np.array([one.update(x) for x in run.measured.T]).T
    # Its own inputs come back to it: an error may grow, though not far in so few seconds.
    scale = np.maximum.accumulate(sum_of_terms(law.law.digital(step), run, u0))
    assert (np.abs(u - run.inputs) <= 1e-12 * scale).all()
    for k, x in enumerate(run.measured.T):
        told.update(x, applied=run.inputs[:, k - 1] if k else None)
        np.testing.assert_allclose(told.belief, run.belief[:, k], rtol=0.0, atol=1e-12)
    return run


@pytest.mark.few(1)
@pytest.mark.parametrize("name", LAWS)
def test_in_the_loop_it_gives_the_inputs_and_the_belief_of_simulate(name):
    """On a plant that is not the filter's model, in noise, with inputs still in flight."""
    law = LAWS[name]()
    plant = dt.SwitchedSystem(1.03 * PLANT.A, 0.98 * PLANT.B, PLANT.delays)
    u0 = np.random.default_rng(3).normal(size=(2, law.law.digital(STEP).taps))
    run = loop(law, plant, u0, 4.0)
    assert 0.2 < run.belief.max(axis=0).min() < 0.9  # it was in doubt


def test_it_does_so_with_a_factorised_table_over_a_long_delay():
    law = on_belief(dt.ExpectedPredictor(GENERIC, GAINS, MARKOV), MARKOV, GENERIC, 0.005)
    assert law.law.digital(0.005).factor is not None
    u0 = np.random.default_rng(4).normal(size=(2, law.law.digital(0.005).taps))
    loop(law, GENERIC, u0, 2.0)


@pytest.mark.parametrize("name", ["mode", "ages"])
def test_a_warm_restart_changes_no_bit(name):
    x = record(LAWS[name](), 6.0).measured.T
    x = np.where(np.arange(len(x))[:, None] == 70, math.nan, x)
    first, second = controller(name, limits=(-4.0, 3.0)), controller(name, limits=(-4.0, 3.0))
    for one in x[:71]:
        first.update(one)
    second.restore(first.state)
    assert (second.belief == first.belief).all()
    for one in x[71:]:
        assert first.update(one).tolist() == second.update(one).tolist()
        assert (second.belief == first.belief).all()
    few = x[::15]  # each beside a controller that nothing has happened to
    again = [second.update(one).tolist() for one in few if second.reset() is None]
    assert again == [controller(name, limits=(-4.0, 3.0)).update(one).tolist() for one in few]


def test_the_filter_predicts_with_the_inputs_as_applied():
    """Beside a filter that is told what acted, period by period."""
    law, rng = LAWS["mode"](), np.random.default_rng(5)
    one, running = controller(limits=(-1.0, 1.5)), law.filter.start()
    sent = None
    for k in range(60):
        x = 0.3 * rng.normal(size=3)
        told = rng.normal(size=2) if k % 3 == 1 else None
        sent = sent if told is None else told
        expected = running.update(x, sent)
        sent = one.update(x, applied=told)
        np.testing.assert_allclose(one.belief, expected, rtol=1e-12, atol=1e-15)
    assert one.status in (Status.OK, Status.SATURATED)


def test_a_missing_state_holds_the_input_and_the_chain_goes_on():
    one, x = controller(), record(LAWS["mode"](), 2.0).measured.T
    for state in x[:20]:
        u = one.update(state)
    P = _steps_of_the_chain(one.belief, 2)
    assert (one.update([math.nan, 1.0, 0.0]) == u).all()
    assert (one.status, one.refused) == (Status.BAD_STATE, 1)
    one.update(x[21])  # the period that begins without an x says nothing, either
    np.testing.assert_allclose(one.belief, P, atol=1e-8)
    one.update(x[22], applied=[math.inf, 0.0])
    assert one.status == Status.BAD_APPLIED
    assert np.isfinite(one.belief).all()


def _steps_of_the_chain(belief, count):
    from scipy.linalg import expm

    return belief @ expm(STEP * count * MARKOV.generator)


def test_periods_without_a_call_count_for_the_chain_and_a_call_out_of_order_for_nothing():
    one, x = controller(), record(LAWS["mode"](), 2.0).measured.T
    for k in range(20):
        one.update(x[k], time=k * STEP)
    before = one.belief
    one.update(x[0], time=19.1 * STEP, belief=[1.0, 0.0, 0.0])
    assert one.status == Status.OUT_OF_ORDER
    assert (one.belief == before).all()
    one.update(x[26], time=26 * STEP)
    assert (one.status, one.late, one.samples) == (Status.LATE, 6, 27)
    np.testing.assert_allclose(one.belief, _steps_of_the_chain(before, 7), atol=1e-8)


def test_a_belief_from_elsewhere_takes_the_place_of_its_own():
    one, other = controller("ages"), controller("ages")
    for x in record(LAWS["ages"](), 1.0).measured.T:
        one.update(x)
        u = other.update(x, belief=[0.0, 1.0, 0.0])
    np.testing.assert_allclose(other.belief, [0.0, 1.0, 0.0], atol=1e-15)
    assert (u != one.update(x)).any()
    before = other.state
    for bad, message in (
        ([0.5, 0.5, 0.1], "belief must be probabilities, ≥ 0 with sum 1, got"),
        ([1.5, -0.5, 0.0], "belief must be probabilities, ≥ 0 with sum 1, got"),
        ([0.5, 0.5], r"belief must have shape \(modes,\) or \(modes, ages\)"),
        ([math.nan, 1.0, 0.0], r"belief\[0\] must be finite, got nan"),
    ):
        with pytest.raises(dt.ArgumentError, match=message):
            other.update(x, belief=bad)
    for name, value in other.state.items():
        assert np.array_equal(value, before[name], equal_nan=name == "clock")


def test_no_mode_is_read():
    one, other = controller(), controller()
    for k, x in enumerate(record(LAWS["mode"](), 1.0).measured.T):
        assert (one.update(x, mode=99 - k) == other.update(x)).all()
        assert one.status <= Status.SATURATED


def test_misuse_is_refused_by_name():
    plain = dt.Controller(LAWS["mode"]().law, STEP)
    assert plain.belief is None
    with pytest.raises(
        dt.ArgumentError, match="belief needs a BeliefPredictor; expected reads the mode"
    ):
        plain.update([1.0, 0.0, 0.0], 0, belief=[1.0, 0.0, 0.0])
    with pytest.raises(dt.ArgumentError, match=r"step must be the filter's, 0\.05 s, got 0\.1"):
        dt.Controller(LAWS["mode"](), 0.1)
    one = controller()
    with pytest.raises(dt.ArgumentError, match=r"state\['belief'\] must be probabilities"):
        one.restore({**one.state, "belief": np.full((3, 1), 0.5)})
    with pytest.raises(dt.ArgumentError, match="of the same law = belief"):
        one.restore(plain.state)


def test_more_periods_keep_no_more_memory():
    one = dt.Controller(paper(), 0.02)
    x, u, kept = np.array([1.0, -1.0]), np.empty(1), []
    one.update(x, 0, out=u)
    tracemalloc.start()
    for _ in range(3):
        for _ in range(300):
            one.update(x, 0, out=u)
        kept.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert kept[2] <= kept[1] + 4000
