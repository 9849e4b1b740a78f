"""The steps of a `deadtime.feedback.belief.Belief`, for one scenario or for eight side by side.

`advance_belief` is one sample of the filter, in single runs, batches and controllers. It reads the
states at two samples and a ring of inputs, u_{k−1} in row `row` and the input before in the row
before. A number of these arrays is a float, or a vector of eight scenarios
(`deadtime.numerics.numbers`); numbers of the form are floats. What differs between scenarios is
`where(condition, a, b)`, as a branch would be taken for all eight.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.feedback.belief import Belief
from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.numbers import arrays_of, exponent, mantissa, ratio, where

ROUND_OFF = 1e-12  # of the terms of a prediction: smaller residuals are round-off
SPENT = 1e-14  # of a variance: a smaller rest is round-off
CURVED = 8.0 / 15.0  # mean square of a parabola over its span, in squares of its height
_LEAST = 1e-300  # a smaller probability counts as 0, so that its share cannot overflow
_LOG_2 = math.log(2.0)
NORMAL = 2.0**-1022  # a smaller variance is denormal: it has lost digits, its inverse overflows


class BeliefState(NamedTuple):
    """The state of a belief, and scratch arrays.

    now : (modes, ages), π_k
    weight : (rows,), the share of every row of the law's table
    density : (modes, modes), log p_ij of the period that ended, up to one constant
    mass : (modes, modes), the probability of each pair before x_k
    sent : (lags, m), the inputs that act in that period
    predicted : (modes, n), apart : (n,), size : (n,), root : (n, n), white : (n,), bent : (n,)
    """

    now: Float[np.ndarray, "mode age ..."]
    weight: Float[np.ndarray, "row ..."]
    density: Float[np.ndarray, "mode mode ..."]
    mass: Float[np.ndarray, "mode mode ..."]
    sent: Float[np.ndarray, "lag m ..."]
    predicted: Float[np.ndarray, "mode n ..."]
    apart: Float[np.ndarray, "n ..."]
    size: Float[np.ndarray, "n ..."]
    root: Float[np.ndarray, "n n ..."]
    white: Float[np.ndarray, "n ..."]
    bent: Float[np.ndarray, "n ..."]

    @classmethod
    def of(cls, belief: Belief, rows: int, *lanes: int) -> BeliefState:
        """The state at time 0 for a table of `rows`; `lanes`: scenarios side by side, if any."""
        modes, lags, n, m = belief.Gamma.shape
        pairs, vector = (modes, modes), (n,)
        shapes = belief.start.shape, (rows,), pairs, pairs, (lags, m), (modes, n)
        state = cls(*arrays_of(*shapes, vector, vector, (n, n), vector, vector, lanes=lanes))
        state.now.T[:] = belief.start.T
        return state


@kernel(eager=True, forceinline=True)
def advance_belief(form, state, before, x, known_inputs, row):
    """π_k in `state.now`, from π_{k−1}, x_{k−1} `before`, x_k and the inputs, u_{k−1} in row `row`.

    Where a state is not finite, or all predictions are 0, the chain is only predicted.
    """
    gather(form.lag, form.lag.size, known_inputs.shape[1], state.sent, known_inputs, row)
    seen = _predict(form, state, before, x)
    for i in range(form.Phi.shape[0]):
        seen = seen & _weigh(form, state, before, x, i)
    move(form, state, seen)


@inner_kernel
def begin_belief(form, state):
    """π_0."""
    for i in range(form.start.shape[0]):
        for a in range(form.start.shape[1]):
            state.now[i, a] = form.start[i, a]


@inner_kernel
def gather(lag, lags, m, sent, known_inputs, row):
    """The inputs that act in the period that ended, out of their ring."""
    for p in range(lags):
        # A lag beyond the ring reaches before time 0: row + 1, the next to be written, still holds
        # the value from there.
        place = row - min(lag[p], known_inputs.shape[0] - 1)
        if place < 0:
            place += known_inputs.shape[0]
        for b in range(m):
            sent[p, b] = known_inputs[place, b]


@inner_kernel
def _predict(form, state, before, x):
    """Predictions of each mode and the size of their terms; whether they are finite and not 0."""
    # Out of their tuples before the loop, in which compiled code would count references to them.
    Phi, Gamma, sent = form.Phi, form.Gamma, state.sent
    largest, predicted = state.size, state.predicted
    modes, lags, n, m = Gamma.shape
    finite, moving = True, 0.0
    for a in range(n):
        finite = finite & math.isfinite(x[a] + before[a])
        largest[a] = abs(x[a])
    for i in range(modes):
        for a in range(n):
            total = size = 0.0
            for b in range(n):
                term = Phi[i, a, b] * before[b]
                total += term
                size += abs(term)
            for p in range(lags):
                for j in range(m):
                    term = Gamma[i, p, a, j] * sent[p, j]
                    total += term
                    size += abs(term)
            predicted[i, a] = total
            largest[a] = max(largest[a], size)
            finite = finite & math.isfinite(size)
            moving = max(moving, size)
    return finite & (moving > 0.0)


@inner_kernel
def _weigh(form, state, before, x, i):
    """log p_ij of the periods that begin in mode i, up to a constant; whether they are finite."""
    n, root, white, apart, bent = x.size, state.root, state.white, state.apart, state.bent
    predicted, density = state.predicted, state.density
    finite = True
    for j in range(predicted.shape[0]):
        if j == i or form.within:
            for a in range(n):
                white[a] = x[a] - predicted[i, a]
            bend(form, i, j, before, state.sent, bent)
            noise = form.noise[i, min(j, form.noise.shape[1] - 1)]
            volume, doublings = factor(noise, state.size, bent, root)
            eliminate(root, white)
            square = 0.0
            if j == i:
                for a in range(n):
                    square += white[a] * root[a, a] * white[a]
            else:
                for a in range(n):
                    apart[a] = predicted[j, a] - predicted[i, a]
                eliminate(root, apart)
                square, wide = _between(root, white, apart)
                volume *= wide
            density[i, j] = -0.5 * (square + math.log(volume) + doublings * _LOG_2)
            finite = finite & math.isfinite(density[i, j])
    if not form.within:
        # A switch at the sample does not change the period that ended.
        for j in range(predicted.shape[0]):
            density[i, j] = density[i, i]
    return finite


@inner_kernel
def bend(form, i, j, x, sent, bent):
    """The variance of x_k about the line between two predictions, due to its bend, per state.

    If a share s of the period is spent in j, x_k is off the line by 4 s (1 − s) times its distance
    in the middle: to second order if the same inputs act all period. If an input arrives within it,
    x_k is a broken line, of which this is a measure.
    """
    bend_x, bend_u = form.bend_x, form.bend_u
    for a in range(bent.size):
        bent[a] = 0.0
    if i == j or not form.within:
        return
    for a in range(bent.size):
        total = 0.0
        for b in range(bent.size):
            total += bend_x[i, j, a, b] * x[b]
        for p in range(sent.shape[0]):
            for b in range(sent.shape[1]):
                total += bend_u[i, j, p, a, b] * sent[p, b]
        bent[a] = CURVED * total * total


@inner_kernel
def factor(noise, size, more, root):
    """L D Lᵀ of the covariances of noise, round-off and bend; det D = v 2^e as (v, e).

    L has ones on its diagonal, where 1/D is stored: 0 for a row without variance, which does not
    count.
    """
    volume, doublings = 1.0, 0.0
    for a in range(size.size):
        off = ROUND_OFF * size[a]
        own = noise[a, a] + more[a] + off * off
        rest = own
        for b in range(a):
            part = noise[a, b]
            for c in range(b):
                part -= root[a, c] * root[b, c]
            root[a, b] = part  # L_ab D_b, until the row is done
        for b in range(a):
            unit = root[a, b] * root[b, b]
            rest -= unit * root[a, b]
            root[a, b] = unit
        rest = max(rest, SPENT * own)
        rest = where(rest >= NORMAL, rest, 0.0)
        root[a, a] = ratio(1.0, rest)
        # One logarithm for all: the product's exponent is taken out before it can overflow.
        volume *= where(rest > 0.0, rest, 1.0)
        doublings += where(math.isfinite(volume), exponent(volume), math.inf)
        volume = mantissa(volume)
    return volume, doublings


@inner_kernel
def eliminate(root, vector):
    """vector = L⁻¹ vector, so that its quadratic form is Σ vector_a² / D_a."""
    for a in range(vector.size):
        rest = vector[a]
        for b in range(a):
            rest -= root[a, b] * vector[b]
        vector[a] = rest


@inner_kernel
def _between(root, white, apart):
    """(square, wide), −2 log density = square + log wide, for a mean uniform on 0 … `apart`.

    A normal density about the middle, with variance 1 + |d|²/12 along d = `apart` and 1 across, in
    units of the noise. Split into along and across before squaring, as d may be 1e12 times the
    noise.
    """
    length = along = across = 0.0
    for a in range(white.size):
        length += apart[a] * root[a, a] * apart[a]
        along += apart[a] * root[a, a] * (white[a] - 0.5 * apart[a])
    along = ratio(along, length)
    for a in range(white.size):
        off = white[a] - (0.5 + along) * apart[a]
        across += off * root[a, a] * off
    wide = 1.0 + length * (1.0 / 12.0)
    return across + along * along * length / wide, wide


@inner_kernel
def move(form, state, seen):
    """Advance the chain by a period, and weigh it by the densities in scenarios that are `seen`.

    Afterwards `state.mass` is the probability of each pair before, `state.density` its factor.
    """
    now, mass, hazard, jump, density = state.now, state.mass, form.hazard, form.jump, state.density
    modes, ages = now.shape
    for i in range(modes):
        leave = stay = 0.0
        for a in range(ages):
            leave += hazard[i, a] * now[i, a]
            stay += (1.0 - hazard[i, a]) * now[i, a]
        for j in range(modes):
            mass[i, j] = leave * jump[i, j]
        mass[i, i] = stay
    _factors(state, seen)
    total = 0.0
    for i in range(modes):
        factor, last = density[i, i], ages - 1
        kept = (1.0 - hazard[i, last]) * now[i, last] * factor
        total += kept
        # From the oldest age down, so that each is read before the next younger one moves into it.
        for a in range(last, 0, -1):
            part = (1.0 - hazard[i, a - 1]) * now[i, a - 1] * factor
            now[i, a] = part
            total += part
        now[i, 0] = 0.0
        now[i, last] += kept
    for j in range(modes):
        young = 0.0
        for i in range(modes):
            if i != j:
                young += mass[i, j] * density[i, j]
        now[j, 0] += young
        total += young
    share = (1.0 - form.forgetting) / total
    for j in range(modes):
        for a in range(ages):
            now[j, a] *= share
        now[j, 0] += form.forgetting / modes


@inner_kernel
def _factors(state, seen):
    """density = p over the largest p of possible pairs; 1 in scenarios that are not `seen`.

    Probabilities are at least 1e-300: factors that underflow, e^−700, do not count beside the
    largest.
    """
    mass, density = state.mass, state.density
    modes = mass.shape[0]
    top = -math.inf
    for i in range(modes):
        for j in range(modes):
            top = where((mass[i, j] >= _LEAST) & (density[i, j] > top), density[i, j], top)
    for i in range(modes):
        for j in range(modes):
            factor = math.exp(min(density[i, j] - top, 0.0))
            factor = where(mass[i, j] >= _LEAST, factor, 0.0)
            density[i, j] = where(seen, factor, 1.0)


@kernel(eager=True, forceinline=True)
def share_rows(state):
    """The share of every row of a table; ages beyond the table's count as its last."""
    now, weight = state.now, state.weight
    modes, ages = now.shape
    rows = weight.size // modes
    for c in range(weight.size):
        weight[c] = 0.0
    for i in range(modes):
        for a in range(ages):
            weight[i * rows + min(a, rows - 1)] += now[i, a]


@kernel
def run_belief(form, state, k, past, known_inputs, measured, trace):
    """The belief at sample k of a run, the shares of the rows, and π_k over modes in the trace.

    u_k is in row past + k of `known_inputs`, the measurement of sample k in row k of `measured`.
    """
    if k > 0:
        advance_belief(form, state, measured[k - 1], measured[k], known_inputs, past + k - 1)
    share_rows(state)
    for i in range(state.now.shape[0]):
        total = 0.0
        for a in range(state.now.shape[1]):
            total += state.now[i, a]
        trace[k, i] = total
