"""Intervals of step tests with noisy sensors, against likelihoods of closed-form responses.

A first-order plant answers a step at t_s with K (1 − e^{a (t − t_s − D)}), a = −1/τ, b = K/τ. The
second methods share no code with the package: output errors by least squares, and a scalar Kalman
filter with a simplex search.
"""

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import brentq, minimize, minimize_scalar
from scipy.stats import t as student

import deadtime as dt
from deadtime.identification.likelihoods.noisy_log import NoiseLevels, NoisyLog
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import Layout

GAIN, TAU, DELAY = 2.0, 60.0, 12.3
TRUTH = {"A[0][0,0]": -1.0 / TAU, "B[0][0,0]": GAIN / TAU, "delay": DELAY}
ONE = {20: 1.0}
SIX = {16: -0.32, 62: 0.78, 127: 0.5, 252: -0.15, 446: -1.43, 559: 1.12}


def response(a, delay, steps, t):
    """The response of dx/dt = a x + u(t − delay) from rest."""
    since = t[:, None] - np.array(list(steps)) - delay
    return np.expm1(a * since.clip(0.0)) / a @ np.array(list(steps.values()))


def log_of(steps, rows, sensor, seed):
    t = np.arange(rows, dtype=float)
    u = sum(size * (t >= row) for row, size in steps.items())
    y = GAIN / TAU * response(-1.0 / TAU, DELAY, steps, t)
    y = y + sensor * GAIN * np.random.default_rng(seed).standard_normal(rows)
    return pd.DataFrame({"t": t, "x": y, "u": u})


def identified(log):
    return dt.identify(log, modes=None, delay=(0.0, 40.0))


def output_error_interval(log, steps):
    """The 95 % interval of the delay by least squares; x_0 and b are linear."""
    t, y = log["t"].to_numpy(), log["x"].to_numpy()

    def squares(delay):
        def of(rate):
            a = -np.exp(rate)
            columns = np.column_stack((np.exp(a * t), response(a, delay, steps, t)))
            return np.linalg.lstsq(columns, y, rcond=None)[1][0]

        return minimize_scalar(
            of, bounds=(np.log(0.2 / TAU), np.log(5.0 / TAU)), method="bounded"
        ).fun

    best = minimize_scalar(squares, bounds=(10.0, 15.0), method="bounded", options={"xatol": 1e-3})
    spare = y.size - 4
    most = best.fun * (1.0 + student.ppf(0.975, spare) ** 2 / spare)
    ends = (best.x - 6.0, best.x), (best.x, best.x + 6.0)
    return [brentq(lambda delay: squares(delay) - most, *each, xtol=1e-3) for each in ends]


@pytest.mark.parametrize(("steps", "rows", "seed"), [(SIX, 600, 0), (SIX, 600, 1), (ONE, 240, 1)])
def test_a_quiet_plants_delay_is_as_certain_as_by_output_errors(steps, rows, seed):
    """The likeliest W is 0: intervals are those of least squares."""
    log = log_of(steps, rows, 0.01, seed)
    low, high = identified(log).interval("delay")
    least, most = output_error_interval(log, steps)
    assert [low, high] == pytest.approx([least, most], abs=0.05 * (most - least))


def filtered(log, a, b, delay, W):
    """log L of measurements for a step at row 20, and R.

    R is concentrated, x_0 integrated out, W in units of R.
    """
    t, y = log["t"].to_numpy(), log["x"].to_numpy()
    e, free = y - b * response(a, delay, ONE, t), np.exp(a * t)
    phi, Q = np.exp(a), W * np.expm1(2.0 * a) / (2.0 * a)
    own = other = P = total = squares = cross = of_y = 0.0
    for one, start in zip(e.tolist(), free.tolist(), strict=True):
        s = P + 1.0
        left, by_start = one - own, start - other
        total, of_y = total + np.log(s), of_y + left * left / s
        squares, cross = squares + by_start * by_start / s, cross + by_start * left / s
        own, other = phi * (own + P / s * left), phi * (other + P / s * by_start)
        P = phi * phi * P / s + Q
    R = (of_y - cross**2 / squares) / (y.size - 1)
    return -0.5 * (total + np.log(squares) + (y.size - 1) * np.log(R)), R


def others_information(log, place, a, b, delay, W, R):
    """The information on A, B and the delay but one, by the dense normal density."""
    t = log["t"].to_numpy()

    def moments(a, b, delay):
        noise = W * R / (2.0 * a) * (np.exp(a * np.add.outer(t, t)) - lags(a))
        S = noise + 1e4 * R * np.exp(a * np.add.outer(t, t)) + R * np.eye(t.size)
        return b * response(a, delay, ONE, t), S

    def lags(a):
        return np.exp(a * np.abs(np.subtract.outer(t, t)))

    theta, moved = np.array([a, b, delay]), []
    S = np.linalg.inv(moments(*theta)[1])
    for step in np.delete(np.diag([1e-6, 1e-6, 1e-3]), place, axis=0):
        ahead, behind = moments(*(theta + step)), moments(*(theta - step))
        moved.append([(x - y) / (2.0 * step.sum()) for x, y in zip(ahead, behind, strict=True)])
    mean, by = np.array([one[0] for one in moved]), [S @ one[1] for one in moved]
    return mean @ S @ mean.T + 0.5 * np.array([[np.trace(x @ y) for y in by] for x in by])


def restricted(log, name, value=None):
    """The largest log L with one unknown fixed, less ½ log det of the others' information."""
    unit, place = np.array([2e-4, 4e-4, 0.3, 1.0]), list(TRUTH).index(name)

    def unknowns(p):
        now = np.array([*TRUTH.values(), -7.0]) + unit * p  # the logarithm of W over R
        if value is not None:
            now[place] = value
        return *now[:3], np.exp(now[3])

    p = np.zeros(4)
    for _ in range(2):
        simplex = p + np.vstack((np.zeros(4), np.eye(4)))
        options = {"initial_simplex": simplex, "xatol": 1e-2, "fatol": 1e-3}
        found = minimize(
            lambda p: -filtered(log, *unknowns(p))[0], p, method="Nelder-Mead", options=options
        )
        p = found.x
    theta = unknowns(p)
    F = others_information(log, place, *theta, filtered(log, *theta)[1])
    return -found.fun - 0.5 * np.linalg.slogdet(F)[1]


def test_about_noise_that_is_there_by_chance_ends_are_those_of_the_restricted_profile():
    log = log_of(ONE, 240, 0.01, 10)
    fit = identified(log)
    assert fit.disturbance[0, 0, 0] > 1e-7  # the plant has none
    spread = fit._estimate.spread
    assert spread.spare[0] < 5.0
    fall = 0.5 * 236 * np.log1p(student.ppf(0.975, 235) ** 2 / 235)
    half = spread.reach[0] * np.sqrt(spread.covariance[0, 0])  # of a parabola
    assert np.diff(fit.interval("A[0][0,0]"))[0] < 2.0 * half
    for name, true in TRUTH.items():
        low, high = fit.interval(name)
        assert low < true < high
        top = restricted(log, name)
        for end in (low, high):
            assert top - restricted(log, name, end) == pytest.approx(fall, rel=0.15)


def test_a_climb_that_begins_at_noise_of_0_finds_the_noise():
    rng, t = np.random.default_rng(3), np.arange(200.0)
    x, u = np.zeros(200), rng.standard_normal(200)
    for k in range(3, 199):
        x[k + 1] = 0.8 * x[k] + 0.2 * u[k - 2] + 0.1 * rng.standard_normal()
    y = (x + 0.1 * rng.standard_normal(200))[:, None]
    part = Part(t, y, u[:, None], np.zeros(200, int))
    record = Recording((part,), 1.0, True, ("x",), ("u",), ("0",), True)
    layout = Layout(1, 1, 1, per_mode=False)
    log = NoisyLog(record, layout, False, (1.0, 4.0), np.zeros(0), np.eye(1))
    theta = layout.join(np.array([[[-0.22]]]), np.array([[[0.22]]]), np.array([[2.5]]))
    quiet = log.join(theta, NoiseLevels(1e-14 * np.eye(1), np.array([0.1])))
    evaluate = log.evaluate_in(1.0, 4.0)(log.cells(theta))
    raised = log.with_visible_noise(quiet, evaluate(quiet).information)
    place = layout.size
    assert evaluate(raised).information[place, place] == pytest.approx(0.04, rel=0.2)
    assert abs(evaluate(quiet).score[place]) < 1e-6 < 1.0 < evaluate(raised).score[place]


@pytest.mark.long
@pytest.mark.parametrize("sensor", [0.01, 0.1])
def test_intervals_of_a_step_test_hold_the_truth(sensor):
    """40 logs, three unknowns each: of 120 intervals 95 % are 114, less two errors 109."""
    inside = 0
    for seed in range(40):
        fit = identified(log_of(ONE, 240, sensor, seed))
        for name, true in TRUTH.items():
            low, high = fit.interval(name)
            inside += low < true < high
    assert inside >= 109
