"""What do logs of loops that only regulate tell? `dt.identify` with default options.

    python benchmarks/closed_loops.py --draws 60 --law P PI PD
    python benchmarks/closed_loops.py --draws 60 --law P --added steps

Random plants, delays, stable loops and noises, by SciPy's exponentials, with no code of ours.
P: one state, u = k y. PI: one state, u = k y + k_i ∫ y. PD: position and speed, u = k y. Every
sensor is noisy, and so is the plant. `--added` moves what the law asks for: by steps of ±0.5 every
two seconds, or by ±0.1 in every row. Answered: no word of a delay that is hardly told. Silently
wrong: an answer whose delay or B lies outside its interval by more than the interval's length.
"""

import argparse
import time

import numpy as np
import pandas as pd
from scipy.linalg import expm

import deadtime as dt

H, LONGEST = 0.05, 1.0


def over(A, B, span):
    """e^{A t} and ∫ e^{A s} B ds."""
    n, m = B.shape
    Z = np.zeros((n + m, n + m))
    Z[:n, :n], Z[:n, n:] = A, B
    E = expm(Z * span)
    return E[:n, :n], E[:n, n:]


def noise_of(A, W):
    """The covariance that W makes in a period (Van Loan)."""
    n = len(A)
    Z = np.zeros((2 * n, 2 * n))
    Z[:n, :n], Z[:n, n:], Z[n:, n:] = -A, W, A.T
    E = expm(Z * H)
    return E[n:, n:].T @ E[:n, n:]


def loop_matrix(Phi, old, new, N, k, k_i):
    """x, the integral, and the last N + 1 inputs, from one sample to the next."""
    n = len(Phi)
    size = n + 1 + N + 1  # x, integral, u_{k−1} … u_{k−N−1}
    M = np.zeros((size, size))
    u = np.zeros(size)  # u_k as a function of all that
    u[:n], u[n] = k + k_i * H * np.eye(n)[0], k_i
    M[:n, :n] = Phi
    for lag, weight in ((N, old[:, 0]), (N - 1, new[:, 0])):
        M[:n] += np.outer(weight, u if lag == 0 else np.eye(size)[n + lag])
    M[n, n], M[n, 0] = 1.0, H
    M[n + 1] = u
    M[n + 2 :, n + 1 : -1] = np.eye(N)
    return M


def drawn(law, rng):
    """A plant, its delay, and a law of which the loop decays."""
    while True:
        D = rng.uniform(0.06, 0.8)
        if law == "PD":
            stiff, damp = rng.uniform(0.0, 4.0), rng.uniform(0.1, 2.0)
            A, B = np.array([[0.0, 1.0], [-stiff, -damp]]), np.array([[0.0], [rng.uniform(0.5, 2)]])
            k = -rng.uniform(0.2, 3.0, 2)
        else:
            A, B = np.array([[rng.uniform(-2.0, 0.5)]]), np.array([[rng.uniform(0.5, 2.0)]])
            k = -rng.uniform(0.3, 4.0, 1)
        k_i = -rng.uniform(0.1, 2.0) if law == "PI" else 0.0
        N = int(np.ceil(D / H))
        Phi, whole = over(A, B, H)
        new = over(A, B, N * H - D)[1]
        M = loop_matrix(Phi, whole - new, new, N, k, k_i)
        if not k_i:  # nothing is integrated
            M = np.delete(np.delete(M, len(A), 0), len(A), 1)
        radius = np.abs(np.linalg.eigvals(M))
        if radius.max() < 0.99:
            return A, B, D, k, k_i, (Phi, whole - new, new, N)


def made(law, added, count, rng):
    """A log, and what is true of it."""
    A, B, D, k, k_i, (Phi, old, new, N) = drawn(law, rng)
    n = len(A)
    W = 0.01 * np.eye(n) * rng.uniform(0.1, 1.0, n)
    root = np.linalg.cholesky(noise_of(A, W))
    sensor = np.sqrt(np.diagonal(root @ root.T).max()) * 10.0 ** rng.uniform(-1.0, 0.7)
    asked = np.zeros(count)
    if added == "steps":
        asked = np.repeat(rng.choice([-0.5, 0.5], count // 40 + 1), 40)[:count]
    if added == "dither":
        asked = 0.1 * rng.choice([-1.0, 1.0], count)
    x, total, late = np.zeros(n), 0.0, np.zeros(N + 2)  # late[j]: u_{k−j}
    y, u = np.zeros((count + 200, n)), np.zeros(count + 200)
    for at in range(count + 200):  # the first 200 rows are not logged: the loop is at work
        now = x + sensor * rng.standard_normal(n)
        total += H * now[0]
        y[at], u[at] = now, k @ now + k_i * total + (asked[at - 200] if at >= 200 else 0.0)
        late = np.concatenate(([u[at]], late[:-1]))
        x = Phi @ x + old[:, 0] * late[N] + new[:, 0] * late[N - 1] + root @ rng.standard_normal(n)
    columns = {"t": H * np.arange(count), "u": u[200:]}
    columns |= {f"x{i + 1}": one for i, one in enumerate(y[200:].T)}
    return pd.DataFrame(columns), (B, D)


def judged(log, truth):
    """ "refused", "open", "wrong" or "right", and whether the delay lies in its interval."""
    B, D = truth
    try:
        fit = dt.identify(log, modes=None, delay=(0.0, LONGEST))
    except dt.ArgumentError:
        return "refused", False
    if "hardly tells" in fit.message:
        low, high = fit.interval("delay")
        return "open", low <= D <= high
    row = len(B) - 1
    missed = []
    for true, (low, high) in (
        (D, fit.interval("delay")),
        (B[row, 0], fit.interval(f"B[0][{row},0]")),
    ):
        missed.append(max(low - true, true - high) / (high - low))
    return ("wrong" if max(missed) > 1.0 else "right"), missed[0] <= 0.0


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--samples", type=int, default=400)
    parser.add_argument("--law", nargs="*", choices=["P", "PI", "PD"], default=["P", "PI", "PD"])
    parser.add_argument("--added", choices=["nothing", "steps", "dither"], default="nothing")
    given = parser.parse_args()
    print(f"{given.samples} samples, h = {H} s, {given.draws} loops each: {given.added} added")
    print("law | answered | inside | hardly told | inside | refused | silently wrong | s a log")
    for law in given.law:
        found, began = [], time.process_time()
        for seed in range(given.first, given.first + given.draws):
            log, truth = made(law, given.added, given.samples, np.random.default_rng(seed))
            found.append(judged(log, truth))
        took = (time.process_time() - began) / given.draws
        kinds = ("right", "wrong", "open", "refused")
        count = {kind: sum(one == kind for one, _ in found) for kind in kinds}
        held = sum(inside for kind, inside in found if kind in ("right", "wrong"))
        open_held = sum(inside for kind, inside in found if kind == "open")
        answered = count["right"] + count["wrong"]
        print(
            f"{law} | {answered} | {held} of {answered} | {count['open']} | {open_held} of "
            f"{count['open']} | {count['refused']} | {count['wrong']} | {took:.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
