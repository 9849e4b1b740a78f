"""The compiled loop of the ideal simulation: one segment after another by collocation.

Time is cut into segments on which everything is analytic. On a segment [a, b] in mode σ:

1. x solves dx/dt = A_σ x + B_σ u(t − D), whose input lies in the past.
2. Each branch's prediction starts from P_b(a), summed afresh over the inputs in flight (so
   that nothing drifts from segment to segment), and solves

       dP_b/dt = A_e P_b + B_e u(t) + M_b(t) r_b(t),
       r_b = L (A_σ x + B_σ u(t − D)) − A_f L x − B_f u(t − D'),

   D' the law's delay and L its lift (I, unless it predicts more than the state), f and e the
   systems in which the branch starts (at t) and ends (at t + D'), M_b its transition from t to
   t + D': the last term is how the plant, moving otherwise than the branch believes, shifts the
   prediction.
3. u = Σ_b K_b P_b turns this into a linear system for u at the nodes.

Both differential equations are collocated at Gauss nodes in their integral form.
"""

from __future__ import annotations

import numpy as np

from deadtime.numerics.exponential import discretise, multiply
from deadtime.numerics.kernels import kernel


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
def interpolate(values, support, barycentric, c, result):
    """The polynomial through `values` (nodes, k) at c ∈ [0, 1]."""
    total = 0.0
    result[:] = 0.0
    for j in range(support.size):
        difference = c - support[j]
        if difference == 0.0:
            result[:] = values[j]
            return
        weight = barycentric[j] / difference
        total += weight
        for i in range(result.size):
            result[i] += weight * values[j, i]
    for i in range(result.size):
        result[i] /= total


@kernel(eager=True)
def sample(edges, values, support, barycentric, times, hint):
    """A segmented function at increasing times, (T, k)."""
    result = np.empty((times.size, values.shape[2]))
    i = hint
    for k in range(times.size):
        i = locate(edges, times[k], i)
        c = (times[k] - edges[i]) / (edges[i + 1] - edges[i])
        interpolate(values[i], support, barycentric, min(max(c, 0.0), 1.0), result[k])
    return result


@kernel(eager=True)
def add_product(M, x, result):
    """result += M x, for small matrices."""
    for i in range(M.shape[0]):
        for j in range(M.shape[1]):
            result[i] += M[i, j] * x[j]


@kernel(eager=True)
def flows(A, length, points):
    """e^{A c_k length} at the nodes of a segment, (p, n, n).

    On a short segment one Taylor series serves all nodes.
    """
    n, p = A.shape[0], points.size
    result = np.empty((p, n, n))
    size = 0.0
    for i in range(n):
        size = max(size, np.abs(A[i]).sum() * length)
    if size > 3.0:
        none = np.zeros((n, 1))
        for k in range(p):
            result[k], _ = discretise(A, none, points[k] * length)
        return result
    term, power = np.eye(n), np.ones(p)
    for k in range(p):
        result[k] = term
    bound, j = 1.0, 0
    while bound > 1e-18:
        j += 1
        term = multiply(A, term)
        term *= length / j
        bound *= size / j
        for k in range(p):
            power[k] *= points[k]
            for a in range(n):
                for b in range(n):
                    result[k, a, b] += power[k] * term[a, b]
    return result


@kernel(eager=True)
def convolve_whole(flow, B, length, weights, u):
    """∫ e^{A(b − θ)} B u(θ) dθ over a segment [a, b], u at its nodes, flow as from `flows`."""
    total, forced = np.zeros(B.shape[0]), np.empty(B.shape[0])
    p = weights.size
    for k in range(p):
        forced[:] = 0.0
        add_product(B, u[k], forced)
        forced *= weights[k] * length
        # The nodes are symmetric: b − t_k is the node p − 1 − k after a.
        add_product(flow[p - 1 - k], forced, total)
    return total


@kernel(eager=True)
def convolve_part(A, B, start, end, edges, inputs, segment, nodes):
    """∫ e^{A(end − θ)} B u(θ) dθ over [start, end] within one segment."""
    points = nodes.points
    u = np.empty((points.size, B.shape[1]))
    length = edges[segment + 1] - edges[segment]
    for k in range(points.size):
        c = (start + points[k] * (end - start) - edges[segment]) / length
        place = min(max(c, 0.0), 1.0)
        interpolate(inputs[segment], nodes.support, nodes.barycentric, place, u[k])
    return convolve_whole(flows(A, end - start, points), B, end - start, nodes.weights, u)


@kernel(eager=True)
def integrate(A, start, forcing, length, integral):
    """y(c_k) with y = start + ∫ A y + forcing (p, n, columns), over a segment of that length."""
    p, n, columns = forcing.shape
    matrix = np.eye(p * n)
    right = np.zeros((p * n, columns))
    for k in range(p):
        for j in range(p):
            factor = length * integral[k, j]
            for i in range(n):
                for q in range(n):
                    matrix[k * n + i, j * n + q] -= factor * A[i, q]
                for q in range(columns):
                    right[k * n + i, q] += factor * forcing[j, i, q]
        for i in range(n):
            for q in range(columns):
                right[k * n + i, q] += start[i, q]
    # The solver answers in Fortran order.
    return np.ascontiguousarray(np.linalg.solve(matrix, right)).reshape(p, n, columns)


@kernel(eager=True)
def solve_state(A, B, x, delayed, length, integral, weights):
    """x at the support nodes of a segment that starts at x, under the delayed inputs (p, m)."""
    p, n = delayed.shape[0], x.size
    forcing = np.zeros((p, n, 1))
    for k in range(p):
        add_product(B, delayed[k], forcing[k, :, 0])
    inner = integrate(A, x.reshape(n, 1), forcing, length, integral)
    result = np.empty((p + 2, n))
    result[0], result[p + 1] = x, x
    for k in range(p):
        result[k + 1] = inner[k, :, 0]
        add_product(A, inner[k, :, 0], forcing[k, :, 0])
        result[p + 1] += length * weights[k] * forcing[k, :, 0]
    return result


@kernel(eager=True)
def solve_input(starts, shifts, ends, A, B, gains, length, nodes):
    """u at the support nodes: u = Σ_b K_b P_b with every P_b collocated.

    starts (branches, n): P_b(a); shifts (branches, p, n): M_b r_b at the nodes; ends: the
    systems e. Solves for u at the nodes, then evaluates both ends.
    """
    branches, p, n = shifts.shape
    m = B.shape[2]
    forced = np.zeros((p, n, 1 + p * m))
    inner = np.empty((branches, p, n, 1 + p * m))
    matrix, right = np.eye(p * m), np.zeros(p * m)
    for b in range(branches):
        forced[:] = 0.0
        start = np.zeros((n, 1 + p * m))
        start[:, 0] = starts[b]
        for k in range(p):
            forced[k, :, 0] = shifts[b, k]
            forced[k, :, 1 + k * m : 1 + (k + 1) * m] = B[ends[b]]
        inner[b] = integrate(A[ends[b]], start, forced, length, nodes.integral)
        for k in range(p):
            value = multiply(gains[b], inner[b, k])
            for i in range(m):
                right[k * m + i] += value[i, 0]
                for q in range(p * m):
                    matrix[k * m + i, q] -= value[i, 1 + q]
    u = np.linalg.solve(matrix, right)
    result = np.zeros((p + 2, m))
    result[1 : p + 1] = u.reshape(p, m)
    for b in range(branches):
        last, P = starts[b].copy(), np.empty(n)
        for k in range(p):
            slope = shifts[b, k].copy()
            for i in range(n):
                P[i] = inner[b, k, i, 0]
                for q in range(p * m):
                    P[i] += inner[b, k, i, 1 + q] * u[q]
            add_product(A[ends[b]], P, slope)
            add_product(B[ends[b]], u[k * m : (k + 1) * m], slope)
            last += length * nodes.weights[k] * slope
        add_product(gains[b], starts[b], result[0])
        add_product(gains[b], last, result[p + 1])
    return result
