"""Logs that tell little, and what is said of them: the cause in words, and what to do."""

import re

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from synthetic_logs import Plant, oscillator

H, T = 0.05, 400
TWO = oscillator()
ONE = Plant(TWO.A[:1], TWO.B[:1], 0.312, TWO.W)
RNG = np.random.default_rng(1)
BINARY = RNG.choice([-1.0, 1.0], (T, 1))
TIME = H * np.arange(T)


def table(plant, u, mode=None, feedback=None):
    y, sent = plant.log(TIME, u, np.random.default_rng(0), mode, feedback=feedback)
    columns = {f"x{i + 1}": one for i, one in enumerate(y.T)}
    columns |= {f"u{j + 1}": one for j, one in enumerate(sent.T)}
    return pd.DataFrame({"t": TIME, **columns, "mode": 0 if mode is None else mode})


MODE = (np.arange(T) // 20) % 2
GOOD = table(TWO, BINARY, MODE)
PERIODIC = table(ONE, np.tile(BINARY[:10], (T // 10, 1)))
SQUARE = table(ONE, np.resize(np.repeat([-1.0, 1.0], 30), T)[:, None])
SINE = table(ONE, np.sin(2.0 * np.pi * TIME / 0.83)[:, None])


def said(log, **how):
    return dt.identify(log, **how).message


@pytest.mark.parametrize(
    ("log", "words"),
    [
        (PERIODIC, "u1 repeats itself every 0.5 s, and with it the delays that explain the log"),
        (SQUARE, "u1 repeats itself with the opposite sign every 1.5 s"),
        (SINE, "u1 repeats itself with the opposite sign every 0.4 s"),
    ],
    ids=["sequence", "square", "sine"],
)
def test_an_input_that_repeats_itself_is_said_with_its_period(log, words):
    message = said(log)
    assert words in message
    assert "narrow delay=(low, high), --delay LOW HIGH, to less than" in message
    assert "log for longer" not in message
    assert "repeats" not in said(GOOD)


def test_a_range_shorter_than_the_period_tells_the_delay_of_it():
    fit = dt.identify(PERIODIC, delay=(0.1, 0.55))
    low, high = fit.delay_interval[0, 0]
    assert low < 0.312 < high < low + 0.01
    assert "repeats" not in fit.message


def test_a_law_alone_tells_a_sum_and_that_is_said_in_words():
    law = np.array([[-0.5, -0.3]])
    words = "u1 is a function of the states of its row, as of a law u = K x and nothing else: the"
    assert words in said(table(ONE, np.zeros((T, 1)), feedback=law))
    assert words not in said(table(ONE, 0.3 * BINARY, feedback=law))
    at_once = table(Plant(TWO.A[:1], TWO.B[:1], 1e-6, TWO.W), np.zeros((T, 1)), feedback=law)
    with pytest.raises(
        dt.ArgumentError, match=r"apart: .* the log determines A \+ B K rather than A"
    ):
        dt.identify(at_once, delay=(0.0, 0.05))


def test_inputs_that_move_together_are_named():
    two = Plant(TWO.A[:1], [[[0.3, 0.0], [1.0, 0.5]]], [[0.312, 0.312]], TWO.W)
    message = said(table(two, BINARY * [1.0, -2.0]), delay=(0.0, 0.6))
    assert "u1 moves as u2 does throughout" in message or "u2 moves as u1 does" in message


def test_a_delay_outside_the_range_is_said():
    below = said(GOOD, delay=(0.0, 0.2))
    assert below.startswith(
        "Delay not found: the best fit is at the longest delay of the range searched, 0 … 0.2 s. "
        "Repeat with delay=(0, "
    )
    for bounds in ((0.0, 0.2), (0.0, 0.25), (0.5, 1.0)):
        text = f"a delay outside the range searched, {bounds[0]:g} … {bounds[1]:g} s: widen"
        assert text in said(GOOD, delay=bounds)


def test_a_mode_that_is_declared_and_never_visited_is_said():
    kinds = pd.Categorical(np.where(MODE, "road", "ice"), categories=["ice", "mud", "road"])
    fit = dt.identify(GOOD.assign(mode=kinds))
    assert fit.modes == ("ice", "road")
    assert "Mode 'mud' is declared and never visited: nothing is known of it" in fit.message
    assert "declared" not in said(GOOD.assign(mode=kinds.remove_unused_categories()))


def test_the_digits_of_a_delay_show_how_sure_it_is():
    fit = dt.identify(GOOD)
    low, high = fit.delay_interval[0, 0]
    text = fit.sentences[0].split(" within ")[1].removesuffix(" s.").split(" … ")
    shown = [float(one) for one in text]
    np.testing.assert_allclose(shown, [low, high], atol=0.05 * (high - low))


REFUSED = {
    "empty": (GOOD.iloc[:0], {}, "log must have at least 3 rows, got 0: log for longer"),
    "short": (GOOD.iloc[:30], {}, "mode '.' has .* periods? .*: it is too short. The log lasts"),
    "rows lost often": (
        GOOD.drop(index=range(5, T, 8)),
        {},
        "too short. 50 rows are lost, and a period is of use only if .*: narrow delay=.low, high",
    ),
    "a mode hardly": (
        GOOD.assign(mode=np.arange(T) // 395),
        {"switches": "samples"},
        "mode '1' has 4 periods whose .* Log longer stays in it",
    ),
    "noise in words": (GOOD, {"noise": "yes"}, "noise must be True, False, or None .*'yes'"),
    "zeros in words": (GOOD, {"zeros": "no"}, "zeros must be True, False, or None .*'no'"),
    "progress is no function": (
        GOOD,
        {"progress": 3},
        "progress must be a function .* leave it out",
    ),
    "a mode slips in": (
        GOOD.assign(mode=np.where(np.arange(T) % 30, MODE, 2)),
        {},
        "mode '2' has 0 periods .* It stays for 1 row at a time, at most: put rows right whose",
    ),
    "every row another mode": (
        GOOD.assign(mode=np.arange(T) % 2),
        {},
        'changes at samples only say switches="samples", --switches samples',
    ),
    "a mode never": (GOOD.assign(mode=2 * MODE), {}, "mode: mode 1 is never visited"),
    "never measured": (GOOD.assign(x1=np.nan), {}, "x1 must move, got no row where all states"),
    "text for a list": (GOOD, {"states": "x1,x2"}, r"states must be a list .* \['x1', 'x2'\], got"),
    "milliseconds": (GOOD, {"delay": (0, 500)}, r"delay = \(0, 500\) s is 10,000 periods"),
    "clock": (
        GOOD.rename(columns={"t": "t_ms"}),
        {},
        'column t of times in seconds.* name it by time="…", --time, or give the sampling',
    ),
    "constant": (table(ONE, np.ones((T, 1))), {}, "u1 must change, got 1.0 .* --inputs"),
}


@pytest.mark.parametrize(("log", "how", "message"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_is_refused_by_name(log, how, message):
    with pytest.raises(dt.ArgumentError, match=message):
        dt.identify(log, **how)


@pytest.mark.parametrize(("row", "value"), [(150, 40.0), (60, -4.0), (399, 1e3)])
def test_a_wrong_reading_is_named_and_nothing_looks_like_chance_beside_it(row, value):
    log = table(ONE, BINARY)
    log.loc[row, "x1"] = value
    fit = dt.identify(log, modes=None, delay=(0.0, 0.6))
    assert f"x1 at t = {log['t'][row]:.10g} s lies" in fit.message
    assert "looks like chance" not in fit.message
    assert any("farther off than chance" in doubt for doubt in fit.doubts)


def test_a_wrong_reading_of_more_outputs_than_states_is_named():
    C = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    log = table(ONE, BINARY)
    y = log[["x1", "x2"]].to_numpy() @ C.T + 0.01 * np.random.default_rng(3).standard_normal((T, 3))
    y[200, 2] += 1.0
    outputs = pd.DataFrame({"t": log["t"], "u1": log["u1"]} | {f"y{j}": y[:, j] for j in range(3)})
    fit = dt.identify(outputs, modes=None, delay=(0.0, 0.6), C=C)
    assert f"y2 at t = {log['t'][200]:.10g} s lies" in fit.message


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_a_sensor_that_is_slower_than_the_rows_is_seen(share):
    log = table(ONE, BINARY)
    stale = np.flatnonzero(np.random.default_rng(2).random(T - 1) < share) + 1
    log.loc[stale, "x2"] = log["x2"].to_numpy()[stale - 1]
    fit = dt.identify(log, modes=None, delay=(0.0, 0.6))
    assert re.search(r"\d+ % of rows repeat the x2 before", fit.message)
    assert any("repeated" in doubt for doubt in fit.doubts)


def test_rounded_measurements_and_a_rest_without_noise_are_no_repeats():
    log = table(ONE, BINARY)
    assert "repeat the" not in dt.identify(log.round(2), modes=None, delay=(0.0, 0.6)).message
    still = table(Plant([[[-1.0]]], [[[1.0]]], 0.31), np.repeat([0.0, 1.0], T // 2)[:, None])
    fit = dt.identify(still, modes=None, delay=(0.0, 0.6))
    assert "repeat the" not in fit.message
    assert not fit.doubts
