"""Noise of a log whose matrices were fitted: a closed form, and a dense restricted likelihood."""

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.identification import noisy_estimate as restricted_noise
from deadtime.identification.likelihoods.likelihood import maximise
from deadtime.identification.likelihoods.noisy_log import NoiseLevels, NoisyLog
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.noisy_estimate import restricted
from deadtime.identification.parameters import Layout
from synthetic_logs import Plant

H, D = 0.1, 0.237
LAYOUT = Layout(1, 1, 1, per_mode=False)
START = LAYOUT.join(np.array([[[-1.2]]]), np.array([[[0.8]]]), np.array([[D]]))
WINDOW = 0.2 + 1e-6, 0.3 - 1e-6
UNKNOWNS = 3


def log_of(count, sensor, seed):
    """A log of one state, and its rows."""
    rng, t = np.random.default_rng(seed), H * np.arange(count)
    plant = Plant([[[-1.2]]], [[[0.8]]], D, 0.04 * np.eye(1))
    y, u = plant.log(t, rng.standard_normal((count, 1)), rng, sensor=sensor)
    part = Part(t, y, u, np.zeros(count, int))
    record = Recording((part,), H, True, ("x",), ("u",), ("0",), True)
    return NoisyLog(record, LAYOUT, False, WINDOW, np.zeros(0), np.eye(1)), part


def test_of_exact_sensors_the_noise_is_the_residuals_over_the_rows_less_the_unknowns():
    """One regression: its variance is unbiased, and Student's freedom and intervals its own."""
    count = 44
    log, part = log_of(count, 0.0, 5)
    start = log.join(START, NoiseLevels(0.04 * np.eye(1), np.array([1e-5])))
    fixed = np.arange(log.size) == log.size - 1  # sensors as good as exact
    best, _ = maximise(log, start, fixed, WINDOW)
    found = restricted(log, log, best, WINDOW, float(count))
    periods = int((~log.starts(*WINDOW)[0]).sum())
    spare = periods - UNKNOWNS
    grown = log.noise(found.theta).W[0, 0] / log.noise(best.theta).W[0, 0]
    assert grown - 1.0 == pytest.approx(UNKNOWNS / spare, rel=0.05)  # A shapes the noise, too
    np.testing.assert_allclose(found.spare[1:UNKNOWNS], spare, rtol=0.02)
    table = pd.DataFrame({"t": part.time, "x": part.output[:, 0], "u": part.input[:, 0]})
    exact = dt.identify(table, modes=None, delay=(0.1, 0.4), noise=False)
    covariance = np.linalg.inv(found.information[:UNKNOWNS, :UNKNOWNS])
    for place, name in enumerate(("A[0][0,0]", "B[0][0,0]")):
        low, high = exact.interval(name)
        error = 0.5 * (high - low) / float(exact._estimate.spread.reach[place])
        assert np.sqrt(covariance[place, place]) == pytest.approx(error, rel=0.03)


def dense(log, vector):
    """log L − ½ log det F of A, B and the delay, by the joint Gaussian of all measurements."""
    part = log.recording.parts[0]
    first = int(np.flatnonzero(log.starts(*WINDOW)[0])[-1])
    y, u = part.output[first:, 0], part.input[:, 0]
    apart = np.subtract.outer(np.arange(y.size), np.arange(y.size)).clip(0)
    W, R = np.exp(2.0 * vector[UNKNOWNS:])

    def moments(a, b, delay):
        phi, late = np.exp(a * H), np.exp(a * (3 * H - delay))
        mean, steps = np.zeros(y.size), np.full(y.size, W * (phi**2 - 1.0) / (2.0 * a))
        for k in range(y.size - 1):
            older, newer = u[first + k - 3], u[first + k - 2]
            added = b / a * ((phi - late) * older + (late - 1.0) * newer)
            mean[k + 1] = phi * mean[k] + added
        steps[0] = log.P0[0, 0]
        lower = np.tril(phi**apart)
        return mean, lower * steps @ lower.T + R * np.eye(y.size)

    theta = vector[:UNKNOWNS]
    mean, S = moments(*theta)
    inverse = np.linalg.inv(S)
    value = -0.5 * (np.linalg.slogdet(S)[1] + (y - mean) @ inverse @ (y - mean))
    moved = [(moments(*(theta + d)), moments(*(theta - d))) for d in 1e-5 * np.eye(UNKNOWNS)]
    of_mean = np.array([(ahead[0] - behind[0]) / 2e-5 for ahead, behind in moved])
    of_S = np.array([inverse @ (ahead[1] - behind[1]) / 2e-5 for ahead, behind in moved])
    F = of_mean @ inverse @ of_mean.T + 0.5 * np.einsum("iab,jba->ij", of_S, of_S)
    return value - 0.5 * np.linalg.slogdet(F)[1]


@pytest.mark.parametrize("seed", [1, 3])
def test_the_restricted_likelihood_of_the_dense_gaussian_is_largest_there(seed):
    log, _ = log_of(90, 0.03, seed)
    start = log.join(START, NoiseLevels(0.04 * np.eye(1), np.array([0.03])))
    best, _ = maximise(log, start, None, WINDOW)
    found = restricted(log, log, best, WINDOW, 90.0)

    def slope(vector):
        steps = 1e-4 * np.eye(log.size)[UNKNOWNS:]
        return np.array([(dense(log, vector + d) - dense(log, vector - d)) / 2e-4 for d in steps])

    unit = np.linalg.cholesky(np.linalg.inv(best.information[UNKNOWNS:, UNKNOWNS:]))
    before, after = (np.abs(slope(v) @ unit).max() for v in (best.theta, found.theta))
    assert after < 0.2 * before


def test_sensors_without_noise_leave_intervals_as_wide_as_if_they_were_exact():
    """The log does not tell the sensors' noise, which is at its bound or nearly."""
    _, part = log_of(120, 0.0, 4)
    table = pd.DataFrame({"t": part.time, "x": part.output[:, 0], "u": part.input[:, 0]})
    noisy, exact = (
        dt.identify(table, modes=None, delay=(0.1, 0.4), noise=noise) for noise in (True, False)
    )
    for name in ("A[0][0,0]", "B[0][0,0]", "delay"):
        width, other = (high - low for low, high in (f.interval(name) for f in (noisy, exact)))
        assert width == pytest.approx(other, rel=0.15)


@pytest.mark.long
def test_noise_beside_many_unknowns_is_not_too_small():
    """Three modes and two inputs: 26 unknowns, 300 rows; the likeliest W is 0.75 of the truth."""
    A = [[[0.0, 1.0], [-2.0, -1.0]], [[0.0, 1.0], [-3.0, -0.5]], [[0.0, 1.0], [-1.0, -1.5]]]
    plant = Plant(A, [[[0.2, 1.0], [1.0, -0.5]]] * 3, (0.312, 0.174), 9e-4 * np.eye(2))
    true, held, shares = np.array(plant.A), [], []
    for seed in range(24):
        rng, t = np.random.default_rng(seed), 0.05 * np.arange(300)
        mode = np.repeat(np.arange(30) % 3, rng.integers(10, 31, 30))[:300]
        y, u = plant.log(t, rng.standard_normal((300, 2)), rng, mode, sensor=0.02)
        columns = {"x1": y[:, 0], "x2": y[:, 1], "u1": u[:, 0], "u2": u[:, 1]}
        table = pd.DataFrame({"t": t, "mode": mode, **columns})
        fit = dt.identify(table, delay=(0.0, 0.5), noise=True, switches="samples")
        shares.append(np.diagonal(fit.disturbance[0]) / 9e-4)
        for place in np.ndindex(true.shape):
            low, high = fit.interval("A[{}][{},{}]".format(*place))
            held.append(low < true[place] < high)
    assert np.mean(shares) == pytest.approx(1.0, abs=0.15)
    assert 0.92 < np.mean(held) < 0.98


def test_a_correction_that_would_run_away_is_left_out(monkeypatch):
    """The gradient is taken as constant: where it is huge the noise would grow for ever."""
    log, _ = log_of(60, 0.05, 4)
    start = log.join(START, NoiseLevels(0.04 * np.eye(1), np.array([0.05])))
    best, _ = maximise(log, start, window=WINDOW)
    moves = restricted_noise._moves
    monkeypatch.setattr(restricted_noise, "_moves", lambda *given: 1e6 * moves(*given))
    found = restricted(log, log, best, WINDOW, 55.0)
    np.testing.assert_array_equal(found.theta, best.theta)
    np.testing.assert_array_equal(found.information, best.information)
    assert (found.spare == 55.0).all()
