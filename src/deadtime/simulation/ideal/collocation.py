"""The ideal loop by collocation, segment by segment, under a law that is a `Functional`.

Time is cut into segments on which everything is analytic. On a segment [a, b] in mode σ

    dx/dt = A_σ x + B_σ u(t − D),

whose input lies in the past (each input has its own delay in mode σ); predictions obey such an
equation, too. Both are solved by variation of constants,

    y(t) = e^{A(t−a)} (y(a) + ∫_a^t e^{−A(θ−a)} f(θ) dθ),

with the integral from a to each Gauss node by collocation; segments are so short that e^{−A(θ−a)}
loses no digits. The unknowns are u at the nodes, which solve a linear system.

A law that is a `Functional` has windows on the past inputs,

    u(t) = F_c x(t) + Σ_p C_c,p y_p(t),    y_p(t) = ∫ e^{S_p (τ − α_p)} R_p u(t − τ) dτ, α_p to β_p,

c the row that applies on a segment [a, b]. There x is solved first, as above. Every
y_p(a) is summed afresh over the inputs sent from a − β_p to a − α_p, so that nothing drifts from
segment to segment, and then

    dy_p/dt = S_p y_p + R_p u(t − α_p) − e^{S_p (β_p − α_p)} R_p u(t − β_p).

The last two inputs are known, as segments are shorter than α_p > 0; where α_p = 0 the first one is
u at the nodes, the unknown.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.base.checks import read_only
from deadtime.feedback import Functional
from deadtime.numerics.exponential import discretise, product
from deadtime.numerics.kernels import kernel
from deadtime.simulation.loop_arrays import LIMIT

_SAME = 1e-15  # of the run's length: segments whose lengths differ by less share their flows


@kernel(eager=True)
def locate(edges, t, hint):
    """The segment that holds t: edges[i] ≤ t < edges[i + 1]."""
    i = min(max(hint, 0), edges.size - 2)
    while i > 0 and t < edges[i]:
        i -= 1
    while i < edges.size - 2 and t >= edges[i + 1]:
        i += 1
    return i


@kernel(eager=True)
def interpolate(values, segment, support, barycentric, c, result, k):
    """Row k of result: the polynomial through values[segment] (nodes, columns) at c ∈ [0, 1]."""
    columns, total = values.shape[2], 0.0
    for i in range(columns):
        result[k, i] = 0.0
    for j in range(support.size):
        difference = c - support[j]
        # At a node its barycentric weight is infinite: the value there is the result.
        if difference == 0.0:
            for i in range(columns):
                result[k, i] = values[segment, j, i]
            return
        weight = barycentric[j] / difference
        total += weight
        for i in range(columns):
            result[k, i] += weight * values[segment, j, i]
    for i in range(columns):
        result[k, i] /= total


@kernel(eager=True)
def sample(edges, values, support, barycentric, times, hint):
    """A segmented function at increasing times, (T, k)."""
    result = np.empty((times.size, values.shape[2]))
    i = hint
    for k in range(times.size):
        i = locate(edges, times[k], i)
        c = (times[k] - edges[i]) / (edges[i + 1] - edges[i])
        interpolate(values, i, support, barycentric, min(max(c, 0.0), 1.0), result, k)
    return result


@kernel(eager=True)
def arrivals(line, delays, times, nodes, hint):
    """The inputs that act in a mode at increasing times, u_j(t − D_j), (T, m)."""
    edges, inputs = line.edges, line.inputs
    known = inputs, nodes.support, nodes.barycentric
    result = sample(edges, *known, times - delays[0], hint)
    for j in range(1, delays.size):
        # `sample` gives all columns: inputs as late as the first one have theirs already.
        if delays[j] != delays[0]:
            other = sample(edges, *known, times - delays[j], hint)
            for k in range(times.size):
                result[k, j] = other[k, j]
    return result


@kernel(eager=True)
def add_product(M, x, result):
    """result += M x, for small matrices."""
    for i in range(M.shape[0]):
        for j in range(M.shape[1]):
            result[i] += M[i, j] * x[j]


@kernel(eager=True)
def flows(A, length, points, forward, backward):
    """e^{A c length} into `forward` (points + 1, n, n), at the points c ∈ [0, 1] and at 1.

    `backward` (points, n, n) gets e^{−A c length}, unless it is empty. On a short segment one
    Taylor series serves all points and both signs.
    """
    n, p, back = A.shape[0], points.size, backward.shape[0]
    size = 0.0
    for i in range(n):
        row = 0.0
        for j in range(n):
            row += abs(A[i, j] * length)
        size = max(size, row)
    # Here e^{−A c} by a series would lose digits to cancellation.
    if size > 3.0:
        none = np.zeros((n, 1))
        for k in range(p + 1):
            forward[k], _ = discretise(A, none, (points[k] if k < p else 1.0) * length)
        for k in range(back):
            backward[k], _ = discretise(A, none, -points[k] * length)
        return
    term, following, power = np.eye(n), np.empty((n, n)), np.ones(p + 1)
    for k in range(p + 1):
        for i in range(n):
            for j in range(n):
                forward[k, i, j] = term[i, j]
                if k < back:
                    backward[k, i, j] = term[i, j]
    bound, order, sign = 1.0, 0, 1.0
    while bound > 1e-18:
        order += 1
        sign = -sign
        product(A, term, following)
        bound *= size / order
        for i in range(n):
            for j in range(n):
                term[i, j] = following[i, j] * (length / order)
        for k in range(p + 1):
            power[k] *= points[k] if k < p else 1.0
            for i in range(n):
                for j in range(n):
                    added = power[k] * term[i, j]
                    forward[k, i, j] += added
                    if k < back:
                        backward[k, i, j] += sign * added


class Flows(NamedTuple):
    """e^{A c} and e^{−A c} of systems over a segment, at its nodes; the first also at its end.

    forward : (systems, p + 1, n, n);  backward : (systems, p, n, n)
    length : (systems,), the segment's, −1 at first
    """

    forward: np.ndarray
    backward: np.ndarray
    length: np.ndarray


@kernel(eager=True)
def flows_of(systems, p, n):
    """Room for the flows of so many systems."""
    forward, backward = np.empty((systems, p + 1, n, n)), np.empty((systems, p, n, n))
    return Flows(forward, backward, np.full(systems, -1.0))


@kernel(eager=True)
def renew(flow, s, A, length, points, horizon):
    """The flows of a system over a segment, where it is not as long as the one before."""
    if abs(length - flow.length[s]) > _SAME * horizon:
        flows(A, length, points, flow.forward[s], flow.backward[s])
        flow.length[s] = length


@kernel(eager=True)
def convolve(flow, B, length, weights, u, total):
    """total += ∫ e^{A(b − θ)} B u(θ) dθ over a segment [a, b], u at its nodes, flow its `flows`."""
    n, p = B.shape[0], weights.size
    forced = np.empty(n)
    for k in range(p):
        for i in range(n):
            forced[i] = 0.0
            for j in range(B.shape[1]):
                forced[i] += B[i, j] * u[k, j] * (weights[k] * length)
        # The nodes are symmetric: b − t_k is the node p − 1 − k after a.
        add_product(flow[p - 1 - k], forced, total)


@kernel(eager=True)
def solve_state(forward, backward, B, x, delayed, length, nodes, states):
    """x at the support nodes of a segment that starts at x, under the delayed inputs (p, m)."""
    p, n = delayed.shape[0], x.size
    undone, forced = np.zeros((p, n)), np.empty(n)
    for k in range(p):
        for i in range(n):
            forced[i] = 0.0
        add_product(B, delayed[k], forced)
        add_product(backward[k], forced, undone[k])
    states[0] = x
    vary(forward, x, undone, length, nodes, states[1:])


@kernel(eager=True)
def solve_alone(A, B, x, u, length, nodes):
    """`solve_state` with flows that no other segment needs: (p + 2, n), u at the nodes (p, m)."""
    p, n = u.shape[0], x.size
    forward, backward = np.empty((p + 1, n, n)), np.empty((p, n, n))
    flows(A, length, nodes.points, forward, backward)
    states = np.empty((p + 2, n))
    solve_state(forward, backward, B, x, u, length, nodes, states)
    return states


@kernel(eager=True)
def vary(forward, start, undone, length, nodes, result):
    """e^{A(t−a)} (start + ∫_a^t undone) at the nodes and at the end (p + 1, n)."""
    p, n = undone.shape
    y = np.empty(n)
    for k in range(p + 1):
        for i in range(n):
            y[i] = start[i]
        for j in range(p):
            factor = length * (nodes.integral[k, j] if k < p else nodes.weights[j])
            for i in range(n):
                y[i] += factor * undone[j, i]
        for i in range(n):
            result[k, i] = 0.0
        add_product(forward[k], y, result[k])


@kernel(eager=True)
def add_branch(forward, backward, B, K, start, shift, length, nodes, matrix, right):
    """Add a branch to the system matrix u = right for u at the nodes.

    `shift` (p, n) is M_b(a) e^{−A_f(t−a)} r_b at the nodes, which e^{A_e(t−a)} takes into P_b.
    """
    p, n = shift.shape
    m = B.shape[1]
    free = np.empty((p + 1, n))
    vary(forward, start, shift, length, nodes, free)
    ahead, behind = np.zeros((p * m, n)), np.zeros((n, p * m))
    for k in range(p):
        for i in range(m):
            for a in range(n):
                right[k * m + i] += K[i, a] * free[k, a]
                for b in range(n):
                    ahead[k * m + i, b] += K[i, a] * forward[k, a, b]
                    behind[b, k * m + i] += backward[k, b, a] * B[a, i]
    for row in range(p * m):
        for column in range(p * m):
            total = 0.0
            for a in range(n):
                total += ahead[row, a] * behind[a, column]
            matrix[row, column] -= length * nodes.integral[row // m, column // m] * total


@kernel(eager=True)
def end_branch(forward, backward, B, start, shift, length, nodes, u, last):
    """P_b at the end of a segment, u at its nodes (p, m) known."""
    p, n = shift.shape
    forced, y = np.empty(n), start.copy()
    for k in range(p):
        factor = length * nodes.weights[k]
        for i in range(n):
            forced[i] = 0.0
        add_product(B, u[k], forced)
        for i in range(n):
            y[i] += factor * shift[k, i]
            for j in range(n):
                y[i] += factor * backward[k, i, j] * forced[j]
    for i in range(n):
        last[i] = 0.0
    add_product(forward[p], y, last)


@kernel(eager=True)
def hand_on(last, x):
    """Copy the last state of a segment into x; whether it is within the limit."""
    inside = True
    for j in range(x.size):
        x[j] = last[j]
        inside &= abs(x[j]) <= LIMIT
    return inside


class Windows(NamedTuple):
    """A `Functional` for the compiled march.

    leaving : e^{S (β − α)} R;  sought : R where α = 0, else 0;  row : (segments,) of F and C
    """

    F: np.ndarray
    C: np.ndarray
    S: np.ndarray
    R: np.ndarray
    near: np.ndarray
    far: np.ndarray
    leaving: np.ndarray
    sought: np.ndarray
    row: np.ndarray


@kernel(eager=True)
def _window_sum(line, law, p, g, whole, moved, nodes, y):
    """y_p at the start of segment g, into y."""
    edges, n = line.edges, y.size
    low, high = edges[g] - law.far[p], edges[g] - law.near[p]
    flow, u = np.empty((nodes.points.size + 1, n, n)), np.empty((nodes.points.size, law.R.shape[2]))
    following = np.empty(n)
    for i in range(n):
        y[i] = 0.0
    for q in range(locate(edges, low, 0 if g < 1 else g - 1), g):
        if edges[q] >= high:
            break
        start, end, length = max(edges[q], low), min(edges[q + 1], high), edges[q + 1] - edges[q]
        if start == edges[q] and end == edges[q + 1]:
            for i in range(n):
                following[i] = moved[q, p, i]
            add_product(whole[q, p], y, following)
        else:
            flows(law.S[p], end - start, nodes.points, flow, np.empty((0, n, n)))
            for k in range(nodes.points.size):
                c = (start + nodes.points[k] * (end - start) - edges[q]) / length
                interpolate(
                    line.inputs, q, nodes.support, nodes.barycentric, min(max(c, 0.0), 1.0), u, k
                )
            for i in range(n):
                following[i] = 0.0
            add_product(flow[nodes.points.size], y, following)
            convolve(flow, law.R[p], end - start, nodes.weights, u, following)
        for i in range(n):
            y[i] = following[i]


@kernel(eager=True)
def _shift(line, law, p, times, backward, nodes, hint, result):
    """e^{−S (t − a)} times the known terms of dy_p/dt, at the nodes of a segment."""
    count, n = result.shape
    known = line.inputs, nodes.support, nodes.barycentric
    leaving = sample(line.edges, *known, times - law.far[p], hint)
    entering = leaving if law.near[p] == 0.0 else sample(
        line.edges, *known, times - law.near[p], hint
    )  # fmt: skip
    change = np.empty(n)
    for k in range(count):
        for a in range(n):
            change[a] = result[k, a] = 0.0
            for j in range(leaving.shape[1]):
                change[a] -= law.leaving[p, a, j] * leaving[k, j]
                if law.near[p] > 0.0:
                    change[a] += law.R[p, a, j] * entering[k, j]
        add_product(backward[k], change, result[k])


@kernel(eager=True)
def _solve_input(law, F, C, states, starts, shifts, forward, backward, length, nodes, inputs):
    """u at the support nodes of a segment, x there known; F and C of its row."""
    windows, p, n = shifts.shape
    m = inputs.shape[1]
    matrix, right = np.eye(p * m), np.zeros(p * m)
    for k in range(p):
        add_product(F, states[k + 1], right[k * m : (k + 1) * m])
    for w in range(windows):
        add_branch(
            forward[w], backward[w], law.sought[w], C[w], starts[w], shifts[w], length, nodes,
            matrix, right,
        )  # fmt: skip
    u = np.linalg.solve(matrix, right).reshape(p, m)
    for i in range(m):
        inputs[0, i] = inputs[p + 1, i] = 0.0
        for k in range(p):
            inputs[k + 1, i] = u[k, i]
    # No node lies at the ends: there the law itself is evaluated, not the polynomial.
    add_product(F, states[0], inputs[0])
    add_product(F, states[p + 1], inputs[p + 1])
    last = np.empty(n)
    for w in range(windows):
        end_branch(
            forward[w], backward[w], law.sought[w], starts[w], shifts[w], length, nodes, u, last
        )
        add_product(C[w], starts[w], inputs[0])
        add_product(C[w], last, inputs[p + 1])


@kernel(eager=True)
def march_windows(plant, line, law, x0, nodes):
    """Solve x on the segments from `begin` on, and u on those before segment `stop`.

    `plant` and `line` are `SegmentPlant` and `Segments` of `ideal_run`, `nodes` Gauss's.
    line.inputs (segments, p + 2, m) holds the history and receives u. Returns x
    (segments, p + 2, n) and the number of segments solved before |x| left the limit.
    """
    edges, points, n, q = line.edges, nodes.points, x0.size, law.S.shape[1]
    segments, p, windows = edges.size - 1, points.size, law.near.size
    states, x = np.zeros((segments, p + 2, n)), x0.copy()
    whole, moved = np.zeros((segments, windows, q, q)), np.zeros((segments, windows, q))
    own, flow = flows_of(plant.A.shape[0], p, n), flows_of(windows, p, q)
    forward, backward, end = flow.forward, flow.backward, edges[segments]
    starts, shifts = np.empty((windows, q)), np.empty((windows, p, q))
    for g in range(segments):
        length = edges[g + 1] - edges[g]
        if g < line.stop:
            for w in range(windows):
                renew(flow, w, law.S[w], length, points, end)
                # Of the history, too: the first windows reach back into it.
                whole[g, w] = forward[w, p]
        if g >= line.begin:
            times, i = edges[g] + length * points, line.mode[g]
            delayed = arrivals(line, plant.delays[i], times, nodes, g - 1)
            renew(own, i, plant.A[i], length, points, end)
            solve_state(
                own.forward[i], own.backward[i], plant.B[i], x, delayed, length, nodes, states[g]
            )
            if g < line.stop:
                for w in range(windows):
                    _window_sum(line, law, w, g, whole, moved, nodes, starts[w])
                    _shift(line, law, w, times, backward[w], nodes, g - 1, shifts[w])
                _solve_input(
                    law, law.F[law.row[g]], law.C[law.row[g]], states[g], starts, shifts, forward,
                    backward, length, nodes, line.inputs[g],
                )  # fmt: skip
            if not hand_on(states[g, p + 1], x):
                return states, g
        if g < line.stop:
            for w in range(windows):
                sent = line.inputs[g, 1 : p + 1]
                convolve(forward[w], law.R[w], length, nodes.weights, sent, moved[g, w])
    return states, segments


def windows_of(law: Functional, middles: np.ndarray) -> Windows:
    """A `Functional` on the segments around these times, as `march_windows` takes it."""
    sought = np.where(law.near[:, None, None] == 0.0, law.R, 0.0)
    row = law.row(np.maximum(middles, 0.0))
    own = law.F, law.C, law.S, law.R, law.near, law.far
    return Windows(*map(read_only, (*own, law.leaving, sought, row)))
