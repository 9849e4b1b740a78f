"""Evidence of the second kind: V at nodes of mode and age, pulled back along stretches of periods.

The nodes are (i, a) with a in `knots`, a_0 < a_1 < …, as long as mode i lasts, and V_{i,k}(ξ) =
ξᵀ P_{i,k} ξ there. From a node the loop goes along one of these stretches to the next node:

    full steps to the next knot; from the last one, where a mode may last, one full step to it;
    full steps to an age at which the plant may switch, a mixed step to j, a_0 full steps there.

If the reported mode is that of L samples ago, the law uses the rows of i, at known ages, in the
first L of these a_0 ≥ L steps, and j is reported from the node on: nothing before a node matters
after it. With lost samples a node is a mode, an age and the number of samples lost just before,
every age is a knot, and every stretch is one period.

With M the product of the matrices of the L periods of a stretch, what is proved is

    P_here − Mᵀ P_next M/ρ^{2L} ≻ 0    for every stretch and every instant of its switch,

so V falls by ρ^{2L} from node to node. Between nodes V is its value at the next node, pulled back,
which loses nothing: for a plant without input these are the inequalities e^{A_iᵀτ} P_j e^{A_iτ} ≺
P_i [Geromel and Colaneri, SIAM J. Control Optim. 45 (2006) 1915], at whole periods.

With an average dwell time the nodes are the modes, every stretch is one period, and V may rise at a
switch [Hespanha and Morse, CDC 1999]. With r periods per switch on average what is proved is

    P_i − Mᵀ P_i M μ^{1/r}/ρ² ≻ 0,    P_i − Mᵀ P_j M μ^{1/r − 1}/ρ² ≻ 0    where it switches.

k periods with s ≤ N₀ + k/r switches multiply V by less than ρ^{2k} μ^{s − k/r} ≤ μ^{N₀} ρ^{2k}.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.certificates.proof import balls
from deadtime.certificates.proof.balls import congruent
from deadtime.certificates.proof.covering import Covering, QuadraticForm
from deadtime.certificates.proof.evidence import Evidence, Setting
from deadtime.certificates.proof.step_enclosure import cells_of
from deadtime.certificates.proof.transitions import NodeStretch, Transition
from deadtime.certificates.proof.work import Work, cost
from deadtime.numerics.precision import precision


@dataclass(frozen=True, eq=False)
class StretchEvidence(Frozen):
    """A certificate's numbers (immutable): the setting, V at the nodes, and ρ.

    Attributes
    ----------
    P : (places, knots, d, d)
        The modes in turn; then, where samples may be lost, the modes after one lost sample, ….
    knots : tuple of int
        Ages of the nodes, ascending.
    rho : float
        ρ, the decay over a period.
    mu : float
        μ ≥ 1, the factor by which V may rise at a switch, for an average dwell time; else 1.
    """

    setting: Setting
    P: Float[np.ndarray, "place knot order order"]
    knots: tuple[int, ...]
    rho: float
    mu: float = 1.0

    @property
    def numbers(self) -> int:
        """Number of entries: the measure of allowed work."""
        return self.setting.numbers + self.P.size

    def lyapunov(self, mode: int, age: int, lost: int = 0) -> Float[np.ndarray, "order order"]:
        """V_{mode,age}, in floats: V at the next node of the mode, pulled back.

        Between nodes it may be singular, and need not fall over a period with a switch.
        """
        place = self.setting.transitions.place(mode, lost)
        if self.setting.transitions.bucket is not None:
            return self.P[place, 0]
        knots = self.setting.transitions.knots_of(mode, self.knots)
        knot = bisect_left(knots, age)
        lag = self.setting.signals.mode_lag
        if age < lag:
            raise ArgumentError(
                f"age must be at least the mode's lag, {lag}, got {age}: before that "
                "the Lyapunov function depends on the mode before."
            )
        if knot == len(knots):
            raise ArgumentError(
                f"age must be at most {knots[-1]}, got {age}: after it the mode has to be "
                "left, and the Lyapunov function depends on when."
            )
        # For the user, so floats at the end; balls since the check has the same product.
        with precision():
            ahead = StretchInequalities(self).full(mode, age, self.knots[knot])
        M, periods = balls.middle(ahead), self.knots[knot] - age
        return M.T @ self.P[place, knot] @ M / self.rho ** (2 * periods)


def decay_rate(evidence: Evidence | StretchEvidence) -> float:
    """−ln ρ/h, rounded down; 0 for ρ = 1, where the decay is strict but its rate is unknown."""
    if evidence.rho >= 1.0:
        return 0.0
    return (-math.log(evidence.rho) / evidence.setting.step) * (1.0 - 1e-12)


@dataclass(frozen=True, eq=False)
class PeriodMap:
    """`Setting.period` in balls (immutable), `rest` (d, d) with zeros in the plant's rows.

    ξ⁺ = (E seen + rest) ξ.
    """

    seen: Any
    rest: Any

    @classmethod
    def of(cls, setting: Setting, row: np.ndarray) -> PeriodMap:
        """Under one row (o, d) of the table."""
        seen, rest = setting.period(row)
        rest = np.concatenate((np.zeros((setting.states, setting.order)), rest))
        return cls(balls.exact(seen), balls.exact(rest))

    def loop(self, E: Any) -> Any:
        """The lifted loop's matrix."""
        from flint import arb_mat

        return arb_mat((E * self.seen).tolist() + self.rest.tolist()[E.nrows() :])


class StretchInequalities:
    """The inequalities of one piece of evidence of this kind, in balls."""

    def __init__(self, evidence: StretchEvidence, work: Work | None = None) -> None:
        from flint import arb

        self.evidence = evidence
        self.setting = evidence.setting
        self.rho = arb(evidence.rho)
        self.work = Work() if work is None else work
        self.covering = Covering(self.setting.family, self.work)
        self.rows = [PeriodMap.of(self.setting, row) for row in self.setting.rows]
        self.known: dict[tuple[int, int, int], Any] = {}
        self.followed: dict[tuple[int, tuple[int, ...]], Any] = {}

    def positive(self) -> bool:
        """Whether V ≻ 0 at every node."""
        graph, knots = self.setting.transitions, self.evidence.knots
        nodes = (
            self.evidence.P[graph.place(mode, lost), knot]
            for mode in range(graph.modes)
            for lost in range(graph.losses + 1)
            for knot in range(len(graph.knots_of(mode, knots)))
        )
        return all(congruent(balls.exact(P)) is not None for P in nodes)

    def holds(self, stretch: NodeStretch) -> tuple[int, float | None]:
        """Check one stretch, for every instant of its switch; as `Covering.holds`.

        ξ⁺ = (E seen + rest) ξ in the one period that may contain a switch, so the inequality is a
        quadratic form in E, and only this period is covered by cells; the others are one matrix.
        """
        P, n, step = self.evidence.P, self.setting.states, stretch.step
        before = self.full(step.mode, step.age - stretch.waits, step.age)
        after = self._following(step, stretch.follows)
        period = self.rows[step.row]
        place = self.setting.transitions.place
        here = balls.exact(P[place(step.mode, step.lost), stretch.knot])
        there = balls.exact(P[place(step.after, step.next_lost), stretch.next_knot])
        there = there * self.rho ** (-2 * stretch.periods) * self._rise(step)
        Q = after.transpose() * there * after
        seen, rest = period.seen * before, period.rest * before
        top = balls.top(Q, n)
        vv = here - rest.transpose() * Q * rest
        ww = balls.top(top.transpose(), n) * -1
        form = QuadraticForm.of(vv, top * rest * -1, ww, balls.zeros(n, seen.nrows()), seen)
        return self.covering.holds(form, step, [])

    def _rise(self, step: Transition) -> Any:
        """μ^{1/r}, or μ^{1/r − 1} at a switch; 1 without an average dwell time."""
        from flint import arb, fmpq

        periods = self.setting.periods_per_switch
        if periods is None:
            return arb(1)
        power = 1 / periods - step.switches  # a Fraction: r is rational
        return arb(self.evidence.mu) ** arb(fmpq(power.numerator, power.denominator))

    def full(self, mode: int, start: int, end: int) -> Any:
        """The product of the full steps from one age to another.

        By halves: multiplied one by one, the radii would grow like the product of all norms. From
        the age on at which the rows no longer change all steps are equal, so a product depends on
        its length alone and is kept under its earliest ages.
        """
        same = self.setting.ages - 1 + self.setting.signals.mode_lag
        late = max(0, start - same)
        key = mode, start - late, end - late
        if key not in self.known:
            self.work.do(cost(self.setting.order))
            if end == start:
                product = balls.exact(np.eye(self.setting.order))
            elif end == start + 1:
                product = self._step(mode, self.setting.transitions.row(mode, start))
            else:
                # Cut where the rows stop changing, so that the second factor is one kept for all.
                middle = same if start < same < end else (start + end) // 2
                product = self.full(mode, middle, end) * self.full(mode, start, middle)
            self.known[key] = product
        return self.known[key]

    def _following(self, step: Transition, follows: int) -> Any:
        """The product of the full steps after a step; the first ones have rows of the old mode."""
        rows = tuple(self.setting.transitions.rows_after(step, follows))
        if not rows:
            return self.full(step.after, 0, follows)
        return self.full(step.after, len(rows), follows) * self._under(step.after, rows)

    def _under(self, mode: int, rows: tuple[int, ...]) -> Any:
        key = mode, rows
        if key not in self.followed:
            self.work.do(cost(self.setting.order))
            half = len(rows) // 2
            self.followed[key] = (
                self._under(mode, rows[half:]) * self._under(mode, rows[:half])
                if half
                else self._step(mode, rows[0])
            )
        return self.followed[key]

    def _step(self, mode: int, row: int) -> Any:
        # One cell: with a range of delays every stretch is one period, and no product is formed.
        (whole,) = cells_of(self.setting.family, mode, mode)
        return self.rows[row].loop(self.covering.enclosure(whole).centre)
