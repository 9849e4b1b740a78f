"""Short logs of slow processes: the maximum over a wide range of delays is the largest of all."""

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm
from scipy.signal import square

import deadtime as dt
from deadtime.identification.likelihoods.likelihood import maximise

LAGS, GAIN, DELAY, STEP = (40.0, 15.0), 2.0, 12.7, 5.0


def slow_log(u):
    """Rows of two lags in series under a held input, by exponentials of a tenth of a second."""
    A = np.array([[-1 / LAGS[0], 1 / LAGS[0], 0], [0, -1 / LAGS[1], GAIN / LAGS[1]], [0, 0, 0]])
    tenth, fine, late = expm(0.1 * A), round(STEP / 0.1), round(DELAY / 0.1)
    held, x, y = np.repeat(u, fine), np.zeros(3), np.zeros(u.size)
    for k in range(held.size):
        if k % fine == 0:
            y[k // fine] = x[0]
        x[2] = held[k - late] if k >= late else u[0]
        x = tenth @ x
    y += 0.02 * np.random.default_rng(5).standard_normal(u.size)
    return pd.DataFrame({"t": STEP * np.arange(u.size), "y1": y, "u1": u})


@pytest.mark.long
@pytest.mark.parametrize("wave", [np.sin, square])
def test_no_cell_of_a_periodic_input_is_likelier(wave):
    phase = 2.0 * np.pi * STEP * np.arange(120) / 43.0  # 43 s: shorter than the range of delays
    u = np.where(np.arange(120) < 3, 0.0, wave(phase))
    fit = dt.identify(slow_log(u), modes=None, delay=(0, 60), order=2, zeros=False)
    estimate = fit._estimate
    log, bounds = estimate.of_outputs, (STEP, 55.0)
    place = log.layout.at_delays
    best = maximise(log, estimate.best.theta, window=bounds)[0]
    for delay in np.arange(7.5, 55.0, STEP):
        start = best.theta.copy()
        start[place] = delay
        start[log.layout.of_B[0, :, 0]] *= np.sign(np.cos(2.0 * np.pi * (delay - DELAY) / 43.0))
        assert maximise(log, start, window=bounds, gain=1e-4)[0].value < best.value + 0.05
    low, high = fit.delay_interval[0, 0]
    assert low < DELAY < high
