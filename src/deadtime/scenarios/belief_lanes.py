"""The steps of eight beliefs side by side: `estimation/belief_kernel.py`, the lane last.

Where that takes logarithms, for one factor between 0 and 1 per pair of modes, products of ratios
are taken here. `mind` is `believing.Believed`; a vector is one number of each scenario.
"""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

import math

from deadtime.estimation.belief_kernel import CURVED, ROUND_OFF, SPENT
from deadtime.numerics.kernels import inner_kernel
from deadtime.numerics.lanes import (
    LANES,
    choose,
    exponential,
    first_of,
    larger,
    load,
    quotient,
    same,
    smaller,
    square_root,
    store,
    times,
    where_larger,
)

_ONE, _TWO = (0.0,), (0.0,) * 2
# A probability below is none. The likeliest factor is not 1 here but 1 / volume: with those above
# the 1e-300 of `estimation/belief_kernel.py` it would leave a total that is no number to divide by.
_LEAST = 1e-200


@inner_kernel
def pair(a, b):
    return first_of(a, b, b, _TWO)


@inner_kernel
def _add(a, b):
    return times(same(1.0, _ONE), a, b)


@inner_kernel
def _less(a, b):
    return times(same(-1.0, _ONE), b, a)


@inner_kernel
def _times(a, b):
    return times(a, b, same(0.0, _ONE))


@inner_kernel
def _size(a):
    return larger(a, _less(same(0.0, _ONE), a))


@inner_kernel
def _finite(a):
    """1 where a is finite, else 0."""
    return where_larger(same(1.0, _ONE), _size(_less(a, a)), 1.0, same(0.0, _ONE))


@inner_kernel
def _sent(belief, mind, p, b, m):
    """Input b of the lag p, in the period that ends."""
    length = mind.sent.size // (m * LANES)
    place = mind.latest[0] - belief.lag[p]
    place += length if place < 0 else 0
    return load(mind.sent, (place * m + b) * LANES, _ONE)


@inner_kernel
def predict(belief, mind):
    """What each mode makes of the period, and the size of its terms; 1 where that says anything."""
    Phi, Gamma = belief.Phi, belief.Gamma
    modes, lags, n, m = Gamma.shape
    none, one = same(0.0, _ONE), same(1.0, _ONE)
    finite, moving = one, none
    for a in range(n):
        x = load(mind.x, a * LANES, _ONE)
        finite = smaller(finite, _finite(_add(x, load(mind.before, a * LANES, _ONE))))
        store(mind.size, a * LANES, _size(x))
    for i in range(modes):
        for a in range(n):
            total, size = none, none
            for b in range(n):
                term = _times(same(Phi[i, a, b], _ONE), load(mind.before, b * LANES, _ONE))
                total, size = _add(total, term), _add(size, _size(term))
            for p in range(lags):
                for b in range(m):
                    term = _times(same(Gamma[i, p, a, b], _ONE), _sent(belief, mind, p, b, m))
                    total, size = _add(total, term), _add(size, _size(term))
            store(mind.predicted, (i * n + a) * LANES, total)
            store(mind.size, a * LANES, larger(size, load(mind.size, a * LANES, _ONE)))
            finite, moving = smaller(finite, _finite(size)), larger(size, moving)
    return smaller(finite, where_larger(moving, none, 1.0, none))


@inner_kernel
def _bend(belief, mind, i, j):
    """The variance that the bend between two predictions leaves, into `mind.bent`."""
    bend_x, bend_u = belief.bend_x, belief.bend_u
    _, lags, n, m = belief.Gamma.shape
    for a in range(n):
        total = same(0.0, _ONE)
        if i != j:
            for b in range(n):
                before = load(mind.before, b * LANES, _ONE)
                total = times(same(bend_x[i, j, a, b], _ONE), before, total)
            for p in range(lags):
                for b in range(m):
                    u = _sent(belief, mind, p, b, m)
                    total = times(same(bend_u[i, j, p, a, b], _ONE), u, total)
        store(mind.bent, a * LANES, _times(_times(same(CURVED, _ONE), total), total))


@inner_kernel
def _root_of(belief, mind, i, j, first):
    """Cholesky's L of a pair's noise; its volume over that of the first pair."""
    none, one, n = same(0.0, _ONE), same(1.0, _ONE), belief.Phi.shape[1]
    noise, root, ratio = belief.noise, mind.root, one
    end = min(j, noise.shape[1] - 1)
    for a in range(n):
        off = _times(same(ROUND_OFF, _ONE), load(mind.size, a * LANES, _ONE))
        own = _add(same(noise[i, end, a, a], _ONE), load(mind.bent, a * LANES, _ONE))
        own = times(off, off, own)
        for b in range(a + 1):
            rest = own if a == b else same(noise[i, end, a, b], _ONE)
            for c in range(b):
                left = load(root, (a * n + c) * LANES, _ONE)
                rest = _less(rest, _times(left, load(root, (b * n + c) * LANES, _ONE)))
            if a == b:
                rest = square_root(larger(rest, _times(same(SPENT, _ONE), own)))
            else:
                rest = _share_of(rest, load(root, (b * n + b) * LANES, _ONE), none)
            store(root, (a * n + b) * LANES, rest)
        rest = load(root, (a * n + a) * LANES, _ONE)
        place = (n * n + a) * LANES
        if first:
            store(root, place, rest)
        else:
            ratio = _times(ratio, quotient(_or_one(rest), _or_one(load(root, place, _ONE))))
    return ratio


@inner_kernel
def _share_of(a, b, other):
    """a / b, or something else where b is not above 0."""
    there = where_larger(b, same(0.0, _ONE), 1.0, same(0.0, _ONE))
    return choose(pair(other, quotient(a, b)), there, _ONE)


@inner_kernel
def _or_one(a):
    """a, or the 1 of a row that is left out."""
    one = same(1.0, _ONE)
    return choose(pair(one, a), where_larger(a, same(0.0, _ONE), 1.0, same(0.0, _ONE)), _ONE)


@inner_kernel
def _whiten(mind, vector, n):
    """vector = L⁻¹ vector, 0 in rows that are left out."""
    for a in range(n):
        rest = load(vector, a * LANES, _ONE)
        for b in range(a):
            left = load(mind.root, (a * n + b) * LANES, _ONE)
            rest = _less(rest, _times(left, load(vector, b * LANES, _ONE)))
        diagonal = load(mind.root, (a * n + a) * LANES, _ONE)
        store(vector, a * LANES, _share_of(rest, diagonal, same(0.0, _ONE)))


@inner_kernel
def weigh(belief, mind, i, j):
    """The exponent and the volume of p_ij: p is e^(−square/2) / volume, up to a factor."""
    none, n, modes = same(0.0, _ONE), belief.Phi.shape[1], belief.Phi.shape[0]
    _bend(belief, mind, i, j)
    volume = _root_of(belief, mind, i, j, i == 0 and j == 0)
    for a in range(n):
        own = load(mind.predicted, (i * n + a) * LANES, _ONE)
        store(mind.white, a * LANES, _less(load(mind.x, a * LANES, _ONE), own))
        apart = _less(load(mind.predicted, (j * n + a) * LANES, _ONE), own)
        store(mind.apart, a * LANES, apart)
    _whiten(mind, mind.white, n)
    if i != j:
        _whiten(mind, mind.apart, n)
    length, along, square = none, none, none
    for a in range(n):
        white, apart = load(mind.white, a * LANES, _ONE), load(mind.apart, a * LANES, _ONE)
        if i != j:
            length = times(apart, apart, length)
            along = times(apart, times(same(-0.5, _ONE), apart, white), along)
    wide = times(same(1.0 / 12.0, _ONE), length, same(1.0, _ONE))
    along = _share_of(along, length, none)
    for a in range(n):
        white, apart = load(mind.white, a * LANES, _ONE), load(mind.apart, a * LANES, _ONE)
        if i != j:
            white = _less(white, _times(_add(along, _half(length)), apart))
        square = times(white, white, square)
    square = _add(square, quotient(_times(_times(along, along), length), wide))
    store(mind.square, (i * modes + j) * LANES, square)
    store(mind.volume, (i * modes + j) * LANES, _times(volume, square_root(wide)))


@inner_kernel
def _half(length):
    """½, or 0 where two predictions are the same."""
    return where_larger(length, same(0.0, _ONE), 0.5, same(0.0, _ONE))


@inner_kernel
def _factors(belief, mind, seen):
    """p of every pair into `mind.density`, 1 where nothing was seen, or p is no number."""
    modes, none, least = belief.Phi.shape[0], same(0.0, _ONE), same(math.inf, _ONE)
    for i in range(modes):
        for j in range(modes):
            at, own = (i * modes + j) * LANES, (i * modes + (j if belief.within else i)) * LANES
            square = load(mind.square, own, _ONE)
            seen = smaller(seen, _finite(_add(square, load(mind.volume, own, _ONE))))
            there = where_larger(load(mind.mass, at, _ONE), same(_LEAST, _ONE), 1.0, none)
            least = choose(pair(least, smaller(square, least)), there, _ONE)
    for i in range(modes):
        for j in range(modes):
            at, own = (i * modes + j) * LANES, (i * modes + (j if belief.within else i)) * LANES
            there = where_larger(load(mind.mass, at, _ONE), same(_LEAST, _ONE), 1.0, none)
            off = _times(same(-0.5, _ONE), _less(load(mind.square, own, _ONE), least))
            p = quotient(exponential(off), load(mind.volume, own, _ONE))
            p = choose(pair(none, p), there, _ONE)
            store(mind.density, at, choose(pair(same(1.0, _ONE), p), seen, _ONE))


@inner_kernel
def move(belief, mind, seen):
    """Let the chains go on for a period, weighed by the densities where they say something."""
    hazard, jump, chain = belief.hazard, belief.jump, mind.chain
    modes, ages = hazard.shape
    last, none = ages - 1, same(0.0, _ONE)
    for i in range(modes):
        leave, stay = none, none
        for a in range(ages):
            part = load(chain, (i * ages + a) * LANES, _ONE)
            leave = times(same(hazard[i, a], _ONE), part, leave)
            stay = times(same(1.0 - hazard[i, a], _ONE), part, stay)
        for j in range(modes):
            mass = stay if i == j else _times(same(jump[i, j], _ONE), leave)
            store(mind.mass, (i * modes + j) * LANES, mass)
    _factors(belief, mind, seen)
    total = none
    for i in range(modes):
        factor = load(mind.density, (i * modes + i) * LANES, _ONE)
        keeps = same(1.0 - hazard[i, last], _ONE)
        kept = _times(_times(keeps, load(chain, (i * ages + last) * LANES, _ONE)), factor)
        for a in range(last, 0, -1):
            part = load(chain, (i * ages + a - 1) * LANES, _ONE)
            part = _times(_times(same(1.0 - hazard[i, a - 1], _ONE), part), factor)
            store(chain, (i * ages + a) * LANES, part)
            total = _add(total, part)
        store(chain, i * ages * LANES, none)
        older = _add(load(chain, (i * ages + last) * LANES, _ONE), kept)
        store(chain, (i * ages + last) * LANES, older)
        total = _add(total, kept)
    for j in range(modes):
        young = load(chain, j * ages * LANES, _ONE)
        for i in range(modes):
            if i != j:
                at = (i * modes + j) * LANES
                part = _times(load(mind.mass, at, _ONE), load(mind.density, at, _ONE))
                young, total = _add(young, part), _add(total, part)
        store(chain, j * ages * LANES, young)
    share = quotient(same(1.0 - belief.forgetting, _ONE), larger(total, same(1e-300, _ONE)))
    for j in range(modes):
        for a in range(ages):
            part = _times(load(chain, (j * ages + a) * LANES, _ONE), share)
            if a == 0:
                part = _add(part, same(belief.forgetting / modes, _ONE))
            store(chain, (j * ages + a) * LANES, part)


@inner_kernel
def share_rows(mind, modes, ages):
    """The shares of the rows: ages past the table's count as its last."""
    rows = mind.share.size // LANES
    for c in range(rows):
        store(mind.share, c * LANES, same(0.0, _ONE))
    for i in range(modes):
        for a in range(ages):
            at = (i * (rows // modes) + min(a, rows // modes - 1)) * LANES
            part = load(mind.chain, (i * ages + a) * LANES, _ONE)
            store(mind.share, at, _add(load(mind.share, at, _ONE), part))
