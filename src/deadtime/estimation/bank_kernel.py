"""The compiled steps of a bank of Kalman filters, one per mode: see `estimation.running_bank`.

`begin_bank` is the first sample and `advance_bank` every other one, whoever runs them: a single
run, eight scenarios, a controller. The belief moves by `estimation/belief_kernel.py`.
"""

from __future__ import annotations

import math

from deadtime.estimation.belief_kernel import CURVED, ROUND_OFF, SPENT, bend, move
from deadtime.numerics.kernels import inner_kernel, kernel


@kernel(eager=True)
def begin_bank(form, bank, y):
    """The first sample: what y_0 says of x_0, and of the mode where C depends on it."""
    now, modes = bank.chain.now, bank.x.shape[0]
    start_anew(form, bank)
    _copy(form.chain.start.reshape(-1), now.reshape(-1))
    for j in range(modes):
        _copy(bank.x[j], bank.pair_x[0, j])
        _copy(bank.P[j].reshape(-1), bank.pair_P[0, j].reshape(-1))
    for a in range(bank.wide.size):
        bank.wide[a] = abs(form.estimate[a])
    finite, top = _correct(form, bank, 1, y), -math.inf
    for j in range(modes):
        _copy(bank.pair_x[0, j], bank.x[j])
        _copy(bank.pair_P[0, j].reshape(-1), bank.P[j].reshape(-1))
        for a in range(now.shape[1]):
            if now[j, a] > 0.0:
                top = max(top, bank.chain.density[0, j])
    if finite:
        total = 0.0
        for j in range(modes):
            factor = math.exp(min(bank.chain.density[0, j] - top, 0.0))
            for a in range(now.shape[1]):
                now[j, a] *= factor
                total += now[j, a]
        for j in range(modes):
            for a in range(now.shape[1]):
                now[j, a] /= total
    _require_finite(form, bank)


@kernel(eager=True)
def advance_bank(form, bank, y, told, row):
    """One period: y_k at its end, and the inputs, u_{k−1} in row `row` of `told`."""
    modes, seen = bank.x.shape[0], False
    _predict(form, bank, told, row)
    _copy(bank.ahead_x.reshape(-1), bank.pair_x.reshape(-1))
    _copy(bank.ahead_P.reshape(-1), bank.pair_P.reshape(-1))
    for a in range(y.size):
        seen |= math.isfinite(y[a])
    if seen:
        seen = _correct(form, bank, modes, y)
    if not seen:
        _copy(bank.ahead_x.reshape(-1), bank.pair_x.reshape(-1))
        _copy(bank.ahead_P.reshape(-1), bank.pair_P.reshape(-1))
    move(form.chain, bank.chain, seen)
    _merge(form, bank)
    _require_finite(form, bank)


@inner_kernel
def _copy(source, target):
    for i in range(target.size):
        target[i] = source[i]


@inner_kernel
def start_anew(form, bank):
    """Nothing is known of x."""
    for i in range(bank.x.shape[0]):
        _copy(form.estimate, bank.x[i])
        _copy(form.covariance.reshape(-1), bank.P[i].reshape(-1))


@inner_kernel
def _require_finite(form, bank):
    """Where numbers have left the range of doubles, nothing is known of x any more."""
    x, P, finite = bank.x.reshape(-1), bank.P.reshape(-1), True
    for i in range(x.size):
        finite &= math.isfinite(x[i])
    for i in range(P.size):
        finite &= math.isfinite(P[i])
    if not finite:
        start_anew(form, bank)


@inner_kernel
def _predict(form, bank, told, row):
    """x̄ and P̄ of every pair, and the size of the terms of predictions per state."""
    chain, x, own = form.chain, bank.x, bank.chain.predicted
    apart, bent = bank.chain.apart, bank.chain.bent
    modes, n = x.shape
    for a in range(n):
        bank.wide[a] = 0.0
    for i in range(modes):
        for j in range(modes):
            if i == j or chain.within:
                _move_state(chain, x[i], told, row, j, own[j], bank.wide)
        for j in range(modes):
            for a in range(n):
                apart[a] = own[j, a] - own[i, a] if chain.within else 0.0
                bank.ahead_x[i, j, a] = own[i, a] + 0.5 * apart[a]
            bend(chain, i, j, x[i], told, row, bent)
            _spread_out(chain, bank, i, j, apart, bent)


@inner_kernel
def _move_state(chain, x, told, row, j, result, wide):
    """What mode j makes of x over a period, and the size of its terms."""
    Phi, Gamma, lag = chain.Phi, chain.Gamma, chain.lag
    for a in range(x.size):
        total = size = 0.0
        for b in range(x.size):
            term = Phi[j, a, b] * x[b]
            total += term
            size += abs(term)
        for p in range(lag.size):
            for b in range(told.shape[1]):
                term = Gamma[j, p, a, b] * told[row - lag[p], b]
                total += term
                size += abs(term)
        result[a] = total
        wide[a] = max(wide[a], size)


@inner_kernel
def _spread_out(chain, bank, i, j, apart, bent):
    """P̄_ij = M P_i Mᵀ + (Δ P_i Δᵀ + d dᵀ)/12 + Q_ij and what the bend leaves, of P_i as of x̂_i."""
    Phi, P, middle, slope, half = chain.Phi, bank.P, bank.spare[0], bank.spare[1], bank.spare[2]
    n, moved, end = apart.size, bank.ahead_P, min(j, chain.noise.shape[1] - 1)
    for a in range(n):
        for b in range(n):
            slope[a, b] = Phi[j, a, b] - Phi[i, a, b] if chain.within else 0.0
            middle[a, b] = Phi[i, a, b] + 0.5 * slope[a, b]
            moved[i, j, a, b] = chain.noise[i, end, a, b] + apart[a] * apart[b] / 12.0
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
    """P = (P + Pᵀ)/2: what round-off tells apart is the same number."""
    for a in range(P.shape[0]):
        for b in range(a):
            P[a, b] = P[b, a] = 0.5 * (P[a, b] + P[b, a])


@inner_kernel
def _correct(form, bank, many, y):
    """log p(y), x̂ and P after y of the first `many` rows of pairs; whether all logs are finite.

    One output after the other, those that are missing left out. Beside its noise each has the
    round-off of its prediction, so that nothing is divided by 0; and of a variance 1e-14 is left,
    as no less is told from round-off.
    """
    C, density, modes = form.C, bank.chain.density, bank.x.shape[0]
    _size_outputs(C, bank, y)
    for i in range(many):
        for j in range(modes):
            density[i, j] = 0.0
            if form.gain.size > 0:
                _copy(bank.pair_x[i, j], bank.ahead_x[i, j])
                _copy(bank.pair_P[i, j].reshape(-1), bank.ahead_P[i, j].reshape(-1))
    for a in range(y.size):
        if not math.isfinite(y[a]):
            continue
        r = form.variance[a] + (ROUND_OFF * bank.size[a]) ** 2
        # Where nothing moves, 0 is what every mode expects.
        if _measure(C, bank, many, a, r):
            for i in range(many):
                for j in range(modes):
                    _correct_by(C[j, a], bank, i, j, y[a], r)
    finite = True
    for i in range(many):
        for j in range(modes):
            finite &= math.isfinite(density[i, j])
            if form.gain.size > 0:
                _observe(form, bank, i, j, y)
    return finite


@inner_kernel
def _size_outputs(C, bank, y):
    """The sizes of what is added up for every output, in the mode in which they are largest."""
    for a in range(y.size):
        bank.size[a] = abs(y[a])
        for j in range(C.shape[0]):
            total = 0.0
            for b in range(C.shape[2]):
                total += abs(C[j, a, b]) * bank.wide[b]
            bank.size[a] = max(bank.size[a], total)


@inner_kernel
def _measure(C, bank, many, a, r):
    """P c and the variance of output a of every pair; whether all of these are above 0."""
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
            there &= spread[i, j] > 0.0
    return there


@inner_kernel
def _correct_by(c, bank, i, j, y, r):
    """One pair by one output of the variance r about cᵀ x, its P in Joseph's form."""
    x, P, half = bank.pair_x[i, j], bank.pair_P[i, j], bank.spare[0]
    toward, s, n = bank.toward[i, j], bank.spread[i, j], c.size
    wrong = y
    for b in range(n):
        wrong -= x[b] * c[b]
    bank.chain.density[i, j] -= 0.5 * (wrong * wrong / s + math.log(s))
    for a in range(n):
        gain = toward[a] / s
        x[a] += gain * wrong
        for b in range(n):
            half[a, b] = P[a, b] - gain * toward[b]
    for a in range(n):
        rest = 0.0
        for b in range(n):
            rest += half[a, b] * c[b]
        for b in range(n):
            half[a, b] += toward[b] / s * (r * (toward[a] / s) - rest)
    for a in range(n):
        left = SPENT * P[a, a]
        for b in range(a + 1):
            P[a, b] = P[b, a] = 0.5 * (half[a, b] + half[b, a])
        P[a, a] += left


@inner_kernel
def _observe(form, bank, i, j, y):
    """A pair by the gains of observers, which need all of y."""
    gain, C, r, x, P = form.gain, form.C, form.variance, bank.pair_x[i, j], bank.pair_P[i, j]
    rest, half, n = bank.spare[0], bank.spare[1], bank.wide.size
    before = bank.ahead_P[i, j]
    _copy(bank.ahead_x[i, j], x)
    _copy(before.reshape(-1), P.reshape(-1))
    for a in range(y.size):
        if not math.isfinite(y[a]):
            return
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
    for c in range(y.size):
        wrong = y[c]
        for b in range(n):
            wrong -= C[j, c, b] * bank.ahead_x[i, j, b]
        for a in range(n):
            x[a] += gain[j, a, c] * wrong


@inner_kernel
def _merge(form, bank):
    """One normal density for each mode, with mean and covariance of those that end in it.

    The part of the belief that is forgotten is spread about x as it is believed to be in all: a
    mode that was ruled out begins there.
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
    _clear(P.reshape(-1))
    for i in range(modes):
        for j in range(modes):
            _add_mean(weight[i, j], bank.pair_x[i, j], x)
    for i in range(modes):
        for j in range(modes):
            _add_spread(weight[i, j], bank.pair_x[i, j], bank.pair_P[i, j], x, P)
    for j in range(modes):
        own = part / modes
        for i in range(modes):
            own += (1.0 - part) * weight[i, j]
        _clear(bank.x[j])
        _clear(bank.P[j].reshape(-1))
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
