"""The table of a law that holds the current mode for the rest of its dwell time.

At age a of mode i its forecast is: mode i for r_a seconds more, then, held, one of the
systems (A_s, B_s), gain K_s. With [0, D) cut into the stretches in which inputs in flight act,
[0, φ), [φ, φ + h), …, [D − h, D), the functional Σ_s K_s P_s is carried backwards from D: in
every system by itself down to r_a, where all branches join into R = Σ_s K_s e^{A_s (D − r_a)},
and from there in mode i down to 0. Over a stretch, R adds R Γ to the taps of its inputs and
becomes R Φ. The stretch that r_a cuts is propagated in two parts, so any real dwell time is exact.

Where inputs or modes have delays of their own, each branch is a signal with one switch, and has the
row of `along_signal`, under the gain of its last system.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Feedback
from deadtime.feedback.law import require_room, room
from deadtime.laws.tables.along_signal import rows_along
from deadtime.numerics.exponential import discretise_into, product
from deadtime.numerics.kernels import kernel
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.discretisation import snap
from deadtime.switching import SwitchingSignal


@kernel
def place(tap, lag, G):
    """Add what a stretch gives its inputs to their taps, G (N, m, m), the youngest first."""
    m = tap.shape[0]
    for j in range(m):
        for i in range(m):
            G[lag[j] - 1, i, j] += tap[i, j]


@kernel(eager=True)
def _add_product(X, Y, spare, result):
    """Add X Y to result; `spare` is overwritten by it."""
    product(X, Y, spare)
    for i in range(spare.shape[0]):
        for j in range(spare.shape[1]):
            result[i, j] += spare[i, j]


@kernel(eager=True)
def _branches(K, ahead, Phi, Gamma, R, taps):
    """Σ_s of the functionals at the start of every stretch, apart per system, and their taps.

    R (stretches + 1, systems, m, n): stretch p starts with R[p]; the last is K. taps (stretches,
    m, m) is to be zero before.
    """
    systems, m, n = K.shape
    stretches, spare = ahead.kind.size, np.empty((m, m))
    for s in range(systems):
        for i in range(m):
            for j in range(n):
                R[stretches, s, i, j] = K[s, i, j]
    for p in range(stretches - 1, -1, -1):
        kind = ahead.kind[p]
        for s in range(systems):
            _add_product(R[p + 1, s], Gamma[kind, s], spare, taps[p])
            product(R[p + 1, s], Phi[kind, s], R[p, s])


@kernel(eager=True)
def _kinds(A, B, length, Phi, Gamma):
    """Φ (kinds, modes, n, n) and Γ (kinds, modes, n, m) over stretches of these lengths."""
    for kind in range(length.size):
        for i in range(A.shape[0]):
            discretise_into(A[i], B[i], length[kind], Phi[kind, i], Gamma[kind, i])


@kernel(eager=True)
def _join(A, B, K, seconds, R, tap, joined):
    """Σ_s of R_s e^{A_s seconds}, and what the input of this time weighs on the way."""
    m, n = joined.shape
    Phi, Gamma = np.empty((n, n)), np.empty((n, m))
    one, two = np.empty((m, m)), np.empty((m, n))
    for i in range(m):
        for j in range(m):
            tap[i, j] = 0.0
        for j in range(n):
            joined[i, j] = 0.0
    for s in range(K.shape[0]):
        discretise_into(A[s], B[s], seconds, Phi, Gamma)
        _add_product(R[s], Gamma, one, tap)
        _add_product(R[s], Phi, two, joined)


@kernel(eager=True)
def _rows(A, B, fA, fB, fK, ahead, rest):
    """F (modes·ages, m, n) and G (modes·ages, N, m, m); `rest` (ages,) are the r_a < D."""
    modes, n, m = B.shape
    ages, stretches, kinds, systems = rest.size, ahead.kind.size, ahead.length.size, fK.shape[0]
    F, G = np.empty((modes * ages, m, n)), np.zeros((modes * ages, ahead.lag.max(), m, m))
    R, taps = np.empty((stretches + 1, systems, m, n)), np.zeros((stretches, m, m))
    Phi, Gamma = np.empty((kinds, systems, n, n)), np.empty((kinds, systems, n, m))
    _kinds(fA, fB, ahead.length, Phi, Gamma)
    _branches(fK, ahead, Phi, Gamma, R, taps)
    Phi, Gamma = np.empty((kinds, modes, n, n)), np.empty((kinds, modes, n, m))
    _kinds(A, B, ahead.length, Phi, Gamma)
    joined, now, moved = np.empty((m, n)), np.empty((m, n)), np.empty((m, n))
    tap, whole, spare = np.empty((m, m)), np.empty((m, m)), np.empty((m, m))
    before, forced = np.empty((n, n)), np.empty((n, m))
    for a in range(ages):
        cut = 0
        while cut < stretches - 1 and ahead.stop[cut] <= rest[a]:
            cut += 1
        inside = max(rest[a] - ahead.start[cut], 0.0)  # round-off may make it negative
        left = ahead.stop[cut] - ahead.start[cut] - inside
        _join(fA, fB, fK, left, R[cut + 1], tap, joined)
        for i in range(modes):
            row = i * ages + a
            for p in range(cut + 1, stretches):
                place(taps[p], ahead.lag[p], G[row])
            discretise_into(A[i], B[i], inside, before, forced)
            for r in range(m):
                for c in range(m):
                    whole[r, c] = tap[r, c]
            _add_product(joined, forced, spare, whole)
            place(whole, ahead.lag[cut], G[row])
            product(joined, before, now)
            for p in range(cut - 1, -1, -1):
                kind = ahead.kind[p]
                product(now, Gamma[kind, i], spare)
                place(spare, ahead.lag[p], G[row])
                product(now, Phi[kind, i], moved)
                now, moved = moved, now  # arrays change their roles, nothing is copied
            for r in range(m):
                for c in range(n):
                    F[row, r, c] = now[r, c]
    return F, G


def dwelling_table(
    plant: SwitchedSystem,
    after: SwitchedSystem,
    K: Float[np.ndarray, "system m n"],
    weights: Float[np.ndarray, " system"],
    dwell_time: float,
    step: float,
) -> Feedback:
    """The (mode, age) table Σ_s w_s K_s P_s; `after` has the systems that may follow as modes."""
    everything = plant.like(
        np.concatenate((plant.A, after.A)),
        np.concatenate((plant.B, after.B)),
        np.concatenate((plant.delays, after.delays)),
    )
    sampled = SampledPlant(everything, step)
    periods = snap(dwell_time / sampled.step)
    modes, m = plant.modes, plant.inputs
    most = room(8 * modes * sampled.longest_lag * m * m)
    require_room("dwell_time", periods, sampled.step, most)
    ages = math.ceil(periods) + 1
    rest = np.maximum(0.0, periods - np.arange(ages)) * sampled.step
    rest = np.minimum(rest, sampled.windows[-1].delay)  # a forecast ends there
    if everything.has_one_delay:
        gains = np.array(weights[:, None, None] * K, order="C")
        F, G = _rows(plant.A, plant.B, after.A, after.B, gains, sampled.ahead, rest)
    else:
        F, G = _dense_rows(sampled, modes, K, weights, rest)
    return Feedback(F, G, "mode_age", sampled.step, ages)


def _dense_rows(
    sampled: SampledPlant, modes: int, K: np.ndarray, weights: np.ndarray, rest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """F and G for any delays; the systems that follow are the modes from `modes` on."""
    m, n = K.shape[1:]
    ages = rest.size
    F = np.zeros((modes * ages, m, n))
    G = np.zeros((modes * ages, sampled.longest_lag, m, m))
    for i in range(modes):
        for s, weight in enumerate(weights.tolist()):
            gains = np.tile(K[s], (sampled.plant.modes, 1, 1))
            for a, left in enumerate(rest.tolist()):
                times, path = ([0.0, left], [i, modes + s]) if left else ([0.0], [modes + s])
                row = rows_along(sampled, gains, SwitchingSignal(times, path), 1)
                F[i * ages + a] += weight * row[0][0]
                G[i * ages + a] += weight * row[1][0]
    return F, G
