"""Tolerances by simulation: the largest value of an imperfection with which every run succeeds.

An imperfection is tolerated up to a value if every run succeeds there and at every smaller value
that was tried. A run is lost when it diverges, ends early, or its loop grows
(`simulation.outcome`). A bounded run fails, too, when |x| ends above its start. That test says
nothing where a force, noise or a reference pushes x, where input limits keep any oscillation
bounded, and from rest: there a run must end as the run of the perfect loop, which has the same
force, noise and reference and no other imperfection (`keeps_up`). Without limits the loop is
linear; if its own motion still decays when the run ends, the horizon is too short and the run does
not fail (`still_falls`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial

import numpy as np
from jaxtyping import Bool, Float

from deadtime.base.frozen import Frozen
from deadtime.base.wording import amount
from deadtime.feedback import Law
from deadtime.imperfections import Imperfection, Limiting, Noise
from deadtime.plant import SwitchedSystem, Weight
from deadtime.simulation import Trajectory, simulate
from deadtime.simulation.initial_input import InitialInput
from deadtime.simulation.outcome import (
    at_rest,
    elsewhere,
    is_pushed,
    keeps_up,
    outcome_of,
    pushes,
    still_falls,
)
from deadtime.simulation.tracking import Followed
from deadtime.switching import Rule, SwitchingSignal

Cost = Float[np.ndarray, " scenario"]
KEPT, BOUNDED, LOST = range(3)  # how a run ends
_TRIALS = 10
_ROUNDS = 60  # of a bracket, which shrinks by a tenth of the variance at least: 0.9⁶⁰ = 0.002
_DOUBLING = 0.01  # relative: 20 scenarios leave the doubling uncertain by several per cent
_LEVEL = 2.5  # times the base, at twice the doubling: 5 in a linear loop; at 2 no noise adds more


@dataclass(frozen=True, eq=False)
class RobustnessRuns:
    """A loop, the signal that it runs on, and the random numbers of its runs."""

    plant: SwitchedSystem
    law: Law
    signal: SwitchingSignal | Rule
    x0: Float[np.ndarray, " n"]
    horizon: float
    step: float
    scenarios: int
    seed: int
    imperfections: tuple[Imperfection, ...]
    u0: InitialInput = None
    weight: Weight | None = None

    @property
    def moves(self) -> bool:
        """Whether x ever leaves 0."""
        return bool(self.x0.any() or self._run(self.x0, self.imperfections, 0).states.any())

    @property
    def works(self) -> str:
        """The verb of a run that succeeds, for sentences."""
        rests = not self.compared or at_rest(self._perfect[0]) is not None
        return "settles" if rests else "stays near the run without imperfections"

    @property
    def where(self) -> str:
        """The horizon and the signal of every tolerance, for sentences."""
        return f"over {self.horizon:g} s of this signal"

    def costs(self, more: Sequence[Imperfection]) -> Cost:
        """The cost of every scenario with more imperfections; `priced` names it."""
        whole = (*self.imperfections, *more)
        runs = (self._run(self.x0, whole, i) for i in range(self.scenarios))
        return np.array([self._price(run) for run in runs])

    @property
    def priced(self) -> str:
        """The cost of noise, for sentences; of a loop that follows a reference, the error."""
        return "the cost" if Followed.of(self.law) is None else "∫|r − y|²"

    def _price(self, run: Trajectory) -> float:
        if run.tracked is None or run.reference is None:
            return run.metrics(self.weight)["cost"]
        return self.step * float(np.sum((run.reference - run.tracked) ** 2))

    def runs(self, more: Sequence[Imperfection], scenarios: int) -> tuple[Cost, np.ndarray]:
        """The cost of every scenario with more imperfections, and how it ends."""
        cost, ends = np.empty(scenarios), np.empty(scenarios, int)
        for i in range(scenarios):
            whole = (*self.imperfections, *more)
            run = self._run(self.x0, whole, i)
            cost[i] = run.metrics(self.weight)["cost"]
            again = cache(partial(self._run, elsewhere(self.x0), whole, i))
            outcome = outcome_of(run, self.horizon, again if self.compared else None, whole)
            if self.compared:
                kept = outcome.lost or keeps_up(run, self._perfect[i])
                if not (kept or self._limited):
                    kept = still_falls(run, again(), self._perfect[i], self._perfect_elsewhere[i])
            else:
                kept = outcome.kind != "bounded"
            ends[i] = LOST if outcome.lost else KEPT if kept else BOUNDED
        return cost, ends

    @cached_property
    def compared(self) -> bool:
        """Whether |x| alone does not show failure, so that the perfect loop is run as well."""
        pushed = is_pushed(self.law, self.imperfections)
        return self._limited or pushed or not self.x0.any()

    @cached_property
    def _limited(self) -> bool:
        return any(isinstance(one, Limiting) for one in self.imperfections)

    @cached_property
    def _perfect(self) -> list[Trajectory]:
        """The run of every scenario with only the imperfections that push x."""
        alone = pushes(self.imperfections)
        return [self._run(self.x0, alone, i) for i in range(self.scenarios)]

    @cached_property
    def _perfect_elsewhere(self) -> list[Trajectory]:
        alone, start = pushes(self.imperfections), elsewhere(self.x0)
        return [self._run(start, alone, i) for i in range(self.scenarios)]

    def _run(self, x0: np.ndarray, whole: Sequence[Imperfection], scenario: int) -> Trajectory:
        given = self.plant, self.law, self.signal, x0, self.horizon, self.step, self.u0
        return simulate(*given, imperfections=whole, seed=self.seed + scenario)


@dataclass(frozen=True, eq=False)
class Tolerance(Frozen):
    """The runs with one imperfection at growing values (immutable).

    Attributes
    ----------
    values : (k,)
        Values tried, increasing from 0.
    cost : (k, scenarios)
        The cost of each run.
    lost : (k, scenarios) bool
        Whether a run is lost, or no longer settles.
    bounded : (k, scenarios) bool
        Whether a `lost` run stays bounded.
    tolerated : float or None
        The largest value tried at and below which no run was `lost`; None if one is lost at 0.
    failed : float or None
        The smallest value tried at which a run was `lost`; None if there is none.
    message : str
        The same in a sentence.
    """

    values: Float[np.ndarray, " k"]
    cost: Float[np.ndarray, "k scenarios"]
    lost: Bool[np.ndarray, "k scenarios"]
    bounded: Bool[np.ndarray, "k scenarios"]
    tolerated: float | None
    failed: float | None
    message: str


@dataclass(frozen=True, eq=False)
class NoisePrice(Frozen):
    """The price of measurement noise: the standard deviation that doubles the cost.

    In a linear loop E cost = `base` + `slope`·std² for every std; elsewhere this parabola is exact
    at std = 0 and `doubling` alone. The cost of a loop that follows a reference is ∫|r − y|² here:
    the effect of noise on ∫|x|² + |u|² is small beside the cost of holding the reference.

    Attributes
    ----------
    std : (k,)
        Standard deviations of the noise that were run, the first 0, in the states' units.
    cost : (k, scenarios)
    base, slope : float
        The cost without noise, and base/doubling².
    doubling : float
        The standard deviation that doubles the mean cost of these scenarios, to 1 %; NaN where no
        noise tried does, or where the cost levels off beyond it.
    message : str
    """

    std: Float[np.ndarray, " k"]
    cost: Float[np.ndarray, "k scenarios"]
    base: float
    slope: float
    doubling: float
    message: str

    @classmethod
    def unknown(cls, message: str) -> NoisePrice:
        """No price, and why."""
        return cls(np.zeros(1), np.zeros((1, 1)), math.nan, math.nan, math.nan, message)


def tolerance_of(
    setting: RobustnessRuns,
    make: Callable[[float], Imperfection],
    values: Sequence[float],
    refine: Callable[[float, float], float | None],
    scenarios: int,
    sentence: Callable[[float, float | None, bool], str],
) -> Tolerance:
    """The tolerance of the imperfection `make(value)`, tried at rising `values` until a run fails.

    Then at values between the last two, while `refine(good, bad)` returns one.
    `sentence(tolerated, failed, bounded)` states the result; `bounded` says that every run that
    fails stays bounded.
    """
    tried: dict[float, tuple[Cost, np.ndarray]] = {}

    def fails(value: float) -> bool:
        more = [make(value)] if value > 0.0 else []
        tried[value] = setting.runs(more, scenarios)
        return bool((tried[value][1] != KEPT).any())

    good, bad = None, None
    for value in values:
        if fails(value):
            bad = value
            break
        good = value
    while good is not None and bad is not None:
        middle = refine(good, bad)
        if middle is None:
            break
        good, bad = (good, middle) if fails(middle) else (middle, bad)
    order = sorted(tried)
    cost, ends = (np.array([tried[value][i] for value in order]) for i in range(2))
    lost, bounded = ends != KEPT, ends == BOUNDED
    bad = np.flatnonzero(lost.any(axis=1))
    failed = order[bad[0]] if bad.size else None
    stays = bool(bad.size) and not (ends[bad[0]] == LOST).any()
    if failed == order[0]:
        text = "the runs are lost as they are, with nothing added"
        if stays:
            text = f"not every run {setting.works} as it is, with nothing added"
        return Tolerance(np.array(order), cost, lost, bounded, None, failed, text)
    tolerated = order[bad[0] - 1] if bad.size else order[-1]
    text = sentence(tolerated, failed, stays)
    return Tolerance(np.array(order), cost, lost, bounded, tolerated, failed, text)


def noise_price(setting: RobustnessRuns, unit: float) -> NoisePrice:
    """The price of measurement noise, searched from a thousandth of `unit` (|x(0)|, or 1 at rest).

    Every standard deviation is run with the same random numbers, so that the mean cost is a
    continuous function of it: in a linear loop a parabola. Limits of the inputs bend it, so that no
    parabola through distant points gives the doubling; it is bracketed instead.
    """
    base_cost = setting.costs([])
    base = float(base_cost.mean())
    tried = {0.0: base_cost}

    def excess(std: float) -> float:
        """Added cost less the base: 0 where the cost is doubled; infinite in runs that diverge."""
        if std not in tried:
            tried[std] = setting.costs([Noise(std)])
        more = float(tried[std].mean()) - 2.0 * base
        return more if math.isfinite(more) else math.inf

    def unknown(why: str) -> NoisePrice:
        text = f"the price of measurement noise could not be computed: {why}"
        return NoisePrice(np.zeros(1), base_cost[None], base, math.nan, math.nan, text)

    if not 0.0 < base < math.inf:
        return unknown(f"without noise {setting.priced} is {amount(base)}, which nothing doubles")
    low, high = 0.0, 1e-3 * unit
    for _ in range(_TRIALS):
        if excess(high) >= 0.0:
            break
        low, high = high, 4.0 * high
    else:
        return unknown(f"with {amount(low)} {setting.priced} is not doubled; more was not tried")
    for _ in range(_ROUNDS):
        if high - low <= _DOUBLING * high:
            break
        below, above = excess(low), excess(high)
        # A secant in the variance is nearly exact for a linear loop; its share is kept off the
        # ends, so that the bracket shrinks in every round. Bisection beside runs that diverge.
        share = below / (below - above) if math.isfinite(above) else 0.5
        middle = math.sqrt(low**2 + min(max(share, 0.1), 0.9) * (high**2 - low**2))
        if abs(excess(middle)) <= _DOUBLING * base:
            low = high = middle
        elif excess(middle) < 0.0:
            low = middle
        else:
            high = middle
    else:
        return unknown(f"{setting.priced} is doubled by noise below {amount(high)} already")
    doubling = 0.5 * (low + high)
    std = doubling * np.array([0.0, 0.25, 0.5, 1.0, 2.0])
    for value in std.tolist():
        excess(value)
    cost = np.array([tried[value] for value in std.tolist()])
    if cost[-1].mean() < _LEVEL * base:
        text = (
            f"the price of measurement noise could not be computed: {setting.priced} does not grow "
            "with its variance, as where inputs are at their limits"
        )
        return NoisePrice(std, cost, base, math.nan, math.nan, text)
    signal = "state" if setting.law.outputs is None else "output"
    text = f"measurement noise with a standard deviation of {amount(doubling)} in every {signal}"
    if setting.x0.any():
        part = doubling / unit
        text += f", {100.0 * part:.2g} % of |x(0)|," if part < 1.0 else ""
    text += f" doubles {setting.priced}"
    return NoisePrice(std, cost, base, base / doubling**2, doubling, text)
