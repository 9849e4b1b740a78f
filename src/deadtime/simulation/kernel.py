"""The compiled inner loops of the digital simulation."""

from __future__ import annotations

import numpy as np
from numba import njit

from deadtime.numerics.exponential import advance, between, energy_between, energy_gramian

LIMIT = 1e100


@njit(cache=True, fastmath={"reassoc", "contract"})
def _dot(a, b):
    """Σ a_i b_i, summed in any order (so that it vectorises)."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@njit(cache=True)
def _within_limit(x):
    """Whether |x| ≤ LIMIT (false when x is not a number)."""
    square = 0.0
    for i in range(x.size):
        square += (x[i] / LIMIT) ** 2
    return square <= 1.0


@njit(cache=True)
def _finite(a):
    """Whether all are finite."""
    finite = True
    for value in a:
        finite &= np.isfinite(value)
    return finite


@njit(cache=True)
def _limited(u, before, low, high, relative):
    """An input under limits, one after the other, `before` being what was applied before it."""
    for j in range(relative.size):
        base = before if relative[j] else 0.0
        u = np.minimum(np.maximum(u, base + low[j]), base + high[j])
    return u


@njit(cache=True)
def closed_loop(
    index, Phi, Gamma, count, F, G, rows, x0, past, inputs, asked, told, noise, limits, shift
):
    """Run the loop over the samples 0, …, rows.size − 1 and on until the pipe is empty.

    `inputs[past + k]` is u_k; its first `past` rows are the history. Row `r` of the law is
    F[r] and G[r] (m, taps·m), the oldest input first. The law writes into `asked` and is told the
    past inputs `told`, of the shape of `inputs`: all three are one array where what is asked for
    is applied. `noise` (samples, n), or empty, is added to what is measured; limits = (low, high,
    relative) are those of `_limited`. `shift` (steps, 2, n), or empty, is what disturbances add
    over the phases. Returns (samples, states, at_phase): how many samples were kept before |x|
    left the limit, x(t_k), and x(t_k + φ) for k = 0, …, samples + count − 1 and one less.
    """
    m, window = G.shape[1:]
    n = x0.size
    pipe = told.reshape(-1)
    seen = np.empty(n)
    low, high, relative = limits
    states = np.empty((rows.size + count, n))
    at_phase = np.empty((rows.size + count - 1, n))
    states[0] = x0
    samples = rows.size
    k = 0
    while k < samples + count - 1:
        x = states[k]
        if k < samples and k > 0 and not _within_limit(x):
            samples = k
            if count == 1:
                break
        if k < samples:
            row, now = rows[k], (past + k) * m
            recent = pipe[now - window : now]
            for i in range(n):
                seen[i] = x[i] + (noise[k, i] if noise.size else 0.0)
            for i in range(m):
                asked[past + k, i] = _dot(G[row, i], recent) + _dot(F[row, i], seen)
            held = not (_finite(seen) or _finite(asked[past + k]))
            for i in range(m):
                command = asked[past + k - 1, i] if held else asked[past + k, i]
                asked[past + k, i] = command
                before = inputs[past + k - 1, i]
                inputs[past + k, i] = _limited(command, before, low[:, i], high[:, i], relative)
        i = index[k, 0]
        advance(Phi[i], Gamma[i], x, inputs[past + k - count], at_phase[k])
        if shift.size:
            at_phase[k] += shift[k, 0]
        i = index[k, 1]
        u = inputs[past + k - count + 1]
        advance(Phi[i], Gamma[i], at_phase[k], u, states[k + 1])
        if shift.size:
            states[k + 1] += shift[k, 1]
        k += 1
    return samples, states[: samples + count], at_phase[: samples + count - 1]


@njit(cache=True)
def states_at(A, B, phase, cut_step, cut_offset, cut_mode, step, offset, states, acting):
    """x at the instants t_k + offset, k = `step`; acting[k, f] is held over phase f of step k."""
    result = np.empty((step.size, A.shape[1]))
    for i in range(step.size):
        k, o = step[i], offset[i]
        p = np.searchsorted(cut_step, k)
        stop = np.searchsorted(cut_step, k + 1)
        Phi, Gamma, p, mode = between(
            A, B, cut_mode[p], cut_offset, cut_mode, p, stop, 0.0, min(o, phase)
        )
        advance(Phi, Gamma, states[k], acting[k, 0], result[i])
        if o > phase:
            Phi, Gamma, p, mode = between(A, B, mode, cut_offset, cut_mode, p, stop, phase, o)
            advance(Phi, Gamma, result[i].copy(), acting[k, 1], result[i])
    return result


@njit(cache=True)
def phase_gramians(A, B, step, phase, cut_offset, cut_mode, mode, first, stop, Q=None):
    """∫xᵀQx over each entry of the phase table as a form in (x, u) at its start; None: Q = I."""
    modes, n, m = B.shape
    M = np.zeros((mode.size, n + m, n + m))
    for e in range(mode.size):
        early = e % 2 == 0 if e < 2 * modes else cut_offset[first[e]] < phase
        a, b = (0.0, phase) if early else (phase, step)
        if e < 2 * modes:
            M[e] = energy_gramian(A[mode[e]], B[mode[e]], b - a, Q)
        else:
            M[e] = energy_between(A, B, mode[e], cut_offset, cut_mode, first[e], stop[e], a, b, Q)
    return M


@njit(cache=True)
def form_integral(M, index, steps, states, at_phase, acting):
    """The sum of `phase_gramians`' forms over the steps 0, …, steps − 1."""
    n, m = states.shape[1], acting.shape[2]
    total = 0.0
    z = np.empty(n + m)
    for k in range(steps):
        for f in range(2):
            z[:n] = states[k] if f == 0 else at_phase[k]
            z[n:] = acting[k, f]
            form = M[index[k, f]]
            for i in range(n + m):
                total += z[i] * _dot(form[i], z)
    return total
