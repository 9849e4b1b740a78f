"""The search for evidence at one decay: frequencies, program, Riccati equation, check.

The search distinguishes rows along a few directions only, which gives P. The proof needs every row
exactly: with R complete, the best multiplier for this P is the partial minimum over ξ of

    ξᵀ P ξ − (M₀ ξ + B w)ᵀ P (M₀ ξ + B w)/ρ² − slack    for given (v, w),

a Schur complement. One large inequality then still proves all rows.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from deadtime.certificates.dwell.centre import (
    CentreFloats,
    ResponseForms,
    fine_frequencies,
    frequencies,
    response,
)
from deadtime.certificates.dwell.program import Sample, Solution, Units, solve
from deadtime.certificates.dwell.solvers import solve_riccati
from deadtime.certificates.proof import Check, check
from deadtime.certificates.proof.box import Box
from deadtime.certificates.proof.covering import enclosures_of
from deadtime.certificates.proof.evidence import Evidence, Setting
from deadtime.certificates.proof.family import Family
from deadtime.certificates.proof.step_enclosure import (
    BoxEnclosures,
    Enclosures,
    ParameterCell,
)
from deadtime.certificates.proof.sway import Sway
from deadtime.certificates.proof.transitions import Transition
from deadtime.numerics.precision import precision

ALL = 10**6
# For (v, w) that no ξ, or hardly any, produces: thresholds of singular values of Y relative to the
# largest, and weights relative to the largest entry of Π, used in place of the partial minimum.
NONE, HARDLY = 1e-13, 1e-6
WEIGHT_NONE, WEIGHT_HARDLY = 1e6, 1.0
LEAST_MARGIN = 1e-9
ROUNDS = 10  # of additional frequencies
REPAIRS = 4  # of additional samples after a failed proof
ENOUGH = 0.5  # of the margin: the least that must remain between the chosen frequencies
CLEARLY = 0.8  # the same for a rough solution, so that the accurate one has ENOUGH
FREQUENCIES = 40
INSTANTS = (0.0, 0.25, 0.5, 0.75, 1.0)
MOST_AGES = 40  # of a (mode, age) table, sampled by the search


class Sways:
    """W and X of `proof.sway` at points of the steps, beside `Steps.corners`."""

    def __init__(self, family: Family | Box) -> None:
        self.family = family

    @cached_property
    def enclosures(self) -> Enclosures | BoxEnclosures:
        """Built at first use: only an ellipsoid of plants needs them."""
        return enclosures_of(self.family)

    def at(self, order: Any, instants: np.ndarray) -> list[Sway | None]:
        """One for every sample of `family.corners(order, instants)`."""
        us = instants.tolist() if self.family.switches(order) else [0.0]
        ends = self.family.ends(order)
        plants = self.family.plants
        if plants.in_polytope:
            return [None] * (len(us) * len(ends) * len(plants.A))
        found: list[Sway | None] = []
        with precision():
            for u, f in product(us, ends):
                places = f if isinstance(f, tuple) else (f,) * len(self.family.moving(order))
                point = tuple((place, place) for place in places)
                columns = self.enclosures.sway(ParameterCell(order, (u, u), point, np.eye(1)))
                found.append(None if columns is None else Sway.of(columns, self.family.states))
        return found


def extend(evidence: Evidence, model: CentreFloats, slack: np.ndarray) -> Evidence | None:
    """Evidence with this P and S and all directions of the rows; None if there is no such Π."""
    from scipy.linalg import cho_factor, cho_solve, null_space

    setting = evidence.setting
    # In units in which ξ and the rows of Y are about 1; svd(Y) then separates (v, w) by how well
    # some ξ reaches it.
    full = CentreFloats.of(setting, model.eigenvectors, ALL)
    P, rho, d = evidence.P, evidence.rho, setting.order
    moved = np.concatenate((full.M, full.B), axis=1) / rho
    form = -moved.T @ P @ moved
    form[:d, :d] += P
    form[np.diag_indices_from(form)] -= slack
    inside = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(form)), 1e-300))
    form = form * inside * inside[:, None]
    wide = full.channels.wide * inside
    units = 1.0 / np.linalg.norm(wide, axis=1)
    left, sizes, right = np.linalg.svd(wide * units[:, None])
    values = np.zeros(len(left))
    values[: len(sizes)] = sizes
    keep, none = values > HARDLY * values[0], left[:, values <= NONE * values[0]]
    hardly = left[:, ~keep & (values > NONE * values[0])]
    left, values, right = left[:, keep], values[keep], right[: len(sizes)][keep[: len(sizes)]]
    rest = null_space(right)
    across = rest.T @ form @ right.T
    try:
        inner = cho_factor(rest.T @ form @ rest)
    except np.linalg.LinAlgError:
        return None
    best = right @ form @ right.T - across.T @ cho_solve(inner, across)
    back = left / values
    Pi = back @ best @ back.T
    outside = WEIGHT_NONE * (none @ none.T) + WEIGHT_HARDLY * (hardly @ hardly.T)
    Pi = Pi + np.abs(Pi).max() * outside
    Pi = Pi * units * units[:, None]
    return Evidence(setting, full.centre, P, 0.5 * (Pi + Pi.T), evidence.S, evidence.knots, rho)


@dataclass(frozen=True, eq=False)
class Proposal:
    """A solution that holds on the fine grid, with its units and its least margin there.

    A rough one shows that an accurate one exists.
    """

    model: CentreFloats
    units: Units
    solution: Solution
    margin: float
    knots: tuple[int, ...]
    rho: float


@dataclass(frozen=True, eq=False)
class Freedom:
    """Left eigenvectors per mode, pieces of S in age, and directions of distinct rows."""

    eigenvectors: int
    segments: int = 1
    rank: int = 4


class EvidenceSearch:
    """A search for evidence in one setting; models and samples are kept between decay rates."""

    def __init__(self, setting: Setting, level: Freedom) -> None:
        self.setting, self.level = setting, level
        self.model = CentreFloats.of(setting, level.eigenvectors, level.rank)
        last = setting.transitions.last
        marks = np.linspace(0, last, level.segments + 1).round().astype(int)
        late = max(setting.signals.mode_lag, setting.signals.lost_samples)
        reported = [late] if 0 < late < last else []
        knots = sorted({*(int(mark) for mark in marks), *reported})
        self.knots = tuple(knots) if level.eigenvectors else (0,)
        self.looked_at: set[tuple[Transition, Any, float]] = set()
        self.sways = Sways(setting.family)
        self.samples = self._samples()
        delay = float(setting.delays.ends.max())
        self.angles = frequencies(FREQUENCIES, setting.step, delay)
        self.fine = fine_frequencies(setting.past, setting.step, delay)

    def propose(self, rho: float, *, roughly: bool = False) -> Proposal | None:
        """A solution with a margin at all frequencies, or None."""
        with suppress(np.linalg.LinAlgError):  # an eigenvalue is on |z| = ρ
            return self._proposal(rho, roughly)
        return None

    def glance(self, rho: float) -> Proposal | None:
        """As `propose`, but rough and in a third of the time, if the margin is clear.

        In the main thread it is an accurate one. The frequencies are restored, so that later
        proposals do not depend on whether `glance` was called.
        """
        angles = self.angles
        try:
            return self.propose(rho, roughly=True)
        finally:
            self.angles = angles

    def _proposal(self, rho: float, roughly: bool) -> Proposal | None:
        fine = response(self.model, self.fine, rho)
        for _ in range(ROUNDS):
            chosen = response(self.model, self.angles, rho)
            units = Units.of(self.model, chosen, self.samples)
            solved = self._solved(chosen, fine, units, rho, roughly)
            if solved is None:
                return None
            solution, margins = solved
            if margins.min() > ENOUGH * solution.margin:
                margin = min(solution.margin, float(margins.min()))
                return Proposal(self.model, units, solution, margin, self.knots, rho)
            # Add the frequencies of the local minima that violate.
            lows = (margins <= np.roll(margins, 1)) & (margins <= np.roll(margins, -1))
            lows[[0, -1]] = True
            worst = self.fine[lows & (margins < 0.8 * solution.margin)]
            self.angles = np.unique(np.concatenate((self.angles, worst)))
        return None

    def _solved(
        self, chosen: ResponseForms, fine: ResponseForms, units: Units, rho: float, roughly: bool
    ) -> tuple[Solution, np.ndarray] | None:
        """A solution with a margin at the chosen frequencies, and its margins at the fine ones."""
        solution = solve(self.model, chosen, self.samples, units, self.knots, rho, roughly=roughly)
        if solution is None or solution.margin < LEAST_MARGIN:
            return None
        margins = _margins(fine, units, solution)
        if solution.rough and margins.min() < CLEARLY * solution.margin:
            return self._solved(chosen, fine, units, rho, roughly=False)
        return solution, margins

    def prove(self, proposal: Proposal) -> tuple[Evidence | None, Check]:
        """Evidence from a proposal, and the check; samples are added at steps that fail."""
        outcome = Check(False, "no Lyapunov function was found from the multiplier")
        if (
            proposal.solution.rough
        ):  # from a new search: the result does not depend on earlier attempts
            better = EvidenceSearch(self.setting, self.level).propose(proposal.rho)
            if better is None:
                return None, outcome
            proposal = better
        for _ in range(REPAIRS):
            evidence = _evidence(proposal)
            if evidence is None:
                return None, outcome
            outcome = check(evidence)
            if outcome.proven or outcome.failed is None:
                return evidence, outcome
            again = self.propose(proposal.rho) if self._add(*outcome.failed) else None
            if again is None:
                return None, outcome
            proposal = again
        return None, outcome

    def _samples(self) -> list[Sample]:
        samples: list[Sample] = []
        steps: dict[Any, list[tuple[np.ndarray, Sway | None]]] = {}
        kept = _ages_to_visit(self.setting)
        for transition in self.setting.transitions.all(self.knots):
            if kept is not None and transition.age not in kept:
                continue
            key = transition.mode, transition.within, transition.instants
            if key not in steps:
                steps[key] = self._points(transition)
            samples += [self._sample(transition, E, sway) for E, sway in steps[key]]
            if transition.within == transition.mode:
                order = self.setting.family.orders(transition.mode, transition.mode)[0]
                self.looked_at.add((transition, order, 0.0))
        return samples

    def _add(self, failed: Transition, u: float) -> bool:
        """Add samples of a step at the instant u of the period; False if they are there."""
        family: Any = self.setting.family
        order, inner = family.place(failed.mode, failed.within, u)
        key = failed, order, inner if failed.within != failed.mode else 0.0
        if key in self.looked_at:
            return False
        self.looked_at.add(key)
        at = np.array([inner])
        for point in zip(family.corners(order, at), self.sways.at(order, at), strict=True):
            self.samples.append(self._sample(failed, *point))
        return True

    def _sample(self, step: Transition, E: np.ndarray, sway: Sway | None) -> Sample:
        return Sample(step, self.model.delta(E, step.row), sway)

    def _points(self, step: Transition) -> list[tuple[np.ndarray, Sway | None]]:
        """The plant's rows E, and the ellipsoid there, at some instants of a step's switch."""
        family: Any = self.setting.family
        orders, points = family.orders(step.mode, step.within), []
        instants = np.array(INSTANTS if len(orders) == 1 else INSTANTS[::2])
        for order in orders:
            shares = family.shares(order, step.instants)
            if shares is not None:
                at = shares[0] + (shares[1] - shares[0]) * instants
                points += zip(family.corners(order, at), self.sways.at(order, at), strict=True)
        return points


def _ages_to_visit(setting: Setting) -> set[int] | None:
    """The ages to sample where the table has very many; None for all."""
    last = setting.transitions.last
    if setting.context != "mode_age" or last <= MOST_AGES:
        return None
    ends = {age for clock in setting.transitions.clocks for age in (clock.first, clock.last - 1)}
    return {int(age) for age in np.linspace(0, last, MOST_AGES).round()} | {
        *(max(age, 0) for age in ends)
    }


def _margins(response: ResponseForms, units: Units, solution: Solution) -> np.ndarray:
    """The margin t at each frequency: the least eigenvalue of −Y* Π Y relative to the weight."""
    Y, weight, rest = units.of_signals(response)
    form = -(Y.conj().transpose(0, 2, 1) @ (solution.Pi @ Y)) - solution.kappa * rest
    inverse = np.linalg.inv(np.linalg.cholesky(weight))
    scaled = inverse @ form @ inverse.conj().transpose(0, 2, 1)
    return np.linalg.eigvalsh(scaled)[:, 0]


def _evidence(proposal: Proposal) -> Evidence | None:
    """P by the Riccati equation, half of the margin as slack that absorbs its rounding."""
    model, units, rho = proposal.model, proposal.units, proposal.rho
    setting, channels = model.setting, model.channels
    d, v = setting.order, len(units.v)
    scale = 1.0 / np.concatenate((units.v, units.w))
    Pi = proposal.solution.Pi * scale * scale[:, None]
    wide = channels.wide
    form = wide.T @ Pi @ wide
    weight = np.full(d, setting.step)
    weight[: setting.states + setting.memory] = 1.0
    slack = np.concatenate((weight / units.q, 1.0 / units.w**2)) * (0.5 * proposal.margin)
    form[np.diag_indices_from(form)] += slack
    form[:d, :d] += (proposal.solution.kappa / units.w[-1] ** 2) * (model.rest.T @ model.rest)
    P = solve_riccati(model.M / rho, model.B / rho, form[:d, :d], form[d:, d:], form[:d, d:])
    if P is None:
        return None
    psi = units.v[v - len(model.centre.Psi) :]
    S = proposal.solution.S / psi / psi[:, None]
    evidence = Evidence(
        setting,
        model.centre,
        P,
        0.5 * (Pi + Pi.T),
        0.5 * (S + np.swapaxes(S, -1, -2)),
        proposal.knots,
        rho,
    )
    if len(model.rest):
        return extend(evidence, model, 0.5 * slack)
    return evidence
