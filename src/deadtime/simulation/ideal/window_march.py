"""The compiled march under a law that is a `Functional`: windows on the past inputs.

    u(t) = F_c x(t) + Σ_p C_c,p y_p(t),    y_p(t) = ∫ e^{S_p (τ − α_p)} R_p u(t − τ) dτ, α_p to β_p,

c the row that applies on a segment [a, b]. There x is solved first, as in `collocation`. Every
y_p(a) is summed afresh over the inputs sent from a − β_p to a − α_p, so that nothing drifts from
segment to segment, and then

    dy_p/dt = S_p y_p + R_p u(t − α_p) − e^{S_p (β_p − α_p)} R_p u(t − β_p).

The last two inputs are known, segments being shorter than α_p > 0; where α_p = 0 the first is what
is sought, and u at the nodes solves a linear system.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.base.checks import read_only
from deadtime.feedback import Functional
from deadtime.numerics.kernels import kernel
from deadtime.simulation.ideal.collocation import (
    add_branch,
    add_product,
    arrivals,
    convolve,
    end_branch,
    flows,
    flows_of,
    hand_on,
    interpolate,
    locate,
    renew,
    sample,
    solve_state,
)


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
    """e^{−S (t − a)} of what is known of dy_p/dt at the nodes of a segment."""
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
    """Solve the segments from `begin` on; u is sought before segment `stop`, x on all.

    `plant` and `line` are those of `deadtime.simulation.ideal.ideal_run`, `nodes` those of
    `collocation`. line.inputs (segments, p + 2, m) holds the history and receives u. Returns x
    (segments, p + 2, n) and the number of segments done before |x| left the limit.
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
    """A `Functional` on the segments around these times, as the march takes it."""
    sought = np.where(law.near[:, None, None] == 0.0, law.R, 0.0)
    row = law.row(np.maximum(middles, 0.0))
    own = law.F, law.C, law.S, law.R, law.near, law.far
    return Windows(*map(read_only, (*own, law.leaving, sought, row)))
