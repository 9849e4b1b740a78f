"""Rows that were lost or whose times were rounded: what a log knows of them, and what they cost."""

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.identification.likelihoods.likelihood import ExactLog
from deadtime.identification.likelihoods.noisy_log import NoiseLevels, NoisyLog
from deadtime.identification.likelihoods.switched_filter import Places
from deadtime.identification.log.read_recording import read_recording
from deadtime.identification.log.recording import Part
from deadtime.identification.log.row_grid import snapped, split_at_gaps
from deadtime.identification.parameters import Layout
from deadtime.identification.sampling import nodes_for
from synthetic_logs import Plant, oscillator

H, T = 0.05, 400
TWO = oscillator()
ONE = Plant(TWO.A[:1], TWO.B[:1], 0.312, TWO.W)
MODE = (np.arange(T) // 20) % 2


def table(plant, time, mode=None, seed=0):
    rng = np.random.default_rng(seed)
    y, u = plant.log(time, rng.choice([-1.0, 1.0], (time.size, 1)), rng, mode)
    columns = {"t": time, "x1": y[:, 0], "x2": y[:, 1], "u1": u[:, 0]}
    return pd.DataFrame(columns | ({} if mode is None else {"mode": mode}))


EVEN = table(TWO, H * np.arange(T), MODE)
LOST = [50, 51, 90, 133, 260, 263]


def test_a_lost_row_is_a_row_of_which_nothing_is_known():
    record = read_recording(EVEN.drop(index=LOST), "mode")
    (part,) = record.parts
    assert np.flatnonzero(~part.logged).tolist() == LOST
    assert np.flatnonzero(part.mode < 0).tolist() == LOST
    np.testing.assert_allclose(part.time, EVEN["t"], atol=1e-12)
    kept = EVEN.drop(index=LOST)
    np.testing.assert_array_equal(part.output[part.logged], kept[["x1", "x2"]])
    assert (record.even, record.samples) == (True, T - len(LOST))
    assert record.read_as == ("Read as: 6 rows lost, of which nothing is known.",)


def test_a_long_gap_and_one_off_the_grid_begin_a_new_part():
    for kept, later in ((EVEN.drop(index=range(100, 240)), 0.0), (EVEN.drop(index=[100]), 0.4)):
        moved = kept.assign(t=kept["t"] + later * H * (kept.index > 100))
        first, second = read_recording(moved, "mode").parts
        assert first.time.size == 100
        assert second.after_gap
        assert first.logged.all()


@pytest.mark.parametrize("within", [False, True])
def test_likelihoods_with_lost_rows_are_those_of_the_stretches_between(within):
    """With delays of less than a period nothing before a lost row acts after it."""
    record = read_recording(EVEN.drop(index=LOST), "mode")
    whole = read_recording(EVEN, "mode").parts[0]
    rows = np.setdiff1d(np.arange(T), LOST)
    gone = whole._replace(**{name: getattr(whole, name)[rows] for name in Part._fields[:4]})
    apart = record._replace(parts=tuple(split_at_gaps(gone, H)))
    layout = Layout(2, 2, 1, per_mode=False)
    theta = layout.join(1.05 * TWO.A, 0.9 * TWO.B, np.full((2, 1), 0.6 * H))
    nodes, bounds, cells = nodes_for(record.parts, TWO.A), (0.1 * H, 0.9 * H), np.array([1])
    exact = [ExactLog(one, layout, within, bounds, nodes) for one in (record, apart)]
    values = [log.evaluate_in(*bounds)(cells)(theta) for log in exact]
    np.testing.assert_allclose(values[0].value, values[1].value, rtol=1e-12)
    np.testing.assert_allclose(values[0].score, values[1].score, rtol=1e-9, atol=1e-7)
    levels = NoiseLevels(0.1 * np.eye(2), np.array([0.02, 0.05]))
    noisy = [NoisyLog(one, layout, within, bounds, nodes, np.eye(2)) for one in (record, apart)]
    none = Places.none(2)
    filters = [
        list(log.filter(log.join(theta, levels), log.starts(*bounds), cells).innovations(none))
        for log in noisy
    ]
    e, s = ([np.vstack([getattr(b, name) for b in own]) for own in filters] for name in "es")
    known = record.parts[0].logged
    np.testing.assert_allclose(e[0][known], e[1], rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(s[0][known], s[1], rtol=1e-12)


def test_ten_percent_of_lost_rows_leave_the_delay_and_its_interval():
    lost = np.random.default_rng(1).random(T) < 0.1
    lost[[0, -1]] = False
    fit = dt.identify(table(ONE, H * np.arange(T), seed=3)[~lost], modes=None, delay=(0.0, 1.0))
    low, high = fit.interval("delay")
    assert low < 0.312 < high < low + 0.004
    assert fit.samples == T - lost.sum()
    assert f"{lost.sum()} rows lost, of which nothing is known" in fit.message
    assert fit.read_as[-1] in fit.sentences
    assert fit.plot() is not None


@pytest.mark.parametrize(
    ("step", "resolution"), [(1 / 30, 0.01), (0.0317, 0.01), (1.4, 1.0), (0.4, 1.0)]
)
def test_times_that_a_clock_rounded_are_put_on_their_grid(step, resolution):
    true = step * np.arange(300)
    for rounded in (np.round(true / resolution), np.floor(true / resolution + 0.3)):
        grid = snapped(resolution * rounded - resolution * rounded[0])
        assert grid.resolution == pytest.approx(resolution)
        assert grid.step == pytest.approx(step, rel=1e-9 if step != 0.0317 else 1e-4)
    kept = np.setdiff1d(np.arange(300), [7, 8, 100])
    if resolution < 0.5 * step:
        grid = snapped((resolution * np.round(true / resolution))[kept])
        np.testing.assert_allclose(np.diff(grid.seconds), np.diff(true[kept]), rtol=1e-4)


def test_times_that_jitter_or_repeat_now_and_then_are_not_put_on_a_grid():
    rng = np.random.default_rng(2)
    for share in (0.03, 0.1, 0.3):
        time = H * (np.arange(300) + share * rng.uniform(-1.0, 1.0, 300))
        assert snapped(time - time[0]) is None
        if share > 0.1:
            assert snapped(np.round(time - time[0], 2)) is None
    assert snapped(np.sort(np.append(H * np.arange(300), 100 * H))) is None
    assert snapped(H * np.arange(300)) is None


def test_a_delay_from_rounded_times_lies_in_its_interval():
    true = np.arange(600) / 30.0
    log = table(ONE, true, seed=5).assign(t=true.round(2))
    fit = dt.identify(log, modes=None, delay=(0.0, 1.0), hold="held")
    low, high = fit.interval("delay")
    assert low < 0.312 < high < low + 0.002
    assert "times rounded to 0.01 s put on an even grid of 0.0333333 s" in fit.message


def test_lost_rows_are_counted_in_their_own_log_and_logs_keep_their_names():
    whole = table(ONE, H * np.arange(300), seed=1)
    gappy = whole.drop(index=[1, 2, 3, 50, 51])
    fit = dt.identify([gappy, whole, whole], modes=None, delay=(0.0, 1.0), hold="held")
    assert "log read as: 5 rows lost" in fit.message.replace("log[0]", "log")
    assert "log[2] read as" not in fit.message
    assert [len(parts) for parts in fit._recording.by_log] == [1, 1, 1]


def test_a_grid_begins_at_the_first_time_of_the_log():
    true = np.arange(300) / 30.0
    log = table(ONE, true, seed=5).assign(t=(1234.5 + true).round(2))
    fit = dt.identify(log, modes=None, delay=(0.0, 1.0), hold="held")
    assert fit._recording.parts[0].time[0] == pytest.approx(1234.5)


def test_a_lost_row_in_a_held_out_part_is_no_mode():
    fit = dt.identify(EVEN.drop(index=350), delay=(0.0, 1.0), hold="held", test="half")
    assert fit.validation.samples > 150


def test_a_range_of_delays_that_lost_rows_leave_without_measurements_is_refused():
    rng = np.random.default_rng(1)
    log = EVEN.drop(columns="mode")[rng.random(T) < 0.8]
    with pytest.raises(dt.ArgumentError, match=r"too few for .* narrow delay"):
        dt.identify(log, delay=(0.0, 2.0), noise=True)
