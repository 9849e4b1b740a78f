"""The steps of a `deadtime.feedback.memory.Memory`: an observer, and the sum of tracking errors.

`predict_observer` moves z over the period that ends, in the mode of its begin; `select_mode` takes
the matrices of the mode at the sample; `correct_observer` corrects z by the measurement. Numbers
and inputs are as in `belief_steps.py`: of one scenario, or of eight, each with the matrices of its
own mode.

    own   Φ (n n) | Γ of lag 0 (n m) | Γ of lag 1 | … | C (p n) | L (n p) | gain of q (m q)
          0         n n                               at_C      at_gain   at_gain + n p
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.feedback.memory import Memory
from deadtime.loop.belief_steps import gather
from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.numbers import arrays_of, where

_ROUND_OFF = 1e-9  # of an input: a smaller difference to the command is no limit


class ObserverState(NamedTuple):
    """The state of an observer, and scratch arrays.

    own : (size,), the matrices of the mode that applies, as in a row of `Memory.matrices`
    z : (n + q + r,), the estimate, sums of errors and the reference
    value : (2, r), v at the sample before and now
    asked : (m,), the law's command at the sample before, written by the caller
    used : (1,), 1 where the last measurement corrected z, else 0
    sent : (lags, m), the inputs that act in the period that ended
    innovation : (p,), change : (q,), spare : (n,)
    """

    own: Float[np.ndarray, "size ..."]
    z: Float[np.ndarray, "z ..."]
    value: Float[np.ndarray, "2 r ..."]
    asked: Float[np.ndarray, "m ..."]
    used: Float[np.ndarray, "1 ..."]
    sent: Float[np.ndarray, "lag m ..."]
    innovation: Float[np.ndarray, "p ..."]
    change: Float[np.ndarray, "q ..."]
    spare: Float[np.ndarray, "n ..."]

    @classmethod
    def of(cls, memory: Memory, *lanes: int) -> ObserverState:
        """The state before the first sample; `lanes`: scenarios side by side, if any."""
        n, p, q, r, m, lags = memory.sizes
        shapes = (n + q + r,), (2, r), (m,), (1,), (lags, m), (p,), (q,), (n,)
        return cls(*arrays_of(memory.matrices.shape[1:], *shapes, lanes=lanes))


@inner_kernel
def begin_observer(memory, state):
    """z before the first measurement."""
    for i in range(memory.start.size):
        state.z[i] = memory.start[i]


@kernel(eager=True, nogil=True)
def select_mode(table, own, known, mode):
    """Put each scenario's row of a table into `own` (size, scenarios), where its mode is new."""
    for lane in range(mode.size):
        if mode[lane] != known[lane]:
            known[lane] = mode[lane]
            for i in range(table.shape[1]):
                own[i, lane] = table[mode[lane], i]


@kernel(eager=True, forceinline=True)
def predict_observer(memory, state, known_inputs, row):
    """Predict over the period that ends; u_{k−1} is in row `row` of the ring `known_inputs`."""
    sizes = memory.sizes
    # Offsets in `own` are counted by hand, as slices of it would cost more than the sums.
    n, m, lags = sizes.n, sizes.m, sizes.lags
    own, z, ahead, sent = state.own, state.z, state.spare, state.sent
    gather(memory.lag, lags, m, sent, known_inputs, row)
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += own[i * n + j] * z[j]
        for p in range(lags):
            for j in range(m):
                total += own[n * n + (p * n + i) * m + j] * sent[p, j]
        ahead[i] = total
    # Only now: every row of Φ reads all of z.
    for i in range(n):
        z[i] = ahead[i]


@kernel(eager=True, forceinline=True)
def correct_observer(memory, state, y, applied, reference, k):
    """Correct z at sample k by y, if all of it is finite, and take the reference there.

    `applied` is the input applied in the period that ended.
    """
    sizes = memory.sizes
    n, p, q, r = sizes.n, sizes.p, sizes.q, sizes.r
    at_C = n * n + sizes.lags * n * sizes.m
    at_gain = at_C + p * n
    own, z, innovation, nearer = state.own, state.z, state.innovation, state.spare
    use = True
    for i in range(p):
        total = y[i]
        for j in range(n):
            total -= own[at_C + i * n + j] * z[j]
        innovation[i] = total
    # Aside until all of it is known to be finite: else the measurement is not used at all.
    for i in range(n):
        total = z[i]
        for j in range(p):
            total += own[at_gain + i * p + j] * innovation[j]
        nearer[i] = total
        use = use & math.isfinite(total)
    for i in range(n):
        z[i] = where(use, nearer[i], z[i])
    state.used[0] = where(use, 1.0, 0.0)
    if r > 0:
        for i in range(p):
            total = 0.0
            for j in range(n):
                total += own[at_C + i * n + j] * z[j]
            # The innovation is not needed any more; its array takes y, or C z in its place.
            innovation[i] = where(use, y[i], total)
        for i in range(r):
            total = 0.0
            for j in range(p):
                total += memory.tracked[i, j] * innovation[j]
            state.value[0, i] = state.value[1, i]
            state.value[1, i] = total
        if k > 0:
            _integrate(memory, state, applied, at_gain + n * p)
        # After the sums, which use the reference of the period that ended.
        for i in range(r):
            z[n + q + i] = reference[i]


@inner_kernel
def _integrate(memory, state, applied, at_push):
    """q += h ((before + now)/2 − r), unless the input is limited and q would drive it further.

    `push` is the law's gain of q. Where the applied input differs from the command, a change of q
    that increases the difference is left out, against windup. Round-off of an input that was
    measured and reported counts as no difference.
    """
    sizes = memory.sizes
    n, q, m = sizes.n, sizes.q, sizes.m
    own, z, value, change, further = state.own, state.z, state.value, state.change, 0.0
    for j in range(q):
        change[j] = memory.step * (0.5 * (value[0, j] + value[1, j]) - z[n + q + j])
    for i in range(m):
        push = 0.0
        for j in range(q):
            push += own[at_push + i * q + j] * change[j]
        refused = state.asked[i] - applied[i]
        counts = abs(refused) > _ROUND_OFF * abs(state.asked[i])
        further += where(counts, refused * push, 0.0)
    for j in range(q):
        z[n + j] += where(further > 0.0, 0.0, change[j])


@kernel
def run_observer(memory, state, mode, known, k, known_inputs, past, y, estimates):
    """z at sample k of a run, in its row of the estimates; `mode` is that of every sample.

    `known_inputs` are the inputs that the law knows of, u_k in row past + k.
    """
    if k > 0:
        predict_observer(memory, state, known_inputs, past + k - 1)
    select_mode(memory.matrices, state.own.reshape(-1, 1), known, mode[k : k + 1])
    correct_observer(memory, state, y, known_inputs[past + k - 1], memory.reference[k], k)
    for i in range(state.z.size):
        estimates[k, i] = state.z[i]
