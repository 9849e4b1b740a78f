"""The sampled loop run period by period, compiled, forwards and transposed.

Inputs, cost and growth of a linear loop follow from one recursion:

    u_k = F x_k + Σ_j G_j u_{k−j},    x ← Φ x + Σ_j Γ_j u_{k−lag_j, j} over each piece of a period,

a period beginning with its sample. A long run overflows or underflows, so it may be weighted,
x̃_k = w^k x_k and ũ_k = w^k u_k with w near 1/(growth over a period):

    ũ_k = F x̃_k + Σ_j w^j G_j ũ_{k−j},    x̃ ← Φ x̃ + Σ_j w^{lag_j} Γ_j ũ_{k−lag_j, j},
    x̃_{k+1} = w x̃.

Searches run these loops for long, so they are always compiled. They make no arrays, which halves
the time of compiling.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.feedback import Feedback
from deadtime.numerics.kernels import kernel
from deadtime.plant.pieces import Period, Piece


class LoopPeriods(NamedTuple):
    """The periods of a loop for its compiled runs, repeated cyclically.

    first, entry, Phi, Gamma, lag : the plant's pieces, as in a `PieceTable`
    rows : (periods,), of the law's table
    F : (contexts, m, n), G : (contexts, m, taps·m), that table, weighted, the oldest input first
    weight : w, of one period
    power : (entries,), w^lag of the first input of every entry
    others : (entries, m), w^lag of every input over that of the first
    """

    first: Int[np.ndarray, " period+1"]
    entry: Int[np.ndarray, " piece"]
    Phi: Float[np.ndarray, "entry n n"]
    Gamma: Float[np.ndarray, "entry n m"]
    lag: Int[np.ndarray, "entry m"]
    rows: Int[np.ndarray, " period"]
    F: Float[np.ndarray, "context m n"]
    G: Float[np.ndarray, "context m window"]
    weight: float
    power: Float[np.ndarray, " entry"]
    others: Float[np.ndarray, "entry m"]

    @classmethod
    def of(
        cls,
        pieces: tuple[np.ndarray, ...],
        rows: Int[np.ndarray, " period"],
        F: Float[np.ndarray, "context m n"],
        G: Float[np.ndarray, "context m window"],
        weight: float = 1.0,
    ) -> LoopPeriods:
        """Periods of pieces, the first five fields; read-only arrays, one type for the compiler."""
        lag = pieces[4]
        power, others = weight ** lag[:, 0], weight ** (lag - lag[:, :1])
        parts = *pieces[:5], rows, F, G, weight, power, others
        return cls._make(read_only(one) if isinstance(one, np.ndarray) else one for one in parts)

    @classmethod
    def held(cls, pieces: tuple[Piece, ...], feedback: Feedback, row: int) -> LoopPeriods:
        """One period of a mode that is held, under a row of a table."""
        Phi, Gamma = np.stack([one.Phi for one in pieces]), np.stack([one.Gamma for one in pieces])
        lag = np.stack([one.stretch.lag for one in pieces])
        F, G = feedback.state_gain[row], feedback.input_gain[row]
        return cls._repeated(Phi, Gamma, lag, F, G)

    @classmethod
    def of_period(
        cls, period: Period, F: Float[np.ndarray, "m n"], G: Float[np.ndarray, "tap m m"]
    ) -> LoopPeriods:
        """A whole period, lag by lag, under a row (F, G): only the first piece moves the state."""
        Phi = np.tile(np.eye(len(period.Phi)), (len(period.lags), 1, 1))
        Phi[0] = period.Phi
        lag = np.repeat(np.array(period.lags)[:, None], len(F), axis=1)
        return cls._repeated(Phi, period.Gamma, lag, F, G)

    @classmethod
    def _repeated(
        cls, Phi: np.ndarray, Gamma: np.ndarray, lag: np.ndarray, F: np.ndarray, G: np.ndarray
    ) -> LoopPeriods:
        entry, taps = np.arange(len(Phi)), G[::-1].transpose(1, 0, 2).reshape(len(F), -1)
        pieces = np.array([0, len(Phi)]), entry, Phi, Gamma, lag
        return cls.of(pieces, np.zeros(1, np.int64), F[None], taps[None])

    def until(self, periods: int) -> LoopPeriods:
        """The first periods."""
        return self._replace(first=self.first[: periods + 1], rows=self.rows[:periods])

    @property
    def past(self) -> int:
        """The number of past inputs that a run needs."""
        return max(self.G.shape[2] // self.G.shape[1], int(self.lag.max()))


@kernel(
    eager=True,
    fastmath={"reassoc", "contract"},
    nogil=True,
    no_cpython_wrapper=True,
    forceinline=True,
    _nrt=False,
)
def _dot(a, b):
    """Σ a_i b_i, summed in any order (so that it vectorises)."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@kernel(eager=True, nogil=True, _nrt=False)
def forward(loop, x, line, states):
    """Run period after period from x and the inputs at the beginning of `line`, in place.

    `line` ((W + samples)·m,) has the inputs of one period after those of another, and `states`
    (samples, n) gets x̃ at the end of every period.
    """
    F, G, Phi, Gamma = loop.F, loop.G, loop.Phi, loop.Gamma
    n, m, window, cycle = x.size, G.shape[1], G.shape[2], loop.rows.size
    samples = states.shape[0]
    past = line.size // m - samples
    for k in range(samples):
        step = k % cycle
        row, now = loop.rows[step], (past + k) * m
        # The taps lie oldest first, as the line does, so that a row is one dot product with it.
        for i in range(m):
            line[now + i] = _dot(G[row, i], line[now - window : now]) + _dot(F[row, i], x)
        for q in range(loop.first[step], loop.first[step + 1]):
            e = loop.entry[q]
            for i in range(n):
                total = 0.0
                for j in range(m):
                    acting = loop.others[e, j] * line[now - loop.lag[e, j] * m + j]
                    total += Gamma[e, i, j] * acting
                # One power for all inputs: others are 1 but where delays differ.
                total *= loop.power[e]
                for j in range(n):
                    total += Phi[e, i, j] * x[j]
                states[k, i] = total
            for i in range(n):
                x[i] = states[k, i]
        for i in range(n):
            x[i] *= loop.weight
            states[k, i] = x[i]


@kernel(eager=True, nogil=True, _nrt=False)
def carry_back(loop, p, line, moved):
    """Carry a functional of the lifted state back over one round of all periods, in place.

    It is (p, the last W inputs of `line`) at the end, and (p, the first W) at the start, `line`
    ((W + samples)·m,) as in `forward`; the others must be 0 at first. `moved` (n,) is overwritten.
    """
    F, G, Phi, Gamma = loop.F, loop.G, loop.Phi, loop.Gamma
    n, m, window, cycle = p.size, G.shape[1], G.shape[2], loop.rows.size
    past = line.size // m - cycle
    for k in range(cycle - 1, -1, -1):
        row, now = loop.rows[k], (past + k) * m
        for q in range(loop.first[k + 1] - 1, loop.first[k] - 1, -1):
            e = loop.entry[q]
            # Forwards the weight of the period comes last, so transposed it comes first.
            end = loop.weight if q == loop.first[k + 1] - 1 else 1.0
            for j in range(m):
                acts = now - loop.lag[e, j] * m + j
                own = end * loop.power[e] * loop.others[e, j]
                for i in range(n):
                    line[acts] += own * Gamma[e, i, j] * p[i]
            for j in range(n):
                moved[j] = 0.0
                for i in range(n):
                    moved[j] += end * Phi[e, i, j] * p[i]
            for j in range(n):
                p[j] = moved[j]
        for i in range(m):
            u = line[now + i]
            for j in range(n):
                p[j] += F[row, i, j] * u
            for j in range(window):
                line[now - window + j] += G[row, i, j] * u


@kernel(eager=True, nogil=True, _nrt=False)
def cost_of_run(loop, form, lags, x, line, states, spare, most, done, largest):
    """Σ_k z_kᵀ form z_k from x with no inputs in the past, z_k = (x_k, u_{k−lags[0]}, …).

    Blocks of as many periods as `states` (block, n) has rows are run, `line` ((W + block)·m,) in
    hand, until one adds less than `done` of the sum, or `most` are; what is then missing is the
    tail of a geometric series. Returns the sum and the ratio of the last two blocks; a sum of ∞
    where that is 1 or more, or |x|² is beyond `largest`. `spare` (order of the form,) is
    overwritten.
    """
    n, block = states.shape[1], states.shape[0]
    m, size = loop.G.shape[1], form.shape[0]
    past = line.size // m - block
    total, before, ratio, first = 0.0, 0.0, 0.0, 0.0
    for i in range(line.size):
        line[i] = 0.0
    for i in range(n):
        spare[i] = x[i]
    for rounds in range(most):
        for i in range(past * m):
            line[i] = line[block * m + i]
        forward(loop, x, line, states)
        added = 0.0
        # `states` has ends of periods: the state that a period starts from is kept in `spare`.
        for k in range(block):
            for p in range(lags.size):
                for j in range(m):
                    spare[n + p * m + j] = line[(past + k - lags[p]) * m + j]
            for i in range(size):
                row = 0.0
                for j in range(size):
                    row += form[i, j] * spare[j]
                added += row * spare[i]
            for i in range(n):
                spare[i] = states[k, i]
        total += added
        if not total < largest:
            return np.inf, (added / first) ** (1.0 / rounds) if rounds > 0 else largest
        if added <= done * total:
            return total, added / before if before > 0.0 else 0.0
        ratio = added / before if before > 0.0 else 1.0
        before = added
        first = first if first > 0.0 else added
    if ratio >= 1.0:
        return np.inf, ratio
    return total + before * ratio / (1.0 - ratio), ratio
