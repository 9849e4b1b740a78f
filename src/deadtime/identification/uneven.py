"""Uneven samples: what acts in a period is cut where each input arrives, t_i + D.

With c the arrivals within (t_k, t_{k+1}) and Δu what each of them changes,

    x_{k+1} = Φ(τ_k) x_k + Σ_j [W(τ_k) b_j u_j(t_k − D_j) + Σ_c W(t_{k+1} − c) b_j Δu_j(c)] + w_k,

and ∂x_{k+1}/∂D_j = −Σ_c Φ(t_{k+1} − c) b_j Δu_j(c). Φ and W of the many times are interpolated
between nodes, to round-off, so that all this is a regression again, on the weights of the nodes.
The noise of a period grows with its length: it is S_i τ_k / h.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import Layout
from deadtime.identification.regression import Term
from deadtime.identification.transition import interpolation, nodes_of, transitions_of

_BLOCK = 2_000_000  # numbers of a log that are stacked at a time
_ROUND_OFF = 1e-9  # of a period: an arrival so close to a sample is at it


class ActingInputs(NamedTuple):
    """What acts in periods: `held` (periods, nodes, m), W's weights; `moved`, those of −∂/∂D."""

    held: Float[np.ndarray, "period node m"]
    moved: Float[np.ndarray, "period node m"]


def usable(
    part: Part, within: bool, longest: float, shortest: float
) -> Bool[np.ndarray, " period"]:
    """The periods whose mode, ends and inputs are known, for delays between two, seconds."""
    known = np.asarray(np.isfinite(part.output).all(axis=1))
    good = known[:-1] & known[1:] & fed(part, longest, shortest)
    return good & (part.mode[:-1] == part.mode[1:]) if within else good


def fed(part: Part, longest: float, shortest: float) -> Bool[np.ndarray, " period"]:
    """The periods in which all that can act is known."""
    t = part.time
    lost = np.concatenate(([0], np.cumsum(~np.isfinite(part.input).all(axis=1))))
    slack = _ROUND_OFF * float(np.median(np.diff(t)))
    oldest = np.searchsorted(t, t[:-1] - longest + slack, side="right") - 1
    newest = np.searchsorted(t, t[1:] - shortest - slack, side="left")
    newest = np.maximum(np.minimum(newest, t.size), oldest + 1)
    known = lost[newest] == lost[np.maximum(oldest, 0)]
    return known if part.rests else known & (oldest >= 0)


def acting_in(
    part: Part,
    k: np.ndarray,
    delays: Float[np.ndarray, "mode m"],
    nodes: Float[np.ndarray, " node"],
) -> ActingInputs:
    """What acts in periods k of a part, each with the delays of its mode.

    Before the part's first row its first inputs act: such periods are used where it rests there.
    """
    t, m = part.time, part.input.shape[1]
    held = np.zeros((k.size, nodes.size, m))
    moved = np.zeros(held.shape)
    if k.size == 0:
        return ActingInputs(held, moved)
    slack = _ROUND_OFF * float(np.median(t[k + 1] - t[k]))
    over = interpolation(nodes, t[k + 1] - t[k])
    for j in range(m):
        u, D = part.input[:, j], delays[part.mode[k], j]
        first = np.maximum(np.searchsorted(t, t[k] - D + slack, side="right") - 1, 0)
        last = np.searchsorted(t, t[k + 1] - D - slack, side="left") - 1
        held[:, :, j] = over * u[first][:, None]
        for later in range(1, int((last - first).max(initial=0)) + 1):
            has = np.flatnonzero(first + later <= last)
            index = first[has] + later
            change = (u[index] - u[index - 1])[:, None]
            weight = interpolation(nodes, t[k[has] + 1] - t[index] - D[has]) * change
            held[has, :, j] += weight
            moved[has, :, j] += weight
    return ActingInputs(held, moved)


def nodes_for(parts: tuple[Part, ...], A: Float[np.ndarray, "mode n n"]) -> np.ndarray:
    """Nodes that serve plants about A over all periods of a recording."""
    longest = max(float(np.diff(part.time).max()) for part in parts)
    rate = 2.0 * float(np.abs(np.linalg.eigvals(A)).max()) + 1.0 / longest
    return nodes_of(longest * (1.0 + 1e-9), min(rate, 200.0 / longest))


def uneven_terms(
    parts: tuple[Part, ...],
    good: list[np.ndarray],
    layout: Layout,
    step: float,
    nodes: np.ndarray,
    theta: np.ndarray,
) -> list[Term]:
    """The regressions of unevenly sampled logs, over the periods `good` of every part."""
    A, B, delays = layout.split(theta)
    modes, size = range(layout.modes), node_columns(layout, nodes)
    roots, counts, block = (
        [np.zeros((0, size)) for _ in modes],
        [0] * len(modes),
        max(size, _BLOCK // size),
    )
    for part, every in zip(parts, good, strict=True):
        for start in range(0, every.size, block):
            k = every[start : start + block]
            for i in modes:
                own = k[part.mode[k] == i]
                counts[i] += own.size
                rows = node_rows(part, own, delays[i], nodes, step, layout.constant)
                roots[i] = np.vstack((roots[i], rows))
                if len(roots[i]) > size:
                    roots[i] = np.asarray(np.linalg.qr(roots[i], mode="r"))
    return [node_term(roots[i], counts[i], layout, i, A[i], B[i], nodes) for i in modes]


def node_columns(layout: Layout, nodes: Float[np.ndarray, " node"]) -> int:
    """How many columns `node_rows` has."""
    return layout.n + nodes.size * (layout.n + layout.acting + layout.m)


def node_rows(
    part: Part,
    k: np.ndarray,
    delays: Float[np.ndarray, " m"],
    nodes: Float[np.ndarray, " node"],
    step: float,
    constant: bool,
) -> Float[np.ndarray, "period z"]:
    """z = (x_{k+1}, r_k) / √(τ_k/h) of periods k, all of one mode: r_k by the weights of nodes."""
    length = part.time[k + 1] - part.time[k]
    one = part._replace(mode=np.zeros(part.time.size, np.int64))
    acts, over = acting_in(one, k, delays[None], nodes), interpolation(nodes, length)[:, :, None]
    held = np.concatenate((acts.held, over), axis=2) if constant else acts.held
    x = over * part.output[k][:, None]
    z = [part.output[k + 1], *(one.reshape(k.size, -1) for one in (x, held, acts.moved))]
    return np.hstack(z) / np.sqrt(length / step)[:, None]


def node_term(
    root: np.ndarray,
    periods: int,
    layout: Layout,
    mode: int,
    A: np.ndarray,
    B: np.ndarray,
    nodes: np.ndarray,
) -> Term:
    """The regression of a mode on rows of `node_rows`."""
    n, m, acting, count = layout.n, layout.m, layout.acting, nodes.size
    over, whole = transitions_of(A, nodes), layout.n + layout.acting
    P = np.zeros((n, count, whole + m))
    by_P = np.zeros((n * whole + m, *P.shape))

    def side(M: np.ndarray) -> np.ndarray:
        """(…, node, n, c) as (…, n, node, c)."""
        return np.moveaxis(M, -2, -3)

    P[:, :, :n], P[:, :, n:whole] = side(over.Phi), side(over.W @ B)
    by_P[: n * n, :, :, :n] = side(over.Phi_by_A.swapaxes(0, 1))
    by_P[: n * n, :, :, n:whole] = side((over.W_by_A @ B).swapaxes(0, 1))
    for j in range(acting):
        by_P[n * n + np.arange(n) * acting + j, :, :, n + j] = over.W.transpose(2, 1, 0)
    for j in range(m):
        by_P[n * whole + j, :, :, whole + j] = -(over.Phi @ B[:, j]).T
    order = [count * n, count * acting, count * m]
    flat = [
        M.reshape(*M.shape[:-2], size)
        for M, size in zip(np.split(P, [n, whole], axis=-1), order, strict=True)
    ]
    moved = [
        M.reshape(*M.shape[:-2], size)
        for M, size in zip(np.split(by_P, [n, whole], axis=-1), order, strict=True)
    ]
    own = (layout.of_A[mode].ravel(), layout.of_B[mode].ravel(), layout.of_delay[mode])
    parts = np.concatenate(flat, axis=-1), np.concatenate(moved, axis=-1)
    return Term(root, periods, *parts, np.concatenate(own))


def on_a_grid(part: Part, step: float) -> Part:
    """A part as if it were sampled evenly, for a first guess: states between samples on lines."""
    time = part.time[0] + step * np.arange(int((part.time[-1] - part.time[0]) / step) + 1)
    before = np.searchsorted(part.time, time * (1.0 + 1e-15), side="right") - 1
    columns = [np.interp(time, part.time, column) for column in part.output.T]
    output = np.column_stack(columns)
    return Part(time, output, part.input[before], part.mode[before], part.rests)


def gridded(recording: Recording) -> Recording:
    """A recording as if it were sampled evenly; itself where it is."""
    if recording.even:
        return recording
    parts = tuple(on_a_grid(part, recording.step) for part in recording.parts)
    return recording._replace(parts=parts, even=True)
