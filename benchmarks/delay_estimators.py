"""The delay by what people use, on the same logs: bias, standard deviation and root mean square.

    python benchmarks/delay_estimators.py --draws 100

Logs of `benchmarks/identification.py`, the delay drawn anew for each from 0.1 … 0.5 s, so that
it is no multiple of the period h = 0.05 s. Of the last state, which the input pushes:

- `deadtime.identify`: all states, as it comes.
- correlation: the peak of `scipy.signal.correlate` over `correlation_lags`, of the input with what
  the state gains in a period; through the three points about it a parabola.
- ARX scan: what MATLAB documents for `delayest(data, 2, 2, 1, 12)`: ARX models with na = nb = 2 for
  every nk, that of least loss; (nk − 1/2) h, the middle of the period that nk says.
- Markov: `control.markov`, the impulse response of the state's gain by least squares over 16 lags;
  the first of its parameters beyond a quarter of the largest, and the middle of that period.
- two-weight ARX: x_{k+1} = Φ x_k + Γ₁ u_{k−N} + Γ₀ u_{k−N+1} by least squares for every N, and the
  fraction from how Γ shares out, as if A were 0: by hand, what the log of exact states allows.
"""

from __future__ import annotations

import argparse

import control
import numpy as np
from scipy.signal import correlate, correlation_lags

import deadtime as dt
from identification import CASES, H, made

MOST = 12  # periods
ASKED = ("one mode", "unstable, closed loop", "noisy sensors")


def by_identify(x, u, log, case):
    noisy = "noisy" in case
    return dt.identify(log, delay=(0.0, 0.6), noise=noisy, switches="samples").delays[0, 0]


def by_correlation(x, u, log, case):
    gain, v = np.diff(x[:, -1]), u[:-1] - u[:-1].mean()
    found = np.abs(correlate(gain - gain.mean(), v, mode="full"))
    lags = correlation_lags(gain.size, v.size, mode="full")
    r = found[(lags >= 0) & (lags <= MOST)]
    k = int(r[1:-1].argmax()) + 1
    bend = r[k - 1] - 2.0 * r[k] + r[k + 1]
    return H * (k + 0.5 * (r[k - 1] - r[k + 1]) / bend) if bend < 0.0 else H * k


def by_arx_scan(x, u, log, case):
    y, first, loss = x[:, -1], MOST + 2, []
    for nk in range(1, MOST + 1):
        k = np.arange(first, y.size)
        past = np.column_stack([y[k - 1], y[k - 2], u[k - nk], u[k - nk - 1]])
        loss.append(np.linalg.lstsq(past, y[k], rcond=None)[1][0])
    return H * (int(np.argmin(loss)) + 0.5)


def by_markov(x, u, log, case):
    response = np.abs(np.ravel(control.markov(np.diff(x[:, -1]), u[:-1], 16)))
    return H * (int(np.argmax(response > 0.25 * response.max())) + 0.5)


def by_two_weights(x, u, log, case):
    k, found = np.arange(MOST, len(x) - 1), []
    for N in range(1, MOST + 1):
        past = np.column_stack([x[k], u[k - N], u[k - N + 1]])
        weights, left, *_ = np.linalg.lstsq(past, x[k + 1], rcond=None)
        late, soon = weights[-2:, -1]
        found.append((left.sum(), H * (N - np.clip(soon / (late + soon), 0.0, 1.0))))
    return min(found)[1]


METHODS = {
    "`deadtime.identify`": by_identify,
    "correlation, parabola": by_correlation,
    "ARX scan (`delayest`)": by_arx_scan,
    "`control.markov`": by_markov,
    "two-weight ARX": by_two_weights,
}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--samples", type=int, default=400)
    given = parser.parse_args()
    print("log | method | bias, ms | deviation, ms | root mean square, ms")
    for case in ASKED:
        errors = {name: [] for name in METHODS}
        kept = CASES[case]
        for seed in range(given.draws):
            rng = np.random.default_rng(5000 + seed)
            delay = float(rng.uniform(0.1, 0.5))
            CASES[case] = (*kept[:2], [delay], *kept[3:])
            log = made(case, given.samples, rng)
            x, u = log.filter(regex="^x").to_numpy(), log["u0"].to_numpy()
            for name, method in METHODS.items():
                errors[name].append(1e3 * (method(x, u, log, case) - delay))
        CASES[case] = kept
        for name, error in errors.items():
            size = np.sqrt(np.mean(np.square(error)))
            print(f"{case} | {name} | {np.mean(error):+.2f} | {np.std(error):.2f} | {size:.2f}")


if __name__ == "__main__":
    main()
