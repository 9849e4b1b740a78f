"""The small inequalities of a proof: [I; Δ]ᵀ Θ [I; Δ] ≻ 0 for every step that the plant can take.

Θ = Π + S_{i,a} on ψ − Fᵀ S_{j,b} F/ρ², of a transition (i, a) → (j, b). The steps are covered by
cells, and over a cell Δ = Δ_c + Σ t_k D_k + R: t_k in [−1, 1] (or in a simplex, for a polytope),
D_k the middles of the slopes, R what they leave, of second order in the size of the cell.

As a function of Δ the form is concave where the block Θ_xx of w_x is ⪯ 0, so its least value over
the t is at a corner; there R changes it by at most |2 (R Wᵀ)ᵀ (Θ_wv + Θ_ww Δ) Wᵀ + …| in units
W in which it is about I. Where Θ_xx is not ⪯ 0 the D_k count as part of R.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from deadtime.certificates.proof import balls
from deadtime.certificates.proof.channels import Channels
from deadtime.certificates.proof.definite import congruence, least_dominance
from deadtime.certificates.proof.enclosure import Cell, Enclosure, Enclosures, cells_of
from deadtime.certificates.proof.evidence import Evidence
from deadtime.certificates.proof.transitions import Transition, interpolation

DEEPEST = 20  # bisections of a cell
MOST_CELLS = 1500  # of one transition


@dataclass(frozen=True, eq=False)
class Form:
    """Θ of a transition, in blocks, and S F of its end."""

    vv: Any
    wv: Any
    ww: Any
    SF: Any
    concave: bool


class SmallInequalities:
    """The small inequalities of one piece of evidence, in balls."""

    def __init__(self, evidence: Evidence, channels: Channels) -> None:
        from flint import arb

        self.evidence = evidence
        centre = evidence.centre
        self.v = len(channels.D)
        self.s = len(centre.Psi)
        self.y = self.v - self.s - len(centre.R)
        self.rho2 = arb(evidence.rho) * arb(evidence.rho)
        self.Pi = balls.exact(evidence.Pi)
        self.F: Any = balls.exact(centre.F) if self.s else None
        self.E = balls.exact(centre.E)
        self.T = [balls.exact(T).tolist() for T in centre.T]
        self.enclosures = Enclosures(evidence.setting.family)
        self.known: dict[Any, Enclosure] = {}
        self.forms: dict[Any, Form] = {}

    def holds(self, transition: Transition) -> tuple[int, float | None]:
        """Check all cells of a transition: how many, and the instant where it fails, if it does.

        The instant is that of the switch as a fraction of the period.
        """
        form, count = self.form(transition), 0
        for whole in cells_of(self.evidence.setting.family, transition.mode, transition.after):
            pending = [(whole, 0)]
            while pending:
                cell, depth = pending.pop()
                count += 1
                direction = self._direction(form, transition.row, cell)
                if direction is None:
                    continue
                if direction < 0 or depth == DEEPEST or count == MOST_CELLS:
                    return count, self._instant(cell)
                pending += [(half, depth + 1) for half in cell.halves(direction)]
        return count, None

    def S(self, mode: int, age: int) -> Any:
        """S_{mode, age}, interpolated exactly."""
        from flint import arb, fmpq

        total = balls.zeros(self.s, self.s)
        for knot, weight in interpolation(self.evidence.knots, age):
            factor = arb(fmpq(weight.numerator, weight.denominator))
            total = total + balls.exact(self.evidence.S[mode, knot]) * factor
        return total

    def form(self, transition: Transition) -> Form:
        """Θ of a transition; the same for all rows and instants."""
        from flint import arb_mat

        key = (transition.mode, transition.age, transition.after, transition.next_age)
        key = key if self.s else ()
        if key in self.forms:
            return self.forms[key]
        lines, SF = self.Pi.tolist(), None
        if self.s:
            here = self.S(transition.mode, transition.age)
            SF = self.S(transition.after, transition.next_age) * self.F
            lines = (self.Pi - self.F.transpose() * SF * (1 / self.rho2)).tolist()
            at = self.v - self.s
            for i in range(self.s):
                for j in range(self.s):
                    lines[at + i][at + j] += here[i, j]
        v, n = self.v, self.evidence.setting.states
        vv = arb_mat([line[:v] for line in lines[:v]])
        wv = arb_mat([line[:v] for line in lines[v:]])
        ww = arb_mat([line[v:] for line in lines[v:]])
        xx = arb_mat([line[v : v + n] for line in lines[v : v + n]]) * -1
        self.forms[key] = Form(vv, wv, ww, SF, _least(xx) is not None)
        return self.forms[key]

    def _instant(self, cell: Cell) -> float:
        u, family = 0.5 * sum(cell.u), self.evidence.setting.family
        part = family.phases[1] / family.step
        if not family.split:
            return u
        return part + u * (1.0 - part) if cell.order[0].share == "all" else u * part

    def _enclosure(self, cell: Cell) -> Enclosure:
        """Cells of one pair of modes come again for other ages: enclosed once."""
        key = (cell.order, cell.u, cell.f, cell.corners.tobytes())
        if key not in self.known:
            self.known[key] = self.enclosures.of(cell)
        return self.known[key]

    def _delta(self, E: Any, row: int) -> Any:
        """Δ (w, v) of plant rows and a table's row."""
        from flint import arb_mat

        rest = self.v - self.y
        table = [line + [0] * rest for line in (E - self.E).tolist()]
        if self.evidence.setting.rows_differ:
            table += [line + [0] * self.s for line in self.T[row]]
        return arb_mat(table)

    def _direction(self, form: Form, row: int, cell: Cell) -> int | None:
        """None if the small inequality holds on a cell; else the direction to bisect, or −1."""
        enclosure = self._enclosure(cell)
        points, rest = _corners(enclosure, form.concave)
        sizes, held = dict.fromkeys(rest, 0.0), True
        for E in points:
            Delta = self._delta(E, row)
            cross = Delta.transpose() * form.wv
            found = _least(
                form.vv + cross + cross.transpose() + Delta.transpose() * form.ww * Delta
            )
            if found is None:
                return _widest(enclosure) if len(points) > 1 else -1
            least, Wt = found
            bounds = self._changes(form, Delta, Wt, rest)
            if not sum(bounds.values()) * (1.0 + 1e-12) < least:
                held = False
                sizes = {k: max(sizes[k], bound) for k, bound in bounds.items()}
        if held:
            return None
        return max(sizes, key=lambda k: sizes[k])

    def _changes(self, form: Form, Delta: Any, Wt: Any, rest: dict[int, Any]) -> dict[int, float]:
        """How far R of each direction may change the form at a corner, in the units W.

        2 Rᵀ (Θ_wv + Θ_ww Δ) + Rᵀ Θ_xx R, the last with all of R on one side.
        """
        from flint import arb_mat

        n, beyond = self.E.nrows(), self.v - self.y
        if not rest:
            return {}
        total: Any = None
        for R in rest.values():
            total = R if total is None else total + R
        wide = {
            k: arb_mat([line + [0] * beyond for line in R.tolist()]) * Wt for k, R in rest.items()
        }
        xx = arb_mat([line[:n] for line in form.ww.tolist()[:n]])
        all_of_it = arb_mat([line + [0] * beyond for line in total.tolist()]) * Wt
        pull = balls.top(form.wv + form.ww * Delta, n) * Wt * 2 + xx * all_of_it
        return {k: balls.frobenius(R.transpose() * pull) for k, R in wide.items()}


def _corners(enclosure: Enclosure, concave: bool) -> tuple[list[Any], dict[int, Any]]:
    """The corners in the t, and R by direction as balls around 0."""
    rest: dict[int, Any] = {}
    moves: dict[int, list[Any]] = {}
    for k, slope in enclosure.slopes:
        middle = balls.exact(balls.middle(slope))
        left = _symmetric(slope - middle if concave else slope)
        moves.setdefault(k, []).extend([middle] if k == 2 else [middle, middle * -1])
        rest[k] = left if k not in rest else _union(rest[k], left)
    if not concave or not moves:
        return [enclosure.centre], rest
    points = []
    for move in product(*moves.values()):
        point = enclosure.centre
        for part in move:
            point = point + part
        points.append(point)
    return points, rest


def _symmetric(matrix: Any) -> Any:
    """[−r, r] around 0, r the largest modulus, entry by entry."""
    from flint import arb_mat

    entries = [balls.symmetric(x) for x in matrix.entries()]
    return arb_mat(matrix.nrows(), matrix.ncols(), entries)


def _union(first: Any, second: Any) -> Any:
    from flint import arb_mat

    pairs = zip(first.entries(), second.entries(), strict=True)
    return arb_mat(first.nrows(), first.ncols(), [x.union(y) for x, y in pairs])


def _widest(enclosure: Enclosure) -> int:
    """The direction in which a cell is widest."""
    sizes = [(float(np.linalg.norm(balls.middle(slope))), k) for k, slope in enclosure.slopes]
    return max(sizes)[1]


def _least(X: Any) -> tuple[float, Any] | None:
    """(a lower bound of the least eigenvalue of W X Wᵀ, Wᵀ) for X ≻ 0; None if that fails."""
    W = congruence(balls.middle(X))
    if W is None:
        return None
    left = balls.exact(W)
    right = left.transpose()
    least = least_dominance(left * X * right)
    return (least, right) if least > 0.0 else None
