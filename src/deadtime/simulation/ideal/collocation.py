"""The ideal loop by collocation, one segment after another, compiled.

Time is cut into segments on which everything is analytic. On a segment [a, b] in mode σ

    dx/dt = A_σ x + B_σ u(t − D),

whose input lies in the past (of every input its own delay in mode σ), and what a law predicts obeys
such an equation, too. They are solved by variation of constants,

    y(t) = e^{A(t−a)} (y(a) + ∫_a^t e^{−A(θ−a)} f(θ) dθ),

the integral from a to each Gauss node by collocation; a segment is so short that e^{−A(θ−a)} is
far from losing digits. What is sought is u at the nodes, which solves a linear system.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.numerics.exponential import discretise, product
from deadtime.numerics.kernels import kernel
from deadtime.simulation.loop_arrays import LIMIT

_SAME = 1e-15  # of the run: lengths of segments so close are one


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
    """What acts at increasing times in a mode, u_j(t − D_j), (T, m)."""
    edges, inputs = line.edges, line.inputs
    known = inputs, nodes.support, nodes.barycentric
    result = sample(edges, *known, times - delays[0], hint)
    for j in range(1, delays.size):
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
    """e^{A c length} at the points c of a segment, in units of it, and at 1: (points + 1, n, n).

    `backward` (points, n, n) takes e^{−A c length}; none is wanted where it is empty. On a short
    segment one Taylor series serves all points and both signs.
    """
    n, p, back = A.shape[0], points.size, backward.shape[0]
    size = 0.0
    for i in range(n):
        row = 0.0
        for j in range(n):
            row += abs(A[i, j] * length)
        size = max(size, row)
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
    """The same of a segment whose flows nobody else needs: (p + 2, n), u at the nodes (p, m)."""
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
    """The last state of a segment, into x; whether it is within the limit."""
    inside = True
    for j in range(x.size):
        x[j] = last[j]
        inside &= abs(x[j]) <= LIMIT
    return inside
