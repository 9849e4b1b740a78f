"""The small inequalities of a proof: [I; Δ]ᵀ Θ [I; Δ] ≻ 0 for every step that the plant can take.

Θ = Π + S_{i,a} on ψ − Fᵀ S_{j,b} F/ρ², of a transition (i, a) → (j, b); `covering` has how they are
checked for all instants of a switch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from deadtime.certificates.proof import balls
from deadtime.certificates.proof.channels import Channels
from deadtime.certificates.proof.covering import Covering, QuadraticForm
from deadtime.certificates.proof.evidence import Evidence
from deadtime.certificates.proof.transitions import Transition, interpolation
from deadtime.certificates.proof.work import Work, cost


@dataclass(frozen=True, eq=False)
class Theta:
    """Θ of a transition, and S F of its end."""

    form: QuadraticForm
    SF: Any


class SmallInequalities:
    """The small inequalities of one piece of evidence, in balls."""

    def __init__(self, evidence: Evidence, channels: Channels, work: Work) -> None:
        from flint import arb

        self.evidence = evidence
        centre = evidence.centre
        self.v = len(channels.D)
        self.s = len(centre.Psi)
        self.rho2 = arb(evidence.rho) * arb(evidence.rho)
        self.Pi = balls.exact(evidence.Pi)
        self.F: Any = balls.exact(centre.F) if self.s else None
        self.E = balls.exact(centre.E)
        self.y = balls.exact(np.eye(centre.E.shape[1], self.v))
        self.T = [balls.exact(T).tolist() for T in centre.T]
        self.work = work
        self.covering = Covering(evidence.setting.family, work)
        self.forms: dict[Any, Theta] = {}
        self.answers: dict[Any, tuple[int, float | None]] = {}

    def holds(self, transition: Transition) -> tuple[int, float | None]:
        """Check all cells of a transition: how many, and the instant where it fails, if it does.

        The instant is that of the switch as a fraction of the period.
        """
        lower: list[Any] = []
        row = b""
        if self.evidence.setting.rows_differ:
            row = self.evidence.centre.T[transition.row].tobytes()
            lower = [line + [0] * self.s for line in self.T[transition.row]]
        # Ages at which rows and S are the same ask for the same inequality.
        ends = self._ends(transition)
        key = ends, transition.mode, transition.after, transition.instants, row
        if key not in self.answers:
            form = self.form(transition).form
            self.answers[key] = self.covering.holds(form, transition, lower)
        return self.answers[key]

    def _ends(self, transition: Transition) -> tuple[int, ...]:
        """What Θ depends on: where the transition begins and ends; on nothing without S."""
        here, there = self._places(transition)
        ends = (here, transition.age, there, transition.next_age)
        return ends if self.s else ()

    def _places(self, transition: Transition) -> tuple[int, int]:
        """Where S before and after a transition stands."""
        place = self.evidence.setting.transitions.place
        here = place(transition.mode, transition.lost)
        return here, place(transition.after, transition.next_lost)

    def S(self, place: int, age: int) -> Any:
        """S_{place, age}, interpolated exactly."""
        from flint import arb, fmpq

        total = balls.zeros(self.s, self.s)
        for knot, weight in interpolation(self.evidence.knots, age):
            factor = arb(fmpq(weight.numerator, weight.denominator))
            total = total + balls.exact(self.evidence.S[place, knot]) * factor
        return total

    def form(self, transition: Transition) -> Theta:
        """Θ of a transition; the same for all rows and instants."""
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
            at = self.v - self.s
            for i in range(self.s):
                for j in range(self.s):
                    lines[at + i][at + j] += here[i, j]
        v = self.v
        vv = arb_mat([line[:v] for line in lines[:v]])
        wv = arb_mat([line[:v] for line in lines[v:]])
        ww = arb_mat([line[v:] for line in lines[v:]])
        self.forms[key] = Theta(QuadraticForm.of(vv, wv, ww, self.E, self.y), SF)
        return self.forms[key]
