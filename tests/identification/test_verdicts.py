"""A verdict is "enough" of intervals alone that can be trusted."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
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
        (log(WHITE), (0.0, 0.3121), "the delay lies at the edge of the range searched"),
        (log(FAINT), (0.0, 1.0), "the log hardly tells the delay"),
        (log(ALTERNATE), (0.0, 1.0), "the log hardly tells the delay"),
    ],
    ids=["too short a range", "too late a range", "cut", "faint", "periodic"],
)
def test_nothing_is_enough_of_a_delay_that_is_not_told(table, bounds, doubt):
    fit = dt.identify(table, None, bounds, noise=False)
    assert any(doubt in one for one in fit.doubts)
    for said in verdict(fit):
        assert "not enough, for " in said
        assert ": enough" not in said
        assert "100 decay" not in said


def test_nor_of_residuals_that_are_not_white():
    fit = dt.identify(log(WHITE, sensor=0.05), None, (0.0, 1.0), noise=False)
    assert fit.doubts == (
        "what is left of the log is not white, and intervals are too narrow then",
    )
    assert all("not enough, for what is left of the log is not white" in s for s in verdict(fit))
