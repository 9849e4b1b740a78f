"""The table of a law that trusts the current mode for the rest of its guaranteed dwell.

At age a of mode i its forecast is: mode i for r_a seconds more, then for ever one of the
systems (A_s, B_s), gain K_s. With the window cut into the pieces over which an input is held,
[0, φ), [φ, φ + h), …, [D − h, D), the functional Σ_s K_s P_s is carried backwards from D: in
every system by itself down to r_a, where all branches join into R = Σ_s K_s e^{A_s (D − r_a)},
and from there in mode i down to 0. Over a piece, R adds R Γ to the tap of its input and becomes
R Φ. The piece that r_a cuts is propagated in two parts, so any real dwell time is exact.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numba import njit

from deadtime.feedback import Feedback
from deadtime.feedback.law import require_room, room
from deadtime.numerics.exponential import held, held_modes, multiply
from deadtime.plant import Window
from deadtime.plant.steps import snap


@njit(cache=True)
def _branches(A, B, K, step, phase, count):
    """Σ_s of the functionals at the start of every piece, apart per system, and their taps.

    R (count + 1, systems, m, n): piece p starts with R[p]; R[count] = K. taps (count, m, m).
    """
    systems, m, n = K.shape
    R, taps = np.empty((count + 1, systems, m, n)), np.zeros((count, m, m))
    R[count] = K
    Phi, Gamma = held_modes(A, B, step)
    for p in range(count - 1, -1, -1):
        if p == 0:
            Phi, Gamma = held_modes(A, B, phase)
        for s in range(systems):
            taps[p] += multiply(R[p + 1, s], Gamma[s])
            R[p, s] = multiply(R[p + 1, s], Phi[s])
    return R, taps


@njit(cache=True)
def _rows(A, B, fA, fB, fK, step, phase, count, rest):
    """F (modes·ages, m, n) and G (modes·ages, N, m, m); `rest` (ages,) are the r_a < D."""
    modes, n, m = B.shape
    ages = rest.size
    F = np.empty((modes * ages, m, n))
    G = np.zeros((modes * ages, count, m, m))
    R, taps = _branches(fA, fB, fK, step, phase, count)
    Phi, Gamma = held_modes(A, B, step)
    Phi_first, Gamma_first = held_modes(A, B, phase)
    for a in range(ages):
        cut = 0 if rest[a] < phase else min(1 + int((rest[a] - phase) / step), count - 1)
        begin = 0.0 if cut == 0 else phase + (cut - 1) * step
        end = phase + cut * step
        inside = max(rest[a] - begin, 0.0)
        joined, tap = np.zeros((m, n)), np.zeros((m, m))
        for s in range(fK.shape[0]):
            after, forced = held(fA[s], fB[s], end - begin - inside)
            tap += multiply(R[cut + 1, s], forced)
            joined += multiply(R[cut + 1, s], after)
        for i in range(modes):
            row = i * ages + a
            G[row, : count - cut - 1] = taps[:cut:-1]
            before, forced = held(A[i], B[i], inside)
            G[row, count - 1 - cut] = tap + multiply(joined, forced)
            now = multiply(joined, before)
            for p in range(cut - 1, -1, -1):
                G[row, count - 1 - p] = multiply(now, Gamma_first[i] if p == 0 else Gamma[i])
                now = multiply(now, Phi_first[i] if p == 0 else Phi[i])
            F[row] = now
    return F, G


def dwelling_table(
    A: Float[np.ndarray, "mode n n"],
    B: Float[np.ndarray, "mode n m"],
    after: tuple[np.ndarray, np.ndarray, np.ndarray],
    dwell_time: float,
    window: Window,
) -> Feedback:
    """The (mode, age) table; `after` are the A, B and (weighted) K of the systems that follow."""
    periods = snap(dwell_time / window.step)
    modes, _, m = B.shape
    most = room(8 * modes * window.count * m * m)
    require_room("dwell_time", periods, window.step, most)
    ages = math.ceil(periods) + 1
    rest = np.maximum(0.0, periods - np.arange(ages)) * window.step
    fA, fB, fK = (np.array(M, order="C") for M in after)
    rest = np.minimum(rest, window.delay)
    F, G = _rows(A, B, fA, fB, fK, window.step, window.phase, window.count, rest)
    return Feedback(F, G, "mode_age", window.step, ages)
