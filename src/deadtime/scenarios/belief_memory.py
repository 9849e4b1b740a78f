"""Beliefs of eight scenarios: a `BeliefState`, and from outputs a `BankState`.

The answers of a law's rows, each weighed by its share, are summed for all eight. From outputs the
rows get an x of 0, and what they make of the estimates of their own modes is added to their mean.
"""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deadtime.feedback.belief import BankForm, Belief
from deadtime.loop.bank_steps import BankState, add_estimates, advance_bank, begin_bank
from deadtime.loop.belief_steps import BeliefState, advance_belief, begin_belief, share_rows
from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.lanes import (
    LANES,
    first_of,
    lanes_of,
    load,
    spread,
    store,
)
from deadtime.numerics.numbers import arrays_of, where
from deadtime.scenarios.lane_types import LoopSizes
from deadtime.scenarios.law_rows import dot


class BeliefLanes(NamedTuple):
    """Memory of eight scenarios.

    chain : BeliefState;  bank : BankState, around the same, or None
    gains : (rows, m, n), F
    x, before : what is measured at this sample and at the one before, (n or p)
    answer : of every row, (rows, m);  u : their mean;  both : (lane, n + m), x and the latest input
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
    """Room for eight scenarios of a law with rows of these gains."""
    rows = len(gains)
    all_of = None if bank is None else BankState.of(bank, rows, LANES)
    chain = BeliefState.of(belief, rows, LANES) if all_of is None else all_of.chain
    m, p = shape.u, shape.seen
    x, before, answer, u = arrays_of((p,), (p,), (rows, m), (m,), lanes=(LANES,))
    both = np.empty((LANES, shape.x + m))
    return BeliefLanes(chain, all_of, gains, x, before, answer, u, both)


@inner_kernel
def believe_again(belief, bank, mind, line, row, seen, lost, k):
    """Each scenario's belief at sample k, from what it sees, and the shares of the rows.

    `line` are the inputs, u_{k−1} in row `row`.
    """
    eight = lanes_of(mind)
    store(mind.x, 0, seen)
    for a in range(eight.x.size):
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
def mean_row(shape, bank, mind, answers):
    """The mean of the answers of factorised rows."""
    store(mind.answer, 0, answers)
    return _mean(shape, bank, mind)


@inner_kernel
def mean_dense_row(shape, bank, mind, dense, window, place, known, before):
    """The same of dense rows."""
    both = len(shape.both)
    spread(mind.both, 0, both, first_of(known, before, before, shape.both))
    _answer_dense(mind, dense, window.line, place, len(shape.u), both)
    return _mean(shape, bank, mind)


@kernel(eager=True, nogil=True)
def _answer_dense(mind, dense, line, place, m, both):
    """What the dense rows of any weight ask for in every scenario."""
    width, answer, share, z = line.size // LANES, mind.answer, mind.chain.weight, mind.both
    for lane in range(LANES):
        start = lane * width + (place + 1) * m
        for c in range(answer.shape[0]):
            for i in range(m):
                total, row = 0.0, c * m + i
                if share[c, lane] > 0.0:
                    total = dot(dense.rest, row * dense.width, line, start, dense.width)
                    for j in range(both):
                        total += dense.head[row * both + j] * z[lane, j]
                answer[c, i, lane] = total


@inner_kernel
def _mean(shape, bank, mind):
    """Σ_c π_c of the answers, and of what rows make of the estimates of their modes."""
    eight = lanes_of(mind)
    share, answer, u = eight.chain.weight, eight.answer, eight.u
    for i in range(u.size):
        total = 0.0
        for c in range(share.size):
            total += share[c] * answer[c, i]
        u[i] = total
    if bank is not None:
        add_estimates(mind.gains, share, eight.bank.x, u)
    return load(mind.u, 0, shape.u)
