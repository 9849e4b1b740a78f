"""The compiled steps of an observer, and of a `deadtime.feedback.memory.Memory` over a run."""

from __future__ import annotations

import numpy as np

from deadtime.numerics.exponential import advance
from deadtime.numerics.kernels import kernel

_ROUND_OFF = 1e-9


@kernel(eager=True)
def correct(C, L, y, x, spare, innovation):
    """x += L (y − C x), if y and the answer are finite; says whether it did."""
    for i in range(y.size):
        total = y[i]
        for j in range(C.shape[1]):
            total -= C[i, j] * x[j]
        innovation[i] = total
    for i in range(C.shape[1]):
        total = x[i]
        for j in range(y.size):
            total += L[i, j] * innovation[j]
        spare[i] = total
        if not np.isfinite(total):
            return False
    for i in range(C.shape[1]):
        x[i] = spare[i]
    return True


@kernel(eager=True)
def measure(C, H, x, y, use, value):
    """value = H y, or H C x where y is of no use."""
    for i in range(H.shape[0]):
        value[i] = 0.0
        for j in range(H.shape[1]):
            output = y[j]
            if not use:
                output = 0.0
                for k in range(C.shape[1]):
                    output += C[j, k] * x[k]
            value[i] += H[i, j] * output


@kernel(eager=True)
def integrate(step, before, now, reference, asked, applied, push, q):
    """q += h ((before + now)/2 − reference), unless that asks for more of what was refused.

    `push` is the law's answer to q. Where the input applied was not the one asked for, a change
    of q that drives it further the same way is left out, so that nothing winds up. Round-off of
    what was applied, as of one that was measured and told, refuses nothing.
    """
    further = 0.0
    for i in range(push.shape[0]):
        change = 0.0
        for j in range(q.size):
            change += push[i, j] * step * (0.5 * (before[j] + now[j]) - reference[j])
        refused = asked[i] - applied[i]
        if abs(refused) > _ROUND_OFF * abs(asked[i]):
            further += refused * change
    if further > 0.0:
        return
    for j in range(q.size):
        q[j] += step * (0.5 * (before[j] + now[j]) - reference[j])


@kernel
def remember(memory, mode, k, told, past, y, asked, estimates):
    """z at sample k, in its row of the estimates; `mode` is that of every sample.

    `told` are the inputs that the law knows of, u_k in row past + k, and `asked` is its answer at
    sample k − 1.
    """
    z, n, r = estimates[k], memory.gain.shape[1], memory.tracked.shape[0]
    x, q, reference = z[:n], z[n : z.size - r], z[z.size - r :]
    spare, acting, innovation = np.empty(n), np.empty(asked.size), np.empty(y.size)
    for i in range(z.size):
        z[i] = memory.start[i] if k == 0 else estimates[k - 1, i]
    if k > 0:
        for piece in range(memory.first[mode[k - 1]], memory.first[mode[k - 1] + 1]):
            for i in range(asked.size):
                acting[i] = told[past + k - 1 - memory.lag[piece, i], i]
            advance(memory.Phi[piece], memory.Gamma[piece], x, acting, spare)
            for i in range(n):
                x[i] = spare[i]
    C = memory.C[mode[k]]
    use = correct(C, memory.gain[mode[k]], y, x, spare, innovation)
    if r > 0:
        value = memory.value[k]
        measure(C, memory.tracked, x, y, use, value)
        if k > 0 and q.size > 0:
            before, latest, push = memory.value[k - 1], told[past + k - 1], memory.push[mode[k]]
            integrate(memory.step, before, value, reference, asked, latest, push, q)
        for i in range(r):
            reference[i] = memory.reference[k, i]
