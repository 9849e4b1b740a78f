"""The ideal loop by a second discretisation, which shares no code with the package.

No differential equation is integrated. Between breakpoints the loop is a Volterra equation,

    x(t) = e^{A(t−a)} x(a) + ∫_a^t e^{A(t−θ)} B u(θ − D) dθ,
    u(t) = Σ_b K_b(t) [Φ_b(t+L, t) x(t) + ∫_{t−L}^t Φ_b(t+L, θ+L) B_b(θ+L) u(θ) dθ],

D the plant's delay, L the law's, Φ_b the model's transition along branch b of the law's belief.
Every integral is a Gauss sum over the pieces of its range, worked out anew for every node, so
nothing drifts. Pieces end at the switches, 0, the jumps of u₀ and the law's own breaks, and at
all their shifts by sums of D and L, however long the run; 14 nodes on pieces short enough that a
Taylor series gives the exponentials leave round-off only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

NODES, LONGEST = 14, 0.06


@dataclass
class Piecewise:
    """σ: mode `modes[i]` from `times[i]` on."""

    times: np.ndarray
    modes: np.ndarray

    def __call__(self, t: float) -> int:
        return int(self.modes[np.searchsorted(self.times, t, side="right") - 1])


@dataclass
class Belief:
    """What a law predicts with.

    Made at t, branch b, of `branches`, follows system `system(b, s, t)` at time s; `gain(b, t)`
    is K_b(t); `breaks` are the times at which either changes. Systems that predict more than the
    state start from `lift` times it.
    """

    A: np.ndarray
    B: np.ndarray
    lead: float
    branches: int
    system: Callable[[int, float, float], int]
    gain: Callable[[int, float], np.ndarray]
    breaks: np.ndarray
    lift: np.ndarray | None = None


def averaged(A, B, lead, K, weights) -> Belief:
    """Each mode for ever, with its weight."""
    return Belief(
        A, B, lead, len(A), lambda b, s, t: b, lambda b, t: weights[b] * K[b], np.empty(0)
    )


def single(A, B, lead, K) -> Belief:
    """One system (n, n), (n, m) for ever: the single-mode law and the mean law."""
    return averaged(A[None], B[None], lead, K[None], [1.0])


def exact(A, B, lead, K, sigma: Piecewise) -> Belief:
    """The signal σ is known."""
    breaks = np.concatenate((sigma.times[1:], sigma.times[1:] - lead))
    return Belief(
        A, B, lead, 1, lambda b, s, t: sigma(max(s, 0.0)), lambda b, t: K[sigma(t + lead)], breaks
    )


def dwelling(A, B, lead, after: Belief, dwell_time, sigma: Piecewise, age) -> Belief:
    """The mode at t until `dwell_time` after it began, then the branches of `after`.

    `age` is that of the first mode at time 0.
    """
    began = np.concatenate(([-age], sigma.times[1:]))
    ends = began + dwell_time

    def system(b, s, t):
        i = np.searchsorted(sigma.times, t, side="right") - 1
        return int(sigma.modes[i]) if s < ends[i] else len(A) + after.system(b, s, t)

    return Belief(
        np.concatenate((A, after.A)),
        np.concatenate((B, after.B)),
        lead,
        after.branches,
        system,
        after.gain,
        np.concatenate((sigma.times[1:], ends, ends - lead)),
    )


def markov(A, B, lead, K, generator, sigma: Piecewise) -> Belief:
    """The mean of K_σ(t+L) x(t + L) over a Markov process that starts in σ(t).

    One copy of (E[x 1{σ = i}])_i per mode s; copy s takes the inputs as if p = e_s, and copies
    mix by −Λ, so that the copies weighted by p(L) are what every input will have met.
    """
    modes, n = A.shape[:2]
    I_n, I_modes = np.eye(n), np.eye(modes)
    whole = sum(np.kron(np.outer(e, e), a) for e, a in zip(I_modes, A, strict=True))
    whole = whole + np.kron(generator.T, I_n)
    system = np.kron(I_modes, whole) - np.kron(generator, np.eye(modes * n))
    inputs = np.vstack([np.kron(e[:, None], b) for e, b in zip(I_modes, B, strict=True)])
    lift = np.vstack([np.kron(e[:, None], I_n) for e in I_modes])
    ahead = flow(generator, np.array([lead]))[0]
    row = np.hstack(list(K))
    return Belief(
        system[None],
        inputs[None],
        lead,
        1,
        lambda b, s, t: 0,
        lambda b, t: np.kron(ahead[sigma(t)], row),
        sigma.times[1:],
        lift,
    )


def delayed(K, sigma: Piecewise) -> Belief:
    """K_σ x, no prediction."""
    return Belief(
        np.empty(0),
        np.empty(0),
        0.0,
        1,
        lambda b, s, t: 0,
        lambda b, t: K[sigma(t)],
        sigma.times[1:],
    )


class _Rule:
    """Gauss nodes on [0, 1], and polynomials by their Legendre coefficients."""

    def __init__(self, count: int) -> None:
        z, w = legendre.leggauss(count)
        self.c, self.w = (z + 1.0) / 2.0, w / 2.0
        degrees = np.arange(count) + 0.5
        # Coefficients of the interpolant, by discrete orthogonality of the Gauss nodes.
        self.coefficients = degrees[:, None] * legendre.legvander(z, count - 1).T * w
        primitive = legendre.legint(np.eye(count), lbnd=-1.0, axis=0)
        self.integral = legendre.legvander(z, count) @ primitive @ self.coefficients / 2.0

    def evaluate(self, coefficients: np.ndarray, c: np.ndarray) -> np.ndarray:
        """Polynomials with coefficients (..., p, k) at c (...), both per point: (..., k)."""
        basis = legendre.legvander(2.0 * c - 1.0, self.c.size - 1)
        return np.einsum("...p,...pk->...k", basis, coefficients)


def flow(A: np.ndarray, times: np.ndarray) -> np.ndarray:
    """e^{A t} at short times (T,), by Taylor series."""
    scaled = A * np.asarray(times)[..., None, None]
    assert np.abs(scaled).sum(axis=-1).max(initial=0.0) < 4.0
    term = np.broadcast_to(np.eye(A.shape[0]), scaled.shape)
    total = term.copy()
    for k in range(1, 36):
        term = term @ scaled / k
        total += term
    return total


@dataclass
class Reference:
    """A solved run: x and u as polynomials on pieces, sampled as right limits."""

    edges: np.ndarray
    x: np.ndarray  # (pieces, p, n) Legendre coefficients
    u: np.ndarray  # (pieces, p, m)
    rule: _Rule
    horizon: float

    def _sample(self, coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        g = np.searchsorted(self.edges, t + 1e-11, side="right") - 1
        g = np.clip(g, 0, self.edges.size - 2)
        c = (t - self.edges[g]) / (self.edges[g + 1] - self.edges[g])
        return self.rule.evaluate(coefficients[g], c).T

    def states(self, t: np.ndarray) -> np.ndarray:
        """x (n, T)."""
        return self._sample(self.x, t)

    def inputs(self, t: np.ndarray) -> np.ndarray:
        """u (m, T)."""
        return self._sample(self.u, t)


def _closure(seeds: np.ndarray, delays: set[float], high: float) -> np.ndarray:
    """The seeds and their shifts by all sums of the delays, up to `high`."""
    found, front = [seeds], seeds
    while front.size:
        front = np.unique(np.concatenate([front + delay for delay in delays]).round(13))
        front = front[front <= high]
        found.append(front)
    return np.concatenate(found)


def _mesh(seeds: np.ndarray, delays: set[float], low: float, high: float, longest: float):
    """All edges from `low` to `high`, 0 among them."""
    times = np.sort(np.concatenate((_closure(seeds, delays, high), [low, 0.0, high])))
    times = times[(times >= low - 1e-12) & (times <= high + 1e-12)]
    kept = [times[0]]
    for time in times[1:]:
        if time - kept[-1] > 1e-12:
            parts = int(np.ceil((time - kept[-1]) / longest))
            kept += [*(kept[-1] + (time - kept[-1]) * np.arange(1, parts) / parts), time]
    edges = np.array(kept)
    edges[np.argmin(np.abs(edges))] = 0.0
    return edges


def solve(
    A: np.ndarray,
    B: np.ndarray,
    delay: float,
    sigma: Piecewise,
    belief: Belief,
    x0: np.ndarray,
    horizon: float,
    u0: Callable[[float], np.ndarray] | None = None,
    u0_breaks: tuple[float, ...] = (),
    nodes: int = NODES,
    longest: float = LONGEST,
) -> Reference:
    """The loop on [0, horizon], and x a delay further."""
    rule = _Rule(nodes)
    p, n, m = nodes, A.shape[1], B.shape[2]
    delays = {delay, belief.lead} - {0.0}
    low = -max(delays)
    seeds = np.concatenate(([0.0, horizon], sigma.times, belief.breaks, u0_breaks))
    longest = min(longest, min(delays) / 2.0)
    edges = _mesh(seeds, delays, low, horizon + delay + longest, longest)
    pieces = edges.size - 1
    run = Reference(edges, np.zeros((pieces, p, n)), np.zeros((pieces, p, m)), rule, horizon)
    flows, sums = {}, {}

    def remember(g: int, u: np.ndarray) -> None:
        """Keep u on a piece, and with every system its flow over it and ∫ e^{A(b−θ)} B u dθ."""
        run.u[g] = rule.coefficients @ u
        length = edges[g + 1] - edges[g]
        for s in range(len(belief.A)):
            flows[g, s] = flow(belief.A[s], np.array([length]))[0]
            back = flow(belief.A[s], (1.0 - rule.c) * length)
            sums[g, s] = length * np.einsum("k,kij,jl,kl->i", rule.w, back, belief.B[s], u)

    x = np.asarray(x0, dtype=float)
    for g in range(pieces):
        a, length = edges[g], edges[g + 1] - edges[g]
        t = a + rule.c * length
        if a < 0.0:
            remember(g, np.zeros((p, m)) if u0 is None else np.array([u0(s) for s in t]))
            continue
        i = sigma(a + length / 2.0)
        ahead, back = flow(A[i], rule.c * length), flow(A[i], -rule.c * length)
        arriving = run.inputs(t - delay).T
        forced = np.einsum("kij,jl,kl->ki", back, B[i], arriving)
        states = np.einsum("kij,kj->ki", ahead, x + length * rule.integral @ forced)
        whole = flow(A[i], np.array([length]))[0]
        x = whole @ (x + length * rule.w @ forced)
        run.x[g] = rule.coefficients @ states
        if a <= horizon + 1e-12:
            remember(g, _inputs(run, belief, g, states, flows, sums))
    return run


def _inputs(run, belief, g, states, flows, sums) -> np.ndarray:
    """u at the nodes of piece g: a linear system, since u(t) depends on u since the piece began."""
    edges, rule, lead = run.edges, run.rule, belief.lead
    p, m = states.shape[0], run.u.shape[2]
    a, length = edges[g], edges[g + 1] - edges[g]
    middle, t = a + length / 2.0, a + rule.c * length
    matrix, right = np.eye(p * m).reshape(p, m, p, m), np.zeros((p, m))
    for b in range(belief.branches):
        K = belief.gain(b, middle)
        if lead == 0.0:
            right += states @ K.T
            continue
        s = belief.system(b, middle + lead, middle)
        ahead, back = flow(belief.A[s], rule.c * length), flow(belief.A[s], -rule.c * length)
        known = _window(run, belief, b, g, t - lead, states, flows, sums)
        right += np.einsum("ij,kjl,kl->ki", K, ahead, known)
        kernel = np.einsum("ij,kjl,qlr,rs->kiqs", K, ahead, back, belief.B[s], optimize=True)
        matrix -= length * kernel * rule.integral[:, None, :, None]
    return np.linalg.solve(matrix.reshape(p * m, p * m), right.ravel()).reshape(p, m)


def _window(run, belief, b, g, starts, states, flows, sums) -> np.ndarray:
    """The branch's state at edges[g] + L, from x at each node and the inputs since t_k − L."""
    edges, rule = run.edges, run.rule
    first = np.searchsorted(edges, starts, side="right") - 1
    states = states if belief.lift is None else states @ belief.lift.T
    n = states.shape[1]
    made = (edges[g] + edges[g + 1]) / 2.0
    result = np.empty_like(states)
    transition, total = np.eye(n), np.zeros(n)
    for q in range(g - 1, first.min() - 1, -1):
        end = edges[q + 1]
        s = belief.system(b, (edges[q] + end) / 2.0 + belief.lead, made)
        A, B = belief.A[s], belief.B[s]
        here = first == q
        if here.any():
            rest = end - starts[here]
            back = rest[:, None] * (1.0 - rule.c)
            c = (end - back - edges[q]) / (end - edges[q])
            arriving = rule.evaluate(run.u[q], c) @ B.T
            tail = rest[:, None] * np.einsum("j,kjil,kjl->ki", rule.w, flow(A, back), arriving)
            tail += np.einsum("kij,kj->ki", flow(A, rest), states[here])
            result[here] = total + tail @ transition.T
        total = total + transition @ sums[q, s]
        transition = transition @ flows[q, s]
    return result
