"""Intervals of A and B where noise hides the delay, against all that the log says of them."""

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from synthetic_logs import Plant

H, COUNT = 0.05, 120


def faint(seed, jitter=0.0, sensor=0.0, noise=1.0, held=4):
    """dx/dt = −x + u(t − 0.512) + noise that hides what the input does."""
    rng = np.random.default_rng(seed)
    t = H * (np.arange(COUNT) + jitter * rng.uniform(-1.0, 1.0, COUNT))
    u = np.repeat(rng.choice([-1.0, 1.0], (COUNT // held, 1)), held, axis=0)
    y, u = Plant([[[-1.0]]], [[[1.0]]], 0.512, noise * np.eye(1)).log(t, u, rng, sensor=sensor)
    return pd.DataFrame({"t": t, "x": y[:, 0], "u": u[:, 0]})


def identified(log, noise=False):
    return dt.identify(log, modes=None, delay=(0.0, 1.0), noise=noise)


def of_all_delays(log):
    """The middle 95 % of B, by sums over A, B and the delay; the noise's variance is out of it."""
    t, x, u = (log[name].to_numpy() for name in "txu")
    k = np.flatnonzero(t[:-1] - 1.0 >= t[0])
    tau, B = np.diff(t)[k], np.linspace(-6.0, 8.0, 281)
    total = np.zeros(B.size)
    for D in np.linspace(0.005, 0.995, 100):
        for A in np.linspace(-7.0, 1.5, 40):

            def over(time, A=A):
                return np.expm1(A * time) / A

            first = np.searchsorted(t, t[k] - D, side="right") - 1
            r = over(tau) * u[first]
            for later in (1, 2):
                left = t[k + 1] - D - t[np.minimum(first + later, COUNT - 1)]
                change = u[np.minimum(first + later, COUNT - 1)] - u[first + later - 1]
                r += np.where(left > 0.0, over(np.maximum(left, 0.0)) * change, 0.0)
            e = (x[k + 1] - np.exp(A * tau) * x[k]) / np.sqrt(tau)
            r /= np.sqrt(tau)
            total += (e @ e - 2.0 * B * (e @ r) + B**2 * (r @ r)) ** (-0.5 * (k.size - 3))
    return np.interp([0.025, 0.975], np.cumsum(total) / total.sum(), B)


@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_an_interval_of_b_is_what_the_log_says_of_it_whatever_the_delay(jitter):
    log = faint(3, jitter)
    fit = identified(log)
    low, high = fit.interval("B[0][0,0]")
    expected = of_all_delays(log)
    assert [low, high] == pytest.approx(expected, abs=0.05 * np.ptp(expected))
    inner = fit._estimate.spread
    half = inner.reach[1] * np.sqrt(inner.covariance[1, 1])
    assert high - low > 2.2 * half  # about the likeliest delay alone


def test_noise_of_sensors_leaves_a_delay_open_too():
    fit = identified(faint(3, jitter=0.3, sensor=0.1), noise=True)
    low, high = fit.interval("B[0][0,0]")
    assert fit._estimate.ends is not None
    assert low < 1.0 < high
    assert high - low > 2.0


@pytest.mark.parametrize("sensor", [0.0, 0.01])
def test_a_log_that_tells_the_delay_has_intervals_about_it_alone(sensor):
    assert identified(faint(0, 0.3, sensor, 1e-3, held=1), sensor > 0.0)._estimate.ends is None


@pytest.mark.long
@pytest.mark.parametrize("given", [(0.3, 0.0), (0.0, 0.2)])
def test_intervals_of_b_hold_it_where_noise_hides_the_delay(given):
    """About the likeliest delay alone 80 % of them do."""
    fits = [identified(faint(seed, *given), given[1] > 0.0) for seed in range(60)]
    ends = [fit.interval("B[0][0,0]") for fit in fits]
    assert np.mean([low < 1.0 < high for low, high in ends]) >= 0.85
