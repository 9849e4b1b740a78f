"""The digital loop of many scenarios at once, in JAX: as `deadtime.scenarios.kernel` has it.

Scenarios are the last axis of every array, so that a period is a few products of small matrices
with long rows. Sizes are static; laws, signals and limits are arguments, so that laws of one shape
share one compiled function. Only `deadtime.scenarios.jax_engine` imports this module: JAX is
optional, and the engine knows how to say so.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from deadtime.scenarios.jax_arguments import Law, Run, Signals, Sizes

OUTSIDE = 0.02**2
_THERE = "promise_in_bounds"  # the host made the indices


def _product(matrix: Array, vectors: Array) -> Array:
    """(…, i, j) times (…, j, scenario)."""
    return jnp.matmul(matrix, vectors, precision="highest")


class _Ring(NamedTuple):
    """How far back inputs are kept; those from before time 0 are rows never written."""

    samples: int
    length: int

    @classmethod
    def of(cls, sizes: Sizes) -> _Ring:
        return cls(sizes.samples, min(max(sizes.back, sizes.taps), sizes.samples) + 1)

    def place(self, k: Array, back: Any) -> Array:
        """Where u_{k−back} is."""
        return (k - jnp.minimum(back, self.samples)) % self.length


def _asked(sizes: Sizes, law: Law, ring: _Ring, x, b, inputs, k, row, earlier) -> Array:
    """The input (m, scenario) that the law's row asks for."""
    rows, m, columns = law.table.shape
    if sizes.window:
        seen = x, b, inputs[ring.place(k, sizes.taps)]
    else:
        taps = (columns - x.shape[0]) // m
        places = ring.place(k, 1 + jnp.arange(taps))
        seen = x, inputs[places].reshape(taps * m, x.shape[1])
    if sizes.own:
        own = law.table.at[row].get(mode=_THERE)
        return jnp.einsum("sij,js->is", own, jnp.concatenate(seen), precision="highest")
    sums = _product(law.table.reshape(rows * m, -1), jnp.concatenate(seen)) + earlier
    sums = sums.reshape(rows, m, -1)
    return sums[0] if row is None else jnp.take_along_axis(sums, row[None, None], axis=0)[0]


def _next_sum(law: Law, b: Array, u: Array) -> Array:
    """b ← S b + Γ u, with S in blocks."""
    blocks, size, _ = law.transition.shape
    moved = _product(law.transition, b.reshape(blocks, size, -1))
    return moved.reshape(b.shape) + _product(law.enter, u)


def _period(sizes: Sizes, law: Law, signals: Signals, run: Run, carry, at):
    """One period: from (x, b, inputs) at sample k to those at sample k + 1."""
    x, b, inputs = carry
    k, index, row, earlier = at
    ring, n = _Ring.of(sizes), x.shape[0]
    before, old = inputs[ring.place(k, 1)], inputs[ring.place(k, sizes.back)]
    u = _asked(sizes, law, ring, x, b, inputs, k, row, earlier)
    for rate, low, high in zip(run.rate, run.low, run.high, strict=True):
        base = rate * before
        u = jnp.minimum(jnp.maximum(u, base + low[:, None]), base + high[:, None])
    new = u if sizes.back == 1 else inputs[ring.place(k, sizes.back - 1)]
    inputs = inputs.at[k % ring.length].set(u)
    if sizes.window:
        b = _next_sum(law, b, u)
    wide = sizes.wide
    z = jnp.concatenate((x, old, new))[:wide]
    own = signals.maps.at[:, index].get(mode=_THERE)
    i, j = jnp.triu_indices(wide)
    ise = (own[n * wide :] * z[i] * z[j]).sum(axis=0)
    after = (own[: n * wide].reshape(n, wide, -1) * z).sum(axis=1)
    kept = (x, u) if sizes.path else None
    return (after, b, inputs), (ise, (u * u).sum(axis=0), (after * after).sum(axis=0), kept)


def _refill(law: Law, ring: _Ring, window: int, inputs: Array, k: Array) -> Array:
    """What the block of inputs before sample k adds to each sum of the coming one.

    With s_r = Σ_{i ≥ r} S^{W−1−i} Γ u_{k−W+i}, the sum r periods on gets H S^r s_r. Nothing is
    subtracted, so nothing cancels.
    """
    _, rows, m, q = law.behind.shape

    def add(s, at):
        ahead, behind, back = at
        s = s + _product(ahead, inputs[ring.place(k, back)])
        return s, _product(behind.reshape(rows * m, q), s)

    back = window - jnp.arange(window)
    start = jnp.zeros((q, inputs.shape[2]))
    return lax.scan(add, start, (law.ahead, law.behind, back), reverse=True)[1]


def _periods(sizes: Sizes, law: Law, signals: Signals, run: Run):
    """Per period ∫|x|², |u|², |x|² at its end and, if asked for, x and u at its start."""
    ring, scenarios, samples = _Ring.of(sizes), signals.index.shape[1], sizes.samples
    m, q = law.table.shape[1], 0 if law.enter is None else law.enter.shape[0]
    x = jnp.tile(run.x0[:, None], scenarios)
    inputs = jnp.zeros((ring.length, m, scenarios))
    one = partial(_period, sizes, law, signals, run)
    if sizes.window == 0 or sizes.window >= samples:
        # No block of inputs is ever before another one.
        b = jnp.zeros((q, scenarios))
        coming = jnp.arange(samples), signals.index, signals.row
        return lax.scan(lambda c, at: one(c, (*at, 0.0)), (x, b, inputs), coming)[1]

    blocks = -(-samples // sizes.window)

    def cut(a):
        extra = ((0, blocks * sizes.window - samples),) + ((0, 0),) * (a.ndim - 1)
        return jnp.pad(a, extra, mode="edge").reshape(blocks, sizes.window, *a.shape[1:])

    def block(carry, at):
        x, inputs = carry
        earlier = _refill(law, ring, sizes.window, inputs, at[0][0])
        b = jnp.zeros((q, scenarios))
        (x, _, inputs), kept = lax.scan(one, (x, b, inputs), (*at, earlier))
        return (x, inputs), kept

    k = jnp.arange(blocks * sizes.window).reshape(blocks, -1)
    coming = k, cut(signals.index), None if signals.row is None else cut(signals.row)
    kept = lax.scan(block, (x, inputs), coming)[1]
    # Periods past the end, which fill the last block, are cut off again.
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:samples], kept)


@partial(jax.jit, static_argnums=0)
def run_scenarios(sizes: Sizes, law: Law, signals: Signals, run: Run):
    """Figures (8, scenario) in the order of `Figures`; x and u (sample, …, scenario) or None."""
    ise, energy, after, kept = _periods(sizes, law, signals, run)
    samples, late = sizes.samples, sizes.late
    start = jnp.broadcast_to(run.x0 @ run.x0, after[:1].shape)
    norm = jnp.concatenate((start, after[:-1]))
    peak = norm.max(axis=0)
    # The peak so far is the peak from where it is reached on, and there |x| is not below 2 % of it.
    k = jnp.arange(samples, dtype=norm.dtype)[:, None]
    last = jnp.where(norm > OUTSIDE * peak, k, -1.0).max(axis=0)
    logs = jnp.log(norm[late:])
    times = jnp.arange(samples - late, 0, -1, dtype=norm.dtype)[:, None]
    figures = (
        ise.sum(axis=0),
        energy[:-1].sum(axis=0) + run.rest * energy[-1],
        peak,
        last,
        norm[late:].min(axis=0),
        logs.sum(axis=0),
        (times * logs).sum(axis=0),
        after[-1],
    )
    return jnp.stack(figures), kept
