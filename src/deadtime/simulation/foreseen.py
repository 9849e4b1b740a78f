"""A law that knows the signal, in the loop of a single run: its prediction by two stacks.

At t_k the prediction goes through the model's pieces from t_k to t_k + D, each an affine map under
the input that acts in it. From sample to sample pieces leave this window at its begin and enter at
its end. Those that enter are composed into `back`; once the older ones are used up, the pieces of
the window become suffixes, slot q the composition of all from q on. So nothing is inverted, a
sample costs a few products of matrices however long the delay is, and every prediction starts from
the x_k that was measured.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.feedback import Foresight
from deadtime.numerics.kernels import kernel
from deadtime.plant.cut_pieces import go_on
from deadtime.plant.pieces import PieceTable
from deadtime.switching.grid import cuts_of


class Foreseen(NamedTuple):
    """A law that knows the signal, and its two stacks, for `foresee`.

    table : PieceTable, the model's pieces along the signal
    sample : (pieces, m), the k of the u_k that acts in each
    until : (samples,), the pieces before which the inputs before u_k act
    gain : (samples, m, n), K of the mode at t_k + D
    latest : (m, m), what u_{k−1} adds
    Phi : (slots + 2, n, n), v : (slots + 2, n, 1), after the slots `back` and a spare one
    bounds : the piece before which slots are used, and that before which pieces have entered
    """

    table: PieceTable
    sample: Int[np.ndarray, "piece m"]
    until: Int[np.ndarray, " sample"]
    gain: Float[np.ndarray, "sample m n"]
    latest: Float[np.ndarray, "m m"]
    Phi: Float[np.ndarray, "slot n n"]
    v: Float[np.ndarray, "slot n 1"]
    bounds: Int[np.ndarray, " 2"]

    @classmethod
    def of(cls, foresight: Foresight, samples: int) -> Foreseen:
        """A law's foresight over a run, with empty stacks that have room for the longest window."""
        sampled, signal = foresight.sampled, foresight.signal
        cuts = cuts_of(signal, sampled)
        table = sampled.along(cuts, samples + sampled.longest_lag)
        sample, n = table.sample, sampled.plant.states
        until = np.searchsorted(sample.min(axis=1), np.arange(samples))
        gain = foresight.gains[foresight.modes_ahead(samples)]
        slots = max(1, int((until - table.first[:samples]).max())) + 2
        stacks = np.zeros((slots, n, n)), np.zeros((slots, n, 1)), np.zeros(2, np.int64)
        sample, until, gain = map(read_only, (sample, until, gain))
        return cls(table, sample, until, gain, read_only(foresight.latest), *stacks)


@kernel
def _put(law, slot, q, past, told):
    """Put piece q, under the inputs told, into a slot."""
    e = law.table.entry[q]
    n, m = law.table.Gamma.shape[1:]
    for i in range(n):
        entered = 0.0
        for j in range(m):
            entered += law.table.Gamma[e, i, j] * told[past + law.sample[q, j], j]
        law.v[slot, i, 0] = entered
        for j in range(n):
            law.Phi[slot, i, j] = law.table.Phi[e, i, j]


@kernel
def _through(Phi, v, x):
    """Let x go through a map."""
    n = x.size
    moved = np.empty(n)
    for i in range(n):
        total = v[i, 0]
        for j in range(n):
            total += Phi[i, j] * x[j]
        moved[i] = total
    for i in range(n):
        x[i] = moved[i]


@kernel
def _predict(law, k, past, told, x):
    """Let x, the state at t_k, go on to t_k + D under the inputs told, u_k in row past + k."""
    slots, n = law.Phi.shape[0] - 2, x.size
    back, spare = slots, slots + 1
    begin, end = law.table.first[k], law.until[k]
    if begin >= law.bounds[0]:
        for q in range(end - 1, begin - 1, -1):
            slot, after = q % slots, (q + 1) % slots
            _put(law, slot, q, past, told)
            if q < end - 1:
                go_on(law.Phi[slot], law.v[slot], law.Phi[after], law.v[after])
        for i in range(n):
            law.v[back, i, 0] = 0.0
            for j in range(n):
                law.Phi[back, i, j] = 1.0 if i == j else 0.0
        law.bounds[0] = end
    else:
        for q in range(law.bounds[1], end):
            _put(law, spare, q, past, told)
            go_on(law.Phi[back], law.v[back], law.Phi[spare], law.v[spare])
    law.bounds[1] = end
    if begin < law.bounds[0]:
        _through(law.Phi[begin % slots], law.v[begin % slots], x)
    _through(law.Phi[back], law.v[back], x)


@kernel
def foresee(law, k, past, told, x, answer):
    """The input of sample k for the state x: K x(t_k + D) + L u_{k−1}."""
    m, n = law.gain.shape[1:]
    ahead = np.empty(n)
    for i in range(n):
        ahead[i] = x[i]
    _predict(law, k, past, told, ahead)
    for i in range(m):
        total = 0.0
        for j in range(m):
            total += law.latest[i, j] * told[past + k - 1, j]
        for j in range(n):
            total += law.gain[k, i, j] * ahead[j]
        answer[i] = total
