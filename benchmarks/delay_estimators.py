"""The delay by what people use, on the same logs: bias, deviation, root mean square, and time.

    python benchmarks/delay_estimators.py --draws 100

Logs of `benchmarks/identification.py`, the delay drawn anew for each from 0.1 … 0.5 s, so that
it is no multiple of the period h = 0.05 s. Of the last state, which the input pushes; every method
is told that the delay is at most 0.6 s, 12 periods. Median: of the size of errors. Time: of the
processor, the median of a log.

- `deadtime.identify`: all states, as it comes, and how many of its intervals hold the delay.
- correlation: the peak of `scipy.signal.correlate` over `correlation_lags`, of the input with what
  the state gains in a period; through the three points about it a parabola.
- ARX scan: what MATLAB documents for `delayest(data, 2, 2, 1, 12)`: ARX models with na = nb = 2 for
  every nk, that of least loss; (nk − 1/2) h, the middle of the period that nk says.
- two-weight ARX: x_{k+1} = Φ x_k + Γ₁ u_{k−N} + Γ₀ u_{k−N+1} by least squares for every N, and the
  fraction from how Γ shares out, as if A were 0: by hand, what the log of exact states allows.
- python-control, SIPPY and nfoursid: see `delay_peers.py`.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import functools
import time

import numpy as np
from delay_peers import MOST, middle, present
from scipy.signal import correlate, correlation_lags

import deadtime as dt
from identification import CASES, H, made

ASKED = ("one mode", "noisy sensors", "unstable, closed loop", "noisy, closed loop")


def by_identify(log, x, u, noisy):
    fit = dt.identify(log, delay=(0.0, H * MOST), noise=noisy, switches="samples")
    return {"": fit.delays[0, 0]}, fit.delay_interval[0, 0]


def by_correlation(log, x, u):
    gain, v = np.diff(x[:, -1]), u[:-1] - u[:-1].mean()
    found = np.abs(correlate(gain - gain.mean(), v, mode="full"))
    lags = correlation_lags(gain.size, v.size, mode="full")
    r = found[(lags >= 0) & (lags <= MOST)]
    k = int(r[1:-1].argmax()) + 1
    bend = r[k - 1] - 2.0 * r[k] + r[k + 1]
    return {"": H * (k + 0.5 * (r[k - 1] - r[k + 1]) / bend) if bend < 0.0 else H * k}


def by_arx_scan(log, x, u):
    y, begin, loss = x[:, -1], MOST + 2, []
    for nk in range(1, MOST + 1):
        k = np.arange(begin, y.size)
        past = np.column_stack([y[k - 1], y[k - 2], u[k - nk], u[k - nk - 1]])
        loss.append(np.linalg.lstsq(past, y[k], rcond=None)[1][0])
    return {"whole": middle(int(np.argmin(loss)))}


def by_two_weights(log, x, u):
    k, found = np.arange(MOST, len(x) - 1), []
    for N in range(1, MOST + 1):
        past = np.column_stack([x[k], u[k - N], u[k - N + 1]])
        weights, left, *_ = np.linalg.lstsq(past, x[k + 1], rcond=None)
        late, soon = weights[-2:, -1]
        found.append((left.sum(), H * (N - np.clip(soon / (late + soon), 0.0, 1.0))))
    return {"share": min(found)[1]}


METHODS = {
    "correlation, parabola": by_correlation,
    "ARX scan (`delayest`)": by_arx_scan,
    "two-weight ARX": by_two_weights,
}


def drawn(case, seed, samples):
    """A log of a case with a delay of its own."""
    rng, kept = np.random.default_rng(5000 + seed), CASES[case]
    delay = float(rng.uniform(0.1, 0.5))
    CASES[case] = (*kept[:2], [delay], *kept[3:])
    log = made(case, samples, rng)
    CASES[case] = kept
    return log, delay


def timed(method, *given):
    began = time.process_time()
    found = method(*given)
    return found, time.process_time() - began


def measured(case, seed, samples):
    """Errors (ms) and seconds of every method on a log, and whether `identify` holds the delay."""
    log, delay = drawn(case, seed, samples)
    given = log, log.filter(regex="^x").to_numpy(), log["u0"].to_numpy()
    (own, ends), took = timed(by_identify, *given, "noisy" in case)
    found = {"`deadtime.identify`": (own, took)}
    found |= {name: timed(method, *given) for name, method in (METHODS | present()[0]).items()}
    errors, times = {}, {}
    for name, (readings, took) in found.items():
        times[name] = took
        errors |= {(name, read): 1e3 * (value - delay) for read, value in readings.items()}
    return errors, times, ends[0] < delay < ends[1]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--samples", type=int, default=400)
    parser.add_argument("--case", nargs="*", default=ASKED, choices=ASKED)
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args()
    missing = present()[1]
    print(
        f"left out, as they do not import: {', '.join(missing)}" if missing else "all peers there"
    )
    print("log | method | read as | bias, ms | deviation | root mean square | median | ms a log")
    for case in given.case:
        one = functools.partial(measured, case, samples=given.samples)
        with concurrent.futures.ProcessPoolExecutor(given.processes) as pool:
            errors, times, held = zip(*pool.map(one, range(given.draws)), strict=True)
        for name, reading in errors[0]:
            error = np.array([each[name, reading] for each in errors])
            size, half = np.sqrt(np.mean(error**2)), np.median(np.abs(error))
            took = 1e3 * np.median([each[name] for each in times])
            print(
                f"{case} | {name} | {reading} | {np.mean(error):+.2f} | {np.std(error):.2f} | "
                f"{size:.2f} | {half:.2f} | {took:.1f}"
            )
        print(
            f"{case}: {sum(held)} of {given.draws} intervals of `identify` hold the delay",
            flush=True,
        )


if __name__ == "__main__":
    main()
