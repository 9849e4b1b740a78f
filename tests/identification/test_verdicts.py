"""A verdict is "enough" of intervals alone that can be trusted."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.identification.problem_text import problem_text
from synthetic_logs import Plant

H, T = 0.05, 240
LAG = Plant([[[-1.0]]], [[[1.0]]], 0.312, 1e-4 * np.eye(1))
RNG = np.random.default_rng(4)
WHITE, FAINT = RNG.choice([-1.0, 1.0], (T, 1)), 1e-3 * RNG.standard_normal((T, 1))
ALTERNATE = np.where(np.arange(T)[:, None] // 4 % 2 == 0, 1.0, -1.0)


def log(u, sensor=0.0, plant=LAG):
    t, rng = H * np.arange(T), np.random.default_rng(7)
    y, u = plant.log(t, u, rng, sensor=sensor)
    return pd.DataFrame({"t": t, "x": y[:, 0], "u": u[:, 0]})


def verdict(fit):
    law = dt.AveragedPredictor(fit.plant, dt.place(fit.plant, [-1.2]))
    margin = dt.delay_margin(fit.plant, law, H)
    wide = dataclasses.replace(margin, lower=0.0, upper=10.0)  # a law that stands any delay
    return fit.verdict(wide, law), fit.verdict(wide)


def test_a_delay_that_is_told_has_enough():
    fit = dt.identify(log(WHITE), None, (0.0, 1.0))
    assert fit.doubts == ()
    assert all(": enough" in said for said in verdict(fit))


@pytest.mark.parametrize(
    ("table", "bounds", "doubt"),
    [
        (log(WHITE), (0.0, 0.2), "the delay lies at the edge of the range searched"),
        (
            log(WHITE),
            (0.5, 1.0),
            "the interval of the delay ends at the edge of the range searched",
        ),
        (log(FAINT), (0.0, 1.0), "the log hardly tells the delay"),
        (log(ALTERNATE), (0.0, 1.0), "the log hardly tells the delay"),
    ],
    ids=["too short a range", "too late a range", "faint", "periodic"],
)
def test_nothing_is_enough_of_a_delay_that_is_not_told(table, bounds, doubt):
    fit = dt.identify(table, None, bounds, noise=False)
    assert any(doubt in one for one in fit.doubts)
    for said in verdict(fit):
        assert "not enough, for " in said
        assert ": enough" not in said
        assert "100 decay" not in said


@pytest.mark.parametrize(
    ("bounds", "end", "advice"),
    [
        ((0.1, 0.3121), "longest delay of the range searched, 0.1 … 0.3121 s", "--delay 0.1 1."),
        ((0.32, 1.0), "shortest delay of the range searched, 0.32 … 1 s", "--delay 0 1."),
    ],
)
def test_of_a_delay_not_found_no_number_is_given_and_the_end_it_lies_at_is_widened(
    bounds, end, advice
):
    fit = dt.identify(log(WHITE), None, bounds, noise=False)
    assert fit.delays_not_found == ("delay",)
    assert f"the best fit is at the {end}" in fit.sentences[0]
    assert fit.sentences[0].endswith(advice)
    for said in verdict(fit):
        assert said.startswith("Nothing is known of the delay, not found in the range searched")
        assert not any(sign.isdigit() for sign in said)
    assert "covariance" not in problem_text(fit)


INTEGRATOR = Plant([[[-1e-4]]], [[[1.0]]], 0.312, 1e-2 * np.eye(1))


def test_gain_and_time_constant_are_given_only_where_the_log_tells_them():
    slow = dt.identify(log(WHITE, plant=INTEGRATOR), None, (0.0, 1.0), noise=False)
    low, high = slow.interval("A[0][0,0]")
    assert low < 0.0 < high
    assert "does not exclude an integrator" in slow.message
    assert slow.processes[0].gain.high == np.inf
    vague = dt.identify(log(ALTERNATE), None, (0.0, 1.0), noise=False)
    assert vague.interval("A[0][0,0]")[1] < 0.0
    assert "gain" not in vague.message.lower()
    assert not vague.processes


def test_nor_of_residuals_that_are_not_white():
    fit = dt.identify(log(WHITE, sensor=0.05), None, (0.0, 1.0), noise=False)
    assert fit.doubts == (
        "what is left of the log is not white, and intervals are too narrow then",
    )
    assert all("not enough, for what is left of the log is not white" in s for s in verdict(fit))
