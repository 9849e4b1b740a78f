"""The compiled march of the ideal simulation over its segments."""

from __future__ import annotations

import numpy as np

from deadtime.numerics.exponential import discretise, multiply
from deadtime.numerics.kernels import kernel
from deadtime.simulation.ideal.kernel import (
    add_product,
    convolve_part,
    convolve_whole,
    flows,
    locate,
    sample,
    solve_input,
    solve_state,
)
from deadtime.simulation.kernel import LIMIT


@kernel(eager=True)
def _prediction(y, g, end_system, flow, moved, line, ahead, nodes):
    """P_b at the start of segment g and its transition M_b, summed over the inputs in flight.

    It starts from y = L x. Up to `until` the system is the one in force, or the one that `path`
    foresees.
    """
    start, lead, until, edges = line.edges[g], ahead.lead, ahead.until[g], line.edges
    now = -1 if ahead.foresees else ahead.here[g]
    q = locate(edges, start - lead, g - 1)
    last = edges[q + 1]
    middle = (start - lead + last) / 2.0 + lead
    s = (now if now >= 0 else ahead.path[q]) if middle < until else end_system
    A, B = ahead.A[s], ahead.B[s]
    M, _ = discretise(A, B, last - (start - lead))
    P = convolve_part(A, B, start - lead, last, edges, line.inputs, q, nodes)
    add_product(M, y, P)
    for j in range(q + 1, g):
        middle = (edges[j] + edges[j + 1]) / 2.0 + lead
        s = (now if now >= 0 else ahead.path[j]) if middle < until else end_system
        following = moved[j, s].copy()
        add_product(flow[j, s], P, following)
        P = following
        M = multiply(flow[j, s], M)
    return P, M


@kernel(eager=True)
def _shift(A, B, first, x, delayed, recent, ahead, M, back, onward):
    """M_b r_b at the nodes of a segment; see the module `ideal_kernel`."""
    p, q = recent.shape[0], ahead.lift.shape[0]
    result = np.zeros((p, q))
    difference = multiply(ahead.lift, A) - multiply(ahead.A[first], ahead.lift)
    forced = multiply(ahead.lift, B)
    for k in range(p):
        r, sent, moved = np.zeros(q), np.zeros(q), np.zeros(q)
        add_product(ahead.B[first], -recent[k], r)
        add_product(forced, delayed[k], r)
        add_product(difference, x[k + 1], r)
        add_product(back[k], r, sent)
        add_product(M, sent, moved)
        add_product(onward[k], moved, result[k])
    return result


@kernel(eager=True)
def march(plant, line, ahead, x0, nodes):
    """Solve the segments from `begin` on; u is sought before segment `stop`, x on all.

    `plant`, `line` and `ahead` are those of `deadtime.simulation.ideal.run`, `nodes` those of
    `collocation`. line.inputs (segments, p + 2, m) holds the history and receives u. Returns x
    (segments, p + 2, n) and the number of segments done before |x| left the limit.
    """
    edges, inputs, branches, points = line.edges, line.inputs, ahead.branches, nodes.points
    n, count, q = x0.size, branches.size, ahead.A.shape[1]
    segments, p, systems = edges.size - 1, points.size, ahead.A.shape[0]
    states = np.zeros((segments, p + 2, n))
    flow = np.zeros((segments, systems, q, q))
    moved = np.zeros((segments, systems, q))
    inner, back = np.empty((systems, p, q, q)), np.empty((systems, p, q, q))
    starts, shifts = np.empty((count, q)), np.empty((count, p, q))
    ends = np.empty(count, np.int64)
    x = x0.copy()
    for g in range(segments):
        start, length = edges[g], edges[g + 1] - edges[g]
        predicts = g < line.stop and ahead.lead > 0.0
        if predicts:
            for s in range(systems):
                flow[g, s], _ = discretise(ahead.A[s], ahead.B[s], length)
                inner[s] = flows(ahead.A[s], length, points)
                # e^{−A c_k} = e^{−A} e^{A (1 − c_k)}, and the nodes are symmetric.
                undo, _ = discretise(-ahead.A[s], ahead.B[s], length)
                for k in range(p):
                    back[s, k] = multiply(undo, inner[s, p - 1 - k])
        if g >= line.begin:
            times, i = start + length * points, line.mode[g]
            A, B = plant.A[i], plant.B[i]
            known = inputs, nodes.support, nodes.barycentric
            delayed = sample(edges, *known, times - plant.delay, g - 1)
            states[g] = solve_state(A, B, x, delayed, length, nodes.integral, nodes.weights)
            if predicts:
                recent = sample(edges, *known, times - ahead.lead, g - 1)
                here, until, middle = ahead.here[g], ahead.until[g], start + length / 2.0
                last = ahead.path[g] if ahead.foresees else here
                lifted = np.zeros(q)
                add_product(ahead.lift, x, lifted)
                for b in range(count):
                    first = here if middle < until else branches[b]
                    ends[b] = last if middle + ahead.lead < until else branches[b]
                    starts[b], M = _prediction(
                        lifted, g, branches[b], flow, moved, line, ahead, nodes
                    )
                    shifts[b] = _shift(
                        A, B, first, states[g], delayed, recent, ahead, M, back[first],
                        inner[ends[b]],
                    )  # fmt: skip
                inputs[g] = solve_input(
                    starts, shifts, ends, ahead.A, ahead.B, ahead.gains[g], length, nodes
                )
            elif g < line.stop:
                for k in range(p + 2):
                    add_product(ahead.gains[g, 0], states[g, k], inputs[g, k])
            x = states[g, p + 1].copy()
            if not np.abs(x).max() <= LIMIT:
                return states, g
        if predicts:
            for s in range(systems):
                u = inputs[g, 1 : p + 1]
                moved[g, s] = convolve_whole(inner[s], ahead.B[s], length, nodes.weights, u)
    return states, segments
