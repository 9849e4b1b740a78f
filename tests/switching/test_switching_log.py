"""Logs of switching signals in CSV files."""

import re

import numpy as np
import pytest
from hypothesis import given, settings

import deadtime as dt
from strategies import signals


@settings(max_examples=60, deadline=None, derandomize=True)
@given(signals())
def test_a_signal_survives_a_csv_file_exactly(tmp_path_factory, signal):
    path = tmp_path_factory.getbasetemp() / "log.csv"
    signal.to_csv(path)
    back = dt.SwitchingSignal.from_csv(path)
    assert np.array_equal(back.times, signal.times)
    assert np.array_equal(back.modes, signal.modes)
    assert back.end == signal.end


@pytest.fixture
def log(tmp_path):
    def write(text, **options):
        path = tmp_path / "log.csv"
        path.write_text(text, encoding="utf-8")
        return dt.SwitchingSignal.from_csv(path, **options)

    return write


def test_samples_at_regular_times_become_switches_that_end_with_the_log(log):
    signal = log("time,mode\n0,0\n0.5,0\n1,1\n1.5,1\n2,1\n")
    assert (signal.times.tolist(), signal.modes.tolist(), signal.end) == ([0, 1], [0, 1], 2.0)


def test_the_first_row_is_time_zero_and_other_columns_do_not_matter(log):
    signal = log("mode,speed,time\n1,9,100\n0,9,100.5\n")
    assert (signal.times.tolist(), signal.modes.tolist(), signal.end) == ([0, 0.5], [1, 0], np.inf)


def test_end_is_on_the_clock_of_the_log(log):
    assert log("time,mode\n100,1\n101,0\n", end=105.0).end == 5.0
    assert log("time,mode\n100,1\n101,1\n", end=105.0).end == 5.0


@pytest.mark.parametrize(("unit", "scale"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_a_clock_that_counts_other_than_seconds_is_told(log, unit, scale):
    start = int(1_763_800_000 * scale)
    rows = "".join(f"{start + int(t * scale)},{mode}\n" for t, mode in ((0, 0), (0.35, 1), (2, 0)))
    signal = log("time,mode\n" + rows, unit=unit, end=float(start + 3 * scale))
    assert (signal.times.tolist(), signal.end) == ([0.0, 0.35, 2.0], 3.0)
    assert log("time,mode\n" + rows).times.tolist() == signal.times.tolist()
    shifted = rows.replace(str(start)[:4], f"9{str(start)[1:4]}")
    with pytest.raises(dt.ArgumentError, match=r"time starts at 9\.7638e\+.*say unit="):
        log("time,mode\n" + shifted)
    assert log("time,mode\n" + rows, unit="s").times[1] == 0.35 * scale


def test_labels_name_the_modes(log):
    signal = log("time,mode\n0,brake\n1, throttle\n", labels={"throttle": 0, "brake": 1})
    assert signal.modes.tolist() == [1, 0]


def test_a_declared_dwell_time_is_checked(log):
    text = "time,mode\n0,0\n0.3,1\n0.5,0\n"
    assert log(text, dwell_time=0.2).switches == 2
    with pytest.raises(dt.ArgumentError, match=r"stays in mode 1 only from 0.3 to 0.5 s"):
        log(text, dwell_time=0.25)


@pytest.mark.parametrize("name", ["t", " t", "time", "time,t"])
def test_times_are_in_a_column_t_as_in_logs_of_a_plant(log, name):
    """Where both are there t is meant, as `identify` takes it."""
    more = "9," if "," in name else ""
    signal = log(f"x1,{name},mode\n0.5,{more}0,0\n0.7,{more}0.3,1\n0.6,{more}0.5,1\n")
    assert signal.times.tolist() == [0.0, 0.3]
    assert signal.end == 0.5
    with pytest.raises(dt.ArgumentError, match=r"line 3: (time|t) must be a num"):
        log(f"{name},mode\n{more}0,0\n{more}soon,1\n")


HEAD = "time,mode\n0,0\n"


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("s,mode\n0,0\n", {}, "must have the columns t (or time) and mode, got ['s', 'mode']"),
        ("", {}, "is no CSV table with one header line: it is empty."),
        ("time,mode\n", {}, "must hold at least one row, got none."),
        (HEAD + "soon,1\n", {}, "line 3: time must be a number or a stamp such as"),
        (HEAD + "\n\nsoon,1\n", {}, "line 5: time must be a number"),
        (HEAD + "nan,1\n", {}, "line 3: time must be finite, got nan."),
        (
            HEAD + "1,b\n",
            {},
            "line 3: mode must be an integer counted from 0, got 'b': map other names with labels",
        ),
        (HEAD + "1,-1\n", {}, "line 3: mode must be an integer counted from 0, got '-1'"),
        (HEAD + "1\n", {}, "line 3: mode must be an integer counted from 0, got ''"),
        (HEAD + "1,²\n", {}, "line 3: mode must be an integer counted from 0, got '²'"),
        (HEAD + "1,2\n", {"modes": 2}, "line 3: mode must be an integer in 0..1, got '2'"),
        (
            HEAD + "1,c\n",
            {"labels": {"0": 0, "b": 1}},
            "line 3: mode must be one of ['0', 'b'], got 'c'.",
        ),
        (HEAD + "1,b\n", {"labels": {"0": 0, "b": 7}, "modes": 2}, "line 3: mode must be"),
        (HEAD + "2,1\n1,0\n", {}, "line 4: time must be later than in line 3"),
        (HEAD, {"unit": "min"}, "unit must be one of s, ms, us, ns, got 'min'."),
        (HEAD + "1e308,1\n-1e308,0\n", {}, "line 4: time must be later than in line 3"),
    ],
)
def test_a_malformed_log_is_refused_by_line(log, text, options, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        log(text, **options)


def test_a_missing_log_is_refused_by_name(tmp_path):
    with pytest.raises(dt.ArgumentError, match=r"nothing\.csv cannot be read: No such file"):
        dt.SwitchingSignal.from_csv(tmp_path / "nothing.csv")


def test_a_log_that_is_not_text_is_refused_by_name(tmp_path):
    path = tmp_path / "binary.csv"
    path.write_bytes(b"time,mode\n0,\xff\n")
    with pytest.raises(dt.ArgumentError, match=r"binary\.csv"):
        dt.SwitchingSignal.from_csv(path)


def test_a_log_with_a_byte_order_mark_is_read(tmp_path):
    path = tmp_path / "excel.csv"
    path.write_bytes("time,mode\n0,1\n2,0\n".encode("utf-8-sig"))
    np.testing.assert_array_equal(dt.SwitchingSignal.from_csv(path).modes, [1, 0])
