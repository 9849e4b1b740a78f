"""The search for designs: global samples, then Nelder and Mead's method from the best of them.

All designs tried are kept for the trade-off of margin and cost, with exact margins.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.laws import LowPassPredictor
from deadtime.margins.delay import DelayMargin, constant_delay_margin
from deadtime.plant import SwitchedSystem, Weight
from deadtime.synthesis.design_measures import assess
from deadtime.synthesis.design_result import Floors, TradeOff
from deadtime.synthesis.gain_families import Choice, ChoiceFamily, Poles, Weights
from deadtime.synthesis.input_peak import largest_inputs

MakeLaw = Callable[[SwitchedSystem, np.ndarray], Law]
Merit = Callable[["Tried | None"], float]
_SLACK = 1.003  # of the request: the error of estimated margins
_SLOPE = 12.0  # of the penalty: cost's logarithm per shortfall
_DEAREST = 100.0  # of the cheapest cost: designs beyond are not considered
_LOST = 1e3  # merit of unstable designs: above all stable ones
_BLOCKS = 150  # of one delay: enough to compare costs


class Spent(Exception):
    """Raised when the budget is spent."""


@dataclass(frozen=True, eq=False)
class Tried:
    """One design: its parameters, law, estimated margin (relative, 0 if unstable) and cost.

    growth : of the fastest growing mode, 1/s; exact if a decay rate is requested
    load : the largest ratio of an input to its limit; 0 without limits
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
    """The state of a search: the request, the budget and the designs tried."""

    plant: SwitchedSystem
    make: MakeLaw
    budget: int
    floors: Floors
    weight: Weight | None = None
    plain: Tried | None = None  # the design for comparison, if it may be chosen, too
    tried: list[Tried] = field(default_factory=list)
    spent: int = 0
    progress: Callable[[str], None] = lambda _: None  # called before each design

    @property
    def stable(self) -> list[Tried]:
        """Stable designs that cost at most `_DEAREST` times the cheapest; and the plain one."""
        most = _DEAREST * self.least_cost
        stable = [one for one in self.tried if one.margin > 0.0]
        return [one for one in stable if one.cost <= most or one is self.plain]

    @property
    def least_cost(self) -> float:
        return min((one.cost for one in self.tried), default=math.inf)

    def evaluate(self, family: ChoiceFamily, step: float, parameters: np.ndarray) -> Tried | None:
        """Try parameters (modes, size); None if they make no law. Raises `Spent` at the end."""
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
        one = assess(self.plant, law, step, _BLOCKS, exact, self.weight)
        load = self.load(law, step) if one[0] > 0.0 else 0.0
        tried = Tried(family, step, parameters, choice, law, *one, load)
        self.tried.append(tried)
        return tried

    def load(self, law: Law, step: float) -> float:
        """The largest ratio of an input to its limit over the modes; 0 without limits."""
        if self.floors.input_limit is None:
            return 0.0
        return self.floors.load(largest_inputs(self.plant, law, step, self.floors.initial))

    def samples(
        self, family: ChoiceFamily, step: float, count: int, rng: np.random.Generator
    ) -> None:
        """A Latin hypercube over the family's box, the same parameters for all modes."""
        low, high = family.box
        cells = np.stack([rng.permutation(count) for _ in low], axis=1)
        for point in low + (high - low) * (cells + rng.random(cells.shape)) / count:
            self.evaluate(family, step, np.tile(point, (self.plant.modes, 1)))

    def polish(self, start: Tried, merit: Merit, per_mode: bool, count: int, size: float) -> None:
        """Nelder and Mead's method from a design, with common changes of all modes or per mode."""
        from scipy.optimize import minimize

        shape = start.parameters.shape

        def parameters(flat: np.ndarray) -> np.ndarray:
            return flat.reshape(shape) if per_mode else start.parameters + flat

        x0 = start.parameters.ravel() if per_mode else np.zeros(shape[1])
        corners = x0 + size * np.concatenate((np.zeros((1, x0.size)), np.eye(x0.size)))
        ends = {"maxfev": count, "xatol": 1e-4, "fatol": 1e-5}
        options = {"initial_simplex": corners, "adaptive": True, **ends}

        def height(flat: np.ndarray) -> float:
            return merit(self.evaluate(start.family, start.step, parameters(flat)))

        minimize(height, x0, method="Nelder-Mead", options=options)

    def cheapest(self) -> Merit:
        """To be minimised: the cost's logarithm, with a penalty on the shortfall."""

        def merit(tried: Tried | None) -> float:
            if tried is None or tried.margin <= 0.0:
                return _unstable_merit(tried)
            return math.log(tried.cost) + _SLOPE * self.shortfall(tried, _SLACK)

        return merit

    def nearest(self) -> Merit:
        """To be minimised: the shortfall, with a penalty on costs above `_DEAREST`."""
        most = _DEAREST * self.least_cost

        def merit(tried: Tried | None) -> float:
            if tried is None or tried.margin <= 0.0:
                return _unstable_merit(tried)
            dear = math.log(max(tried.cost / most, 1.0)) if most < math.inf else 0.0
            return dear + self.shortfall(tried, _SLACK)

        return merit

    def shortfall(self, tried: Tried, slack: float = 1.0) -> float:
        return self.floors.shortfall(tried.margin, -tried.growth, slack, tried.load)

    def ranking(self, merit: Merit) -> list[Tried]:
        return sorted(self.tried, key=merit)


def _unstable_merit(tried: Tried | None) -> float:
    """The merit of an unstable design: slower growth is better."""
    return 3.0 * _LOST if tried is None else _LOST * (1.0 + math.tanh(tried.growth))


def make_law(make: MakeLaw, plant: SwitchedSystem, choice: Choice) -> Law:
    law = make(plant, choice.gains)
    if choice.time_constant is None:
        return law
    T = choice.time_constant
    return LowPassPredictor(law, T[0, 0] if T.shape[0] == 1 else T)


_ROUND = 50  # trials in the first round
_SAMPLED = 0.2  # of a round
_PARTS = (0.2, 0.25, 0.35, 0.5, 1.0)  # of the remaining trials, in order
_SIZES = (0.25, 0.6, 0.25, 0.6, 0.15)  # of the initial simplex of each part
_FEWEST = 20  # trials below which polishing is not begun
_LONGER = (1, 2, 5, 10, 20, 50, 100)  # times the step: periods tried up to `longest_step`


def pairs_of(
    search: DesignSearch, filtered: bool | None, step: float, longest_step: float | None
) -> list[tuple[ChoiceFamily, float]]:
    kinds = [False, True] if filtered is None else [filtered]
    family = Poles if search.plant.inputs == 1 else Weights
    families = [family(search.plant, kind) for kind in kinds]
    longest = step if longest_step is None else longest_step
    steps = [k * step for k in _LONGER if k * step <= longest * (1.0 + 1e-9)]
    return [(family, one) for one in steps for family in families]


def spend(
    search: DesignSearch,
    pairs: Sequence[tuple[ChoiceFamily, float]],
    gains: np.ndarray,
    rng: np.random.Generator,
) -> None:
    """Rounds of samples and polishing, each twice as long as the one before.

    Rounds do not depend on the budget, so a larger one tries all designs of a smaller one.
    """
    try:
        for family, step in pairs:
            for parameters in family.starts(gains):
                search.evaluate(family, step, parameters)
        size = _ROUND
        while True:
            _round(search, pairs, search.spent + size, size, rng)
            size *= 2
    except Spent:
        return


def _round(
    search: DesignSearch,
    pairs: Sequence[tuple[ChoiceFamily, float]],
    end: int,
    size: int,
    rng: np.random.Generator,
) -> None:
    """Samples, then polishing for cost, or for the request while no design meets it."""
    share = max(4, int(_SAMPLED * size / len(pairs)))
    for family, step in pairs:
        search.samples(family, step, share, rng)
    for part, simplex in zip(_PARTS, _SIZES, strict=True):
        short = not any(search.shortfall(one) == 0.0 for one in search.stable)
        merits = [search.nearest()] if short else [search.cheapest()]
        if short and part < 0.3:
            merits.append(search.cheapest())
        per_mode = search.plant.modes > 1 and part >= 0.25
        left = end - search.spent
        for merit in merits:
            if search.budget - search.spent < _FEWEST:
                raise Spent
            if left < _FEWEST:
                return
            for start in _distinct(search, merit, 1 if part == 1.0 else 2):
                search.polish(start, merit, per_mode, int(part * left / 3.0) + 10, simplex)


def _distinct(search: DesignSearch, merit: Merit, most: int) -> list[Tried]:
    """The best design of each family and step, the best of all first."""
    best: list[Tried] = []
    for one in search.ranking(merit):
        if all((one.family, one.step) != (other.family, other.step) for other in best):
            best.append(one)
        if len(best) == most:
            break
    return best


_CHECKED = 10  # designs with exact margins in the search for the nearest
_ERRS = 3e-3  # error of an estimated shortfall
_NEAR = 0.01  # shortfalls closer than this count as equal
_POINTS = 10  # of the trade-off
_WIDE = 2.0  # relative: larger margins count as equal in the trade-off


class Exact:
    """Exact margins of the designs of a search, each computed once."""

    def __init__(self, plant: SwitchedSystem, search: DesignSearch) -> None:
        self.plant = plant
        self.search = search
        self.known: dict[int, DelayMargin] = {}

    def margin(self, tried: Tried) -> DelayMargin:
        key = id(tried)  # `search.tried` keeps it alive, so no other design gets this id
        if key not in self.known:
            self.known[key] = constant_delay_margin(self.plant, tried.law, tried.step)
        return self.known[key]

    def relative(self, tried: Tried) -> float:
        return self.margin(tried).relative or 0.0

    def decay_rate(self, tried: Tried) -> float:
        return -float(self.margin(tried).growth.max())

    def shortfall(self, tried: Tried) -> float:
        found = self.relative(tried), self.decay_rate(tried)
        return self.search.floors.shortfall(*found, load=tried.load)

    def choose(self) -> Tried | None:
        """The cheapest design that meets the request; else the cheapest of the nearest ones."""
        stable = self.search.stable
        short = {one: self.search.shortfall(one) for one in stable}
        for one in sorted(stable, key=_price):
            if short[one] <= _ERRS and self.shortfall(one) == 0.0:
                return one
        few = [*sorted(stable, key=short.__getitem__)[:_CHECKED], *self._front()]
        far = {one: self.shortfall(one) for one in few if self.relative(one) > 0.0}
        least = min(far.values(), default=0.0)
        near = [one for one in far if far[one] <= least + _NEAR]
        return min(near, key=_price, default=None)

    def trade_off(self, chosen: TradeOff | None) -> tuple[TradeOff, ...]:
        """A few designs of the front of margin and cost, and the chosen one.

        If there are designs with the requested decay rate and inputs within their limits, the front
        of these.
        """
        points = [self._point(one) for one in self._front()]
        if chosen is not None:
            points = [chosen, *(point for point in points if point.law is not chosen.law)]
        floors = self.search.floors
        fast = [
            point
            for point in points
            if point.decay_rate >= floors.decay_rate and floors.load(point.input_peak) <= 1.0
        ] or points
        kept, widest = [], 0.0
        for point in sorted(points, key=lambda point: (point.cost, -point.margin)):
            wider = point in fast and point.margin > widest
            if wider or point is chosen:
                kept.append(point)
            if wider:
                widest = point.margin
        return tuple(sorted(kept, key=lambda point: point.margin))

    def _point(self, one: Tried) -> TradeOff:
        peak = largest_inputs(self.plant, one.law, one.step, self.search.floors.initial)
        return TradeOff(one.law, one.step, self.relative(one), one.cost, self.decay_rate(one), peak)

    def _front(self) -> list[Tried]:
        """A few designs of the front by estimated margins, with evenly spaced margins."""
        floor = self.search.floors.decay_rate
        stable = sorted(self.search.stable, key=_price)
        kept = [one for one in stable if (-one.growth >= floor or not floor) and one.load <= 1.0]
        best: list[Tried] = []
        for one in kept or stable:
            if not best or one.margin > best[-1].margin:
                best.append(one)
        if not best:
            return []
        margins = np.array([one.margin for one in best])
        wanted = np.linspace(margins[0], min(margins[-1], max(_WIDE, 2.0 * margins[0])), _POINTS)
        at = np.searchsorted(margins, wanted - 1e-12)  # linspace may miss its end by round-off
        return [best[i] for i in sorted({int(i) for i in at})]


def _price(one: Tried) -> float:
    """The cost to six digits: equal costs keep the order of trial, the plain design first."""
    return float(f"{one.cost:.6g}")
