"""The compiled steps of a `deadtime.feedback.belief.Belief`.

`advance_belief` is one sample of the filter, whoever runs it: it reads the states at two samples
and the inputs in a line whose last row that matters is the one sent at the first of them.
"""

from __future__ import annotations

import math

from deadtime.numerics.kernels import inner_kernel, kernel

ROUND_OFF = 1e-12  # of the size of what a prediction adds up: residuals below say nothing
SPENT = 1e-14  # of a variance: what is left of it is not told from round-off
CURVED = 8.0 / 15.0  # mean square of a parabola over its span, by its height in the middle
_SMALL, _GREAT = 1e-90, 1e90
_LEAST = 1e-300  # a probability below is none, so that its share cannot overflow


@kernel(eager=True)
def advance_belief(form, state, before, x, told, row):
    """π_k in `state.now`, from π_{k−1}, x_{k−1} `before`, x_k and the inputs, u_{k−1} in row `row`.

    Where a state is not finite, or nothing moves, nothing is learnt: the chain goes on by itself.
    """
    seen = _predict(form, state, before, x, told, row)
    if seen:
        for i in range(form.Phi.shape[0]):
            seen &= _weigh(form, state, before, x, told, row, i)
    move(form, state, seen)


@inner_kernel
def _predict(form, state, before, x, told, row):
    """What each mode makes of the period, and the size of its terms; whether that says anything."""
    # Taken out of their tuples first: in a loop, compiled code would count who holds them.
    Phi, Gamma, lag = form.Phi, form.Gamma, form.lag
    largest, predicted = state.size, state.predicted
    modes, n = Phi.shape[:2]
    m = Gamma.shape[3]
    finite, moving = True, False
    for a in range(n):
        finite &= math.isfinite(x[a]) and math.isfinite(before[a])
        largest[a] = abs(x[a])
    for i in range(modes):
        for a in range(n):
            total = size = 0.0
            for b in range(n):
                term = Phi[i, a, b] * before[b]
                total += term
                size += abs(term)
            for p in range(lag.size):
                for j in range(m):
                    term = Gamma[i, p, a, j] * told[row - lag[p], j]
                    total += term
                    size += abs(term)
            predicted[i, a] = total
            largest[a] = max(largest[a], size)
            finite &= math.isfinite(size)
            moving |= size > 0.0
    return finite and moving


@inner_kernel
def _weigh(form, state, before, x, told, row, i):
    """log p_ij of the periods that begin in mode i, up to a constant; whether they are finite."""
    n, root, white, apart, bent = x.size, state.root, state.white, state.apart, state.bent
    predicted, density = state.predicted, state.density
    finite = True
    for j in range(predicted.shape[0]):
        if j == i or form.within:
            for a in range(n):
                white[a] = x[a] - predicted[i, a]
            bend(form, i, j, before, told, row, bent)
            noise = form.noise[i, min(j, form.noise.shape[1] - 1)]
            size = root_of(noise, state.size, bent, root)
            whiten(root, white)
            if j == i:
                square, wide = 0.0, 1.0
                for a in range(n):
                    square += white[a] * white[a]
            else:
                for a in range(n):
                    apart[a] = predicted[j, a] - predicted[i, a]
                whiten(root, apart)
                square, wide = _between(white, apart)
            density[i, j] = -0.5 * (square + math.log(wide)) - size
            finite &= math.isfinite(density[i, j])
    if not form.within:
        for j in range(predicted.shape[0]):
            density[i, j] = density[i, i]
    return finite


@inner_kernel
def bend(form, i, j, x, told, row, bent):
    """The variance about the line from one prediction to the other that its bend leaves, per state.

    With the change at a share s of the period spent in j, x_{k+1} is off the line by 4 s (1 − s)
    times what it is in the middle, to second order where the same inputs act all period; where one
    arrives within it, x_{k+1} is a broken line, of which this is a measure.
    """
    bend_x, bend_u, lag = form.bend_x, form.bend_u, form.lag
    for a in range(bent.size):
        bent[a] = 0.0
    if i == j or not form.within:
        return
    for a in range(bent.size):
        total = 0.0
        for b in range(bent.size):
            total += bend_x[i, j, a, b] * x[b]
        for p in range(lag.size):
            for b in range(told.shape[1]):
                total += bend_u[i, j, p, a, b] * told[row - lag[p], b]
        bent[a] = CURVED * total * total


@inner_kernel
def root_of(noise, size, more, root):
    """Cholesky's L of the noise, of round-off and of what a bend leaves; Σ log L_aa.

    A row without any of them is left out, with a 0 on the diagonal.
    """
    scale, volume = 0.0, 1.0
    for a in range(size.size):
        own = noise[a, a] + more[a] + (ROUND_OFF * size[a]) ** 2
        for b in range(a + 1):
            rest = own if a == b else noise[a, b]
            for c in range(b):
                rest -= root[a, c] * root[b, c]
            if a == b:
                root[a, a] = math.sqrt(max(rest, SPENT * own))
            else:
                root[a, b] = rest / root[b, b] if root[b, b] > 0.0 else 0.0
        if root[a, a] > 0.0:
            volume *= root[a, a]
        if not _SMALL < volume < _GREAT:  # one logarithm for all, where their product is a number
            scale += math.log(volume)
            volume = 1.0
    return scale + math.log(volume)


@inner_kernel
def whiten(root, vector):
    """vector = L⁻¹ vector, 0 in rows that are left out."""
    for a in range(vector.size):
        rest = vector[a]
        for b in range(a):
            rest -= root[a, b] * vector[b]
        vector[a] = rest / root[a, a] if root[a, a] > 0.0 else 0.0


@inner_kernel
def _between(white, apart):
    """(square, wide) of the density of a whitened residual about a point on its way to `apart`.

    The point is spread evenly. A normal density about the middle, −2 log of which is square +
    log wide, its variance along the way 1 + |d|²/12, d = `apart`: split into along and across
    before squaring, as d may be 1e12 times the noise.
    """
    length = along = 0.0
    for a in range(white.size):
        length += apart[a] * apart[a]
        along += apart[a] * (white[a] - 0.5 * apart[a])
    if length == 0.0:
        square = 0.0
        for a in range(white.size):
            square += white[a] * white[a]
        return square, 1.0
    along /= length
    across = 0.0
    for a in range(white.size):
        across += (white[a] - (0.5 + along) * apart[a]) ** 2
    wide = 1.0 + length / 12.0
    return across + along * along * length / wide, wide


@inner_kernel
def move(form, state, seen):
    """Let the chain go on for a period, weighed by the densities where they say something.

    Of each pair of modes `state.mass` is then the probability before, `state.density` the factor.
    """
    now, mass, hazard, jump, density = state.now, state.mass, form.hazard, form.jump, state.density
    modes, ages = now.shape
    for i in range(modes):
        leave = stay = 0.0
        for a in range(ages):
            leave += hazard[i, a] * now[i, a]
            stay += (1.0 - hazard[i, a]) * now[i, a]
        for j in range(modes):
            mass[i, j] = stay if i == j else leave * jump[i, j]
    _factors(state, seen)
    for i in range(modes):
        factor, last = density[i, i], ages - 1
        kept = (1.0 - hazard[i, last]) * now[i, last]
        for a in range(last, 0, -1):
            now[i, a] = (1.0 - hazard[i, a - 1]) * now[i, a - 1] * factor
        now[i, 0] = 0.0
        now[i, last] += kept * factor
    total = 0.0
    for j in range(modes):
        for i in range(modes):
            if i != j:
                now[j, 0] += mass[i, j] * density[i, j]
        for a in range(ages):
            total += now[j, a]
    for j in range(modes):
        for a in range(ages):
            now[j, a] *= (1.0 - form.forgetting) / total
        now[j, 0] += form.forgetting / modes


@inner_kernel
def _factors(state, seen):
    """density = p over that of the likeliest pair that there may be; 1 where nothing was seen.

    With no probability below 1e-300, what e^−700 is lost of does not count beside the likeliest.
    """
    mass, density = state.mass, state.density
    modes = mass.shape[0]
    top = -math.inf
    for i in range(modes):
        for j in range(modes):
            if seen and mass[i, j] >= _LEAST:
                top = max(top, density[i, j])
    for i in range(modes):
        for j in range(modes):
            factor = 1.0
            if seen and density[i, j] != top:
                factor = 0.0
                if mass[i, j] >= _LEAST:
                    factor = math.exp(density[i, j] - top)
            density[i, j] = factor


@kernel(eager=True)
def share_rows(state):
    """The share of every row of a table: ages past the table's count as its last."""
    now, weight = state.now, state.weight
    modes, ages = now.shape
    rows = weight.size // modes
    for c in range(weight.size):
        weight[c] = 0.0
    for i in range(modes):
        for a in range(ages):
            weight[i * rows + min(a, rows - 1)] += now[i, a]


@kernel
def believe(form, state, k, past, told, measured):
    """The belief at sample k of a run, its shares of the rows and its place in the trace.

    u_k is in row past + k of `told`, and what was seen of x at sample k in row k of `measured`.
    """
    if k > 0:
        advance_belief(form, state, measured[k - 1], measured[k], told, past + k - 1)
    share_rows(state)
    for i in range(state.now.shape[0]):
        total = 0.0
        for a in range(state.now.shape[1]):
            total += state.now[i, a]
        state.trace[k, i] = total
