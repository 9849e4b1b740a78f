"""Units mixed up by 1,000: what can be told is refused by name, and ordinary logs are not."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.identification.identifiability import counts_milliseconds
from deadtime.identification.log.read_recording import read_recording
from synthetic_logs import Plant, oscillator

H = 0.05
TWO, QUIET = oscillator(), oscillator(W=1e-9)
ONE = Plant([[[-1.0]]], [[[1.0]]], 0.312, 1e-3 * np.eye(1))
APART = Plant([[[-1.0, 0.0], [0.5, -2.0]]], np.eye(2)[None], [[0.112, 0.16]], 1e-3 * np.eye(2))


def log(plant, seed, rows=400, scale: Any = 1.0, sensor=0.0):
    """Of binary inputs, by `scale` times as large: a number or one for every row and input."""
    rng, m = np.random.default_rng(seed), plant.B.shape[2]
    mode = (np.arange(rows) // 20) % len(plant.A)
    u = scale * rng.choice([-1.0, 1.0], (rows, m))
    y, _ = plant.log(H * np.arange(rows), u, rng, mode, sensor=sensor)
    columns = {f"x{i + 1}": one for i, one in enumerate(y.T)}
    columns |= {f"u{j + 1}": one for j, one in enumerate(u.T)}
    return pd.DataFrame({"t": H * np.arange(rows), **columns, "mode": mode})


def scaled(table, column, factor, first=0):
    table = table.copy()
    table.loc[table.index >= first, column] *= factor
    return table


FIRST, SECOND = log(TWO, 1), log(TWO, 2, 300)


@pytest.mark.parametrize("factor", [1e3, 1e-3])
@pytest.mark.parametrize("column", ["x1", "x2", "u1"])
def test_a_column_of_one_log_in_other_units_than_in_another_is_named(column, factor):
    for logs in ([FIRST, scaled(SECOND, column, factor)], [scaled(FIRST, column, factor), SECOND]):
        second_is_larger = (factor > 1.0) == (logs[0] is FIRST)
        what = "divided" if second_is_larger else "multiplied"
        with pytest.raises(
            dt.ArgumentError, match=rf"{column} seems .* {what} by 1,000 in log\[1\]"
        ):
            dt.identify(logs)


@pytest.mark.parametrize(("row", "factor", "what"), [(150, 1e3, "divided"), (250, 1e-3, "multip")])
@pytest.mark.parametrize("column", ["x1", "x2", "u1"])
def test_a_column_that_changes_its_units_midway_is_named_with_its_line(
    column, row, factor, what, tmp_path
):
    scaled(FIRST, column, factor, row).to_csv(tmp_path / "log.csv", index=False)
    place = rf"{column} seems .* from .*log.csv, line {row + 2}, on than before: .* {what}"
    with pytest.raises(dt.ArgumentError, match=place):
        dt.identify(tmp_path / "log.csv")


def test_of_a_single_state_too():
    table = log(ONE, 3, 300)
    with pytest.raises(dt.ArgumentError, match=r"x1 seems .* from log, row 170, on"):
        dt.identify(scaled(table, "x1", 1e3, 170))
    with pytest.raises(dt.ArgumentError, match=r"u1 seems .* in log\[1\]"):
        dt.identify([table, scaled(log(ONE, 4, 300), "u1", 1e3)])


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds")])
def test_a_clock_that_counts_something_else_is_said(factor, unit):
    with pytest.raises(dt.ArgumentError, match=f"if its t counts {unit}, divide it by 1,000"):
        dt.identify(scaled(FIRST, "t", factor))
    other = scaled(SECOND, "t", factor)
    for logs, name in (
        ([FIRST, other], r"log\[1\]"),
        ([scaled(FIRST, "t", factor), SECOND], "log"),
    ):
        with pytest.raises(dt.ArgumentError, match=f"if t counts {unit} in {name}, divide it by"):
            dt.identify(logs)
        with pytest.raises(dt.ArgumentError, match=f"if t counts {unit} in {name}, divide it by"):
            dt.identify(logs, delay=(0.0, 100.0))


def test_a_clock_of_milliseconds_is_said_where_a_wide_range_hides_it():
    """Rows 50 "s" apart are within delays up to 100 "s", and the delay is not."""
    fit = dt.identify(scaled(FIRST, "t", 1e3), delay=(0.0, 100.0))
    assert "t counts whole numbers, a row every 50: if these are milliseconds" in fit.message
    slow = dt.identify(scaled(FIRST, "t", 1e3), delay=(0.0, 1000.0))  # as of a plant so slow
    assert "whole numbers" not in slow.message


@pytest.mark.parametrize(
    ("step", "jitter", "said"),
    [
        *[(step, 0, False) for step in (1, 2, 5, 10, 20, 60, 300)],
        *[(step, 0, True) for step in (25, 50, 100, 250, 1000)],
        *[(step, 1, True) for step in (20, 60)],
        *[(step, 0.25, False) for step in (1, 10, 50)],
    ],
)
def test_milliseconds_are_said_of_stamps_that_no_clock_of_seconds_makes(step, jitter, said):
    rng = np.random.default_rng(1)
    t = step * np.arange(300.0) + jitter * rng.integers(-1, 2, 300)
    x, u = rng.standard_normal((2, 300))
    record = read_recording(pd.DataFrame({"t": t, "x": x, "u": u}), None)
    assert counts_milliseconds(record) == said


def test_rows_may_be_further_apart_than_the_longest_delay():
    """As of a process that is logged every minute, with half a minute of pipe."""
    plant, t = Plant([[[-0.01]]], [[[0.01]]], 18.7, 1e-6 * np.eye(1)), 60.0 * np.arange(300)
    rng = np.random.default_rng(3)
    y, u = plant.log(t, rng.standard_normal((300, 1)), rng)
    table = pd.DataFrame({"t": t, "x": y[:, 0], "u": u[:, 0]})
    low, high = dt.identify(table, modes=None, delay=(0.0, 30.0)).interval("delay")
    assert 18.0 < low < 18.7 < high < 19.4
    with pytest.raises(dt.ArgumentError, match=r"every 60 s.* far less than that: if its t counts"):
        dt.identify(table, modes=None, delay=(0.0, 10.0))


HALF = np.where(np.arange(400)[:, None] < 200, 1e-3, 1.0)
ORDINARY = {
    "two": [FIRST, SECOND],
    "one a thousandth of the other": [log(TWO, 1, scale=1e-3), SECOND],
    "the other way round": [SECOND, log(TWO, 1, scale=1e-3)],
    "one a thousandth, without noise": [log(QUIET, 1, scale=1e-3), log(QUIET, 2)],
    "larger midway": [log(QUIET, 1, scale=HALF)],
    "larger midway, noisy": [log(QUIET, 1, scale=HALF, sensor=1e-4)],
    "smaller midway": [log(QUIET, 1, scale=HALF[::-1])],
    "at rest, then not": [log(TWO, 1, scale=np.round(HALF))],
    "one input of two small": [log(APART, 1, scale=np.array([1.0, 1e-3])), log(APART, 2)],
    "one input small midway": [log(APART, 1, scale=np.hstack((HALF, HALF**0)))],
    "two rates": [FIRST, log(TWO, 2, 300).iloc[::2]],
}


@pytest.mark.parametrize("logs", ORDINARY.values(), ids=ORDINARY)
def test_ordinary_logs_are_silent(logs):
    fit = dt.identify(logs, noise=False)
    assert "counts" not in fit.message
