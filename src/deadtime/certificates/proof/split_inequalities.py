"""The inequalities of evidence of the first kind: small ones for every step, and a large one.

Small: [I; Δ]ᵀ Θ [I; Δ] ≻ 0 for every possible step of the plant, Θ = Π + S_{i,a} on ψ − Fᵀ
S_{j,b} F/ρ², of a transition (i, a) → (j, b); `covering` checks them for all instants of a switch.

Large: K ≻ 0, and a positive Lyapunov function. Two residuals, of the filter (ε = Ψ [M₀ B]
− F Y) and of the rows (η_c ξ = (row_c − row₀) ξ − T_c (y, r)), are not zero in floats. With (v, w)
= Y ζ they take at most c |ζ̂|² from the sum of the large and a small inequality, ζ̂ = ζ in units in
which diag K is about 1, and

    c = 2 |(Θ Y)_u| |η| + |Θ_uu| |η|² + (2 |S F Y| |ε| + |S| |ε|²)/ρ²,

Frobenius norms in these units, Θ the matrix of the small inequality, _u its rows of w_u, S that
after the step. K − c I ≻ 0 is what is factorised.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from deadtime.certificates.proof import balls
from deadtime.certificates.proof.balls import is_positive_definite, powers_of_two
from deadtime.certificates.proof.covering import Covering, QuadraticForm
from deadtime.certificates.proof.evidence import Channels, Evidence
from deadtime.certificates.proof.transitions import Transition, interpolation
from deadtime.certificates.proof.work import Work, cost


class SplitInequalities:
    """The inequalities of one piece of evidence, in balls; the large ones after the small ones."""

    def __init__(self, evidence: Evidence, channels: Channels, work: Work) -> None:
        from flint import arb

        self.evidence, self.channels = evidence, channels
        centre = evidence.centre
        self.v, self.w = channels.D.shape
        self.s = len(centre.Psi)
        self.rho2 = arb(evidence.rho) * arb(evidence.rho)
        self.Pi = balls.exact(evidence.Pi)
        self.F: Any = balls.exact(centre.F) if self.s else None
        self.E = balls.exact(centre.E)
        self.y = balls.exact(np.eye(centre.E.shape[1], self.v))
        self.T = [balls.exact(T).tolist() for T in centre.T]
        self.work = work
        self.covering = Covering(evidence.setting.family, work)
        self.forms: dict[Any, tuple[QuadraticForm, Any]] = {}
        self.answers: dict[Any, tuple[int, float | None]] = {}

    def holds(self, transition: Transition) -> tuple[int, float | None]:
        """Check all cells of a transition: their number, and the instant of a failure or None.

        The instant is that of the switch, as a fraction of the period.
        """
        lower: list[Any] = []
        row = b""
        if self.evidence.setting.rows_differ:
            row = self.evidence.centre.T[transition.row].tobytes()
            lower = [line + [0] * self.s for line in self.T[transition.row]]
        # Ages with the same rows and S have the same inequality.
        ends = self._ends(transition)
        key = ends, transition.mode, transition.after, transition.instants, row
        if key not in self.answers:
            form, _ = self.form(transition)
            self.answers[key] = self.covering.holds(form, transition, lower)
        return self.answers[key]

    def _ends(self, transition: Transition) -> tuple[int, ...]:
        """The nodes on which Θ depends; without S it depends on none."""
        here, there = self._places(transition)
        ends = (here, transition.age, there, transition.next_age)
        return ends if self.s else ()

    def _places(self, transition: Transition) -> tuple[int, int]:
        place = self.evidence.setting.transitions.place
        here = place(transition.mode, transition.lost)
        return here, place(transition.after, transition.next_lost)

    def S(self, place: int, age: int) -> Any:
        """S_{place, age}, interpolated with rational weights, so that S at a knot is exact."""
        from flint import arb, fmpq

        total = balls.zeros(self.s, self.s)
        for knot, weight in interpolation(self.evidence.knots, age):
            factor = arb(fmpq(weight.numerator, weight.denominator))
            total = total + balls.exact(self.evidence.S[place, knot]) * factor
        return total

    def form(self, transition: Transition) -> tuple[QuadraticForm, Any]:
        """Θ of a transition, and S F of its end; the same for all rows and instants."""
        from flint import arb_mat

        key = self._ends(transition)
        if key in self.forms:
            return self.forms[key]
        self.work.do(cost(self.Pi.nrows()))
        lines, SF = self.Pi.tolist(), None
        if self.s:
            first, last = self._places(transition)
            here = self.S(first, transition.age)
            SF = self.S(last, transition.next_age) * self.F
            lines = (self.Pi - self.F.transpose() * SF * (1 / self.rho2)).tolist()
            at = self.v - self.s  # v = (y, r, ψ): ψ comes last
            for i in range(self.s):
                for j in range(self.s):
                    lines[at + i][at + j] += here[i, j]
        v = self.v
        vv = arb_mat([line[:v] for line in lines[:v]])
        wv = arb_mat([line[:v] for line in lines[v:]])
        ww = arb_mat([line[v:] for line in lines[v:]])
        self.forms[key] = QuadraticForm.of(vv, wv, ww, self.E, self.y), SF
        return self.forms[key]

    def positive(self) -> bool:
        """P + Ψᵀ S Ψ ≻ 0 where every walk can end, which by the inequalities implies it everywhere.

        V ≻ V(next)/ρ² ⪰ 0 at every step into a place where V ≻ 0, so one factorisation where the
        walks end is enough. The last age of mode 0 can be reached from everywhere, unless some
        switches are not allowed; then the last age of every mode is checked, which a walk reaches
        by staying.
        """
        graph = self.evidence.setting.transitions
        ends = range(1 if graph.is_free or not self.s else graph.modes)
        return all(self._positive_at(mode, graph.clocks[mode].last) for mode in ends)

    def _positive_at(self, mode: int, age: int) -> bool:
        value, error = self.evidence.P, np.zeros_like(self.evidence.P)
        if self.s:
            Psi = balls.exact(self.evidence.centre.Psi)
            value, error = _even(balls.exact(value) + Psi.transpose() * self.S(mode, age) * Psi)
        return _definite(value, error, powers_of_two(np.diag(value)))

    def large(self) -> bool:
        """K − c I ≻ 0."""
        middle, error = self._K()
        unit = powers_of_two(np.diag(middle))
        return _definite(middle, error, unit, self._residuals(unit))

    def _K(self) -> tuple[np.ndarray, np.ndarray]:
        """K as floats and errors, entry by entry.

        [M₀ B] has `top` full rows Z; every other row is a unit vector, so [M₀ B]ᵀ P [M₀ B] is a
        shifted copy of a block of P and a product of rank 2·top. Balls of order d are thus never
        multiplied with each other, which would cost d³ slow operations.

                 x   w   u_{k−1} … u_{k−W+1}   u_{k−W}   (w_x, w_u)
            ζ: |   n   |         keep         |    m    |    w     |
                           shifts to ξ⁺[top:]
        """
        from flint import arb

        evidence = self.evidence
        setting, P = evidence.setting, evidence.P
        d, top = setting.order, setting.states + setting.outputs
        keep, full = d - top, d + self.w
        n = top - setting.inputs  # from where on ξ is shifted
        Z = balls.exact(self.channels.left) * balls.exact(self.channels.right)
        half = balls.exact(P[:top, :top]) * arb(0.5) * Z
        across = np.zeros((top, full))
        across[:, n : n + keep] = P[:top, top:]
        # With half of the corner here, Zᵀ Y + (Zᵀ Y)ᵀ has it once and what is across it, too.
        Y = (half + balls.exact(across)) * (1 / self.rho2)
        wide = balls.exact(self.channels.wide)
        low = Z.transpose() * Y
        shared = low + low.transpose() + wide.transpose() * self.Pi * wide
        base = np.zeros((full, full))
        base[:d, :d] = P
        moved = np.zeros((full, full))
        moved[n : n + keep, n : n + keep] = P[top:, top:]
        return _even(balls.exact(base) - balls.exact(moved) * (1 / self.rho2) - shared)

    def _residuals(self, unit: np.ndarray) -> float:
        """c, in the units of ζ̂ = ζ/unit."""
        eta, epsilon = self._row_residual(unit), self._filter_residual(unit)
        wide, grow = self.channels.wide * unit, 1.0 + 1e-10
        u, worst = self.v + self.evidence.setting.states, 0.0
        largest = float(np.linalg.norm(self.evidence.S)) * grow
        if not self.forms:  # `holds` was not called: nothing is known of Θ
            return np.inf
        for form, SF in self.forms.values():
            # See the module for c: Θ_u. of this form, the residuals η and ε, S at the step's end.
            c = 0.0
            if eta:
                blocks = balls.blocks([[form.wv, form.ww]])
                centre, error = (x[self.evidence.setting.states :] for x in balls.split(blocks))
                below = float((np.abs(centre) + error)[:, u:].sum())
                c += 2.0 * _above((centre, error), wide) * eta + below * eta**2
            if epsilon:
                pull = _above(balls.split(SF), wide)
                c += (2.0 * pull * epsilon + largest * epsilon**2) / self.evidence.rho**2
            if not np.isfinite(c):
                return np.inf  # max() below would drop a nan
            worst = max(worst, c)
        return worst * grow

    def _row_residual(self, unit: np.ndarray) -> float:
        setting, centre = self.evidence.setting, self.evidence.centre
        if not setting.rows_differ:
            return 0.0
        columns, largest = unit[: setting.order], 0.0
        seen, row0 = self.v - self.s, balls.exact(centre.row)
        if np.any(centre.T @ self.channels.D[:seen]):
            return np.inf  # w_u must not stand on both sides
        R = balls.exact(self.channels.C[:seen])
        for row, T in zip(setting.rows, centre.T, strict=True):
            rest = balls.exact(row) - row0 - balls.exact(T) * R
            residual = balls.frobenius(rest, columns)
            largest = residual if not residual < largest else largest  # keeps a nan
        return largest

    def _filter_residual(self, unit: np.ndarray) -> float:
        if not self.s:
            return 0.0
        setting, Psi = self.evidence.setting, self.evidence.centre.Psi
        top = setting.states + setting.outputs
        n = top - setting.inputs
        Z = balls.exact(self.channels.left) * balls.exact(self.channels.right)
        moved = np.zeros((self.s, setting.order + self.w))
        moved[:, n : n + setting.order - top] = Psi[:, top:]
        residual = balls.exact(Psi[:, :top]) * Z + balls.exact(moved)
        return balls.frobenius(residual - self.F * balls.exact(self.channels.wide), unit)


def _even(matrix: Any) -> tuple[np.ndarray, np.ndarray]:
    """Floats, symmetric to the last bit as the factorisation needs them, and their errors."""
    middle, error = balls.split(matrix)
    even = 0.5 * (middle + middle.T)
    return even, error + np.abs(even - middle) + np.spacing(np.abs(even))


def _definite(
    middle: np.ndarray, error: np.ndarray, unit: np.ndarray, residual: float = 0.0
) -> bool:
    """Whether X − residual · I ≻ 0 for every symmetric X within the errors, in these units."""
    scaled = middle * unit * unit[:, None]  # scaling by powers of two does not round
    errors = (error * unit * unit[:, None]).sum(axis=1) * (1.0 + 1e-12)
    return is_positive_definite(scaled, errors + residual)


def _above(left: tuple[np.ndarray, np.ndarray], right: np.ndarray) -> float:
    """A bound of |left right| in the Frobenius norm, left as (centre, error)."""
    centre, error = left
    # The norm in floats, a bound of its round-off, and the error of the centre.
    round_off = 1e-13 * balls.norm_above(np.abs(centre) @ np.abs(right))
    rest = balls.norm_above(error @ np.abs(right)) * (1.0 + 1e-10)
    return balls.norm_above(np.abs(centre @ right)) * (1.0 + 1e-10) + round_off + rest
