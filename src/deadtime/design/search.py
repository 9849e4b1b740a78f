"""The search for designs: global samples, then Nelder and Mead's method from the best of them.

Everything tried is kept, so that the trade-off of margin and cost comes with the answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from deadtime.design.estimate import estimated_margin
from deadtime.design.families import Choice, Family
from deadtime.design.price import BLOCKS, cost_and_growth
from deadtime.errors import ArgumentError
from deadtime.laws.base import Law
from deadtime.laws.low_pass import LowPassPredictor
from deadtime.plant import SwitchedSystem

MakeLaw = Callable[[SwitchedSystem, np.ndarray], Law]
Merit = Callable[["Tried | None"], float]
_SLACK = 1.003  # of the margin asked for: what the estimate may err by
_SLOPE = 12.0  # of the penalty, of the cost's logarithm by that of the margin
_LOST = 1e3
_NEARLY = 0.9  # of the decay asked for: what the estimate may err by
_BLOCKS = 150  # of one delay: enough to compare costs by
_WIDEST = 9.0  # relative: beyond, margins are not told apart


@dataclass(frozen=True, eq=False)
class Tried:
    """One design: its parameters, law, estimated margin (relative, 0 if unstable) and cost.

    growth : of the fastest mode, about, 1/s; negative where all decay
    """

    family: Family
    step: float
    parameters: np.ndarray
    choice: Choice
    law: Law
    margin: float
    cost: float
    growth: float


@dataclass
class Search:
    """The state of a search: what it may spend, and what it has tried."""

    plant: SwitchedSystem
    make: MakeLaw
    worst: bool
    budget: int
    dearest: float
    slowest: float = 0.0  # decay rate that is asked for, 1/s
    tried: list[Tried] = field(default_factory=list)
    spent: int = 0

    @property
    def stable(self) -> list[Tried]:
        """Those that are stable and cost at most `dearest` times the cheapest.

        Of these the ones that decay as fast as is asked, where there are any.
        """
        most = self.dearest * self.least_cost
        found = [one for one in self.tried if one.margin > 0.0 and one.cost <= most]
        return [one for one in found if -one.growth >= _NEARLY * self.slowest] or found

    @property
    def least_cost(self) -> float:
        """The cheapest design's cost, ∞ without one."""
        return min((one.cost for one in self.tried), default=math.inf)

    def evaluate(self, family: Family, step: float, parameters: np.ndarray) -> Tried | None:
        """Try parameters (modes, size); None where they make no law."""
        self.spent += 1
        choice = family.choice(parameters)
        if choice is None:
            return None
        try:
            law = made(self.make, self.plant, choice)
        except ArgumentError:  # the law's own rules for gains
            return None
        one = assessed(self.plant, law, step, self.worst, _BLOCKS)
        tried = Tried(family, step, parameters, choice, law, *one)
        self.tried.append(tried)
        return tried

    def samples(self, family: Family, step: float, count: int, rng: np.random.Generator) -> None:
        """A Latin hypercube over the family's box, the same parameters for all modes."""
        low, high = family.box
        cells = np.stack([rng.permutation(count) for _ in low], axis=1)
        points = low + (high - low) * (cells + rng.random(cells.shape)) / count
        for point in points:
            self.evaluate(family, step, np.tile(point, (self.plant.modes, 1)))

    def polish(self, start: Tried, merit: Merit, per_mode: bool, count: int, size: float) -> None:
        """Nelder and Mead's method from a design, on what all modes share or on each mode's own."""
        from scipy.optimize import minimize

        shape = start.parameters.shape

        def parameters(flat: np.ndarray) -> np.ndarray:
            if per_mode:
                return flat.reshape(shape)
            return start.parameters + flat

        x0 = start.parameters.ravel() if per_mode else np.zeros(shape[1])
        corners = x0 + size * np.concatenate((np.zeros((1, x0.size)), np.eye(x0.size)))
        options = {
            "maxfev": count,
            "initial_simplex": corners,
            "xatol": 1e-4,
            "fatol": 1e-5,
            "adaptive": True,
        }
        minimize(
            lambda flat: merit(self.evaluate(start.family, start.step, parameters(flat))),
            x0,
            method="Nelder-Mead",
            options=options,
        )

    def cheapest(self, asked: float) -> Merit:
        """To be minimised: the cost's logarithm, with a penalty where the margin is too small."""

        def merit(tried: Tried | None) -> float:
            if tried is None or tried.margin <= 0.0:
                return _lost(tried)
            short = math.log(max(asked * _SLACK / tried.margin, 1.0))
            return math.log(tried.cost) + _SLOPE * (short + self._slow(tried))

        return merit

    def widest(self) -> Merit:
        """To be minimised: minus the margin's logarithm, with a penalty on what is too dear."""
        most = self.dearest * self.least_cost

        def merit(tried: Tried | None) -> float:
            if tried is None or tried.margin <= 0.0:
                return _lost(tried)
            dear = math.log(max(tried.cost / most, 1.0)) if most < math.inf else 0.0
            return dear - math.log(tried.margin) + _SLOPE * self._slow(tried)

        return merit

    def _slow(self, tried: Tried) -> float:
        """By how much it decays too slowly, the logarithm."""
        wanted = _SLACK * self.slowest
        if not wanted or -tried.growth >= wanted:
            return 0.0
        return math.log(wanted / max(-tried.growth, 1e-9 * wanted))

    def ranked(self, merit: Merit) -> list[Tried]:
        """All that was tried, the best first."""
        return sorted(self.tried, key=merit)


def _lost(tried: Tried | None) -> float:
    """The merit of what is not stable: the slower it grows, the better."""
    return 3.0 * _LOST if tried is None else _LOST * (1.0 + math.tanh(tried.growth))


def made(make: MakeLaw, plant: SwitchedSystem, choice: Choice) -> Law:
    """The law of a choice, filtered where it has a filter."""
    law = make(plant, choice.gains)
    if choice.time_constant is None:
        return law
    T = choice.time_constant
    return LowPassPredictor(law, T[0, 0] if T.shape[0] == 1 else T)


def assessed(
    plant: SwitchedSystem, law: Law, step: float, worst: bool, blocks: int = BLOCKS
) -> tuple[float, float, float]:
    """Estimated relative margin, cost, and growth of the fastest mode, 1/s, about."""
    from deadtime.switching import SwitchingSignal

    costs, margin, growth = [], math.inf, -math.inf
    for mode in range(plant.modes):
        table = law.digital(step, SwitchingSignal.constant(mode), 1)
        cost, grows = cost_and_growth(plant, table, mode, blocks)
        costs.append(cost)
        growth = max(growth, grows)
        if math.isinf(cost):
            margin = 0.0
        elif margin > 0.0:
            margin = min(margin, _WIDEST, estimated_margin(plant, table, mode))
    return margin, max(costs) if worst else sum(costs) / len(costs), growth
