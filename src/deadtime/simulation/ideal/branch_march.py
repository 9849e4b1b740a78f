"""The ideal loop under a law that is a `Forecast`, along the signals of its branches.

On a segment x is solved first, as in `collocation`. At each of its Gauss nodes t the prediction
of every branch is a functional of x(t) and of the inputs in flight. It is integrated backwards from
the instant at which an input is first read. Over an interval in which the branch stays in one
system and every input is either in flight or under its own feedback,

    R(s) = R e^{S (s₁ − s)},   S = A + Σ b_l K_l over the inputs l under their own feedback,

adds ∫ R(s) b_l u_l(s − D_l) ds for every input l in flight: Gauss sums over the segments that were
sent. Inputs of the segment itself are unknown, and u at its nodes solves a linear system.

A prediction that reads its own inputs again is a delay equation: a branch that switches to a system
with a longer delay reads inputs after t a second time. Their values, K x̂ at the first reading, are
known by then, so the prediction is solved by the method of steps. Its pieces end wherever an input
that is read bends. On each, x̂ solves a collocation system under the inputs sent before t, those
first read (feedback of x̂ itself) and those read again. Inputs on the segment of t are unknown at
the nodes, so x̂ is an affine function of them: arrays (…, 1 + p m), the known part first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Forecast
from deadtime.numerics.kernels import kernel
from deadtime.numerics.polynomials import Nodes, gauss, shares
from deadtime.simulation.ideal.collocation import arrivals, flows, interpolate, locate, solve_alone
from deadtime.simulation.initial_input import refit
from deadtime.simulation.loop_arrays import LIMIT

_MOST_PIECES = 10_000


class FirstRead(NamedTuple):
    """The input to be sent from `begin` to `end`, by the instant at which it is first read.

    gain : (n,), K of the system that reads it
    later : seconds from sending to reading; None if overdue at a switch, with the value `held`
    """

    begin: float
    end: float
    gain: np.ndarray
    later: float | None
    held: np.ndarray


class Predicted:
    """x̂ on the pieces so far: their ends, and values at the support nodes (p + 2, n, 1 + p m)."""

    def __init__(self, t: float, x: np.ndarray, columns: int) -> None:
        self.edges, self.values = [t], []
        self.now = np.zeros((x.size, columns))
        self.now[:, 0] = x

    def at(self, times: np.ndarray, nodes: Nodes) -> np.ndarray:
        """x̂ at times within one piece, (T, n, 1 + p m)."""
        place = int(np.searchsorted(self.edges, times.mean())) - 1
        begin, end = self.edges[place], self.edges[place + 1]
        weights = shares((times - begin) / (end - begin), nodes.support)
        return np.tensordot(weights, self.values[place], 1)

    def append(self, end: float, S: np.ndarray, forcing: np.ndarray, nodes: Nodes) -> None:
        """Go on to `end` under dx̂/dt = S x̂ + forcing, (p, n, 1 + p m) at the nodes."""
        length, (p, n, columns) = end - self.edges[-1], forcing.shape
        matrix = np.eye(p * n) - length * np.kron(nodes.integral, S)
        right = self.now + length * np.tensordot(nodes.integral, forcing, 1)
        inside = np.linalg.solve(matrix, right.reshape(p * n, columns)).reshape(forcing.shape)
        slope = np.einsum("ij,kjc->kic", S, inside) + forcing
        following = self.now + length * np.tensordot(nodes.weights, slope, 1)
        self.values.append(np.concatenate((self.now[None], inside, following[None])))
        self.edges.append(end)
        self.now = following


def feedback_through_rereading(
    line, g: int, t: float, branch, x: np.ndarray, nodes: Nodes, longest: float
) -> Float[np.ndarray, "m columns"]:
    """The feedback of a branch at t on segment g, a row per input: 1, then u of the nodes, (p, m).

    `line` and `branch` are those of `deadtime.simulation.ideal.branch_march`; no piece is longer
    than `longest` seconds.
    """
    m, near = branch.K.shape[1], 1e-13 * (1.0 + abs(t))
    columns = 1 + nodes.points.size * m
    path, answer = Predicted(t, x, columns), np.full((m, columns), np.nan)
    newest, sent = np.full(m, t), [[] for _ in range(m)]
    e = max(int(np.searchsorted(branch.starts, t, "right")) - 1, 0)
    for _ in range(_MOST_PIECES):
        s, i = path.edges[-1], int(branch.systems[e])
        delays, gain = branch.delays[i], branch.K[i]
        read = np.isnan(answer[:, 0]) & (t + delays <= s + near)
        answer[read] = branch.weight * (gain[read] @ path.now)
        if not np.isnan(answer[:, 0]).any():
            return answer
        for j in np.flatnonzero(s - delays > newest + near):
            held = gain[j] @ path.now
            sent[j].append(FirstRead(newest[j], s - delays[j], gain[j], None, held))
            newest[j] = s - delays[j]
        switch = branch.starts[e + 1] if e + 1 < branch.starts.size else np.inf
        cuts = np.concatenate([[s + longest, switch], *_bends(line, g, t, delays, sent, path)])
        stop = float(cuts[cuts > s + near].min())
        stop = switch if switch <= stop + near else stop
        times = s + (stop - s) * nodes.points
        S, forcing = branch.A[i].copy(), np.zeros((times.size, x.size, columns))
        for j in range(m):
            then, b = times - delays[j], branch.B[i][:, j]
            middle = 0.5 * (s + stop) - delays[j]
            if middle < t:
                value = _sent_before(line, g, then, j, nodes)
            elif middle < newest[j]:
                value = _read_again(sent[j], middle, then, path, nodes)
            else:
                S += np.outer(b, gain[j])
                none = np.empty(0)
                sent[j].append(FirstRead(s - delays[j], stop - delays[j], gain[j], delays[j], none))
                newest[j] = stop - delays[j]
                continue
            forcing += b[:, None] * value[:, None]
        path.append(stop, S, forcing, nodes)
        e += stop == switch
    raise ArgumentError(
        f"step must be given: the input at {t:.6g} s takes a prediction that reads its own "
        f"inputs again, in more than {_MOST_PIECES} pieces: delays that differ so little between "
        "modes are better made equal."
    )


def _bends(
    line, g: int, t: float, delays: np.ndarray, sent: list[list[FirstRead]], path: Predicted
) -> list[np.ndarray]:
    """Instants at which an input that a system reads is not smooth."""
    before = np.append(line.edges[: g + 1], t)
    bends = []
    for delay, own in zip(delays, sent, strict=True):
        bends.append(before + delay)
        bends.append(np.array([time + delay for part in own for time in part[:2]]))
        lags = {delay - part.later for part in own if part.later is not None}
        bends += [np.array(path.edges) + lag for lag in lags if lag > 0.0]
    return bends


def _sent_before(line, g: int, times: np.ndarray, j: int, nodes: Nodes) -> np.ndarray:
    """The values sent to input j at times within one segment, (T, 1 + p m)."""
    edges, p, m = line.edges, nodes.points.size, line.inputs.shape[2]
    value = np.zeros((times.size, 1 + p * m))
    q = min(int(np.searchsorted(edges, times.mean())) - 1, g)
    c = (times - edges[q]) / (edges[q + 1] - edges[q])
    if q < g:
        value[:, 0] = shares(c, nodes.support) @ line.inputs[q, :, j]
    else:
        value[:, 1 + j :: m] = shares(c, nodes.points)
    return value


def _read_again(
    own: list[FirstRead], middle: float, times: np.ndarray, path: Predicted, nodes: Nodes
) -> np.ndarray:
    """The values that will have been sent to an input at times within one part, (T, 1 + p m)."""
    part = next(each for each in own if middle < each.end)
    if part.later is None:
        return np.broadcast_to(part.held, (times.size, part.held.size))
    return np.einsum("n,knc->kc", part.gain, path.at(times + part.later, nodes))


_AGAIN = -1
_FEW, _SHORT = 4, 0.125  # nodes that do on a panel so much shorter than the longest segment


class ReadsAgain(Exception):
    """A prediction reads its own inputs again, and the segments are not cut for that."""


class Branch(NamedTuple):
    """One branch of a forecast on a segment: the `Forecast`'s systems, and when each begins."""

    A: np.ndarray
    B: np.ndarray
    delays: np.ndarray
    K: np.ndarray
    weight: float
    starts: np.ndarray
    systems: np.ndarray


class Kept(NamedTuple):
    """The maps over whole segments, computed once: many nodes predict over the same segment.

    place = (branch · systems + system) · 2^m + Σ 2^j over the inputs j under their own feedback.

    done : (places, segments), whether computed
    passed : (places, segments, n, n), e^{S length};  moved : (places, segments, m, n), of inputs
    """

    done: np.ndarray
    passed: np.ndarray
    moved: np.ndarray


class Use(NamedTuple):
    """Scratch of `_add_sent`, and 1/∏(c_z − c_y) of the Gauss nodes, (p,)."""

    scale: np.ndarray
    share: np.ndarray
    pushed: np.ndarray


class Intervals(NamedTuple):
    """The intervals of a prediction, see `_divide`.

    edges : (intervals + 1,);  system : (intervals,)
    flying : (intervals, m), 1 for inputs in flight, 0 for those under their own feedback
    read : (m,), the interval at whose start each input is first read;  reader : (m,), the system
    """

    edges: np.ndarray
    system: np.ndarray
    flying: np.ndarray
    read: np.ndarray
    reader: np.ndarray


@kernel(eager=True)
def _divide(t, branch, into):
    """Cut a prediction from t into intervals, until all inputs are read; how many there are.

    −1 where an input that is still to be sent would be read a second time.
    """
    m, starts, near = into.read.size, branch.starts, 1e-13 * (1.0 + abs(t))
    newest = np.full(m, t)
    e, s, count = 0, t, 0
    for j in range(m):
        into.read[j] = -1
    while e + 1 < starts.size and starts[e + 1] <= t:
        e += 1
    into.edges[0] = t
    while True:
        i, missing = branch.systems[e], 0
        stop = starts[e + 1] if e + 1 < starts.size else np.inf
        switches = stop
        for j in range(m):
            arrival = t + branch.delays[i, j]
            if into.read[j] < 0:
                if arrival <= s + near:
                    into.read[j], into.reader[j] = count, i
                else:
                    missing += 1
            if arrival > s + near:
                stop = min(stop, arrival)
        if missing == 0:
            return count
        for j in range(m):
            first, last = s - branch.delays[i, j], stop - branch.delays[i, j]
            # By the middle: an end may lie within round-off of t, on either side.
            into.flying[count, j] = 1 if 0.5 * (first + last) < t else 0
            if into.flying[count, j] == 0 and first < newest[j] - near:
                return _AGAIN
            newest[j] = max(newest[j], last)
        into.system[count] = i
        count += 1
        into.edges[count] = s = stop
        if stop == switches:
            e += 1


@kernel(eager=True)
def _share(c, points, scale, share):
    """The polynomials through the Gauss nodes, 1 at one and 0 at the others, at c ∈ [0, 1]."""
    p = points.size
    # Products from the left and from the right: nothing is divided by, even at a node.
    before = after = 1.0
    for z in range(p):
        share[z] = scale[z] * before
        before *= c - points[z]
    for z in range(p - 1, -1, -1):
        share[z] *= after
        after *= c - points[z]


@kernel(eager=True)
def _add_sent(line, g, q, begin, length, j, R, flow, row, nodes, panel, b, u, use, matrix, right):
    """Add ∫ R e^{S (end − s)} b u_j ds over a part of segment q, for each row of R."""
    edges, p, count, (m, n) = line.edges, nodes.points.size, panel.points.size, R.shape
    for k in range(count):
        c = (begin + panel.points[k] * length - edges[q]) / (edges[q + 1] - edges[q])
        c = min(max(c, 0.0), 1.0)
        if q < g:
            interpolate(line.inputs, q, nodes.support, nodes.barycentric, c, u, 0)
        else:
            _share(c, nodes.points, use.scale, use.share)
        for o in range(n):
            use.pushed[o] = 0.0
            # The nodes are symmetric: the end is the node p − 1 − k after node k.
            for a in range(n):
                use.pushed[o] += flow[count - 1 - k, o, a] * b[a, j]
        for i in range(m):
            weight = 0.0
            for o in range(n):
                weight += R[i, o] * use.pushed[o]
            weight *= panel.weights[k] * length
            if q < g:
                right[row + i] += weight * u[0, j]
                continue
            for z in range(p):
                matrix[row + i, z * m + j] -= weight * use.share[z]


@kernel(eager=True)
def _keep(line, q, length, S, B, flow, nodes, panel, u, kept, place):
    """Store the maps of a system over all of segment q: e^{S length}, and ∫ e^{S …} b_j u_j."""
    count, (n, m) = panel.points.size, B.shape
    flows(S, length, panel.points, flow, np.empty((0, n, n)))
    for a in range(n):
        for j in range(m):
            kept.moved[place, q, j, a] = 0.0
        for o in range(n):
            kept.passed[place, q, a, o] = flow[count, a, o]
    for k in range(count):
        interpolate(line.inputs, q, nodes.support, nodes.barycentric, panel.points[k], u, 0)
        for a in range(n):
            for o in range(n):
                pushed = panel.weights[k] * length * flow[count - 1 - k, a, o]
                for j in range(m):
                    kept.moved[place, q, j, a] += pushed * B[o, j] * u[0, j]
    kept.done[place, q] = 1


@kernel
def _close(branch, i, flying, r, S):
    """A of system i, with the inputs that are not in flight in interval r under their feedback."""
    m, n = branch.K.shape[1:]
    for a in range(n):
        for o in range(n):
            S[a, o] = branch.A[i, a, o]
            for j in range(m):
                if flying[r, j] == 0:
                    S[a, o] += branch.B[i, a, j] * branch.K[i, j, o]


@kernel
def _carry(rows, flows, q, moved):
    """rows times flows[q], in place."""
    n = moved.size
    for k in range(rows.shape[0]):
        for a in range(n):
            moved[a] = 0.0
            for o in range(n):
                moved[a] += rows[k, o] * flows[q, o, a]
        for a in range(n):
            rows[k, a] = moved[a]


@kernel(eager=True)
def _add(line, g, t, branch, row, x, nodes, few, short, into, kept, first, use, matrix, right):
    """Add a branch at node t of segment g to the rows from `row` on of matrix u = right.

    False where it reads its own inputs again; `first` is the branch's first place in `kept`.
    """
    edges, p, (m, n) = line.edges, nodes.points.size, branch.K.shape[1:]
    count = _divide(t, branch, into)
    if count == _AGAIN:
        return False
    R, carried, moved = np.zeros((m, n)), np.zeros((m, n)), np.empty(n)
    S, flow, u = np.empty((n, n)), np.empty((p + 1, n, n)), np.empty((1, m))
    none = np.empty((0, n, n))
    # From the end of the prediction back: m rows are carried instead of n columns.
    for r in range(count - 1, -1, -1):
        i, known, place, bit = into.system[r], -1.0, 0, 1
        for j in range(m):
            if into.read[j] == r + 1:
                for a in range(n):
                    R[j, a] = branch.weight * branch.K[into.reader[j], j, a]
        for j in range(m):
            # The map depends on which inputs are in flight, so one bit of its place is each one's.
            place += 0 if into.flying[r, j] else bit
            bit *= 2
        place += first + i * bit
        _close(branch, i, into.flying, r, S)
        passed, B = kept.passed[place], branch.B[i]
        for j in range(m):
            if into.flying[r, j] == 0:
                continue
            low, high = into.edges[r] - branch.delays[i, j], into.edges[r + 1] - branch.delays[i, j]
            for k in range(m):
                for a in range(n):
                    carried[k, a] = R[k, a]
            q = locate(edges, high, g)
            while q >= 0 and edges[q + 1] > low:
                begin, length = max(edges[q], low), min(edges[q + 1], high) - max(edges[q], low)
                if length > 0.0:
                    panel = few if length < short else nodes
                    whole = q < g and begin == edges[q] and high >= edges[q + 1]
                    if whole:
                        if not kept.done[place, q]:
                            _keep(line, q, length, S, B, flow, nodes, panel, u, kept, place)
                            # `_keep` wrote its own flows over those of the length that was known.
                            known = -1.0
                        for k in range(m):
                            for a in range(n):
                                right[row + k] += carried[k, a] * kept.moved[place, q, j, a]
                    else:
                        if abs(length - known) > 1e-15:
                            flows(S, length, panel.points, flow, none)
                            known = length
                        _add_sent(
                            line, g, q, begin, length, j, carried, flow, row, nodes, panel, B, u,
                            use, matrix, right,
                        )  # fmt: skip
                    if whole:
                        _carry(carried, passed, q, moved)
                    else:
                        _carry(carried, flow, panel.points.size, moved)
                q -= 1
        # An input that is not read yet is in flight: R was carried over the interval with it.
        for k in range(m):
            for a in range(n):
                R[k, a] = carried[k, a]
    for j in range(m):
        for a in range(n):
            right[row + j] += R[j, a] * x[a]
    return True


@kernel(eager=True)
def _add_segment(
    line, g, times, branch, states, nodes, few, short, into, kept, first, use, matrix, right, able
):
    """Add a branch at all nodes of segment g, with x `states`; `able` gets `_add`'s answers."""
    m = branch.K.shape[1]
    for k in range(times.size):
        able[k] = _add(
            line, g, times[k], branch, k * m, states[k + 1], nodes, few, short, into, kept, first,
            use, matrix, right,
        )  # fmt: skip


def march_branches(
    plant, line, law: Forecast, x0: np.ndarray, nodes: Nodes, rereads: bool
) -> tuple[np.ndarray, int]:
    """Solve the segments from `begin` on; arguments and result as of `march_windows`.

    `rereads`: whether segments end where a prediction stops to read its own inputs again.
    """
    edges, (branches, _, m, n) = line.edges, law.gains.shape
    segments, p = edges.size - 1, nodes.points.size
    states, x = np.zeros((segments, p + 2, n)), x0.copy()
    longest = float(np.diff(edges).max())
    few, short = gauss(_FEW), _SHORT * longest
    ends = refit(nodes.points, np.array([0.0, 1.0]))
    A, B, delays, gains = map(read_only, (law.A, law.B, law.delays, law.gains))
    places, able = law.A.shape[0] * 2**m, np.empty(p, np.int8)
    kept = Kept(
        np.zeros((branches * places, segments), np.int8),
        np.empty((branches * places, segments, n, n)),
        np.empty((branches * places, segments, m, n)),
    )
    apart = nodes.points[:, None] - nodes.points + np.eye(p)
    use = Use(1.0 / apart.prod(axis=1), np.empty(p), np.empty(n))
    for g in range(line.begin, segments):
        length, i = edges[g + 1] - edges[g], line.mode[g]
        times = edges[g] + length * nodes.points
        delayed = arrivals(line, plant.delays[i], times, nodes, g - 1)
        states[g] = solve_alone(plant.A[i], plant.B[i], x, delayed, length, nodes)
        if g < line.stop:
            matrix, right = np.eye(p * m), np.zeros(p * m)
            starts, systems = law.signals(edges[g] + length / 2.0)
            # A prediction has an interval per part of its signal and arriving input, at most.
            most = starts.shape[1] * (m + 1) + 1
            whole = np.empty(most, np.int64), np.empty((most, m), np.int64)
            first = np.empty(m, np.int64), np.empty(m, np.int64)
            into = Intervals(np.empty(most + 1), *whole, *first)
            for b in range(branches):
                signal = read_only(starts[b]), read_only(systems[b])
                branch = Branch(A, B, delays, gains[b], law.weights[b], *signal)
                _add_segment(
                    line, g, times, branch, states[g], nodes, few, short, into, kept, b * places,
                    use, matrix, right, able,
                )  # fmt: skip
                for k in np.flatnonzero(able == 0).tolist():
                    if not rereads:
                        raise ReadsAgain
                    t, here = float(times[k]), states[g, k + 1]
                    sent = feedback_through_rereading(line, g, t, branch, here, nodes, longest)
                    right[k * m : k * m + m] += sent[:, 0]
                    matrix[k * m : k * m + m] -= sent[:, 1:]
            u = np.linalg.solve(matrix, right).reshape(p, m)
            line.inputs[g, 1:-1] = u
            line.inputs[g, [0, -1]] = ends @ u
        x = states[g, -1].copy()
        if not np.abs(x).max() <= LIMIT:
            return states, g
    return states, segments
