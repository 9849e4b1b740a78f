"""From a log to a law: coverage, bias, efficiency and time of `dt.identify`.

    python benchmarks/identification.py coverage --draws 200
    python benchmarks/identification.py speed --sizes 10000 100000 --case "uneven, long, noisy"

Logs are made here, by SciPy's exponentials, with no code of the package. Coverage: the share of
95 % intervals that hold the truth, of the delays and of all entries of A and B; the standard error
of the delay over the draws beside what the information promises (Cramér and Rao's bound), and its
bias beside that of the peak of `scipy.signal.correlate`, of the input with the state's increments.
"""

import argparse
import itertools
import resource
import time
from typing import Any

import numpy as np
import pandas as pd
from scipy.linalg import expm
from scipy.signal import correlate
from uneven_logs import uneven_states

import deadtime as dt

H = 0.05
LEAD, LEAST = 24, 16  # samples before the first that is used, and of every mode after it
SLOW, FAST = [[0.0, 1.0], [-2.0, -1.0]], [[0.0, 1.0], [-3.0, -0.5]]
THIRD = [[0.0, 1.0], [-1.0, -1.5]]
GROWS = [[0.0, 1.0], [0.5, -0.5]]  # at 0.5 1/s
PUSH = [[0.0], [1.0]]
BOTH = [[0.2, 1.0], [1.0, -0.5]]
HOLDS = [[-0.8, -0.7], [-0.2, 0.1]]
# name: A, B, delays, process noise s (s √h a sample), sensors' deviation, feedback
CASES = {
    "one mode": ([SLOW], [PUSH], [0.312], 0.03, 0.0, None),
    "two modes": ([SLOW, FAST], [PUSH] * 2, [0.312], 0.03, 0.0, None),
    "three modes": ([SLOW, FAST, THIRD], [PUSH] * 3, [0.312], 0.03, 0.0, None),
    "two inputs": ([SLOW], [BOTH], [0.312, 0.174], 0.03, 0.0, None),
    "unstable, closed loop": ([[[0.5]]], [[[1.0]]], [0.23], 0.03, 0.0, [[-1.2]]),
    "noisy sensors": ([SLOW], [PUSH], [0.312], 0.03, 0.02, None),
    "noisy, two modes": ([SLOW, FAST], [PUSH] * 2, [0.312], 0.03, 0.02, None),
    "noisy, closed loop": ([[[0.5]]], [[[1.0]]], [0.23], 0.03, 0.02, [[-1.2]]),
    "noisy, three modes, two inputs": (
        *([SLOW, FAST, THIRD], [BOTH] * 3, [0.312, 0.174], 0.03, 0.02, None),
    ),
    "three modes, two inputs, closed loop": (
        *([SLOW, FAST, GROWS], [BOTH] * 3, [0.312, 0.174], 0.03, 0.0, HOLDS),
    ),
    "noisy, three modes, two inputs, closed loop": (
        *([SLOW, FAST, GROWS], [BOTH] * 3, [0.312, 0.174], 0.03, 0.02, HOLDS),
    ),
    "uneven": ([SLOW, FAST], [BOTH] * 2, [0.312, 0.174], 0.03, 0.0, None),
    "uneven, noisy": ([SLOW, FAST], [BOTH] * 2, [0.312, 0.174], 0.03, 0.02, None),
    "position alone": ([SLOW], [PUSH], [0.312], 0.03, 0.005, None),
    "position alone, two modes": ([SLOW, FAST], [PUSH] * 2, [0.312], 0.03, 0.005, None),
}
ALONE = "position alone"  # of cases that begin so the first state alone is logged


SLOW = {"slow, rows every 5 s": 5.0, "slow, rows every 1 s": 1.0}
LONG = (*SLOW, "long", "long, noisy", "uneven, long", "uneven, long, noisy", f"{ALONE}, long")
SIZES = (10_000, 100_000, 1_000_000)


def sampled(A, B, D, step=H):
    """Φ(h), and the weights of u_{k−N} and u_{k−N+1} with N of every input, by exponentials."""
    n, m = B.shape

    def over(time):
        Z = np.zeros((n + m, n + m))
        Z[:n, :n], Z[:n, n:] = A, B
        E = expm(Z * time)
        return E[:n, :n], E[:n, n:]

    Phi, whole = over(step)
    N = np.ceil(np.array(D) / step - 1e-9).astype(int)
    new = np.column_stack([over(N[j] * step - D[j])[1][:, j] for j in range(m)])
    return Phi, whole - new, new, N


def made(case, count, rng):
    """A log of a case, as a table; modes last 1 s on average, and change at samples."""
    A, B, D, s, sensor, K = CASES[case]
    A, B = np.array(A), np.array(B)
    modes, n, m = B.shape
    mode = visiting(modes, count, rng)
    if case.startswith("uneven"):
        t = H * (np.arange(count) + rng.integers(-300, 301, count) / 1000.0)
        u = rng.standard_normal((count, m))
        y = uneven_states(A, B, D, s, t, u, mode, rng) + sensor * rng.standard_normal((count, n))
        return tabled(t, mode, y, u)
    parts = [sampled(a, b, D) for a, b in zip(A, B, strict=True)]
    Q = [np.linalg.cholesky(_noise(a, s)) for a in A]
    x, u = np.zeros((count, n)), rng.standard_normal((count, m))
    y, v, w = x.copy(), sensor * rng.standard_normal((count, n)), rng.standard_normal((count, n))
    for k in range(count):
        y[k] = x[k] + v[k]
        if K is not None:
            u[k] += np.array(K) @ y[k]
        if k + 1 == count:
            break
        Phi, old, new, N = parts[mode[k]]
        x[k + 1] = Phi @ x[k] + Q[mode[k]] @ w[k]
        for j in range(m):
            late, soon = k - N[j], k - N[j] + 1
            x[k + 1] += old[:, j] * (u[late, j] if late >= 0 else 0.0)
            x[k + 1] += new[:, j] * (u[soon, j] if soon >= 0 else 0.0)
    return tabled(H * np.arange(count), mode, y, u)


def slow(step, rng):
    """240 rows of a slow process: lags of 40 and 15 s, dead time 12.7 s, steps, a noisy sensor."""
    A, B = np.array([[-1 / 40, 1 / 40], [0, -1 / 15]]), np.array([[0], [2 / 15]])
    Phi, old, new, (N,) = sampled(A, B, [12.7], step)
    u = np.repeat(rng.choice([-1.0, 0.0, 1.0], 240), round(60 / step))[:240]
    u[:3] = 0.0
    x = np.zeros((240, 2))
    for k in range(239):
        late, soon = (u[max(k - N + i, 0)] for i in (0, 1))
        x[k + 1] = Phi @ x[k] + old[:, 0] * late + new[:, 0] * soon
    y = x[:, 0] + 0.02 * rng.standard_normal(240)
    return pd.DataFrame({"t": step * np.arange(240), "y1": y, "u1": u})


def tabled(t, mode, y, u):
    """A log as a table."""
    columns = {"t": t, "mode": mode}
    columns |= {f"x{i}": one for i, one in enumerate(y.T)}
    return pd.DataFrame(columns | {f"u{j}": one for j, one in enumerate(u.T)})


def visiting(modes, count, rng):
    """The mode of every sample, in turn; drawn again until the log tells of all."""
    if count < LEAD + modes * LEAST:
        raise SystemExit(f"--samples must be at least {LEAD + modes * LEAST} for {modes} modes")
    while True:
        length = rng.integers(10, 31, count)  # of each sojourn: half a second to one and a half
        mode = np.repeat(np.arange(count) % modes, length)[:count]
        if np.bincount(mode[LEAD:], minlength=modes).min() >= LEAST:
            return mode


def _noise(A, s):
    """∫₀^h e^{Aτ} s² e^{Aᵀτ} dτ, by Gauss's rule of ten points."""
    nodes, weights = np.polynomial.legendre.leggauss(10)
    E = expm(A * (0.5 * H * (nodes + 1.0))[:, None, None])
    return 0.5 * H * s**2 * np.einsum("q,qab,qcb->ac", weights, E, E)


def alone(order):
    """What `identify` is told where the first state alone is logged."""
    return {"outputs": ["x0"], "order": order}


def correlated(log):
    """The delay by the peak of the correlation of u with what x gains in a period."""
    last = log.filter(regex="x").to_numpy()[:, -1]
    gain, u = np.diff(last - last.mean()), log["u0"].to_numpy()[:-1]
    found = np.abs(correlate(gain, u - u.mean(), mode="full"))[u.size - 1 : u.size + 20]
    return H * float(np.argmax(found))


def coverage(draws, first, count, cases):
    print(f"{count} samples, h = {H} s, {draws} logs of each kind")
    print("case | delays inside | A, B inside | error (ms) | claimed | ratio | bias | correlation")
    for case in cases:
        A, B, D, _, sensor, _ = CASES[case]
        inside_D, inside_AB, error, claimed, peak = [], [], [], [], []
        for seed in range(first, first + draws):
            log = made(case, count, np.random.default_rng(seed))
            noise = sensor > 0.0
            known: dict[str, Any] = alone(2) if case.startswith(ALONE) else {"noise": noise}
            fit = dt.identify(log, delay=(0.0, 1.0), switches="samples", **known)
            ends = fit.delay_interval[0]
            inside_D.append([low < true < high for (low, high), true in zip(ends, D, strict=True)])
            for name, whole in (("A", np.array(A)), ("B", np.array(B))):
                for (i, a, b), true in np.ndenumerate(whole):
                    if f"{name}[{i}][{a},{b}]" not in fit.names:
                        continue
                    low, high = fit.interval(f"{name}[{i}][{a},{b}]")
                    inside_AB.append(low < true < high)
            error.append(fit.delays[0] - D)
            claimed.append(np.diff(ends)[:, 0] / 3.93)
            peak.append(np.nan if case.startswith("uneven") else correlated(log) - D[0])
        held = f"{np.sum(inside_D, axis=0)} of {draws} | {sum(inside_AB)} of {len(inside_AB)}"
        ratio = np.std(error, axis=0) / np.sqrt(np.mean(np.square(claimed), axis=0))
        figures = (1e3 * np.std(error, axis=0), 1e3 * np.mean(claimed, axis=0), ratio)
        said = [np.array2string(one, precision=3) for one in figures]
        bias = np.array2string(1e3 * np.mean(error, axis=0), precision=3)
        print(
            f"{case} | {held} | {' | '.join(said)} | {bias} | {1e3 * np.mean(peak):.1f}",
            flush=True,
        )


def speed(sizes, cases):
    """Seconds of a processor, and memory, of long logs: three states and two modes."""
    A = np.array(
        [[[0, 1, 0], [0, 0, 1], [-1, -3, -2]], [[0, 1, 0], [0, 0, 1], [-2, -3, -1.5]]], float
    )
    B = np.tile([[0.0], [0.0], [1.0]], (2, 1, 1))
    for case in [one for one in SLOW if one in cases]:
        log = slow(SLOW[case], np.random.default_rng(1))
        timed(f"240 samples, {case}", log, modes=None, delay=(0, 60), order=2)
    for count, case in itertools.product(sizes, [case for case in cases if case not in SLOW]):
        deviation = 0.02 if "noisy" in case else 0.005 if case.startswith(ALONE) else 0.0
        CASES[case] = A, B, [0.312], 0.03, deviation, None
        log = made(case, count, np.random.default_rng(1))
        known: dict[str, Any] = alone(3) if case.startswith(ALONE) else {"noise": "noisy" in case}
        timed(f"{count:,} samples, {case}", log, switches="samples", **known)


def timed(name, log, **known):
    """Print seconds of a processor and memory of `identify`, twice."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for turn in ("first", "again"):
        began = time.process_time()
        fit = dt.identify(log, **known)
        took = time.process_time() - began
        more = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        low, high = fit.interval("delay")
        print(
            f"{name}, {turn}: {took:.2f} s, {more / 1024:.0f} MB more, "
            f"delay {low:.5f} … {high:.5f} s",
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=["coverage", "speed"])
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--samples", type=int, default=400)
    parser.add_argument("--case", nargs="*", choices=[*CASES, *LONG])
    parser.add_argument("--sizes", nargs="*", type=int, default=SIZES)
    given = parser.parse_args()
    if given.what == "speed":
        speed(given.sizes, given.case or LONG)
    else:
        coverage(given.draws, given.first, given.samples, given.case or list(CASES))


if __name__ == "__main__":
    main()
