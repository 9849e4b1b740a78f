"""What laws on a belief from outputs keep of eight scenarios: a bank of Kalman filters of each.

Each bank moves by the steps of a single run (`estimation/bank_kernel.py`). The rows of the law's
table get an x of 0; what they make of the estimates of their own modes is added to their mean.
"""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deadtime.estimation.bank_kernel import advance_bank, begin_bank
from deadtime.estimation.belief_kernel import share_rows
from deadtime.feedback.bank import BankState
from deadtime.feedback.belief import BeliefState
from deadtime.numerics.kernels import inner_kernel, kernel
from deadtime.numerics.lanes import LANES, load, own_product, same, spread, times
from deadtime.scenarios.remembering import lay_out


class Banked(NamedTuple):
    """Memory of eight scenarios, beside `believing.Believed`.

    x : (lane, modes, n), P : (lane, modes, n, n);  room : what the steps of one scenario work in
    outputs : the C of each one's plant, and `mode` of which mode
    more : what the rows make of the estimates, (m, lane)
    """

    x: np.ndarray
    P: np.ndarray
    room: BankState
    outputs: np.ndarray
    mode: np.ndarray
    more: np.ndarray


@kernel(eager=True, nogil=True)
def banked_of(shape, bank, chain):
    """The memory before the first sample; `chain` is the room of beliefs."""
    modes, p, n = bank.form.C.shape
    x, P = np.empty((LANES, modes, n)), np.empty((LANES, modes, n, n))
    room = BankState(
        chain,
        x[0],
        P[0],
        np.empty((modes, modes, n)),
        np.empty((modes, modes, n, n)),
        np.empty((modes, modes, n)),
        np.empty((modes, modes, n, n)),
        np.empty((modes, modes, n)),
        np.empty((modes, modes)),
        np.empty(n),
        np.empty((n, n)),
        np.empty((3, n, n)),
        np.empty(n),
        np.empty(p),
    )
    outputs, nowhere = np.zeros(p * n * LANES), np.full(LANES, -1, np.int64)
    return Banked(x, P, room, outputs, nowhere, np.empty(len(shape.u) * LANES))


@inner_kernel
def look_at_outputs(shape, bank, banked, mode, x):
    """y of every scenario, by the C of its plant's mode."""
    lay_out(bank.outputs, banked.outputs, banked.mode, mode)
    return own_product(banked.outputs, 0, x, same(0.0, shape.output))


@kernel(eager=True, nogil=True)
def estimate_again(shape, bank, mind, banked, seen, lost, k):
    """Each scenario's bank at sample k, from what it sees; the shares of the rows; `more`."""
    spare, one, rows = mind.room, banked.room, mind.weight.shape[1]
    newest = mind.latest[0] + mind.told.shape[1] // 2
    spread(mind.seen.reshape(-1), 0, len(shape.seen), seen)
    for lane in range(LANES):
        chain = BeliefState(
            mind.now[lane],
            mind.weight[lane],
            spare.trace,
            spare.density,
            spare.mass,
            spare.predicted,
            spare.apart,
            spare.size,
            spare.root,
            spare.white,
            spare.bent,
        )
        state = BankState(
            chain,
            banked.x[lane],
            banked.P[lane],
            one.ahead_x,
            one.ahead_P,
            one.pair_x,
            one.pair_P,
            one.toward,
            one.spread,
            one.whole_x,
            one.whole_P,
            one.spare,
            one.wide,
            one.size,
        )
        y = mind.seen[lane]
        for a in range(y.size):
            if lost[lane] > 0.0:
                y[a] = math.nan
        if k > 0:
            advance_bank(bank.form, state, y, mind.told[lane], newest)
        else:
            begin_bank(bank.form, state, y)
        share_rows(chain)
        for c in range(rows):
            mind.share[c * LANES + lane] = mind.weight[lane, c]
        _answer_estimates(bank.gains, mind.weight[lane], banked.x[lane], banked.more, lane)


@kernel(eager=True, nogil=True)
def _answer_estimates(gains, share, x, more, lane):
    """Σ_c π_c F_c x̂, x̂ that of the mode of row c."""
    rows, m, n = gains.shape
    ages = rows // x.shape[0]
    for i in range(m):
        total = 0.0
        for c in range(rows):
            for a in range(n):
                total += share[c] * gains[c, i, a] * x[c // ages, a]
        more[i * LANES + lane] = total


@inner_kernel
def add_estimates(shape, banked, u):
    """u with what the rows make of the estimates."""
    return times(same(1.0, shape.u), u, load(banked.more, 0, shape.u))
