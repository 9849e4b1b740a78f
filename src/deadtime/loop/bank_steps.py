"""The steps of a bank of Kalman filters, one per mode, with the belief over the modes (IMM).

A period begins in mode i and ends in j. With x̂_i, P_i the mean and covariance of x_{k−1} given i,

    x̄_ij = M x̂_i + the inputs,    P̄_ij = M P_i Mᵀ + (Δ P_i Δᵀ + d dᵀ)/12 + Q_ij,

Q_ij that of the noise. Where modes change at samples M = Φ_i and Δ = d = 0; where they change
anywhere M is the mean of Φ_i and Φ_j, Δ their difference and d that of their predictions, and P̄_ij
has the variance about the line between these as well. Each pair is corrected by y_k with C_j and
weighed by the density of y_k; the pairs that end in the same mode are merged into one normal
density. (docs/theory/mode-filter.md; signs and lags are those of `deadtime.feedback.belief`.)

`begin_bank` is the first sample and `advance_bank` every later one, in single runs, batches of
eight scenarios and controllers. Numbers and inputs are as in `belief_steps.py`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.feedback.belief import BankForm
from deadtime.loop.belief_steps import (
    CURVED,
    NORMAL,
    ROUND_OFF,
    SPENT,
    BeliefState,
    bend,
    gather,
    move,
)
from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.numbers import arrays_of, flat, where


class BankState(NamedTuple):
    """The state of a bank, and scratch arrays.

    chain : BeliefState
    x : (modes, n), P : (modes, n, n), mean and covariance of x_k given the mode and y_0, …, y_k
    ahead_x : (modes, modes, n), ahead_P : (modes, modes, n, n), of the pairs before y_k
    pair_x, pair_P : after y_k
    toward : (modes, modes, n), P c of an output;  spread : (modes, modes), cᵀ P c + its noise
    whole_x : (n,), whole_P : (n, n), of all modes together
    spare : (3, n, n);  wide : (n,), size : (p,), sizes of the terms of states and outputs
    """

    chain: BeliefState
    x: Float[np.ndarray, "mode n ..."]
    P: Float[np.ndarray, "mode n n ..."]
    ahead_x: Float[np.ndarray, "first second n ..."]
    ahead_P: Float[np.ndarray, "first second n n ..."]
    pair_x: Float[np.ndarray, "first second n ..."]
    pair_P: Float[np.ndarray, "first second n n ..."]
    toward: Float[np.ndarray, "first second n ..."]
    spread: Float[np.ndarray, "first second ..."]
    whole_x: Float[np.ndarray, "n ..."]
    whole_P: Float[np.ndarray, "n n ..."]
    spare: Float[np.ndarray, "3 n n ..."]
    wide: Float[np.ndarray, "n ..."]
    size: Float[np.ndarray, "p ..."]

    @classmethod
    def of(cls, form: BankForm, rows: int, *lanes: int) -> BankState:
        """The state at time 0 for a table of `rows`; `lanes`: scenarios side by side, if any."""
        modes, p, n = form.C.shape
        pair, square = (modes, modes, n), (n, n)
        pairs = pair, (*pair, n), pair, (*pair, n), pair, (modes, modes)
        shapes = (modes, n), (modes, n, n), *pairs, (n,), square, (3, n, n), (n,), (p,)
        state = cls(BeliefState.of(form.chain, rows, *lanes), *arrays_of(*shapes, lanes=lanes))
        # Transposed, the axis of scenarios comes first: one value is spread over all of them.
        state.x.T[:] = np.tile(form.estimate, (modes, 1)).T
        state.P.T[:] = np.tile(form.covariance, (modes, 1, 1)).T
        return state

    @property
    def mean(self) -> Float[np.ndarray, " n"]:
        """x̂_k of one scenario, whatever the mode."""
        return self.chain.now.sum(axis=1) @ self.x


@kernel(eager=True, forceinline=True)
def begin_bank(form, bank, y):
    """The first sample: correct x_0, and the belief if C depends on the mode, by y_0."""
    now, density, modes = bank.chain.now, bank.chain.density, bank.x.shape[0]
    start_anew(form, bank, False)
    for j in range(modes):
        for a in range(now.shape[1]):
            now[j, a] = form.chain.start[j, a]
        copy(bank.x[j], bank.pair_x[0, j])
        copy(flat(bank.P[j]), flat(bank.pair_P[0, j]))
        # `_observe` starts from these, and goes back to them where an output is missing.
        copy(bank.x[j], bank.ahead_x[0, j])
        copy(flat(bank.P[j]), flat(bank.ahead_P[0, j]))
    # Nothing has been predicted: round-off is relative to the first estimate.
    for a in range(bank.wide.size):
        bank.wide[a] = abs(form.estimate[a])
    finite, top, total = _correct(form, bank, 1, y), -math.inf, 0.0
    for j in range(modes):
        copy(bank.pair_x[0, j], bank.x[j])
        copy(flat(bank.pair_P[0, j]), flat(bank.P[j]))
        # The scale is that of possible modes: a larger density of another one would make all
        # factors underflow.
        for a in range(now.shape[1]):
            top = where((now[j, a] > 0.0) & (density[0, j] > top), density[0, j], top)
    for j in range(modes):
        factor = where(finite, math.exp(min(density[0, j] - top, 0.0)), 1.0)
        for a in range(now.shape[1]):
            now[j, a] *= factor
            total += now[j, a]
    for j in range(modes):
        for a in range(now.shape[1]):
            now[j, a] /= total
    _require_finite(form, bank)


@kernel(eager=True, forceinline=True)
def advance_bank(form, bank, y, known_inputs, row):
    """Advance by a period: y_k at its end; u_{k−1} is in row `row` of the ring `known_inputs`."""
    modes, n, seen = bank.x.shape[0], bank.wide.size, False
    lag = form.chain.lag
    gather(lag, lag.size, known_inputs.shape[1], bank.chain.sent, known_inputs, row)
    _predict(form, bank)
    copy(flat(bank.ahead_x), flat(bank.pair_x))
    copy(flat(bank.ahead_P), flat(bank.pair_P))
    for a in range(y.size):
        seen = seen | math.isfinite(y[a])
    # No branch: of eight scenarios some may have a measurement and others none. All are corrected,
    # and those without are put back below.
    seen = seen & _correct(form, bank, modes, y)
    for i in range(modes):
        for j in range(modes):
            for a in range(n):
                bank.pair_x[i, j, a] = where(seen, bank.pair_x[i, j, a], bank.ahead_x[i, j, a])
                for b in range(n):
                    kept = bank.ahead_P[i, j, a, b]
                    bank.pair_P[i, j, a, b] = where(seen, bank.pair_P[i, j, a, b], kept)
    # Before the merge, which weighs pairs by the masses and factors that this leaves.
    move(form.chain, bank.chain, seen)
    _merge(form, bank)
    _require_finite(form, bank)


@inner_kernel
def copy(source, target):
    for i in range(target.size):
        target[i] = source[i]


@inner_kernel
def start_anew(form, bank, known):
    """Reset x̂ and P to their initial values, except in scenarios where they are `known`."""
    for i in range(bank.x.shape[0]):
        for a in range(bank.wide.size):
            bank.x[i, a] = where(known, bank.x[i, a], form.estimate[a])
            for b in range(bank.wide.size):
                bank.P[i, a, b] = where(known, bank.P[i, a, b], form.covariance[a, b])


@inner_kernel
def _require_finite(form, bank):
    """Reset x̂ and P where numbers have left the range of doubles."""
    x, P, finite = flat(bank.x), flat(bank.P), True
    for i in range(x.size):
        finite = finite & math.isfinite(x[i])
    for i in range(P.size):
        finite = finite & math.isfinite(P[i])
    start_anew(form, bank, finite)


@inner_kernel
def _predict(form, bank):
    """x̄ and P̄ of every pair, and the size of the predictions' terms, state by state."""
    chain, x, own = form.chain, bank.x, bank.chain.predicted
    apart, bent, sent = bank.chain.apart, bank.chain.bent, bank.chain.sent
    modes, n = x.shape
    for a in range(n):
        bank.wide[a] = 0.0
    for i in range(modes):
        # Where modes change at samples, x moves through the whole period in the mode of its begin.
        for j in range(modes):
            if i == j or chain.within:
                _move_state(chain, x[i], sent, j, own[j], bank.wide)
        for j in range(modes):
            for a in range(n):
                apart[a] = own[j, a] - own[i, a] if chain.within else 0.0
                bank.ahead_x[i, j, a] = own[i, a] + 0.5 * apart[a]
            bend(chain, i, j, x[i], sent, bent)
            _spread_out(chain, bank, i, j, apart, bent)


@inner_kernel
def _move_state(chain, x, sent, j, result, wide):
    """Move x through a period in mode j, and note the size of the terms."""
    Phi, Gamma = chain.Phi, chain.Gamma
    for a in range(x.size):
        total = size = 0.0
        for b in range(x.size):
            term = Phi[j, a, b] * x[b]
            total += term
            size += abs(term)
        for p in range(sent.shape[0]):
            for b in range(sent.shape[1]):
                term = Gamma[j, p, a, b] * sent[p, b]
                total += term
                size += abs(term)
        result[a] = total
        wide[a] = max(wide[a], size)


@inner_kernel
def _spread_out(chain, bank, i, j, apart, bent):
    """P̄_ij = M P_i Mᵀ + (Δ P_i Δᵀ + d dᵀ)/12 + Q_ij, and the variance of the bend."""
    Phi, P, middle, slope, half = chain.Phi, bank.P, bank.spare[0], bank.spare[1], bank.spare[2]
    n, moved, end = apart.size, bank.ahead_P, min(j, chain.noise.shape[1] - 1)
    for a in range(n):
        for b in range(n):
            slope[a, b] = Phi[j, a, b] - Phi[i, a, b] if chain.within else 0.0
            middle[a, b] = Phi[i, a, b] + 0.5 * slope[a, b]
            # The variance of a switch time that is spread evenly over the period.
            moved[i, j, a, b] = chain.noise[i, end, a, b] + apart[a] * apart[b] * (1.0 / 12.0)
        moved[i, j, a, a] += bent[a]
        if chain.within and i != j:
            moved[i, j, a, a] += CURVED * _form(chain.bend_x[i, j, a], P[i])
    _add_congruence(middle, P[i], 1.0, half, moved[i, j])
    if chain.within and i != j:
        _add_congruence(slope, P[i], 1.0 / 12.0, half, moved[i, j])
    _even_out(moved[i, j])


@inner_kernel
def _form(row, P):
    """row P rowᵀ."""
    total = 0.0
    for a in range(row.size):
        part = 0.0
        for b in range(row.size):
            part += P[a, b] * row[b]
        total += row[a] * part
    return total


@inner_kernel
def _add_congruence(M, P, share, half, result):
    """result += share M P Mᵀ."""
    n = P.shape[0]
    for a in range(n):
        for b in range(n):
            half[a, b] = 0.0
            for c in range(n):
                half[a, b] += M[a, c] * P[c, b]
    for a in range(n):
        for b in range(n):
            total = 0.0
            for c in range(n):
                total += half[a, c] * M[b, c]
            result[a, b] += share * total


@inner_kernel
def _even_out(P):
    """P = (P + Pᵀ)/2: both halves differ by round-off."""
    for a in range(P.shape[0]):
        for b in range(a):
            P[a, b] = P[b, a] = 0.5 * (P[a, b] + P[b, a])


@inner_kernel
def _correct(form, bank, many, y):
    """log p(y), x̂ and P after y of the first `many` rows of pairs; whether all logs are finite.

    One output after the other, without those that are missing. The round-off of its prediction
    adds to the noise of each, so that nothing is divided by 0; and 1e-14 of a variance remains, as
    a smaller rest is round-off.
    """
    C, density, modes, finite = form.C, bank.chain.density, bank.x.shape[0], True
    _size_outputs(C, bank, y)
    for i in range(many):
        for j in range(modes):
            density[i, j] = 0.0
    for a in range(y.size):
        off = ROUND_OFF * bank.size[a]
        r = form.variance[a] + off * off
        # Where x, y and all covariances are 0 every mode predicts 0: nothing is learnt.
        there = _measure(C, bank, many, a, r) & math.isfinite(y[a])
        for i in range(many):
            for j in range(modes):
                _correct_by(C[j, a], bank, i, j, where(there, y[a], 0.0), r, there)
    for i in range(many):
        for j in range(modes):
            finite = finite & math.isfinite(density[i, j])
            if form.gain.size > 0:
                _observe(form, bank, i, j, y)
    return finite


@inner_kernel
def _size_outputs(C, bank, y):
    """Sizes of the terms of every output, in the mode in which they are largest."""
    for a in range(y.size):
        bank.size[a] = where(math.isfinite(y[a]), abs(y[a]), 0.0)
        for j in range(C.shape[0]):
            total = 0.0
            for b in range(C.shape[2]):
                total += abs(C[j, a, b]) * bank.wide[b]
            bank.size[a] = max(bank.size[a], total)


@inner_kernel
def _measure(C, bank, many, a, r):
    """P c and the variance of output a of every pair; whether all variances are normal numbers."""
    n, toward, spread, P = C.shape[2], bank.toward, bank.spread, bank.pair_P
    there = True
    for i in range(many):
        for j in range(C.shape[0]):
            s = 0.0
            for b in range(n):
                total = 0.0
                for c in range(n):
                    total += P[i, j, b, c] * C[j, a, c]
                toward[i, j, b] = total
                s += total * C[j, a, b]
            spread[i, j] = s + r
            there = there & (spread[i, j] >= NORMAL)
    return there


@inner_kernel
def _correct_by(c, bank, i, j, y, r, there):
    """Correct a pair by one output of variance r about cᵀ x, where it is `there`.

    P is in Joseph's form, which stays positive under round-off.
    """
    x, P, half = bank.pair_x[i, j], bank.pair_P[i, j], bank.spare[0]
    toward, s, n = bank.toward[i, j], where(there, bank.spread[i, j], 1.0), c.size
    # s is 1 where there is no measurement, as eight scenarios divide together.
    wrong, share = y, where(there, 1.0, 0.0) / s
    for b in range(n):
        wrong -= x[b] * c[b]
    fit = 0.5 * (wrong * wrong / s + math.log(s))
    bank.chain.density[i, j] -= where(there, fit, 0.0)
    for a in range(n):
        gain = toward[a] * share
        x[a] += gain * wrong
        for b in range(n):
            half[a, b] = P[a, b] - gain * toward[b]
    for a in range(n):
        rest, gain = 0.0, toward[a] * share
        for b in range(n):
            rest += half[a, b] * c[b]
        for b in range(n):
            half[a, b] += toward[b] * share * (r * gain - rest)
    for a in range(n):
        # Before the row below overwrites P[a, a]; the mean of both halves keeps P symmetric.
        left = where(there, SPENT * P[a, a], 0.0)
        for b in range(a + 1):
            P[a, b] = P[b, a] = 0.5 * (half[a, b] + half[b, a])
        P[a, a] += left


@inner_kernel
def _observe(form, bank, i, j, y):
    """Correct a pair by the gains of given observers, which need all of y."""
    gain, C, r, x, P = form.gain, form.C, form.variance, bank.pair_x[i, j], bank.pair_P[i, j]
    rest, half, n = bank.spare[0], bank.spare[1], bank.wide.size
    before, whole = bank.ahead_P[i, j], True
    for a in range(y.size):
        whole = whole & math.isfinite(y[a])
    for a in range(n):
        for b in range(n):
            rest[a, b] = 1.0 if a == b else 0.0
            P[a, b] = 0.0
            for c in range(y.size):
                rest[a, b] -= gain[j, a, c] * C[j, c, b]
                P[a, b] += gain[j, a, c] * r[c] * gain[j, b, c]
    _add_congruence(rest, before, 1.0, half, P)
    _even_out(P)
    for a in range(n):
        P[a, a] += SPENT * before[a, a]
        x[a] = bank.ahead_x[i, j, a]
    for c in range(y.size):
        wrong = y[c]
        for b in range(n):
            wrong -= C[j, c, b] * bank.ahead_x[i, j, b]
        for a in range(n):
            x[a] += gain[j, a, c] * wrong
    for a in range(n):
        x[a] = where(whole, x[a], bank.ahead_x[i, j, a])
        for b in range(n):
            P[a, b] = where(whole, P[a, b], before[a, b])


@inner_kernel
def _merge(form, bank):
    """One normal density for each mode, with mean and covariance of the pairs that end in it.

    The forgetting part of the belief has mean and covariance of all pairs: a mode that was ruled
    out begins there.
    """
    weight, part = bank.chain.mass, form.chain.forgetting
    modes, total = bank.x.shape[0], 0.0
    for i in range(modes):
        for j in range(modes):
            weight[i, j] *= bank.chain.density[i, j]
            total += weight[i, j]
    for i in range(modes):
        for j in range(modes):
            weight[i, j] /= total
    x, P = bank.whole_x, bank.whole_P
    _clear(x)
    _clear(flat(P))
    for i in range(modes):
        for j in range(modes):
            _add_mean(weight[i, j], bank.pair_x[i, j], x)
    for i in range(modes):
        for j in range(modes):
            # In a loop of its own: the mean must be complete before covariances about it.
            _add_spread(weight[i, j], bank.pair_x[i, j], bank.pair_P[i, j], x, P)
    for j in range(modes):
        own = part / modes
        for i in range(modes):
            own += (1.0 - part) * weight[i, j]
        _clear(bank.x[j])
        _clear(flat(bank.P[j]))
        _add_mean(part / modes / own, x, bank.x[j])
        for i in range(modes):
            _add_mean((1.0 - part) * weight[i, j] / own, bank.pair_x[i, j], bank.x[j])
        _add_spread(part / modes / own, x, P, bank.x[j], bank.P[j])
        for i in range(modes):
            share = (1.0 - part) * weight[i, j] / own
            _add_spread(share, bank.pair_x[i, j], bank.pair_P[i, j], bank.x[j], bank.P[j])


@inner_kernel
def _clear(target):
    for i in range(target.size):
        target[i] = 0.0


@inner_kernel
def _add_mean(share, x, mean):
    for a in range(x.size):
        mean[a] += share * x[a]


@inner_kernel
def _add_spread(share, x, P, mean, result):
    """result += share (P + (x − mean)(x − mean)ᵀ)."""
    for a in range(x.size):
        for b in range(x.size):
            result[a, b] += share * (P[a, b] + (x[a] - mean[a]) * (x[b] - mean[b]))


@inner_kernel
def add_estimates(gains, share, x, u):
    """u += Σ_c π_c F_c x̂, x̂ that of the mode of row c; gains (rows, m, n)."""
    # Row mode·ages + age of a table, so that c // ages below is its mode.
    ages = share.size // x.shape[0]
    for i in range(u.size):
        for c in range(share.size):
            total = 0.0
            for a in range(x.shape[1]):
                total += gains[c, i, a] * x[c // ages, a]
            u[i] += share[c] * total
