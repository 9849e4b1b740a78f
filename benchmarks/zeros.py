"""Zeros that outputs alone show, or do not.

    python benchmarks/zeros.py quiet --draws 200
    python benchmarks/zeros.py faint --draws 100

Quiet, is a zero found where there is little noise: dx₁/dt = x₂ + u(t − D), dx₂/dt = a₀ x₁ + a₁ x₂ +
b u(t − D) + noise of both, a₀ from −3 to −0.3, a₁ from −2.5 to −0.3, b from −2 to 2 and D from 0.06
to 0.4 s by chance, x₁ logged in 500 rows of 0.05 s, u held for two of them. Or three states in a
chain, with poles from −3 to −0.3 and two weights of u from −2 to 2. Short of the truth: estimates
less likely, by more than 5 of log L, than the maximum that a climb from the true plant reaches.

Faint, is it told from a delay: "position alone" of `identification.py`, 400 rows, with b₁ for what
the input weighs in the position's derivative, beside 1 in the speed's.

By SciPy's exponentials, with no code of the package.
"""

import argparse

import numpy as np
import pandas as pd
from uneven_logs import uneven_states

import deadtime as dt
import identification
from deadtime.identification.likelihoods.likelihood import maximise
from deadtime.identification.likelihoods.noisy_log import NoiseLevels, NoisyLog

H, COUNT, HELD, MARGIN = 0.05, 500, 2, 5.0
# name: W of all states, deviation of the sensor, jitter of the rows' times in periods
CASES = {
    "no noise of the plant": (0.0, 1e-3, 0.0),
    "W = 1e-8, sensor 1e-5": (1e-8, 1e-5, 0.0),
    "W = 1e-5, sensor 1e-3": (1e-5, 1e-3, 0.0),
    "the same, uneven": (1e-5, 1e-3, 0.3),
    "W = 1e-3, sensor 1e-2": (1e-3, 1e-2, 0.0),
}
THREE = "three states, W = 1e-10, sensor 1e-5"
CASES[THREE] = (1e-10, 1e-5, 0.0)
# name: b₁ and the case of identification.py
FAINT = {
    "b₁ = 0": (0.0, "position alone"),
    "b₁ = 0, two modes": (0.0, "position alone, two modes"),
    "b₁ = 0.1": (0.1, "position alone"),
    "b₁ = 0.3": (0.3, "position alone"),
    "b₁ = −0.1": (-0.1, "position alone"),
}


def plant(rng, case):
    """A and B."""
    if case == THREE:
        poles = np.poly(-np.exp(rng.uniform(np.log(0.3), np.log(3.0), 3)))
        A = np.vstack((np.eye(2, 3, k=1), -poles[:0:-1]))
        return A[None], np.append(rng.uniform(-2.0, 2.0, 2), 1.0).reshape(1, 3, 1)
    a0, a1 = -rng.uniform(0.3, 3.0), -rng.uniform(0.3, 2.5)
    return np.array([[[0.0, 1.0], [a0, a1]]]), np.array([[[1.0], [rng.uniform(-2.0, 2.0)]]])


def made(seed, case):
    """A log as a table, A, B and the delay."""
    rng = np.random.default_rng(seed)
    W, sensor, jitter = CASES[case]
    A, B = plant(rng, case)
    D = float(rng.uniform(0.06, 0.4))
    t = H * (np.arange(COUNT) + jitter * rng.integers(-1000, 1001, COUNT) / 1000.0)
    u = np.repeat(rng.standard_normal((COUNT // HELD, 1)), HELD, axis=0)
    x = uneven_states(A, B, [D], np.sqrt(W), t, u, np.zeros(COUNT, int), rng)
    y = x[:, 0] + sensor * rng.standard_normal(COUNT)
    return pd.DataFrame({"t": t, "y": y, "u": u[:, 0]}), A, B, D


def short_of_the_truth(fit, A, B, D, W, sensor):
    """Whether the true plant leads to a maximum that is more likely; it has a zero."""
    log, window = fit._estimate.log, fit._estimate.window
    assert isinstance(log, NoisyLog)
    if not log.embedding.zeros:
        return None
    vector = log.join(
        log.layout.join(A, B, np.array([[D]])),
        NoiseLevels(max(W, 1e-14) * np.eye(A.shape[1]), np.array([sensor])),
    )
    found, _ = maximise(log, vector, window=window)
    return found.value > fit.log_likelihood + MARGIN


def quiet(seeds, cases):
    print("case | logs | short of the truth | no zero found | refused | delay inside 95 %")
    for case in cases or CASES:
        W, sensor, _ = CASES[case]
        short, without, refused, inside = 0, 0, 0, 0
        for seed in seeds:
            table, A, B, D = made(seed, case)
            try:
                fit = dt.identify(table, None, (0.0, 1.0), order=A.shape[1])
            except dt.ArgumentError:
                refused += 1
                continue
            less = short_of_the_truth(fit, A, B, D, W, sensor)
            short, without = short + bool(less), without + (less is None)
            low, high = fit.interval("delay")
            inside += low < D < high
        share = f"{inside} of {len(seeds) - refused}"
        print(f"{case} | {len(seeds)} | {short} | {without} | {refused} | {share}", flush=True)


def faint(seeds, cases):
    print("case | logs | taken to have a zero | delay inside 95 % | in doubt | wrong | both")
    for case in cases or FAINT:
        b, like = FAINT[case]
        A, B, D, *noise = identification.CASES[like]
        identification.CASES[like] = (A, [[[b], [1.0]]] * len(B), D, *noise)
        counts = np.zeros(5, int)
        for seed in seeds:
            log = identification.made(like, 400, np.random.default_rng(seed))
            known = identification.alone(2)
            fit = dt.identify(log, delay=(0.0, 1.0), switches="samples", **known)
            zero, doubt = "act on all of them" in fit.message, "hardly tells whether" in fit.message
            low, high = fit.interval("delay")
            wrong = zero != (b != 0.0)
            counts += [zero, low < D[0] < high, doubt, wrong, wrong and doubt]
        print(f"{case} | {len(seeds)} | {' | '.join(map(str, counts))}", flush=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=["quiet", "faint"])
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--case", nargs="*", choices=[*CASES, *FAINT])
    given = parser.parse_args()
    part = {"quiet": quiet, "faint": faint}[given.what]
    part(range(given.first, given.first + given.draws), given.case)


if __name__ == "__main__":
    main()
