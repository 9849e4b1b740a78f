"""Predictions that read again what they have predicted themselves: a delay equation.

A branch that switches, within its prediction from t, to a system with a longer delay reads a sample
that is still to be sent a second time. What that sample is is known by then, K x̂ of where it was
first read, so the prediction is marched by the method of steps: pieces that end wherever what is
read bends, on each of which x̂ solves a collocation system under what was sent before t, what is
first read (its own feedback) and what is read again. Of what is sent on the segment of t the values
at the nodes are still sought, so that x̂ is kept as a function of these: arrays (…, 1 + p m), the
known part first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.numerics.polynomials import Nodes, shares

_MOST_PIECES = 10_000


class FirstRead(NamedTuple):
    """What will be sent from `begin` to `end`, by where it is first read.

    gain : (n,), K of the system that reads it
    later : seconds after it is sent; None where it is overdue at a switch and `held` is its value
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
    """What a branch sends at t on segment g, a row per input: 1, then u of the nodes, (p, m).

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
        f"step must be given: what is sent at {t:.6g} s takes a prediction that reads its own "
        f"inputs again, in more than {_MOST_PIECES} pieces: delays that differ so little between "
        "modes are better made equal."
    )


def _bends(
    line, g: int, t: float, delays: np.ndarray, sent: list[list[FirstRead]], path: Predicted
) -> list[np.ndarray]:
    """Where what a system reads bends: it is cut there."""
    before = np.append(line.edges[: g + 1], t)
    bends = []
    for delay, own in zip(delays, sent, strict=True):
        bends.append(before + delay)
        bends.append(np.array([time + delay for part in own for time in part[:2]]))
        lags = {delay - part.later for part in own if part.later is not None}
        bends += [np.array(path.edges) + lag for lag in lags if lag > 0.0]
    return bends


def _sent_before(line, g: int, times: np.ndarray, j: int, nodes: Nodes) -> np.ndarray:
    """What was sent to input j at times within one segment, (T, 1 + p m)."""
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
    """What will have been sent to an input at times within one part, (T, 1 + p m)."""
    part = next(each for each in own if middle < each.end)
    if part.later is None:
        return np.broadcast_to(part.held, (times.size, part.held.size))
    return np.einsum("n,knc->kc", part.gain, path.at(times + part.later, nodes))
