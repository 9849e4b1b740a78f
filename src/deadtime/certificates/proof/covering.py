"""Quadratic inequalities for every possible step of the plant, proved on cells that cover them.

    vv + wvᵀ Δ + Δᵀ wv + Δᵀ ww Δ ≻ 0,    Δ = [(E − E₀) L; lower],

for all plant rows E of the steps from a mode to another. Over a cell E = E_c + Σ t_k D_k + R:
t_k in [−1, 1] (or in a simplex, for a polytope), D_k the midpoints of the slopes, R the rest, of
second order in the size of the cell.

As a function of E the form is concave where its block ww_xx is ⪯ 0, so its least value over the t
is at a corner; there R changes it by at most |2 (R L Wᵀ)ᵀ (wv + ww Δ)_x Wᵀ + …| in units W in
which it is about I. Where ww_xx is not ⪯ 0 the D_k count as part of R.

An ellipsoid of plants adds q = δE y. The bound of `sway`, yᵀ X y − qᵀ W⁻¹ q ≥ 0, is subtracted λ
times (the S-procedure), and the form in (v, q) has to be ≻ 0. The least value over z of a form
that is concave in E is concave in E, so the corners in the t still decide.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from deadtime.certificates.proof import balls
from deadtime.certificates.proof.balls import congruent
from deadtime.certificates.proof.box import POLYTOPE, Box
from deadtime.certificates.proof.family import Family
from deadtime.certificates.proof.step_enclosure import (
    BoxEnclosures,
    Enclosure,
    Enclosures,
    ParameterCell,
    cells_of,
)
from deadtime.certificates.proof.sway import Sway, weight_of
from deadtime.certificates.proof.transitions import Transition
from deadtime.certificates.proof.work import Work, cost

DEEPEST = 20  # bisections of a cell, in all directions together
MOST_CELLS = 1500  # of one inequality


def enclosures_of(family: Family | Box) -> Enclosures | BoxEnclosures:
    """The enclosures of the cells of a family."""
    return BoxEnclosures(family) if isinstance(family, Box) else Enclosures(family)


@dataclass(frozen=True, eq=False)
class QuadraticForm:
    """A quadratic form in Δ = [(E − E₀) L; lower], in balls.

    Attributes
    ----------
    vv : (v, v), wv : (w, v), ww : (w, w)
        The blocks.
    E : (n, k)
        E₀.
    L : (k, v)
        From v to y, the argument of the plant's rows.
    concave : bool
        Whether ww ⪯ 0 in its first n rows and columns.
    """

    vv: Any
    wv: Any
    ww: Any
    E: Any
    L: Any
    concave: bool

    @classmethod
    def of(cls, vv: Any, wv: Any, ww: Any, E: Any, L: Any) -> QuadraticForm:
        """The form with these blocks; whether it is concave is proved, not assumed."""
        from flint import arb_mat

        n = E.nrows()
        xx = arb_mat([line[:n] for line in ww.tolist()[:n]]) * -1
        return cls(vv, wv, ww, E, L, congruent(xx) is not None)


class Covering:
    """Checks forms over all steps of a family; enclosures are kept, since forms share cells."""

    def __init__(self, family: Family | Box, work: Work) -> None:
        self.family = family
        self.work = work
        self.enclosures = enclosures_of(family)
        self.known: dict[Any, Enclosure] = {}
        self.swayed: dict[int, Sway | None] = {}

    def holds(
        self, form: QuadraticForm, step: Transition, lower: list[Any]
    ) -> tuple[int, float | None]:
        """Check all cells of a step; `lower` are further rows of Δ.

        Returns how many cells there were, and where it fails, if it does: the instant of the switch
        as a fraction of the period.
        """
        count = 0
        for whole in cells_of(self.family, step.mode, step.within, step.instants):
            pending = [(whole, 0)]
            while pending:
                cell, depth = pending.pop()  # depth first: few cells are kept at a time
                count += 1
                direction = self._direction(form, lower, cell)
                if direction is None:
                    continue
                # Evidence that fails by a hair would be bisected without end but for these limits.
                if direction < 0 or depth == DEEPEST or count == MOST_CELLS:
                    return count, self.family.instant(cell.order, 0.5 * sum(cell.u))
                pending += [(half, depth + 1) for half in cell.halves(direction)]
        return count, None

    def enclosure(self, cell: ParameterCell) -> Enclosure:
        """E over a cell, computed once: other ages of the same two modes have the same cells."""
        key = (cell.order, cell.u, cell.f, cell.corners.tobytes())
        if key not in self.known:
            n, k = self.family.states, self.family.states + len(self.family.reads)
            self.work.do(cost(k) + self.family.plants.products * cost(n * k))
            self.known[key] = self.enclosures.of(cell)
        return self.known[key]

    def _direction(self, form: QuadraticForm, lower: list[Any], cell: ParameterCell) -> int | None:
        """None if the inequality holds on a cell; else the direction to bisect, or −1."""
        from flint import arb_mat

        enclosure = self.enclosure(cell)
        points, rest = _corners(enclosure, form.concave)
        self.work.do(len(points) * cost(form.vv.nrows()))
        sway = self._sway(enclosure, form.E.nrows())
        if enclosure.sway is not None and sway is None:
            return -1
        sizes, held = dict.fromkeys(rest, 0.0), True
        for E in points:
            Delta = arb_mat(((E - form.E) * form.L).tolist() + lower)
            asked = (form, Delta) if sway is None else swaying(form, Delta, sway)
            definite = None if asked is None else congruent(_value(*asked))
            if asked is None or definite is None:
                # At the centre itself no bisection helps, unless λ may be better on a smaller cell.
                if not enclosure.slopes or (len(points) == 1 and sway is None):
                    return -1
                # The form at a corner is not ≻ 0, so no bound names a direction: bisect the widest.
                widths = [np.abs(balls.middle(slope)) for _, slope in enclosure.slopes]
                directions = (k for k, _ in enclosure.slopes)
                return max(zip(map(balls.norm_above, widths), directions, strict=True))[1]
            least, Wt = definite
            bounds = _changes(*asked, Wt, rest)
            # `not … <` and not `>=`: a nan must not pass.
            if not sum(bounds.values()) * (1.0 + 1e-12) < least:
                held = False
                sizes = {k: max(sizes[k], bound) for k, bound in bounds.items()}
        if held:
            return None
        return max(sizes, key=lambda k: sizes[k])

    def _sway(self, enclosure: Enclosure, n: int) -> Sway | None:
        """W and X of an enclosure, if they are proved; None without an ellipsoid."""
        if enclosure.sway is None:
            return None
        if id(enclosure) not in self.swayed:  # `known` keeps the enclosure
            self.swayed[id(enclosure)] = Sway.of(enclosure.sway, n)
        return self.swayed[id(enclosure)]


def swaying(form: QuadraticForm, Delta: Any, sway: Sway) -> tuple[QuadraticForm, Any] | None:
    """The form in (v, q), w_x = Δ v + q, by the S-procedure; and Δ of (v, q).

    If the form is positive for all q with yᵀ X y − qᵀ W⁻¹ q ≥ 0, it is so for every plant.
    """
    from flint import arb

    n, v, w = form.E.nrows(), form.vv.nrows(), form.ww.nrows()
    unit = balls.exact(np.eye(w, n))
    Delta = balls.blocks([[Delta, unit]])
    wv = balls.blocks([[form.wv, balls.zeros(w, n)]])
    L = balls.blocks([[form.L, balls.zeros(form.L.nrows(), n)]])
    empty = balls.zeros(v, n), balls.zeros(n, v)
    bare = balls.blocks([[form.vv, empty[0]], [empty[1], balls.zeros(n, n)]])
    wide = QuadraticForm(bare, wv, form.ww, form.E, L, form.concave)
    # λ by floats: any λ ≥ 0 makes a valid inequality, so only its size is at stake.
    value = balls.middle(_value(wide, Delta))
    weight = weight_of(0.5 * (value + value.T), balls.middle(form.L), sway.W, sway.X)
    if weight is None:
        return None
    seen = form.L.transpose() * balls.exact(sway.X) * form.L
    vv = balls.blocks(
        [
            [form.vv - seen * arb(weight), empty[0]],
            [empty[1], balls.exact(sway.W).inv() * arb(weight)],
        ]
    )
    return QuadraticForm(vv, wv, form.ww, form.E, L, form.concave), Delta


def _value(form: QuadraticForm, Delta: Any) -> Any:
    cross = Delta.transpose() * form.wv
    return form.vv + cross + cross.transpose() + Delta.transpose() * form.ww * Delta


def _changes(form: QuadraticForm, Delta: Any, Wt: Any, rest: dict[int, Any]) -> dict[int, float]:
    """Bounds of the change of the form at a corner by R of each direction, in the units W.

    2 (R L)ᵀ (wv + ww Δ)_x + (R L)ᵀ ww_xx (R L), with all of R on one side of the last term, so
    that the bounds of the directions add up.
    """
    from flint import arb_mat

    n = form.E.nrows()
    if not rest:
        return {}
    total: Any = None
    for R in rest.values():
        total = R if total is None else total + R
    seen = form.L * Wt
    wide = {k: R * seen for k, R in rest.items()}
    xx = arb_mat([line[:n] for line in form.ww.tolist()[:n]])
    pull = balls.top(form.wv + form.ww * Delta, n) * Wt * 2 + xx * (total * seen)
    return {k: balls.frobenius(R.transpose() * pull) for k, R in wide.items()}


def _corners(enclosure: Enclosure, concave: bool) -> tuple[list[Any], dict[int, Any]]:
    """The corners in the t, and R by direction as balls around 0."""
    from flint import arb_mat

    rest: dict[int, Any] = {}
    moves: dict[int, list[Any]] = {}
    for k, slope in enclosure.slopes:
        middle = balls.exact(balls.middle(slope))
        # [−r, r] around 0, r the largest modulus, entry by entry
        left = [balls.symmetric(x) for x in (slope - middle if concave else slope).entries()]
        # ±D_k of a parameter; of a polytope one D per corner, and R is the hull over them.
        moves.setdefault(k, []).extend([middle] if k == POLYTOPE else [middle, middle * -1])
        if k in rest:
            left = [x.union(y) for x, y in zip(rest[k].entries(), left, strict=True)]
        rest[k] = arb_mat(slope.nrows(), slope.ncols(), left)
    if not concave or not moves:
        return [enclosure.centre], rest
    points = []
    for move in product(*moves.values()):
        point = enclosure.centre
        for part in move:
            point = point + part
        points.append(point)
    return points, rest
