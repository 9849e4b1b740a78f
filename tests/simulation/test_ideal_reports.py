"""What an ideal run reports: jumps of the input, right limits, cost, points and messages."""

import re
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import fixed_quad
from scipy.linalg import expm

import deadtime as dt
import plants
from ideal_runs import CONSTANT, PAPER, PLANT, SIGNAL, X0, D, reference, run, same_run


def test_at_time_zero_the_input_is_already_the_law_s():
    expected = np.mean(
        [K @ expm(A * PLANT.delay) @ X0 for A, K in zip(PLANT.A, plants.gains(PLANT), strict=True)],
        axis=0,
    )
    plants.close(run().inputs[:, 0], expected, 1e-13)


def test_the_oracle_s_input_jumps_a_delay_before_a_switch():
    K = plants.gains(PLANT)
    for switch, old, new in [(0.3727, 2, 0), (0.8, 0, 1), (1.1234, 1, 2)]:
        at = run("exact", times=[switch - D - 1e-9, switch - D, switch])
        x = at.states[:, 2]
        plants.close(at.inputs[:, 0], K[old] @ x, 1e-7)
        plants.close(at.inputs[:, 1], K[new] @ x, 1e-12)


def test_delayed_feedback_jumps_at_a_switch():
    K = plants.gains(PLANT)
    for switch, old, new in [(0.3727, 2, 0), (0.8, 0, 1), (1.1234, 1, 2)]:
        at = run("delayed", times=[switch - 1e-9, switch])
        plants.close(at.inputs[:, 0], K[old] @ at.states[:, 0], 1e-12)
        plants.close(at.inputs[:, 1], K[new] @ at.states[:, 1], 1e-12)
        assert at.mode.tolist() == [old, new]


def test_switches_at_reported_instants_are_right_limits():
    # Switches, and switches less the delay, fall on multiples of 0.01, up to round-off.
    switches = [0.0, 0.3, 0.7, 1.1, 1.3, 2.3, 2.9]
    signal = dt.SwitchingSignal(switches, [0, 1, 0, 1, 0, 1, 0])
    for times in (np.arange(301) * 0.01, np.linspace(0.0, 3.0, 301), np.cumsum([0.01] * 299)):
        one = run("exact", PAPER, signal, [-1.0, 1.0], 3.0, times=times)
        assert np.abs(one.mismatch).max() <= 1e-11 * np.abs(one.inputs).max()
        other = run("delayed", PAPER, signal, [-1.0, 1.0], 3.0, times=times)
        u = np.einsum("kij,jk->ik", plants.gains(PAPER)[signal(times + 1e-9)], other.states)
        plants.close(other.inputs, u, 1e-12)
        assert np.array_equal(other.mode, signal(times + 1e-9))


def test_an_ideal_run_reports_1001_uniform_points_unless_asked_for_others():
    one = run()
    assert np.array_equal(one.time, np.linspace(0.0, 3.0, 1001))
    assert np.array_equal(one.mode, SIGNAL(one.time))
    some = run(times=one.time[[0, 17, 500, 1000]])
    plants.close(some.states, one.states[:, [0, 17, 500, 1000]], 1e-14)
    plants.close(some.inputs, one.inputs[:, [0, 17, 500, 1000]], 1e-14)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["averaged", "exact", "delayed"])
def test_the_cost_is_the_integral_of_the_reference(name):
    law = plants.LAWS[name](PLANT)
    other = reference(law, PLANT, SIGNAL, X0, 3.0)
    edges = other.edges[(other.edges >= 0.0) & (other.edges <= 3.0 + 1e-9)]
    ise, energy = (
        sum(
            fixed_quad(lambda t, f=f: np.sum(f(t) ** 2, axis=0), a, b, n=20)[0]
            for a, b in pairwise(edges)
        )
        for f in (other.states, other.inputs)
    )
    metrics = run(law).metrics()
    assert metrics["ise"] == pytest.approx(ise, rel=1e-11)
    assert metrics["energy"] == pytest.approx(energy, rel=1e-11)
    assert metrics["cost"] == metrics["ise"] + metrics["energy"]


def test_a_signal_that_ends_early_is_continued_and_the_message_says_so():
    short = dt.SwitchingSignal([0.0, 0.3], [0, 1], end=0.5)
    one = run(signal=short)
    assert one.message == "the signal ends at 0.5 s and was continued in mode 1."
    same_run(one, run(signal=dt.SwitchingSignal([0.0, 0.3], [0, 1])), 1e-14)


@pytest.mark.parametrize("horizon", [150.0, 1000.0])
def test_a_run_that_diverges_ends_with_a_message(horizon):
    one = run("delayed", PAPER, CONSTANT, [-1.0, 1.0], horizon)
    assert one.diverged
    assert re.fullmatch(r"diverged: \|x\| left 1e100 after t = 116(\.\d+)? s.*", one.message)
    assert one.end == one.time[-1] < 117.0
    assert 1e98 < np.abs(one.states[:, -1]).max() <= 1e100
    for values in (one.states, one.inputs):
        assert np.isfinite(values).all()
    assert not np.isnan(one.mismatch).any()
    assert all(not np.isnan(value) for value in one.metrics().values())
    before = run("delayed", PAPER, CONSTANT, [-1.0, 1.0], 100.0)
    assert not before.diverged
    again = run("delayed", PAPER, CONSTANT, [-1.0, 1.0], horizon, times=before.time)
    plants.close(again.states, before.states, 1e-11)
