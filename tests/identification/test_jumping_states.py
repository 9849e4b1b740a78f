"""Outputs alone whose derivative jumps at a switch, against plants whose states do not."""

from typing import Any

import numpy as np
import pytest

import deadtime as dt
from output_logs import H, logged, misses
from synthetic_logs import Plant, oscillator

LOWER = [[0.0, 1.0]]  # the second of two states in series is logged


def in_series(upper, flow, lower, push=1.0, D=0.312):
    """dx/dt = −a_i x + push u, dy/dt = f_i x − c_i y: y′ jumps with f and c."""
    A = [[[-a, 0.0], [f, -c]] for a, f, c in zip(upper, flow, lower, strict=True)]
    return Plant(A, [[[push], [0.0]]] * len(A), D, 1e-5 * np.eye(2))


SERIES = {
    "two tanks with a valve between": in_series((1.6, 0.6), (1.6, 0.6), (1.0, 1.0)),
    "a sensor with a filter of two speeds": in_series((1.0, 1.0), (4.0, 1.5), (4.0, 1.5)),
    "a gain that is switched": in_series((1.5, 1.5), (1.0, 2.5), (0.8, 0.8), 1.3, 0.17),
    "three modes": in_series((1.6, 0.6, 1.0), (1.6, 0.6, 1.0), (1.0, 1.0, 1.0)),
}


def identified(plant, C, seed=0, **how):
    log = logged(plant, C, 500, seed, len(plant.A), sensor=0.002, hold=4)
    given: dict[str, Any] = {"delay": (0.0, 0.6), "switches": "samples", "order": 2}
    return dt.identify(log, **given, **how)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", SERIES)
def test_a_derivative_that_jumps_at_a_switch_is_found_to_jump(name):
    plant = SERIES[name]
    fit = identified(plant, LOWER, zeros=False)
    assert "an output's derivative jumps at a switch" in fit.message
    low, high = fit.interval("delay")
    slack = 0.5 * (high - low)
    assert low - slack < plant.D[0, 0] < high + slack
    assert high - low < 0.4 * H
    a, b = plant.A[0], plant.A[1]
    truth = np.linalg.solve(np.array([[0.0, 1.0], a[1]]).T, b[1])  # y′ of mode 1 by y, y′ of mode 0
    for column, true in enumerate(truth):
        low, high = fit.interval(f"A[1][0,{column}]")
        assert low - 0.5 * (high - low) < true < high + 0.5 * (high - low)


@pytest.mark.long
def test_by_default_neither_zeros_nor_a_late_delay_stand_for_the_jump():
    plant = SERIES["two tanks with a valve between"]
    fit = identified(plant, LOWER)
    assert "an output's derivative jumps at a switch" in fit.message
    assert "act on all of them" not in fit.message
    low, high = fit.interval("delay")
    assert low < 0.312 < high < low + 0.4 * H


def test_position_and_speed_are_not_taken_to_jump():
    plant = oscillator(W=1e-5)
    fit = identified(plant, [[1.0, 0.0]], 1, zeros=False)
    assert "not to jump at a switch, as position and speed do not: the log does not say" in (
        fit.message
    )
    wrong, names = misses(fit, plant, [[1.0, 0.0]], (2,))
    assert names == 6
    assert len(wrong) <= 1
