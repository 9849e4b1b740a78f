"""The search for evidence along stretches: matrices, program, directions, check.

The nodes are few: the first age at which a mode may be left and the last age with its own node,
two between them where the order is small. With an average dwell time there is one per mode, and
several factors μ, by which V may rise at a switch, are tried up to the slowest mode's limit.
With uncertain steps (a range of delays, a polytope of plants, lost samples) no stretch has one
matrix, so every age is a node.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from deadtime.certificates.dwell.leaps import Leap, Leaps, Node
from deadtime.certificates.dwell.stretch_program import (
    ADDED,
    Looked,
    LyapunovShape,
    balancing_units,
    decrease,
    functionals,
    metric,
    solve,
    whole,
)
from deadtime.certificates.proof import Check, StretchEvidence, check
from deadtime.certificates.proof.evidence import Setting
from deadtime.certificates.proof.transitions import Transition

LEAST_MARGIN = 1e-9
ROUNDS = 6  # of additional directions
REPAIRS = 4  # of additional instants after a failed proof
ENOUGH = 0.05  # of the margin: the least that must remain in all directions
PIECES = 3  # between the first and the last age, where the order is small
AT_FIRST = 6  # leaps per pair of nodes in the first program
WORST = 12  # leaps added in a round
MOST_STEPS = 400  # with an average dwell time
MOST_WORK = 4e8  # leaps times order³
MOST_UNKNOWNS, MOST_AFTER_LOSSES = 1500, 2400
MOST_RISE = 60.0  # ln μ
# Tried in this order, relative to the largest ln μ that a held mode allows.
RISES = (0.75, 0.93, 0.55, 0.97, 0.86, 0.35, 0.99, 0.998, 0.15)


@dataclass(frozen=True, eq=False)
class Loops:
    """The leaps of a setting at one ρ that constrain the program, in units ζ = frame ξ."""

    shape: LyapunovShape
    leaps: list[tuple[Node, Node, np.ndarray]]
    frame: np.ndarray

    def look(self, k: int) -> Looked:
        """The leap k with its first directions."""
        here, there, M = self.leaps[k]
        return Looked.at(here, there, M, self.shape)


def knots_of(setting: Setting) -> tuple[int, ...]:
    """The ages of the nodes."""
    graph = setting.transitions
    if graph.bucket is not None:
        return (0,)
    if _unknown(setting):
        return tuple(range(graph.last + 1))
    pieces = PIECES if setting.order <= whole(setting) else 1
    if len(set(graph.clocks)) > 1:  # each mode's own ages, so many that no piece is needed
        own = {age for clock in graph.clocks for age in (clock.first, clock.last)}
        return tuple(sorted(own))
    marks = np.linspace(graph.first, graph.last, pieces + 1).round().astype(int)
    return tuple(sorted({int(mark) for mark in marks}))


class StretchSearch:
    """A search for V at nodes in one setting; instants at which a proof failed are kept."""

    def __init__(self, setting: Setting) -> None:
        self.setting, self.knots = setting, knots_of(setting)
        self.leaps = Leaps(setting)
        self.stretches = setting.transitions.stretches(self.knots)
        self.known: list[Leap] = [leap for one in self.stretches for leap in self.leaps.of(one)]
        self.added: set[tuple[Transition, float]] = set()

    @staticmethod
    def suits(setting: Setting) -> bool:
        """Whether there are stretches, and not too many."""
        graph = setting.transitions
        if not setting.plants.in_polytope or (graph.modes == 1 and not graph.losses):
            return False
        if graph.bucket is not None:
            steps = len(setting.F) * graph.modes * graph.places
            return setting.order <= whole(setting) and steps <= MOST_STEPS
        if graph.lag > graph.first or (graph.lag and _unknown(setting)):
            return False  # the loop after a node would depend on the modes before it
        d, most = setting.order, whole(setting)
        if d > most and (_unknown(setting) or 2 * (graph.first + 1) < setting.past):
            return False  # two stretches do not empty the delay line
        entries = min(d, most) * (min(d, most) + 1) // 2 + 1
        unknowns = MOST_AFTER_LOSSES if graph.losses else MOST_UNKNOWNS
        if graph.places * len(knots_of(setting)) * entries > unknowns:
            return False
        return 2 * graph.switching * (2 * graph.losses + 1) * max(d, 8) ** 3 <= MOST_WORK

    def propose(self, rho: float) -> StretchEvidence | None:
        """V at the nodes with a margin at all leaps, or None."""
        proposals = (self._propose(rho, mu) for mu in self._rises(rho))
        return next((one for one in proposals if one is not None), None)

    def _rises(self, rho: float) -> list[float]:
        """Values of μ to try; 1 without an average dwell time.

        With a mode held V has to fall by μ^{1/r}/ρ² in each period, so ln μ is below 2 r (ln ρ −
        ln ρ_i), ρ_i the radius of the mode; a mode that grows allows none.
        """
        periods = self.setting.periods_per_switch
        if periods is None:
            return [1.0]
        held = [leap.M for leap in self.known if leap.here[0] == leap.there[0]]
        radius = max(float(np.abs(np.linalg.eigvals(M)).max()) for M in held)
        most = 2.0 * float(periods) * math.log(rho / max(radius, 1e-9))
        return [math.exp(part * min(most, MOST_RISE)) for part in RISES if most > 0.0]

    def _propose(self, rho: float, mu: float) -> StretchEvidence | None:
        loops = self._loops(rho, mu)
        if loops is None:
            return None
        # The program starts from a few leaps of every pair of nodes, over all ages.
        groups: dict[tuple[Node, Node], list[int]] = {}
        for k, (here, there, _) in enumerate(loops.leaps):
            groups.setdefault((here, there), []).append(k)
        looked = {
            group[k]: loops.look(group[k])
            for group in groups.values()
            for k in np.unique(np.linspace(0, len(group) - 1, AT_FIRST).round().astype(int))
        }
        for _ in range(ROUNDS):
            answer = solve(loops.shape, list(looked.values()))
            if answer is None or answer[0] < LEAST_MARGIN:
                return None
            margin, V = answer[0], loops.shape.values(answer[1])
            if self._lacks_margin(loops, V, margin, looked):
                continue
            places, d = self.setting.transitions.places, self.setting.order
            P = np.zeros((places, len(self.knots), d, d))
            for (place, knot), X in sorted(V.items(), key=lambda item: item[0]):
                # Past a mode's last age it is unused.
                P[place, knot:] = loops.frame.T @ X @ loops.frame
            P = P / np.trace(P[0, 0])
            P = 0.5 * (P + np.swapaxes(P, -1, -2))
            return StretchEvidence(self.setting, P, self.knots, rho, mu)
        return None

    def glance(self, rho: float) -> StretchEvidence | None:
        """As `propose`; only `EvidenceSearch.glance` is quicker."""
        return self.propose(rho)

    def prove(self, proposal: StretchEvidence) -> tuple[StretchEvidence | None, Check]:
        """The proposal or a better one, and the check; instants are added where it fails."""
        outcome = check(proposal)
        for _ in range(REPAIRS):
            if outcome.proven or outcome.failed is None or not self._add(*outcome.failed):
                break
            again = self._propose(proposal.rho, proposal.mu)
            if again is None:
                return None, outcome
            proposal = again
            outcome = check(proposal)
        return proposal, outcome

    def _loops(self, rho: float, mu: float) -> Loops | None:
        """The leaps at one ρ and μ; None where a constant mode grows."""
        graph = self.setting.transitions
        lasts = [clock.last for clock in graph.clocks]
        periods = [self.leaps.full(i, last, last + 1) for i, last in enumerate(lasts)]
        units = balancing_units(periods)
        leaps = [(leap.here, leap.there, leap.in_units(rho, units, mu)) for leap in self.known]
        lasting = [M for here, there, M in leaps if here == there]
        # First balanced, so that Cholesky's factor of the metric is accurate.
        T = metric(lasting, leaps)
        back = np.linalg.inv(T)
        leaps = [(here, there, T @ M @ back) for here, there, M in leaps]
        staying = [leap for leap in leaps if leap[0][0] == leap[1][0]]
        moving = [leap for leap in leaps if leap[0][0] != leap[1][0]]
        H = functionals(moving, len(T), whole(self.setting))
        nodes = tuple(
            (place, k)
            for place in range(graph.places)
            for k in range(len(graph.knots_of(place % graph.modes, self.knots)))
        )
        # A mode that lasts may have several rows, and then no single matrix to sum over.
        staying_at = [(one.knot, one.step.mode) for one in self.stretches if not one.step.switches]
        if _unknown(self.setting) or len(staying_at) > len(set(staying_at)):
            shape, moving = LyapunovShape.of(H, {}, {}, nodes), leaps
        else:
            loops = {here: M for here, there, M in staying if here == there}
            links = {here: M for here, there, M in staying if here != there}
            shape = LyapunovShape.of(H, loops, links, nodes)
        return None if shape is None else Loops(shape, moving, T * units)

    def _lacks_margin(
        self, loops: Loops, V: dict[Node, np.ndarray], margin: float, looked: dict[int, Looked]
    ) -> bool:
        """Whether some leaps lack the margin; the worst get their worst directions."""
        low = []
        for k, (here, there, M) in enumerate(loops.leaps):
            values, vectors = np.linalg.eigh(decrease(V, here, there, M))
            if values[0] < ENOUGH * margin:
                low.append((float(values[0]), k, vectors[:, :ADDED][:, values[:ADDED] < margin]))
        fresh = 0
        for _, k, vectors in sorted(low, key=lambda item: item[:2]):
            if k not in looked and fresh < WORST:
                looked[k] = loops.look(k)
                fresh += 1
            if k in looked:
                looked[k].widen(vectors)
        return bool(low)

    def _add(self, failed: Transition, instant: float) -> bool:
        """Add the leaps of a step at this instant; False if they are there."""
        if (failed, instant) in self.added:
            return False
        self.added.add((failed, instant))
        for stretch in self.stretches:
            if stretch.step == failed:
                self.known += self.leaps.of(stretch, (instant,))
        return failed.within != failed.mode


def _unknown(setting: Setting) -> bool:
    """Whether the steps are uncertain: ranges of delays, sets of plants, lost samples."""
    known = setting.plants.known and not setting.family.ranges
    return not known or setting.signals.lost_samples > 0
