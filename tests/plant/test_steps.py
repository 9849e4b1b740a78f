"""How time is cut: N and φ of a delay, switches laid on steps, sampled modes."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import deadtime as dt
from deadtime.plant import SampledPlant, Window
from deadtime.plant.discretisation import snap, snap_all
from deadtime.switching.grid import cuts_of, modes_at

quick = settings(max_examples=200, deadline=None, derandomize=True)


def test_naive_floats_would_get_seven_periods_wrong():
    assert np.ceil(0.07 / 0.01) == 8
    assert Window.of(0.07, 0.01) == Window(step=0.01, count=7, phase=0.01)


@pytest.mark.parametrize("step", [0.01, 0.1, 0.3, 1 / 3, 0.007])
def test_every_multiple_of_the_step_is_that_many_whole_periods(step):
    for count in range(1, 1001):
        for delay in (count * step, float(Fraction(str(step)) * count), sum([step] * count)):
            assert Window.of(delay, step) == Window(step, count, step)


@pytest.mark.parametrize(
    ("ratio", "count", "phase"),
    [
        (7 + 1e-10, 7, 1.0),
        (7 - 1e-10, 7, 1.0),
        (7 + 1e-8, 8, 1e-8),
        (7 - 1e-8, 7, 1 - 1e-8),
        (0.25, 1, 0.25),
        (1.0, 1, 1.0),
        (2.5, 3, 0.5),
        (1e-12, 1, 1e-12),
    ],
)
def test_a_ratio_within_1e_9_of_an_integer_is_that_integer(ratio, count, phase):
    window = Window.of(ratio * 0.5, 0.5)
    assert window.count == count
    assert window.phase == pytest.approx(0.5 * phase, rel=1e-7)
    if phase == 1.0:
        assert window.phase == window.step


@quick
@given(st.floats(1e-3, 1e3), st.floats(1e-2, 10.0))
def test_a_window_covers_the_delay(delay, step):
    window = Window.of(delay, step)
    assert 0 < window.phase <= step
    assert window.delay == pytest.approx(delay, abs=1.1e-9 * step, rel=1e-15)
    assert window.count - 1 <= delay / step + 1e-9
    assert delay / step <= window.count + 1e-9


@quick
@given(st.lists(st.floats(-1e5, 1e5), min_size=1))
def test_snap_all_snaps_every_entry(ratios):
    ratios = [*ratios, *np.round(ratios), *(np.round(ratios) + 9e-10)]
    assert snap_all(np.array(ratios)).tolist() == [snap(float(r)) for r in ratios]


def laid(times, window):
    modes = len(times) + 1
    plant = dt.SwitchedSystem(np.zeros((modes, 1, 1)), np.ones((modes, 1, 1)), window.delay)
    signal = dt.SwitchingSignal([0.0, *times], np.arange(modes))
    return cuts_of(signal, SampledPlant(plant, window.step))


def test_switches_at_samples_have_offset_zero_whatever_the_float():
    times = np.array([k * 0.1 for k in range(1, 200)])
    for wobble in (0.0, 1e-15, -1e-15, 5e-11, -5e-11):
        cuts = laid(times + wobble, Window.of(0.25, 0.1))
        assert cuts.step.tolist() == list(range(1, 200))
        assert (cuts.offset == 0.0).all()
        assert cuts.mode.tolist() == list(range(200))


def test_switches_at_a_sample_plus_the_delay_have_the_offset_phase_exactly():
    window = Window.of(0.25, 0.1)
    times = np.array([k * 0.1 + 0.25 for k in range(-2, 200)])
    for wobble in (0.0, 1e-15, -1e-15, 5e-11, -5e-11):
        cuts = laid(times + wobble, window)
        assert cuts.step.tolist() == list(range(202))
        assert (cuts.offset == window.phase).all()


def test_other_switches_keep_their_offset():
    window = Window.of(0.25, 0.1)
    times = [0.01, 0.0499, 0.1 + 1e-8, 0.11, 0.15 - 1e-8, 0.15 + 1e-8, 0.37]
    cuts = laid(times, window)
    assert cuts.step.tolist() == [0, 0, 1, 1, 1, 1, 3]
    assert cuts.offset == pytest.approx(
        [0.01, 0.0499, 1e-8, 0.01, 0.05 - 1e-8, 0.05 + 1e-8, 0.07], abs=1e-16
    )
    assert (cuts.offset[[2, 4, 5]] != window.phase).all()
    assert (cuts.offset > 0).all()


@quick
@given(
    st.lists(st.floats(1e-3, 20.0), min_size=1, max_size=20, unique=True),
    st.floats(0.01, 3.0),
    st.sampled_from([0.1, 0.25, 1.0]),
)
def test_cuts_are_in_order_and_put_the_switches_back(times, delay, step):
    window = Window.of(delay, step)
    cuts = laid(sorted(times), window)
    place = cuts.step * step + cuts.offset
    assert np.abs(place - sorted(times)).max() <= 2.1e-9 * step
    assert (np.diff(place) >= -1e-15 * place.max()).all()
    assert ((cuts.offset >= 0) & (cuts.offset < step)).all()


def test_a_switch_at_a_sample_is_seen_there_whatever_the_float():
    samples = np.arange(8) * 0.1
    assert samples[3] > 0.3
    for switch in (0.3, 0.1 + 0.2, 0.3 + 5e-11, 0.3 - 5e-11):
        signal = dt.SwitchingSignal([0.0, switch], [0, 1])
        assert modes_at(signal, samples, 0.1).tolist() == [0, 0, 0, 1, 1, 1, 1, 1]


def test_a_switch_after_a_sample_is_not_seen_there():
    signal = dt.SwitchingSignal([0.0, 0.3 + 1e-8], [0, 1])
    assert modes_at(signal, np.arange(6) * 0.1, 0.1).tolist() == [0, 0, 0, 0, 1, 1]


def test_a_delay_of_more_than_a_million_periods_is_taken_for_a_slip_of_units():
    assert Window.of(1000.0, 0.001).count == 1_000_000
    with pytest.raises(
        dt.ArgumentError, match=r"delay / step = 1e\+08 periods, .* both in seconds"
    ):
        Window.of(1e6, 0.01)
