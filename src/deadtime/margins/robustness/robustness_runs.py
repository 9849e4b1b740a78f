"""The runs behind tolerances, and whether the loop does its work in them.

A run is lost when it diverges, ends early, or its loop grows (`simulation.outcome`). One that stays
bounded does not settle either when |x| ends above where it started. Where a force, noise or a
reference pushes x, where limits of the input can keep any oscillation bounded, and from rest, that
says nothing: there a run must do as the perfect loop does, which is pushed alike and has no other
imperfection (`keeps_up`). Without limits the loop is linear, and where the run ends while its own
motion still decays, the horizon is too short, not the loop at fault (`still_falls`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Law
from deadtime.imperfections import Imperfection, Limiting
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


@dataclass(frozen=True, eq=False)
class RobustnessRuns:
    """What is run, and how often."""

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
        """What a run does that is neither lost nor fails."""
        rests = not self.compared or at_rest(self._perfect[0]) is not None
        return "settles" if rests else "keeps up with the perfect loop"

    @property
    def where(self) -> str:
        """What tolerances are about."""
        return f"over {self.horizon:g} s of this signal"

    def costs(self, more: Sequence[Imperfection]) -> Cost:
        """What every scenario with more imperfections costs, as `priced` names it."""
        whole = (*self.imperfections, *more)
        runs = (self._run(self.x0, whole, i) for i in range(self.scenarios))
        return np.array([self._price(run) for run in runs])

    @property
    def priced(self) -> str:
        """What noise costs: of a loop that follows a reference the error, else the cost."""
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
        """Whether |x| alone does not tell if a loop does its work."""
        pushed = is_pushed(self.law, self.imperfections)
        return self._limited or pushed or not self.x0.any()

    @cached_property
    def _limited(self) -> bool:
        return any(isinstance(one, Limiting) for one in self.imperfections)

    @cached_property
    def _perfect(self) -> list[Trajectory]:
        """The runs of every scenario with nothing but what pushes x."""
        alone = pushes(self.imperfections)
        return [self._run(self.x0, alone, i) for i in range(self.scenarios)]

    @cached_property
    def _perfect_elsewhere(self) -> list[Trajectory]:
        """The same from another start."""
        alone, start = pushes(self.imperfections), elsewhere(self.x0)
        return [self._run(start, alone, i) for i in range(self.scenarios)]

    def _run(self, x0: np.ndarray, whole: Sequence[Imperfection], scenario: int) -> Trajectory:
        return simulate(
            self.plant,
            self.law,
            self.signal,
            x0,
            self.horizon,
            self.step,
            self.u0,
            imperfections=whole,
            seed=self.seed + scenario,
        )
