"""The compiled march of the ideal simulation over its segments."""

from __future__ import annotations

import numpy as np
from numba import njit

from deadtime.numerics.exponential import held, multiply
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


@njit(cache=True)
def _prediction(y, start, segment, lead, until, now, end_system, path, flow, moved, edges, inputs,
                fA, fB, points, weights, support, barycentric):  # fmt: skip
    """P_b at the start of a segment and its transition M_b, summed over the inputs in the pipe.

    It starts from y = L x. Up to `until` the system is `now`, or where that is negative the one
    that `path` foresees.
    """
    q = locate(edges, start - lead, segment - 1)
    last = edges[q + 1]
    middle = (start - lead + last) / 2.0 + lead
    s = (now if now >= 0 else path[q]) if middle < until else end_system
    M, _ = held(fA[s], fB[s], last - (start - lead))
    P = convolve_part(
        fA[s], fB[s], start - lead, last, edges, inputs, q, points, weights, support, barycentric
    )
    add_product(M, y, P)
    for j in range(q + 1, segment):
        middle = (edges[j] + edges[j + 1]) / 2.0 + lead
        s = (now if now >= 0 else path[j]) if middle < until else end_system
        following = moved[j, s].copy()
        add_product(flow[j, s], P, following)
        P = following
        M = multiply(flow[j, s], M)
    return P, M


@njit(cache=True)
def _shift(A, B, lift, x, delayed, A_first, B_first, recent, M, back, ahead):
    """M_b r_b at the nodes of a segment; see the module `ideal_kernel`."""
    p, q = recent.shape[0], lift.shape[0]
    result = np.zeros((p, q))
    difference = multiply(lift, A) - multiply(A_first, lift)
    forced = multiply(lift, B)
    for k in range(p):
        r, sent, moved = np.zeros(q), np.zeros(q), np.zeros(q)
        add_product(B_first, -recent[k], r)
        add_product(forced, delayed[k], r)
        add_product(difference, x[k + 1], r)
        add_product(back[k], r, sent)
        add_product(M, sent, moved)
        add_product(ahead[k], moved, result[k])
    return result


@njit(cache=True)
def march(edges, begin, stop, mode, A, B, delay, fA, fB, lead, branches, gains, here, path, until,
          foresees, lift, x0, inputs, points, integral, weights, support, barycentric):  # fmt: skip
    """Solve the segments from `begin` on; u is sought before segment `stop`, x on all.

    `inputs` (segments, p + 2, m) holds the history and receives u. `here` and `path` are the
    forecast's systems at the middle of a segment and a lead after it. Returns x (segments,
    p + 2, n) and the number of segments done before |x| left the limit.
    """
    n, count, q = x0.size, branches.size, fA.shape[1]
    segments, p, systems = edges.size - 1, points.size, fA.shape[0]
    states = np.zeros((segments, p + 2, n))
    flow = np.zeros((segments, systems, q, q))
    moved = np.zeros((segments, systems, q))
    inner, back = np.empty((systems, p, q, q)), np.empty((systems, p, q, q))
    starts, shifts = np.empty((count, q)), np.empty((count, p, q))
    ends = np.empty(count, np.int64)
    x = x0.copy()
    for g in range(segments):
        start, length = edges[g], edges[g + 1] - edges[g]
        predicts = g < stop and lead > 0.0
        if predicts:
            for s in range(systems):
                flow[g, s], _ = held(fA[s], fB[s], length)
                inner[s] = flows(fA[s], length, points)
                # e^{−A c_k} = e^{−A} e^{A (1 − c_k)}, and the nodes are symmetric.
                undo, _ = held(-fA[s], fB[s], length)
                for k in range(p):
                    back[s, k] = multiply(undo, inner[s, p - 1 - k])
        if g >= begin:
            times, i = start + length * points, mode[g]
            delayed = sample(edges, inputs, support, barycentric, times - delay, g - 1)
            states[g] = solve_state(A[i], B[i], x, delayed, length, integral, weights)
            if predicts:
                recent = sample(edges, inputs, support, barycentric, times - lead, g - 1)
                now, middle = -1 if foresees else here[g], start + length / 2.0
                last = path[g] if foresees else here[g]
                lifted = np.zeros(q)
                add_product(lift, x, lifted)
                for b in range(count):
                    first = here[g] if middle < until[g] else branches[b]
                    ends[b] = last if middle + lead < until[g] else branches[b]
                    starts[b], M = _prediction(
                        lifted, start, g, lead, until[g], now, branches[b], path, flow, moved,
                        edges, inputs, fA, fB, points, weights, support, barycentric,
                    )  # fmt: skip
                    shifts[b] = _shift(
                        A[i], B[i], lift, states[g], delayed, fA[first], fB[first], recent, M,
                        back[first], inner[ends[b]],
                    )  # fmt: skip
                inputs[g] = solve_input(
                    starts, shifts, ends, fA, fB, gains[g], length, integral, weights
                )
            elif g < stop:
                for k in range(p + 2):
                    add_product(gains[g, 0], states[g, k], inputs[g, k])
            x = states[g, p + 1].copy()
            if not np.abs(x).max() <= LIMIT:
                return states, g
        if predicts:
            for s in range(systems):
                u = inputs[g, 1 : p + 1]
                moved[g, s] = convolve_whole(inner[s], fB[s], length, weights, u)
    return states, segments
