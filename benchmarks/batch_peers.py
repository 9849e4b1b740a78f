"""The loops that people write for many scenarios, on the grid only, for `batch.py`.

All get the same: a mode per period, (scenario, period) int8, transitions and the law's table
ready-made; and return (3, scenario): ∫|x|² by the Gramian of the period, Σ u² and max|x|². They
leave out settling time and decay rate, which deadtime has, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from batch_problem import LAWS, PAPER, USUAL, X0
from numba import njit, prange

import deadtime as dt
from deadtime.plant import SampledPlant
from deadtime.scenarios.batch_loop import Loop

WIDTH = 64  # scenarios side by side in `side_by_side`


class Problem(NamedTuple):
    """Two states, one input, D = N h: x_{k+1} = move (x, u_{k−N}), the table's rows, x0.

    `S`, `into`, `leave` and `out` are the window's recursion in the eigenvectors of S:
    I ← S I + into u_k − leave u_{k−N}, u = F x + out I.
    """

    move: np.ndarray
    energy: np.ndarray
    F: np.ndarray
    G: np.ndarray
    ages: int
    x0: np.ndarray
    S: np.ndarray
    into: np.ndarray
    leave: np.ndarray
    out: np.ndarray


def problem_of(law: dt.Law) -> Problem:
    """The tables of a peer; the window's recursion is that of the averaged law."""
    feedback, averaged = law.digital(USUAL.step), LAWS["averaged"].digital(USUAL.step)
    loop = Loop(SampledPlant(PAPER.plant, USUAL.step), np.array(X0), USUAL.horizon)
    factor = averaged.factor
    assert factor is not None
    values, vectors = np.linalg.eig(factor.S)
    into = np.linalg.solve(vectors, factor.input)[:, 0]
    return Problem(
        *map(np.ascontiguousarray, loop.maps),
        np.ascontiguousarray(feedback.state_gain[:, 0]),
        np.ascontiguousarray(feedback.input_gain[:, ::-1, 0, 0]),
        feedback.ages,
        np.array(X0),
        values,
        into,
        values**feedback.taps * into,
        (factor.H[0] @ vectors)[0],
    )


def blocks_of(modes: np.ndarray) -> np.ndarray:
    """Modes (scenario, period) as (block, period, WIDTH)."""
    blocks = modes.reshape(-1, WIDTH, modes.shape[1])
    return np.ascontiguousarray(blocks.transpose(0, 2, 1))


class Numbers(NamedTuple):
    """A `Problem` in tuples, which compiled code keeps in registers."""

    move: tuple
    energy: tuple
    F: tuple
    x0: tuple
    S: tuple
    into: tuple
    leave: tuple
    out: tuple


def numbers_of(problem: Problem) -> Numbers:
    """The same in tuples; energies by their upper triangles, off the diagonal doubled."""
    i, j = np.triu_indices(3)
    upper = problem.energy[:, i, j] * np.where(i == j, 1.0, 2.0)
    parts = [tuple(map(float, part)) for part in (problem.F[0], problem.x0, *problem[6:])]
    move = tuple(tuple(map(float, one.ravel())) for one in problem.move)
    return Numbers(move, tuple(tuple(map(float, one)) for one in upper), *parts)


@njit(parallel=True, fastmath=True, cache=True)
def dense(problem, modes):
    """N products a period, as in a textbook; a scenario's inputs lie in one array, oldest first.

    Row 0 of the table, or that of the mode and its age.
    """
    move, energy, F, G, ages, start, _, _, _, _ = problem
    scenarios, K = modes.shape
    N, aware = G.shape[1], F.shape[0] > 1
    result = np.empty((3, scenarios))
    for s in prange(scenarios):
        u = np.zeros(N + K)
        x, y = start[0], start[1]
        ise, effort, peak = 0.0, 0.0, x * x + y * y
        age, before = 0, modes[s, 0]
        for k in range(K):
            i = modes[s, k]
            age = age + 1 if i == before and k > 0 else 0
            before = i
            row = i * ages + min(age, ages - 1) if aware else 0
            value = F[row, 0] * x + F[row, 1] * y
            taps = G[row]
            for j in range(N):
                value += taps[j] * u[k + j]
            u[N + k] = value
            v, M, E = u[k], move[i], energy[i]
            ise += E[0, 0] * x * x + E[1, 1] * y * y + E[2, 2] * v * v
            ise += 2.0 * (E[0, 1] * x * y + E[0, 2] * x * v + E[1, 2] * y * v)
            effort += value * value
            x, y = (
                M[0, 0] * x + M[0, 1] * y + M[0, 2] * v,
                M[1, 0] * x + M[1, 1] * y + M[1, 2] * v,
            )
            peak = max(peak, x * x + y * y)
        result[0, s], result[1, s], result[2, s] = ise, effort, peak
    return result


@njit(parallel=True, cache=True)
def ring_buffer(problem, modes):
    """`dense` with the last N inputs in a ring, and sums in the order written: no fast maths."""
    move, energy, F, G, ages, start, _, _, _, _ = problem
    scenarios, K = modes.shape
    N, aware = G.shape[1], F.shape[0] > 1
    result = np.empty((3, scenarios))
    for s in prange(scenarios):
        u, now = np.zeros(N), 0
        x, y = start[0], start[1]
        ise, effort, peak = 0.0, 0.0, x * x + y * y
        age, before = 0, modes[s, 0]
        for k in range(K):
            i = modes[s, k]
            age = age + 1 if i == before and k > 0 else 0
            before = i
            row = i * ages + min(age, ages - 1) if aware else 0
            value = F[row, 0] * x + F[row, 1] * y
            taps = G[row]
            place = now
            for j in range(N):
                value += taps[j] * u[place]
                place = 0 if place + 1 == N else place + 1
            v, M, E = u[now], move[i], energy[i]
            u[now] = value
            now = 0 if now + 1 == N else now + 1
            ise += E[0, 0] * x * x + E[1, 1] * y * y + E[2, 2] * v * v
            ise += 2.0 * (E[0, 1] * x * y + E[0, 2] * x * v + E[1, 2] * y * v)
            effort += value * value
            x, y = (
                M[0, 0] * x + M[0, 1] * y + M[0, 2] * v,
                M[1, 0] * x + M[1, 1] * y + M[1, 2] * v,
            )
            peak = max(peak, x * x + y * y)
        result[0, s], result[1, s], result[2, s] = ise, effort, peak
    return result


@njit(parallel=True, fastmath=True, cache=True)
def plain(problem, modes):
    """O(1) a period: add the new input, subtract the one that leaves. It cancels."""
    move, energy, F, G, _, start, S, into, leave, out = problem
    scenarios, K = modes.shape
    N = G.shape[1]
    result = np.empty((3, scenarios))
    for s in prange(scenarios):
        u = np.zeros(N + K)
        x, y = start[0], start[1]
        a, b, c, d = 0.0, 0.0, 0.0, 0.0
        ise, effort, peak = 0.0, 0.0, x * x + y * y
        for k in range(K):
            i = modes[s, k]
            w = F[0, 0] * x + F[0, 1] * y + out[0] * a + out[1] * b + out[2] * c + out[3] * d
            u[N + k] = w
            v, M, E = u[k], move[i], energy[i]
            a = S[0] * a + into[0] * w - leave[0] * v
            b = S[1] * b + into[1] * w - leave[1] * v
            c = S[2] * c + into[2] * w - leave[2] * v
            d = S[3] * d + into[3] * w - leave[3] * v
            ise += E[0, 0] * x * x + E[1, 1] * y * y + E[2, 2] * v * v
            ise += 2.0 * (E[0, 1] * x * y + E[0, 2] * x * v + E[1, 2] * y * v)
            effort += w * w
            x, y = (
                M[0, 0] * x + M[0, 1] * y + M[0, 2] * v,
                M[1, 0] * x + M[1, 1] * y + M[1, 2] * v,
            )
            peak = max(peak, x * x + y * y)
        result[0, s], result[1, s], result[2, s] = ise, effort, peak
    return result


@njit(parallel=True, fastmath=True, cache=True)
def side_by_side(numbers, N, modes):
    """`plain`, scenarios side by side in memory: `numbers_of` the problem, `blocks_of` the modes.

    Everything but the inputs lies in one array at known distances, so that the compiler can
    prove that the inner loop's iterations do not meet, and vectorises it.
    """
    blocks, K, _ = modes.shape
    result = np.empty((3, blocks * WIDTH))
    p00, p01, p02, p10, p11, p12 = numbers.move[0]
    q00, q01, q02, q10, q11, q12 = numbers.move[1]
    e00, e01, e02, e11, e12, e22 = numbers.energy[0]
    f00, f01, f02, f11, f12, f22 = numbers.energy[1]
    F, S, into, leave, out = numbers.F, numbers.S, numbers.into, numbers.leave, numbers.out
    start = numbers.x0
    for block in prange(blocks):
        ring = np.zeros((N, WIDTH))
        z = np.zeros(9 * WIDTH)
        for j in range(WIDTH):
            z[j], z[WIDTH + j] = start[0], start[1]
            z[8 * WIDTH + j] = start[0] ** 2 + start[1] ** 2
        now = 0
        for k in range(K):
            u, mode = ring[now], modes[block, k]
            for j in range(WIDTH):
                x, y, first = z[j], z[WIDTH + j], mode[j] == 0
                a, b = z[2 * WIDTH + j], z[3 * WIDTH + j]
                c, d = z[4 * WIDTH + j], z[5 * WIDTH + j]
                w = F[0] * x + F[1] * y + out[0] * a + out[1] * b + out[2] * c + out[3] * d
                v = u[j]
                u[j] = w
                z[2 * WIDTH + j] = S[0] * a + into[0] * w - leave[0] * v
                z[3 * WIDTH + j] = S[1] * b + into[1] * w - leave[1] * v
                z[4 * WIDTH + j] = S[2] * c + into[2] * w - leave[2] * v
                z[5 * WIDTH + j] = S[3] * d + into[3] * w - leave[3] * v
                z[6 * WIDTH + j] += (
                    (e00 if first else f00) * x * x
                    + (e11 if first else f11) * y * y
                    + (e22 if first else f22) * v * v
                    + (e01 if first else f01) * x * y
                    + (e02 if first else f02) * x * v
                    + (e12 if first else f12) * y * v
                )
                z[7 * WIDTH + j] += w * w
                g = (p00 if first else q00) * x + (p01 if first else q01) * y
                h = (p10 if first else q10) * x + (p11 if first else q11) * y
                g += (p02 if first else q02) * v
                h += (p12 if first else q12) * v
                z[j], z[WIDTH + j] = g, h
                z[8 * WIDTH + j] = max(z[8 * WIDTH + j], g * g + h * h)
            now = 0 if now + 1 == N else now + 1
        for j in range(WIDTH):
            for figure in range(3):
                result[figure, block * WIDTH + j] = z[(6 + figure) * WIDTH + j]
    return result
