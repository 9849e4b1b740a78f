"""Design for margin: the cheapest gains, filter and period with a requested delay margin."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from deadtime.checks import count, instance, number, positive
from deadtime.design.families import Family, Poles, Weights
from deadtime.design.limits import delay_limit
from deadtime.design.message import sentences
from deadtime.design.result import Design, TradeOff
from deadtime.design.search import MakeLaw, Search, Tried, assessed
from deadtime.errors import ArgumentError
from deadtime.gains import lqr, require_controllable
from deadtime.laws.averaged import AveragedPredictor
from deadtime.laws.base import TableLaw, checked_gains, require_match
from deadtime.laws.exact import ExactPredictor
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.growth import growth_rate
from deadtime.spectrum.margin import DelayMargin, constant_delay_margin

DEAREST = 100.0
_LONGER = (1, 2, 5, 10, 20, 50, 100)  # times the step: what is tried where longer ones are allowed
_CHECKED = 10  # exact margins computed in search of one that reaches
_POINTS = 10  # of the trade-off


def design(
    plant: SwitchedSystem,
    *,
    delay_margin: float,
    step: float = 0.01,
    law: MakeLaw | None = None,
    gains: ArrayLike | None = None,
    filtered: bool | None = None,
    longest_step: float | None = None,
    cost: str = "mean",
    budget: int = 1500,
    dearest: float = DEAREST,
    seed: int = 0,
) -> Design:
    """Gains and a law with a requested delay margin, at the least cost found.

    Varied are the gains (with one input the poles of each mode, with several the LQR weights), the
    time constant of a low-pass filter in the law, and, if allowed, a longer sampling period. If
    nothing tried has the margin, the largest margin found comes back, beside what any linear
    controller could reach.

    Parameters
    ----------
    plant : SwitchedSystem
        The plant at its nominal delay, the model of the law.
    delay_margin : float
        The relative error of the true delay, above 0 and below 1, that every constant mode must
        tolerate both ways: 0.05 for ±5 %.
    step : float
        Sampling period h, seconds.
    law : callable, optional
        The law family: (plant, gains) → law; `AveragedPredictor` by default. For one mode's own
        exact law give a plant of that mode alone.
    gains : array_like, shape (modes, m, n), optional
        The plain design to start from and to compare with; LQR of identity weights by default.
    filtered : bool, optional
        True: only laws with a low-pass filter; False: only without; by default both.
    longest_step : float, optional
        Allow periods up to this, seconds: 2, 5, 10, … times `step`.
    cost : "mean" or "worst"
        The cost ∫ |x|² + |u|² of the mean or of the worst mode, each for ever.
    budget : int
        How many designs to try.
    dearest : float
        Designs that cost more than so many times the cheapest found are not considered.
    seed : int
        Of the samples that the search starts from; the answer depends on nothing else.

    Returns
    -------
    Design

    Raises
    ------
    ArgumentError
        If an argument is malformed, a mode is not controllable, or the law family makes laws that
        are no table or foresee the signal.

    Notes
    -----
    The margin is that of constant modes, exact; switching may lose the loop earlier, which
    `delay_margin(…, dwell_time=…)` decides. A search proves nothing about what it did not find.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], delay=0.5)
    >>> found = design(plant, delay_margin=0.4, step=0.05, budget=200)
    >>> found.reached, found.margin.relative >= 0.4, found.cost > found.plain.cost
    (True, True, True)
    """
    asked = _checked(plant, delay_margin, step, filtered, longest_step, cost, dearest)
    given = None if gains is None else checked_gains(plant, gains, True)
    budget, make = count("budget", budget, 20), law or _averaged
    for mode in range(plant.modes):
        require_controllable(plant.A[mode], plant.B[mode], mode)
    start = lqr(plant, np.eye(plant.states), np.eye(plant.inputs)) if given is None else given
    plain_law = _required_table(plant, make, start)
    limits = tuple(delay_limit(plant, mode) for mode in range(plant.modes))
    search = Search(plant, make, cost == "worst", budget, dearest)
    kinds = [False, True] if filtered is None else [filtered]
    families = [(Poles if plant.inputs == 1 else Weights)(plant, one) for one in kinds]
    steps = [step] if longest_step is None else [k * step for k in _LONGER if k * step <= longest_step]
    _run(search, families, steps, start, asked, np.random.default_rng(seed))
    exact = _Exact(plant)
    chosen = exact.choose(search, asked)
    plain_margin = constant_delay_margin(plant, plain_law, step)
    _, plain_cost, _ = assessed(plant, plain_law, step, search.worst)
    plain = TradeOff(plain_law, step, plain_margin.relative or 0.0, plain_cost)
    if chosen is None:
        chosen_law, chosen_step, margin, price = plain_law, step, plain_margin, plain_cost
    else:
        chosen_law, chosen_step, price = chosen.law, chosen.step, chosen.cost
        margin = exact.margin(chosen)
    growth = _ends(plant, chosen_law, chosen_step, asked)
    reached = (margin.relative or 0.0) >= asked and bool((growth < 0.0).all())
    found = None if chosen is None else TradeOff(chosen_law, chosen_step, margin.relative or 0.0, price)
    result = TradeOff(chosen_law, chosen_step, margin.relative or 0.0, price)
    return Design(
        law=chosen_law,
        gains=start if chosen is None else chosen.choice.gains,
        time_constant=result.time_constant,
        step=chosen_step,
        margin=margin,
        asked=asked,
        reached=reached,
        growth=growth,
        cost=price,
        plain=plain,
        limits=limits,
        points=exact.front(search, found),
        evaluated=search.spent,
        message=sentences(asked, reached, found, plain, limits, search.spent),
    )


def _averaged(plant: SwitchedSystem, gains: np.ndarray) -> AveragedPredictor:
    return AveragedPredictor(plant, gains, allow_unstable=True)


def _checked(
    plant: SwitchedSystem,
    delay_margin: float,
    step: float,
    filtered: bool | None,
    longest_step: float | None,
    cost: str,
    dearest: float,
) -> float:
    """The margin asked for, once the arguments make sense."""
    instance("plant", plant, SwitchedSystem)
    asked = number("delay_margin", delay_margin)
    if not 0.0 < asked < 1.0:
        raise ArgumentError(
            f"delay_margin must be above 0 and below 1, relative to the delay, got {asked:g}: "
            "0.05 asks for ±5 %."
        )
    step = positive("step", step)
    if longest_step is not None and positive("longest_step", longest_step) < step:
        raise ArgumentError(
            f"longest_step must be at least the step, {step:g} s, got {longest_step:g}: leave it "
            "out to keep the step."
        )
    if filtered not in (None, True, False):
        raise ArgumentError(f"filtered must be True, False or None for both, got {filtered!r}.")
    if cost not in ("mean", "worst"):
        raise ArgumentError(f'cost must be "mean" or "worst" over the modes, got {cost!r}.')
    if number("dearest", dearest) <= 1.0:
        raise ArgumentError(f"dearest must be above 1, times the cheapest cost, got {dearest:g}.")
    return asked


def _required_table(plant: SwitchedSystem, make: MakeLaw, gains: np.ndarray) -> TableLaw:
    """The plain design's law, if the family's laws can be run."""
    if not callable(make):
        raise ArgumentError(f"law must be a function (plant, gains) -> law, got {make!r}.")
    law = make(plant, gains)
    kind = type(law).__name__
    if not isinstance(law, TableLaw):
        raise ArgumentError(
            f"law must make laws that are tables, got {kind}: a delay margin is that of a linear loop."
        )
    if isinstance(law, ExactPredictor):
        raise ArgumentError(
            "law must make laws that can run, but ExactPredictor foresees the signal: for a mode's "
            "own exact law give a plant of that mode alone."
        )
    require_match(plant, law)
    return law


def _run(
    search: Search,
    families: Sequence[Family],
    steps: Sequence[float],
    gains: np.ndarray,
    asked: float,
    rng: np.random.Generator,
) -> None:
    """Spend the budget: samples, then polishing for cost, and for margin where it falls short."""
    pairs = [(family, step) for step in steps for family in families]
    share = max(4, int(0.35 * search.budget / len(pairs)))
    for family, step in pairs:
        for parameters in family.starts(gains):
            search.evaluate(family, step, parameters)
        search.samples(family, step, share, rng)
    per_mode = search.plant.modes > 1
    for part in (0.25, 0.3, 0.5, 1.0):
        short = not any(one.margin >= asked for one in search.stable)
        merits = [search.cheapest(asked), search.widest()] if short else [search.cheapest(asked)]
        left = search.budget - search.spent
        for merit in merits:
            if left < 20:
                return
            for start in _distinct(search, merit, 1 if part == 1.0 else 2):
                search.polish(start, merit, per_mode and part >= 0.5, int(part * left / 4.0) + 10)


def _distinct(search: Search, merit, most: int) -> list[Tried]:
    """The best of each family and step, the best of all first."""
    best: list[Tried] = []
    for one in search.ranked(merit):
        if all((one.family, one.step) != (other.family, other.step) for other in best):
            best.append(one)
        if len(best) == most:
            break
    return best


def _ends(plant: SwitchedSystem, law: TableLaw, step: float, asked: float) -> np.ndarray:
    """The growth rates at both ends of the margin asked for, from spectra of their own."""
    ends = [SwitchedSystem(plant.A, plant.B, plant.delay * (1.0 + s * asked)) for s in (-1.0, 1.0)]
    return np.array([[growth_rate(end, law, i, step) for i in range(plant.modes)] for end in ends])


class _Exact:
    """Exact margins of what a search tried, each computed once."""

    def __init__(self, plant: SwitchedSystem) -> None:
        self.plant = plant
        self.known: dict[int, DelayMargin] = {}

    def margin(self, tried: Tried) -> DelayMargin:
        key = id(tried)
        if key not in self.known:
            self.known[key] = constant_delay_margin(self.plant, tried.law, tried.step)
        return self.known[key]

    def relative(self, tried: Tried) -> float:
        return self.margin(tried).relative or 0.0

    def choose(self, search: Search, asked: float) -> Tried | None:
        """The cheapest with the margin asked for; else the one with the largest margin."""
        stable = search.stable
        able = sorted((one for one in stable if one.margin >= asked), key=lambda one: one.cost)
        for one in able[:: max(1, len(able) // 200)][:_CHECKED]:
            if self.relative(one) >= asked:
                return one
        widest = sorted(stable, key=lambda one: -one.margin)[:_CHECKED]
        return max(widest, key=self.relative, default=None)

    def front(self, search: Search, found: TradeOff | None) -> tuple[TradeOff, ...]:
        """The trade-off: designs of which none is both wider and cheaper, few enough to draw."""
        best: list[Tried] = []
        for one in sorted(search.stable, key=lambda one: one.cost):
            if not best or one.margin > best[-1].margin:
                best.append(one)
        if not best:
            return ()
        margins = np.array([one.margin for one in best])
        wanted = np.linspace(margins[0], min(margins[-1], 2.0), _POINTS)
        few = [best[i] for i in sorted({int(np.searchsorted(margins, w - 1e-12)) for w in wanted})]
        points = [TradeOff(one.law, one.step, self.relative(one), one.cost) for one in few]
        points += [] if found is None else [found]
        kept: list[TradeOff] = []
        for point in sorted(points, key=lambda point: (point.cost, -point.margin)):
            if not kept or point.margin > kept[-1].margin:
                kept.append(point)
        return tuple(kept)
