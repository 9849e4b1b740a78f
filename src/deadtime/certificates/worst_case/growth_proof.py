"""Proof that a loop grows along a cycle, for the numbers as stored, in ball arithmetic (Arb).

Over a cycle of K periods the lifted state of order d is multiplied by a matrix M. Its eigenvalues
are not computed: balls around ill-conditioned ones would be too wide. From

    |tr M^q| = |Σ_i λ_i^q| ≤ d ρ^q

follows ρ ≥ (|tr M^q|/d)^(1/q), so a trace above d proves ρ > 1. Tried are q = 1, 2, 4, …; if the
leading eigenvalues are complex and their sum happens to vanish, it does not at the next q.
Constant modes have bounds of their own, at any order (`deadtime.spectrum.growth`).

The matrices of the plant and the rows of the law's table are the binary64 numbers stored, and the
switches fall where the signal's binary64 times say, in the first cycle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Any

import numpy as np

from deadtime.certificates.worst_case.cycle_growth import SampledLoop
from deadtime.certificates.worst_case.cycles import Cycle
from deadtime.plant.discretisation import Cuts
from deadtime.plant.pieces import PieceTable
from deadtime.spectrum import aged_row
from deadtime.spectrum.growth import LARGEST, enclose_growth, exact_matrix, exact_period
from deadtime.switching.grid import cuts_of

BITS = (192, 384, 768, 1536)
BEYOND = 3.0  # the trace has to exceed d by e³ before squaring stops
TURNS = 4  # more squarings, for complex eigenvalues
TOGETHER = 32  # periods multiplied as functions of their first ζ
PERIOD, SQUARING = 5e-8, 1e-8  # seconds per d² and d³, about
MOST_SECONDS = 30.0
LARGE = 200  # order from which the first growth proved is the answer


@dataclass(frozen=True)
class GrowthProof:
    """The result of a proof of growth along a signal (immutable).

    Attributes
    ----------
    proven : bool
        Whether the loop grows beyond doubt.
    rate : float or None
        1/s, above 0: a lower bound of the growth rate; None if not proven.
    reason : str
        The obstacle, if not proven.
    """

    proven: bool
    rate: float | None = None
    reason: str = ""


def prove(loop: SampledLoop, cycle: Cycle, rate: float) -> GrowthProof:
    """Prove that a loop grows along a cycle, at which it grows at about `rate` in floats, 1/s."""
    if not rate > 0.0:
        return GrowthProof(False, reason="no growth was computed")
    if cycle.constant and not cycle.lost:
        if loop.order > LARGEST:
            reason = f"the loop has order {loop.order:,}, and {LARGEST:,} is the limit"
            return GrowthProof(False, reason=f"{reason}; lengthen the step")
        mode, feedback = cycle.modes[0], loop.feedback
        low, high = enclose_growth(loop.plant, feedback, mode, aged_row(feedback, mode))
        if low > 0.0:
            return GrowthProof(True, low)
        reason = f"the growth rate is between {low:.4g} /s and {high:.4g} /s"
        return GrowthProof(False, reason=reason)
    order, step = loop.order, loop.step
    time = cycle.periods * step
    squarings = max(1, math.ceil(math.log2((math.log(order) + BEYOND) / (rate * time))) + TURNS)
    seconds = PERIOD * cycle.periods * order**2 + SQUARING * squarings * order**3
    if seconds > MOST_SECONDS:
        return GrowthProof(
            False,
            reason=f"a cycle of {cycle.periods:,} periods of a loop of order {order:,} is beyond "
            "reach; lengthen the step",
        )
    for bits in BITS:
        proof = _by_traces(loop, cycle, squarings, bits)
        if proof is not None:
            return proof
    return GrowthProof(False, reason=f"{BITS[-1]} bits do not suffice")


def _by_traces(loop: SampledLoop, cycle: Cycle, squarings: int, bits: int) -> GrowthProof | None:
    """The proof at a precision; None if the balls are too wide to decide."""
    from flint import arb

    from deadtime.numerics.precision import precision

    best, worn = 0.0, False
    with precision(bits):
        M, d = _over(loop, cycle), loop.order
        time = arb(cycle.periods) * loop.step
        for k in range(squarings + 1):
            trace = abs(M.trace())
            if trace > d:
                proved = float(((trace / d).log() / (time * 2**k)).lower())
                best = max(best, float(np.nextafter(proved, 0.0)))
            # A ball wider than the trace itself decides nothing any more: more bits are needed.
            worn = not trace.abs_upper() - trace.abs_lower() < max(0.5 * d, trace.abs_lower())
            if worn or k == squarings or (best > 0.0 and d > LARGE):
                break
            M = M * M
    if best > 0.0:
        return GrowthProof(True, best)
    if worn:
        return None
    return GrowthProof(False, reason=f"the traces of up to {2**squarings:,} cycles stay below {d}")


def _over(loop: SampledLoop, cycle: Cycle) -> Any:
    """M of ζ = (x, u_{k−W}, …, u_{k−1}) over one cycle, in balls.

    A few periods at a time, as functions of ζ at their beginning: their matrix has few full rows,
    and only these are multiplied by M.
    """
    from flint import arb_mat

    n, size = loop.plant.states, loop.past * loop.plant.inputs
    F, G = loop.feedback.state_gain, loop.feedback.input_gain
    taps = G[:, ::-1].transpose(0, 2, 1, 3).reshape(*F.shape[:2], -1)  # the oldest input first
    gains = [exact_matrix(row).tolist() for row in np.concatenate((F, taps), axis=2)]
    rows, moves = loop.table(cycle).rows.tolist(), _moves(loop, cycle)
    M = exact_matrix(np.eye(loop.order))
    for k in range(0, len(rows), TOGETHER):
        part = slice(k, k + TOGETHER)
        x, new = _ahead(loop, [gains[row] for row in rows[part]], moves[part])
        moved = (arb_mat(x + new) * M).tolist()
        M = arb_mat(moved[:n] + (M.tolist()[n:] + moved[n:])[-size:])
    return M


def _ahead(loop: SampledLoop, gains: list[list[list[Any]]], moves: list[Any]) -> tuple[list, list]:
    """x after some periods, and their inputs, as rows over ζ at the beginning."""
    from flint import arb_mat

    n, m, N, d = loop.plant.states, loop.plant.inputs, loop.sampled.longest_lag, loop.order
    unit = exact_matrix(np.eye(d)).tolist()
    x, line = unit[:n], unit[n:]
    for count, (gain, move) in enumerate(zip(gains, moves, strict=True)):
        #  line:  | entries of ζ, oldest first … | inputs of these periods |
        #  gain:      n of x | older                | recent                  |
        recent = min(count * m, len(gain[0]) - n)
        older = len(gain[0]) - n - recent  # their rows are unit vectors: no product needed
        short = arb_mat([row[:n] + row[n + older :] for row in gain])
        u = (short * arb_mat(x + line[len(line) - recent :])).tolist()
        for row, full in zip(u, gain, strict=True):
            for j in range(older):
                row[d - older + j] += full[n + j]
        line = line + u
        first = len(line) - (N + 1) * m
        x = (move * arb_mat(x + line[first : first + move.ncols() - n])).tolist()
    return x, line[d - n :]


def _moves(loop: SampledLoop, cycle: Cycle) -> list[Any]:
    """[Φ, Γ_N, Γ_{N−1}, …] of x⁺ = Φ x + Σ_l Γ_l u_{k−l} of every period, in balls."""
    cuts = cuts_of(cycle.signal(loop.step), loop.sampled)
    table = loop.sampled.along(cuts, cycle.periods)
    lags = range(loop.sampled.longest_lag, int(table.lag.min()) - 1, -1)
    known: dict[tuple[int, ...], Any] = {}
    moves = []
    for first, stop in pairwise(table.first):
        entries = tuple(table.entry[first:stop].tolist())
        if entries not in known:
            known[entries] = _move(loop, table, cuts, entries, lags)
        moves.append(known[entries])
    return moves


def _move(
    loop: SampledLoop, table: PieceTable, cuts: Cuts, entries: tuple[int, ...], lags: range
) -> Any:
    from flint import arb_mat

    parts = [(*part, table.lag[e]) for e in entries for part in table.parts(e, cuts)]
    Phi, arrived = exact_period(loop.plant, parts)
    none = arb_mat(*loop.plant.B.shape[1:])
    columns = [Phi.tolist(), *(arrived.get(lag, none).tolist() for lag in lags)]
    return arb_mat([list(chain(*rows)) for rows in zip(*columns, strict=True)])
