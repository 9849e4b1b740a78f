"""Step tests: a plant at rest, one or a few steps of its input, logged from shortly before."""

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

import deadtime as dt
from deadtime.identification.log.logged_states import resting
from deadtime.identification.log.recording import Part, Recording
from shares import mostly_long

H, DELAY, RATE = 0.02, 0.23, 2.0


def motor(edges, sizes, end=6.0, noise=0.005, level=0.0, valve=0.0, seed=0):
    """dx/dt = −2 x + 2 u(t − 0.23) about a level of x and of u, by its closed form."""
    t = H * np.arange(round(end / H))
    u, x = np.zeros(t.size), np.zeros(t.size)
    for edge, size in zip(edges, sizes, strict=True):
        u += size * (t >= edge - 1e-9)
        x += size * -np.expm1(-RATE * np.maximum(t - edge - DELAY, 0.0))
    y = x + level + noise * np.random.default_rng(seed).standard_normal(t.size)
    return pd.DataFrame({"t": t, "x1": y, "u1": u + valve})


def holds(fit, delay=DELAY):
    low, high = fit.delay_interval[0, 0]
    assert low <= fit.delays[0, 0] <= high
    return low - 1e-3 <= delay <= high + 1e-3


KINDS = {
    "at once": ([H], [1.0], {}),
    "soon": ([0.5], [1.0], {}),
    "late": ([2.4], [1.0], {}),
    "noisy": ([0.5], [1.0], {"noise": 0.02}),
    "pulse": ([0.5, 2.5], [1.0, -1.0], {}),
    "up and down": ([0.5, 2.0, 4.0], [1.0, -2.0, 1.5], {}),
    "level": ([0.5], [1.0], {"level": 21.0}),
    "valve": ([0.5], [1.0], {"valve": 40.0}),
    "both": ([0.5], [-1.0], {"level": -300.0, "valve": 7.0}),
}


@pytest.mark.parametrize("kind", mostly_long(KINDS, "soon", "both", "up and down"))
def test_a_step_test_tells_delay_gain_and_time_constant_with_default_options(kind):
    edges, sizes, how = KINDS[kind]
    fit = dt.identify(motor(edges, sizes, **how), modes=None)
    assert holds(fit)
    assert fit.plant.A[0, 0, 0] == pytest.approx(-RATE, rel=0.1)
    assert fit.plant.B[0, 0, 0] == pytest.approx(RATE, rel=0.1)
    assert "looks like chance" in fit.message
    assert "taken for those of its first row" in fit.message
    level, valve = how.get("level", 0.0), how.get("valve", 0.0)
    if level == valve == 0.0:
        assert fit.operating_point is None
    else:
        assert fit.operating_point.x == pytest.approx([level], abs=0.02)
        assert fit.operating_point.u == pytest.approx([valve], abs=0.02)
        assert "subtract" not in fit.message


def test_an_order_of_1_and_logged_states_are_the_same_question():
    log = motor([0.5], [1.0], level=3.0)
    one = dt.identify(log, modes=None)
    other = dt.identify(log.rename(columns={"x1": "y1"}), modes=None, order=1)
    np.testing.assert_array_equal(one.delays, other.delays)
    np.testing.assert_array_equal(one.plant.A, other.plant.A)
    assert one.message.replace("x1", "y1") == other.message


def test_the_balance_point_of_logs_of_which_one_begins_at_rest_is_said_to_be_of_that():
    first, second = motor([0.5], [1.0], level=3.0), motor([0.02, 2.0], [1.0, -1.0], level=3.0)
    second = second[60:].assign(t=second.t - second.t[60])
    near = "Balance point near the first row of a log that begins at rest: "
    assert near in dt.identify([second, first], modes=None).message
    assert "near the log's first row: " in dt.identify([first, first], modes=None).message


def test_who_knows_that_inputs_were_others_before_the_log_says_so():
    fit = dt.identify(motor([0.5], [1.0], level=3.0), modes=None, rest=False)
    assert "first row" not in fit.message
    low, high = fit.delay_interval[0, 0]
    assert low <= fit.delays[0, 0] <= high


def test_inputs_that_were_others_before_the_log_are_not_taken_for_its_first():
    """The input rests from the log's first row on, and what it did before arrives within it."""
    t = H * np.arange(-200, 300)
    rng = np.random.default_rng(1)
    u = np.where(t < 0.0, np.repeat(rng.choice([-1.0, 1.0], 50), 10), 1.0)
    u[t > 1.5] = -1.0
    x, Phi = np.zeros(t.size), np.exp(-RATE * H)
    N, s = 12, 12 * H - DELAY
    for k in range(N, t.size - 1):
        new = -np.expm1(-RATE * s)
        x[k + 1] = Phi * x[k] + (1.0 - Phi - new) * u[k - N] + new * u[k - N + 1]
    log = pd.DataFrame({"t": t, "x1": x + 2e-3 * rng.standard_normal(t.size), "u1": u})[t >= 0.0]
    fit = dt.identify(log, modes=None, delay=(0.0, 1.0))
    assert holds(fit)


def test_position_and_speed_tell_the_delay_of_a_step():
    A, b = np.array([[0.0, 1.0], [-4.0, -1.2]]), np.array([0.0, 8.0])
    t, D = 0.05 * np.arange(160), 0.63
    late = np.maximum(t - 1.0 - D, 0.0)
    steady = np.linalg.solve(A, b)
    x = np.array([(expm(A * s) - np.eye(2)) @ steady for s in late])
    y = x + 0.01 * np.random.default_rng(0).standard_normal(x.shape) + [12.0, 0.0]
    log = pd.DataFrame({"t": t, "x1": y[:, 0], "x2": y[:, 1], "u1": 5.0 + (t >= 1.0 - 1e-9)})
    fit = dt.identify(log, modes=None)
    assert holds(fit, D)
    assert fit.operating_point.x == pytest.approx([12.0, 0.0], abs=0.05)


def test_an_input_that_never_moves_is_left_out_and_said():
    log = motor([0.5], [1.0]).assign(u2=45.0)
    fit = dt.identify(log, modes=None)
    assert fit.inputs == ("u1",)
    assert "u2 is 45 throughout" in fit.message
    assert holds(fit)


@pytest.mark.parametrize(
    ("u", "rests"),
    [
        (np.repeat([0.0, 1.0], [25, 75]), True),
        (np.repeat([0.0, 1.0, 0.0], [1, 49, 50]), True),
        (np.tile([0.0, 0.0, 1.0, 1.0], 25), False),
        (np.random.default_rng(0).standard_normal(100), False),
    ],
    ids=["step", "step at once", "held in turn", "noise"],
)
def test_a_log_begins_at_rest_where_its_input_stays_longer_than_otherwise(u, rests):
    x = np.cumsum(u)[:, None] - u[0]
    part = Part(
        np.arange(100.0), np.where(u.cumsum() > 0.0, x.T, 0.0).T, u[:, None], np.zeros(100, int)
    )
    record = Recording((part,), 1.0, True, ("x",), ("u",), ("0",), False)
    assert resting(record, None).parts[0].rests is rests
    assert resting(record, True).parts[0].rests
    assert not resting(record, False).parts[0].rests
