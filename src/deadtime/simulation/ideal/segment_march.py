"""The compiled march of the ideal simulation over its segments."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.numerics.exponential import multiply, product
from deadtime.numerics.kernels import kernel
from deadtime.simulation.ideal.segment_kernel import (
    add_branch,
    add_product,
    convolve,
    end_branch,
    flows,
    hand_on,
    interpolate,
    locate,
    sample,
    solve_state,
)

_SAME = 1e-15  # of the run: lengths of segments so close are one


class Flows(NamedTuple):
    """e^{A c} and e^{−A c} of systems over a segment, at its nodes; the first also at its end.

    forward : (systems, p + 1, n, n);  backward : (systems, p, n, n)
    length : (systems,), the segment's, −1 at first
    """

    forward: np.ndarray
    backward: np.ndarray
    length: np.ndarray


@kernel(eager=True)
def _flows_of(systems, p, n):
    """Room for the flows of so many systems."""
    forward, backward = np.empty((systems, p + 1, n, n)), np.empty((systems, p, n, n))
    return Flows(forward, backward, np.full(systems, -1.0))


@kernel(eager=True)
def _renew(flow, s, A, length, points, horizon):
    """The flows of a system over a segment, where it is not as long as the one before."""
    if abs(length - flow.length[s]) > _SAME * horizon:
        flows(A, length, points, flow.forward[s], flow.backward[s])
        flow.length[s] = length


@kernel(eager=True)
def _oldest(g, line, lead, nodes, u):
    """The inputs in flight at the start of segment g that are part of a segment: its index, and
    they at the nodes of that part, into u (p, m).
    """
    edges = line.edges
    start = edges[g] - lead
    q = locate(edges, start, g - 1)
    last, length = edges[q + 1], edges[q + 1] - edges[q]
    for k in range(nodes.points.size):
        c = (start + nodes.points[k] * (last - start) - edges[q]) / length
        c = min(max(c, 0.0), 1.0)
        interpolate(line.inputs, q, nodes.support, nodes.barycentric, c, u, k)
    return q


@kernel(eager=True)
def _prediction(y, g, q, u, end_system, whole, moved, line, ahead, nodes, P):
    """P_b at the start of segment g, into P, and its transition M_b, over the inputs in flight.

    It starts from y = L x; q and u are those of `_oldest`. Up to `until` the system is the one in
    force, or the one that `path` foresees.
    """
    edges, lead, until, n, p = line.edges, ahead.lead, ahead.until[g], y.size, nodes.points.size
    start, last = edges[g] - lead, edges[q + 1]
    now = -1 if ahead.foresees else ahead.here[g]
    middle = (start + last) / 2.0 + lead
    s = (now if now >= 0 else ahead.path[q]) if middle < until else end_system
    flow = np.empty((p + 1, n, n))
    flows(ahead.A[s], last - start, nodes.points, flow, np.empty((0, n, n)))
    for i in range(n):
        P[i] = 0.0
    convolve(flow, ahead.B[s], last - start, nodes.weights, u, P)
    add_product(flow[p], y, P)
    both, moves = np.empty((n, n + 1)), np.empty((n, n + 1))
    for i in range(n):
        both[i, n] = P[i]
        for k in range(n):
            both[i, k] = flow[p, i, k]
    for j in range(q + 1, g):
        middle = (edges[j] + edges[j + 1]) / 2.0 + lead
        s = (now if now >= 0 else ahead.path[j]) if middle < until else end_system
        for i in range(n):
            for k in range(n + 1):
                total = moved[j, s, i] if k == n else 0.0
                for a in range(n):
                    total += whole[j, s, i, a] * both[a, k]
                moves[i, k] = total
        for i in range(n):
            for k in range(n + 1):
                both[i, k] = moves[i, k]
    for i in range(n):
        P[i] = both[i, n]
    return both[:, :n].copy()


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


class Owed(NamedTuple):
    """How the plant and a system differ: L A_i − A_f L (modes, systems, q, n), and L B_i."""

    states: np.ndarray
    inputs: np.ndarray


@kernel(eager=True)
def _owed(plant, ahead):
    """The differences of all modes and systems."""
    lift, modes, systems = ahead.lift, plant.A.shape[0], ahead.A.shape[0]
    q, n = lift.shape
    states, inputs = np.empty((modes, systems, q, n)), np.empty((modes, q, plant.B.shape[2]))
    for i in range(modes):
        product(lift, plant.B[i], inputs[i])
        for f in range(systems):
            of_plant, of_system = multiply(lift, plant.A[i]), multiply(ahead.A[f], lift)
            for a in range(q):
                for b in range(n):
                    states[i, f, a, b] = of_plant[a, b] - of_system[a, b]
    return Owed(states, inputs)


@kernel(eager=True)
def _shift(owed, i, first, x, delayed, recent, ahead, M, backward, result):
    """M_b(a) e^{−A_f(t−a)} r_b at the nodes of a segment; see `ideal.kernel`."""
    p, q = recent.shape[0], ahead.lift.shape[0]
    r, sent = np.empty(q), np.empty(q)
    for k in range(p):
        for a in range(q):
            r[a] = sent[a] = result[k, a] = 0.0
            for j in range(recent.shape[1]):
                r[a] += owed.inputs[i, a, j] * delayed[k, j] - ahead.B[first, a, j] * recent[k, j]
            for b in range(x.shape[1]):
                r[a] += owed.states[i, first, a, b] * x[k + 1, b]
        add_product(backward[k], r, sent)
        add_product(M, sent, result[k])


@kernel(eager=True)
def _solve_input(starts, shifts, ends, ahead, gains, flow, length, nodes, inputs):
    """u at the support nodes: u = Σ_b K_b P_b, a linear system for u at the nodes.

    starts (branches, n): P_b(a); shifts (branches, p, n) as from `_shift`; ends: the systems e.
    """
    branches, p, n = shifts.shape
    m = inputs.shape[1]
    matrix, right = np.eye(p * m), np.zeros(p * m)
    for b in range(branches):
        e = ends[b]
        add_branch(
            flow.forward[e], flow.backward[e], ahead.B[e], gains[b], starts[b], shifts[b], length,
            nodes, matrix, right,
        )  # fmt: skip
    u = np.linalg.solve(matrix, right).reshape(p, m)
    last = np.empty(n)
    for i in range(m):
        inputs[0, i] = inputs[p + 1, i] = 0.0
        for k in range(p):
            inputs[k + 1, i] = u[k, i]
    for b in range(branches):
        e = ends[b]
        end_branch(
            flow.forward[e], flow.backward[e], ahead.B[e], starts[b], shifts[b], length, nodes, u,
            last,
        )  # fmt: skip
        add_product(gains[b], starts[b], inputs[0])
        add_product(gains[b], last, inputs[p + 1])


@kernel(eager=True)
def march(plant, line, ahead, x0, nodes):
    """Solve the segments from `begin` on; u is sought before segment `stop`, x on all.

    `plant`, `line` and `ahead` are those of `deadtime.simulation.ideal.ideal_run`, `nodes` those of
    `collocation`. line.inputs (segments, p + 2, m) holds the history and receives u. Returns x
    (segments, p + 2, n) and the number of segments done before |x| left the limit.
    """
    edges, inputs, branches, points = line.edges, line.inputs, ahead.branches, nodes.points
    n, count, q = x0.size, branches.size, ahead.A.shape[1]
    segments, p, systems = edges.size - 1, points.size, ahead.A.shape[0]
    states = np.zeros((segments, p + 2, n))
    whole, moved = np.zeros((segments, systems, q, q)), np.zeros((segments, systems, q))
    own, flow = _flows_of(plant.A.shape[0], p, n), _flows_of(systems, p, q)
    starts, shifts = np.empty((count, q)), np.empty((count, p, q))
    ends, lifted, oldest = np.empty(count, np.int64), np.empty(q), np.empty((p, inputs.shape[2]))
    x, end, owed = x0.copy(), edges[segments], _owed(plant, ahead)
    for g in range(segments):
        start, length = edges[g], edges[g + 1] - edges[g]
        predicts = g < line.stop and ahead.lead > 0.0
        if predicts:
            for s in range(systems):
                _renew(flow, s, ahead.A[s], length, points, end)
                whole[g, s] = flow.forward[s, p]
        if g >= line.begin:
            times, i = start + length * points, line.mode[g]
            delayed = arrivals(line, plant.delays[i], times, nodes, g - 1)
            place, twin = flow, ahead.twin[i]
            if twin < 0 or not predicts:
                place, twin = own, i
                _renew(own, i, plant.A[i], length, points, end)
            solve_state(
                place.forward[twin], place.backward[twin], plant.B[i], x, delayed, length, nodes,
                states[g],
            )  # fmt: skip
            if predicts:
                known = inputs, nodes.support, nodes.barycentric
                recent = sample(edges, *known, times - ahead.lead, g - 1)
                here, until, middle = ahead.here[g], ahead.until[g], start + length / 2.0
                last = ahead.path[g] if ahead.foresees else here
                lifted[:] = 0.0
                add_product(ahead.lift, x, lifted)
                cut = _oldest(g, line, ahead.lead, nodes, oldest)
                for b in range(count):
                    first = here if middle < until else branches[b]
                    ends[b] = last if middle + ahead.lead < until else branches[b]
                    M = _prediction(
                        lifted, g, cut, oldest, branches[b], whole, moved, line, ahead, nodes,
                        starts[b],
                    )  # fmt: skip
                    _shift(
                        owed, i, first, states[g], delayed, recent, ahead, M, flow.backward[first],
                        shifts[b],
                    )  # fmt: skip
                _solve_input(
                    starts, shifts, ends, ahead, ahead.gains[g], flow, length, nodes, inputs[g]
                )
            elif g < line.stop:
                for k in range(p + 2):
                    add_product(ahead.gains[g, 0], states[g, k], inputs[g, k])
            if not hand_on(states[g, p + 1], x):
                return states, g
        if predicts:
            for s in range(systems):
                sent = inputs[g, 1 : p + 1]
                convolve(flow.forward[s], ahead.B[s], length, nodes.weights, sent, moved[g, s])
    return states, segments
