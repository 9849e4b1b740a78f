"""States of laws in eight scenarios: observers, beliefs, banks, and the outputs that they measure.

A law on a belief commands Σ_c π_c u_c over its rows. With a bank the rows get x = 0, and
Σ_c π_c F_c x̂ with the estimate x̂ of the row's mode is added.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deadtime.feedback.belief import BankForm, Belief
from deadtime.feedback.memory import Memory
from deadtime.loop.bank_steps import BankState, add_estimates, advance_bank, begin_bank
from deadtime.loop.belief_steps import BeliefState, advance_belief, begin_belief, share_rows
from deadtime.loop.observer_steps import (
    ObserverState,
    begin_observer,
    correct_observer,
    predict_observer,
    select_mode,
)
from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.lanes import (
    LANES,
    first_of,
    lanes_of,
    load,
    own_product,
    same,
    spread,
    store,
)
from deadtime.numerics.numbers import arrays_of, where
from deadtime.scenarios.lane_types import LoopSizes
from deadtime.scenarios.law_lanes import dot

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false


class OutputLanes(NamedTuple):
    """The outputs of eight plants.

    table : (modes, p n), C of each mode;  own : (p n, lane), of the mode of each plant
    mode : (lane,), that mode;  y : (p, lane)
    """

    table: np.ndarray
    own: np.ndarray
    mode: np.ndarray
    y: np.ndarray

    @classmethod
    def of(cls, outputs: np.ndarray) -> OutputLanes:
        modes, p, n = outputs.shape
        own, y = arrays_of((p * n,), (p,), lanes=(LANES,))
        return cls(outputs.reshape(modes, -1), own, np.full(LANES, -1), y)


class ObserverLanes(NamedTuple):
    """The observers of eight scenarios: their state, the mode of each, and the reported modes."""

    state: ObserverState
    mode: np.ndarray
    reported: np.ndarray

    @classmethod
    def of(cls, memory: Memory) -> ObserverLanes:
        return cls(ObserverState.of(memory, LANES), np.full(LANES, -1), np.full(LANES, -1))


@inner_kernel
def measure_outputs(shape, outputs, mode, x):
    """y of every scenario, by the C of its plant's mode."""
    select_mode(outputs.table, outputs.own, outputs.mode, mode)
    return own_product(outputs.own, 0, x, same(0.0, shape.output))


@inner_kernel
def begin_observers(memory, kept):
    """The initial z, after inputs and commands of 0."""
    state = lanes_of(kept.state)
    begin_observer(memory, state)
    for i in range(state.asked.size):
        state.asked[i] = 0.0


@inner_kernel
def update_observers(shape, memory, kept, outputs, line, row, mode, received, lost, k):
    """z at sample k of all scenarios, from received outputs; `line` are the inputs to row `row`."""
    state, y = lanes_of(kept.state), lanes_of(outputs.y)
    store(outputs.y, 0, received)
    for i in range(y.size):
        y[i] = where(lost[0] > 0.0, math.nan, y[i])
    if k > 0:
        predict_observer(memory, state, line, row)
    select_mode(memory.matrices, kept.state.own, kept.mode, mode)
    correct_observer(memory, state, y, line[row], memory.reference[k], k)
    return load(kept.state.z, 0, shape.kept)


@inner_kernel
def store_commands(kept, u):
    """Store the command, before limits: the sums of errors compare it with the applied input."""
    store(kept.state.asked, 0, u)


class BeliefLanes(NamedTuple):
    """Memory of a belief in eight scenarios.

    chain : BeliefState;  bank : BankState around it, or None
    gains : (rows, m, n), F
    x, before : (n or p), the measurements at this sample and at the one before
    answer : (rows, m), of every row;  u : (m,), their mean
    both : (lane, n + m), x and the latest input
    """

    chain: BeliefState
    bank: BankState | None
    gains: np.ndarray
    x: np.ndarray
    before: np.ndarray
    answer: np.ndarray
    u: np.ndarray
    both: np.ndarray


def belief_lanes(
    shape: LoopSizes, belief: Belief, bank: BankForm | None, gains: np.ndarray
) -> BeliefLanes:
    """Memory for eight scenarios of a law with rows of these gains."""
    rows = len(gains)
    all_of = None if bank is None else BankState.of(bank, rows, LANES)
    chain = BeliefState.of(belief, rows, LANES) if all_of is None else all_of.chain
    m, p = shape.u, shape.seen
    x, before, answer, u = arrays_of((p,), (p,), (rows, m), (m,), lanes=(LANES,))
    both = np.empty((LANES, shape.x + m))
    return BeliefLanes(chain, all_of, gains, x, before, answer, u, both)


@inner_kernel
def update_beliefs(belief, bank, beliefs, line, row, seen, lost, k):
    """Each scenario's belief at sample k, from its measurement, and the shares of the rows.

    `line` are the inputs, u_{k−1} in row `row`.
    """
    eight = lanes_of(beliefs)
    store(beliefs.x, 0, seen)
    for a in range(eight.x.size):
        # NaN is a missing number: so lanes with and without a measurement take one path.
        eight.x[a] = where(lost[0] > 0.0, math.nan, eight.x[a])
    if bank is not None:
        if k > 0:
            advance_bank(bank, eight.bank, eight.x, line, row)
        else:
            begin_bank(bank, eight.bank, eight.x)
    else:
        if k > 0:
            advance_belief(belief, eight.chain, eight.before, eight.x, line, row)
        else:
            begin_belief(belief, eight.chain)
        for a in range(eight.x.size):
            eight.before[a] = eight.x[a]
    share_rows(eight.chain)


@inner_kernel
def mean_row(shape, bank, beliefs, answers):
    """The mean of the answers of factorised rows."""
    store(beliefs.answer, 0, answers)
    return _mean(shape, bank, beliefs)


@inner_kernel
def mean_dense_row(shape, bank, beliefs, dense, window, place, known, before):
    """The mean of the answers of dense rows."""
    both = len(shape.both)
    spread(beliefs.both, 0, both, first_of(known, before, before, shape.both))
    _answer_dense(beliefs, dense, window.line, place, len(shape.u), both)
    return _mean(shape, bank, beliefs)


@kernel(eager=True, nogil=True)
def _answer_dense(beliefs, dense, line, place, m, both):
    """Fill in the answers of the dense rows that have any weight, in every scenario."""
    width, answer, share, z = line.size // LANES, beliefs.answer, beliefs.chain.weight, beliefs.both
    for lane in range(LANES):
        start = lane * width + (place + 1) * m
        for c in range(answer.shape[0]):
            for i in range(m):
                total, row = 0.0, c * m + i
                # Most rows have weight 0: their sums over all past inputs are left out.
                if share[c, lane] > 0.0:
                    total = dot(dense.rest, row * dense.width, line, start, dense.width)
                    for j in range(both):
                        total += dense.head[row * both + j] * z[lane, j]
                answer[c, i, lane] = total


@inner_kernel
def _mean(shape, bank, beliefs):
    """Σ_c π_c u_c, and with a bank Σ_c π_c F_c x̂."""
    eight = lanes_of(beliefs)
    share, answer, u = eight.chain.weight, eight.answer, eight.u
    for i in range(u.size):
        total = 0.0
        for c in range(share.size):
            total += share[c] * answer[c, i]
        u[i] = total
    if bank is not None:
        add_estimates(beliefs.gains, share, eight.bank.x, u)
    return load(beliefs.u, 0, shape.u)
