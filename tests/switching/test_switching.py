"""Switching signals: right-continuous, merged, random with a dwell time, read from logs."""

import re
import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.stats import expon, kstest

import deadtime as dt
from deadtime.numerics import kernels
from strategies import signals

quick = settings(max_examples=60, deadline=None, derandomize=True)


def windows(signal):
    """Every closed window that starts and ends at a switch: (switches in it, its length)."""
    t = signal.times[1:]
    return [(j - i + 1, t[j] - t[i]) for i in range(t.size) for j in range(i, t.size)]


def test_a_signal_is_right_continuous_and_goes_on_past_its_end():
    signal = dt.SwitchingSignal([0.0, 0.5, 0.75], [2, 1, 0], end=1.0)
    t = [0.0, np.nextafter(0.5, 0), 0.5, np.nextafter(0.75, 0), 0.75, 1.0, 99.0]
    assert signal(t).tolist() == [2, 2, 1, 1, 0, 0, 0]
    assert signal([[0.1, 0.6]]).shape == (1, 2)


def test_a_signal_takes_a_single_time():
    assert dt.SwitchingSignal([0.0, 0.5], [2, 1])(0.5) == 1


def test_neighbours_with_the_same_mode_are_one_sojourn():
    signal = dt.SwitchingSignal([0, 0.1, 0.2, 0.3, 0.4], [0, 0, 1, 1, 0])
    assert signal.times.tolist() == [0.0, 0.2, 0.4]
    assert signal.modes.tolist() == [0, 1, 0]
    assert signal.switches == 2


def test_the_dwell_time_is_the_shortest_sojourn_that_ends_in_a_switch():
    signal = dt.SwitchingSignal([0.0, 0.5, 0.8], [0, 1, 0], end=0.81)
    assert signal.dwell_time == pytest.approx(0.3, rel=1e-15)
    assert dt.SwitchingSignal.constant(1).dwell_time == np.inf
    assert repr(signal) == "SwitchingSignal(switches=2, end=0.81, dwell_time=0.3)"


def test_a_signal_is_immutable():
    signal = dt.SwitchingSignal([0.0, 0.5], [0, 1])
    for array in (signal.times, signal.modes):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(AttributeError):
        signal.end = 1.0


@quick
@given(signals(), st.floats(0.0, 0.999), st.integers(0, 10))
def test_after_is_the_same_signal_seen_from_later(signal, fraction, switch):
    last = signal.times[-1]
    time = float(signal.times[switch]) if switch <= signal.switches else fraction * last
    later = signal.after(time)
    assert later.end == signal.end - time
    kept = signal.times[signal.times > time]
    assert np.array_equal(later.times[1:], kept - time)
    assert later([0.0]) == signal([time])
    assert np.array_equal(later.modes[1:], signal.modes[signal.times > time])


@quick
@given(signals(), st.integers(1, 4))
def test_the_average_dwell_time_is_the_largest_that_holds_in_every_window(signal, chatter):
    average = signal.average_dwell_time(float(chatter))
    bounds = [length / (count - chatter) for count, length in windows(signal) if count > chatter]
    assert average == pytest.approx(min(bounds, default=np.inf), rel=1e-15)


def quadratic_average_dwell_time(signal, chatter):
    """Straight from the definition: all pairs of switches."""
    t = signal.times[1:]
    excess = np.arange(t.size)[None, :] - np.arange(t.size)[:, None] + 1 - chatter
    span = t[None, :] - t[:, None]
    return float((span[excess > 0] / excess[excess > 0]).min(initial=np.inf))


@pytest.mark.parametrize("chatter", [0.0, 0.5, 1.0, 1.5, 2.0, 3.25, 10.0, 299.0, 300.0, 301.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_average_dwell_time_is_that_of_all_pairs_of_switches(seed, chatter):
    rng = np.random.default_rng(seed)
    gaps = [
        rng.exponential(1.0, 300),
        rng.pareto(0.7, 300) + 1e-3,  # bursts and long rests
        rng.integers(1, 4, 300) / 8.0,  # many ties
        np.sort(rng.exponential(1.0, 300)),  # ever slower
    ][seed]
    signal = dt.SwitchingSignal(np.append(0.0, np.cumsum(gaps)), np.arange(301) % 2)
    wanted = quadratic_average_dwell_time(signal, chatter)
    assert signal.average_dwell_time(chatter) == wanted


@pytest.mark.parametrize("switches", [20_000, 1_000_000])
def test_the_average_dwell_time_of_many_switches_takes_memory_in_proportion(monkeypatch, switches):
    monkeypatch.setattr(kernels, "WISH", "always")
    gaps = np.random.default_rng(7).exponential(1.0, switches)
    gaps[switches // 2 :][:50] = 0.01
    signal = dt.SwitchingSignal(np.append(0.0, np.cumsum(gaps)), np.arange(switches + 1) % 2)
    signal.average_dwell_time()
    tracemalloc.start()
    before = time.process_time()
    found = signal.average_dwell_time(40.0)
    taken = time.process_time() - before
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    burst = signal.times[1:][switches // 2 - 1 :][:51]
    assert found <= (burst[-1] - burst[0]) / (51 - 40.0)
    assert found > 0.01
    assert most < 20 * switches + 1e6  # bytes: the hull's indices, and little else
    assert taken < 2.0  # seconds, of some 0.02


@pytest.mark.parametrize(
    ("chatter", "message"),
    [
        (-1.0, "chatter must be ≥ 0, a number of switches, got -1."),
        (np.nan, "chatter must be finite"),
    ],
)
def test_a_chatter_that_is_no_number_of_switches_is_refused(chatter, message):
    with pytest.raises(dt.ArgumentError, match=message):
        dt.SwitchingSignal([0.0, 1.0], [0, 1]).average_dwell_time(chatter)


def test_periodic_repeats_its_sojourns_up_to_the_horizon():
    signal = dt.SwitchingSignal.periodic([0.2, 0.3, 0.1], [0, 1, 2], 1.5)
    assert signal.times == pytest.approx([0, 0.2, 0.5, 0.6, 0.8, 1.1, 1.2, 1.4], rel=1e-12)
    assert signal.modes.tolist() == [0, 1, 2, 0, 1, 2, 0, 1]
    assert signal.end == 1.5


@quick
@given(st.integers(0, 10**6), st.floats(0.05, 2.0), st.floats(1.0, 3.0), st.integers(1, 4))
def test_a_random_signal_keeps_its_dwell_time(seed, dwell_time, ratio, modes):
    signal = dt.SwitchingSignal.random(
        modes, 20.0, dwell_time=dwell_time, mean_sojourn=ratio * dwell_time, seed=seed
    )
    assert signal.dwell_time >= dwell_time * (1 - 1e-12)
    assert signal.modes.max() < modes
    assert signal.end == 20.0
    assert signal.require_dwell_time(dwell_time) is signal


@quick
@given(st.integers(0, 10**6), st.floats(0.2, 2.0), st.integers(1, 4), st.floats(0.1, 2.0))
def test_a_random_signal_keeps_its_average_dwell_time_in_every_window(
    seed, average, chatter, ratio
):
    signal = dt.SwitchingSignal.random(
        3,
        20.0,
        average_dwell_time=average,
        chatter=chatter,
        mean_sojourn=ratio * average,
        seed=seed,
    )
    for count, length in windows(signal):
        assert count <= chatter + length / average * (1 + 1e-9) + 1e-9


def test_the_leaky_bucket_lets_chatter_switches_pass_at_once():
    fast = dt.SwitchingSignal.random(
        2, 400.0, average_dwell_time=1.0, chatter=3, mean_sojourn=0.1, seed=0
    )
    assert max(count for count, length in windows(fast) if length < 0.5) == 3
    assert fast.switches == pytest.approx(400.0, rel=0.05)


def test_random_sojourns_are_the_dwell_time_plus_an_exponential():
    signal = dt.SwitchingSignal.random(3, 4000.0, dwell_time=0.3, mean_sojourn=0.8, seed=2)
    extra = np.diff(signal.times) - 0.3
    assert kstest(extra, expon(scale=0.5).cdf).pvalue > 0.01
    _, jumps = np.unique((np.diff(signal.modes)) % 3, return_counts=True)
    assert jumps / jumps.sum() == pytest.approx([0.5, 0.5], abs=0.03)


@pytest.mark.parametrize("kind", ["dwell_time", "average_dwell_time"])
def test_a_seed_fixes_the_signal_and_a_longer_horizon_continues_it(kind):
    short, again, long, other = (
        dt.SwitchingSignal.random(4, horizon, **{kind: 0.4}, seed=seed)
        for horizon, seed in [(10.0, 7), (10.0, 7), (30.0, 7), (10.0, 8)]
    )
    assert np.array_equal(short.times, again.times)
    assert np.array_equal(short.modes, again.modes)
    assert np.array_equal(short.times, long.times[: short.times.size])
    assert np.array_equal(short.modes, long.modes[: short.times.size])
    assert not np.array_equal(short.times, other.times)


def test_the_default_mean_sojourn_is_twice_the_dwell_time():
    signal = dt.SwitchingSignal.random(2, 4000.0, dwell_time=0.2, seed=1)
    assert np.diff(signal.times).mean() == pytest.approx(0.4, rel=0.03)


signal = dt.SwitchingSignal([0.0, 0.5], [0, 3], end=1.0)
random = dt.SwitchingSignal.random


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: dt.SwitchingSignal([0.1], [0]), "times[0] must be 0, got 0.1: subtract it"),
        (lambda: dt.SwitchingSignal([0, 2, 1], [0, 1, 0]), "times[2] = 1 after 2 is unsorted"),
        (lambda: dt.SwitchingSignal([0, 1, 1], [0, 1, 0]), "times[2] = 1 after 1 is repeated"),
        (
            lambda: dt.SwitchingSignal([0, 1], [0, 1], 1.0),
            "end must be later than the last switch at 1 s, got 1.",
        ),
        (lambda: dt.SwitchingSignal([0, 1], [0, 1], np.nan), "end must be finite, got nan"),
        (lambda: dt.SwitchingSignal([0, 1], [0]), "modes must have one entry per time, 2, got 1."),
        (
            lambda: dt.SwitchingSignal([0, 1], [0, 0.5]),
            "modes must be integers counted from 0, got [0.0, 0.5].",
        ),
        (lambda: dt.SwitchingSignal([0, 1], [0, -1]), "modes must be integers counted from 0"),
        (
            lambda: dt.SwitchingSignal([[0, 1]], [0, 1]),
            "times must have shape (sojourns,), got (1, 2).",
        ),
        (lambda: dt.SwitchingSignal([0, np.nan], [0, 1]), "times[1] must be finite, got nan."),
        (lambda: signal([0.1, -1e-9]), "t must be ≥ 0"),
        (lambda: signal([np.nan]), "t must be ≥ 0"),
        (lambda: signal.after(1.0), "time must be in [0, end) = [0, 1), got 1."),
        (lambda: signal.after(-0.1), "time must be in [0, end)"),
        (
            lambda: signal.require_modes(3),
            "signal enters mode 3 at 0.5 s, but the plant's modes are 0..2",
        ),
        (
            lambda: signal.require_dwell_time(0.6),
            "the signal stays in mode 0 only from 0 to 0.5 s: declare at most 0.5 s.",
        ),
        (lambda: signal.require_dwell_time(0.0), "dwell_time must be positive, in s, got 0."),
        (
            lambda: dt.SwitchingSignal.periodic([0.1, 0.0], [0, 1], 1.0),
            "sojourns must be positive, in s, got 0.",
        ),
        (
            lambda: dt.SwitchingSignal.periodic([0.1], [0, 1], 1.0),
            "modes must have one entry per time, 1, got 2.",
        ),
        (
            lambda: dt.SwitchingSignal.periodic([0.1], [0], 0.0),
            "horizon must be positive, in s, got 0.",
        ),
        (lambda: random(2, 1.0), "give exactly one of the two"),
        (
            lambda: random(2, 1.0, dwell_time=0.1, average_dwell_time=0.1),
            "give exactly one of the two",
        ),
        (lambda: random(0, 1.0, dwell_time=0.1), "modes must be an integer of at least 1, got 0."),
        (
            lambda: random(True, 1.0, dwell_time=0.1),
            "modes must be an integer of at least 1, got True.",
        ),
        (lambda: random(2, -1.0, dwell_time=0.1), "horizon must be positive, in s, got -1."),
        (lambda: random(2, 1.0, dwell_time=0.0), "dwell_time must be positive, in s, got 0."),
        (
            lambda: random(2, 1.0, average_dwell_time=0.0),
            "average_dwell_time must be positive, in s, got 0.",
        ),
        (
            lambda: random(2, 1.0, dwell_time=0.2, mean_sojourn=0.1),
            "mean_sojourn must be at least dwell_time = 0.2 s, got 0.1.",
        ),
        (
            lambda: random(2, 1.0, average_dwell_time=0.2, mean_sojourn=0.0),
            "mean_sojourn must be positive",
        ),
        (
            lambda: random(2, 1.0, average_dwell_time=0.2, chatter=0),
            "chatter must be an integer of at least 1, got 0.",
        ),
    ],
)
def test_a_malformed_signal_is_refused_by_name(call, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        call()


# -- the first mode's age ----------------------------------------------------------------------


def test_the_first_sojourn_counts_from_before_0():
    signal = dt.SwitchingSignal([0, 0.2, 1.0], [0, 1, 0], initial_age=0.5)
    assert signal.sojourns.tolist() == [0.7, 0.8]
    assert signal.dwell_time == 0.7
    assert signal.last_switch(np.array([0.0, 0.1999, 0.2, 5.0])).tolist() == [-0.5, -0.5, 0.2, 1.0]


def test_a_signal_seen_later_keeps_the_age_of_its_mode():
    signal = dt.SwitchingSignal([0, 0.25, 1.0], [0, 1, 0], initial_age=0.5)
    assert signal.after(0.125).initial_age == 0.625
    assert signal.after(0.75).initial_age == 0.5
    assert signal.after(0.25).initial_age == 0.0


def test_a_log_keeps_the_first_mode_s_age(tmp_path):
    signal = dt.SwitchingSignal([0, 0.25, 1.0], [0, 1, 0], end=2.0, initial_age=0.1 + 0.2)
    signal.to_csv(tmp_path / "log.csv")
    again = dt.SwitchingSignal.from_csv(tmp_path / "log.csv")
    assert again.initial_age == signal.initial_age
    assert (again.times.tolist(), again.end) == (signal.times.tolist(), 2.0)


@pytest.mark.parametrize("age", [-0.1, np.nan, np.inf])
def test_an_age_that_is_none_is_refused(age):
    with pytest.raises(dt.ArgumentError, match="initial_age must be"):
        dt.SwitchingSignal([0.0], [0], initial_age=age)
