"""The search for designs: global samples, then Nelder and Mead's method from the best of them.

Everything tried is kept, so that the trade-off of margin and cost comes with the answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.laws import LowPassPredictor
from deadtime.plant import SwitchedSystem, Weight
from deadtime.synthesis.design_measures import assess
from deadtime.synthesis.floors import Floors
from deadtime.synthesis.gain_families import Choice, ChoiceFamily
from deadtime.synthesis.input_peak import largest_inputs

MakeLaw = Callable[[SwitchedSystem, np.ndarray], Law]
Merit = Callable[["Tried | None"], float]
_SLACK = 1.003  # of what is asked for: what the estimates may err by
_SLOPE = 12.0  # of the penalty, of the cost's logarithm by the shortfall
_LOST = 1e3
_BLOCKS = 150  # of one delay: enough to compare costs by


class Spent(Exception):
    """The budget is spent."""


@dataclass(frozen=True, eq=False)
class Tried:
    """One design: its parameters, law, estimated margin (relative, 0 if unstable) and cost.

    growth : of the fastest mode, 1/s; negative where all decay, exact where a decay is asked for
    load : the largest input beside its limit; 0 where none is asked for
    """

    family: ChoiceFamily
    step: float
    parameters: np.ndarray
    choice: Choice
    law: Law
    margin: float
    cost: float
    growth: float
    load: float = 0.0


@dataclass
class DesignSearch:
    """The state of a search: what is asked, what it may spend, and what it has tried."""

    plant: SwitchedSystem
    make: MakeLaw
    worst: bool
    budget: int
    dearest: float
    floors: Floors
    weight: Weight | None = None
    plain: Tried | None = None  # the design to compare with, where it may be chosen, too
    tried: list[Tried] = field(default_factory=list)
    spent: int = 0
    progress: Callable[[str], None] = lambda _: None  # told of each design

    @property
    def stable(self) -> list[Tried]:
        """Those stable at a cost of at most `dearest` times the cheapest's; and the plain one."""
        most = self.dearest * self.least_cost
        stable = [one for one in self.tried if one.margin > 0.0]
        return [one for one in stable if one.cost <= most or one is self.plain]

    @property
    def least_cost(self) -> float:
        """The cheapest design's cost, ∞ without one."""
        return min((one.cost for one in self.tried), default=math.inf)

    def evaluate(self, family: ChoiceFamily, step: float, parameters: np.ndarray) -> Tried | None:
        """Try parameters (modes, size); None where they make no law. `Spent` when that is over."""
        if self.spent >= self.budget:
            raise Spent
        self.spent += 1
        self.progress("trying designs")
        choice = family.choice(parameters)
        if choice is None:
            return None
        try:
            law = make_law(self.make, self.plant, choice)
        except ArgumentError:  # the law's own rules for gains
            return None
        exact = self.floors.decay_rate > 0.0
        one = assess(self.plant, law, step, self.worst, _BLOCKS, exact, self.weight)
        load = self.load(law, step) if one[0] > 0.0 else 0.0
        tried = Tried(family, step, parameters, choice, law, *one, load)
        self.tried.append(tried)
        return tried

    def load(self, law: Law, step: float) -> float:
        """The largest input of the modes beside its limit; 0 where none is asked for."""
        if not self.floors.limited:
            return 0.0
        return self.floors.load(largest_inputs(self.plant, law, step, self.floors.initial))

    def samples(
        self, family: ChoiceFamily, step: float, count: int, rng: np.random.Generator
    ) -> None:
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

    def cheapest(self) -> Merit:
        """To be minimised: the cost's logarithm, with a penalty on what falls short."""

        def merit(tried: Tried | None) -> float:
            if tried is None or tried.margin <= 0.0:
                return _unstable_merit(tried)
            return math.log(tried.cost) + _SLOPE * self.shortfall(tried, _SLACK)

        return merit

    def nearest(self) -> Merit:
        """To be minimised: what is short of the request, with a penalty on what is too dear."""
        most = self.dearest * self.least_cost

        def merit(tried: Tried | None) -> float:
            if tried is None or tried.margin <= 0.0:
                return _unstable_merit(tried)
            dear = math.log(max(tried.cost / most, 1.0)) if most < math.inf else 0.0
            return dear + self.shortfall(tried, _SLACK)

        return merit

    def shortfall(self, tried: Tried, slack: float = 1.0) -> float:
        """By how much the estimates fall short of the request."""
        return self.floors.shortfall(tried.margin, -tried.growth, slack, tried.load)

    def ranking(self, merit: Merit) -> list[Tried]:
        """All that was tried, the best first."""
        return sorted(self.tried, key=merit)


def _unstable_merit(tried: Tried | None) -> float:
    """The merit of what is not stable: the slower it grows, the better."""
    return 3.0 * _LOST if tried is None else _LOST * (1.0 + math.tanh(tried.growth))


def make_law(make: MakeLaw, plant: SwitchedSystem, choice: Choice) -> Law:
    """The law of a choice, filtered where it has a filter."""
    law = make(plant, choice.gains)
    if choice.time_constant is None:
        return law
    T = choice.time_constant
    return LowPassPredictor(law, T[0, 0] if T.shape[0] == 1 else T)
