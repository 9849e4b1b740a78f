"""Runs of a problem under every law, and under its first law in constant modes.

Where the problem has no step, laws without an ideal loop are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from deadtime.base.checks import reporter
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.problems.problem import Problem
from deadtime.simulation import Trajectory
from deadtime.simulation.outcome import Outcome, elsewhere, is_pushed, outcome_of
from deadtime.simulation.tracking import measure_of
from deadtime.spectrum import growth_rate
from deadtime.spectrum.held_mode_checks import why_left_out
from deadtime.switching import SwitchingSignal

Progress = Callable[[str], None]
_MOST_PERIODS = 200_000  # of a run in one mode
_MOST_WORK = 2e9  # periods of a run times periods of its delay


@dataclass(frozen=True, eq=False)
class ProblemRuns:
    """Runs of a problem's laws, with their metrics and outcomes.

    Attributes
    ----------
    problem : Problem
        The setting, with the laws that were run.
    runs : mapping
        One run per law, on the problem's signal.
    reasons : mapping
        Why each law that was left out has no run.
    """

    problem: Problem
    runs: Mapping[str, Trajectory]
    reasons: Mapping[str, str]

    @property
    def lead(self) -> str:
        """Name of the law that the problem is about, its first."""
        return next(iter(self.runs))

    @property
    def signal(self) -> SwitchingSignal:
        """The switching signal of the problem; for a rule, that of the first law's run."""
        return self.runs[self.lead].signal

    @cached_property
    def metrics(self) -> dict[str, dict[str, float]]:
        """`Trajectory.metrics` of each run, at the problem's cost."""
        return {name: run.metrics(self.problem.weight) for name, run in self.runs.items()}

    @cached_property
    def outcomes(self) -> dict[str, Outcome]:
        """How each run ends."""
        return {name: ending(self.problem, name, run) for name, run in self.runs.items()}

    @property
    def measure(self) -> str:
        """The metric by which its laws are ranked."""
        return measure_of(run.followed for run in self.runs.values())


@dataclass(frozen=True, eq=False)
class Comparison(ProblemRuns):
    """Runs of a problem's laws, and of its first one with each mode held.

    Attributes
    ----------
    held : tuple of Trajectory
        The problem's first law with mode 0, 1, … held.
    growth : tuple of float
        Growth rate of each of these, 1/s: positive means unstable. From the loop's spectrum; where
        that does not exist or takes long, as `measured`.
    measured : tuple of float
        The slope of log|x| over the second half of each of these runs, 1/s.
    """

    held: tuple[Trajectory, ...]
    growth: tuple[float, ...]
    measured: tuple[float, ...]


def compare(problem: Problem, progress: Progress | None = None) -> Comparison:
    """Run every law of a problem, then its first law without any switching.

    Parameters
    ----------
    problem : Problem
        The setting.
    progress : callable, optional
        Called with the name of each task before it starts.

    Examples
    --------
    >>> import deadtime as dt
    >>> from deadtime.problems.comparison import compare
    >>> result = compare(dt.problems.paper())
    >>> [round(rate, 2) for rate in result.growth]      # unstable if it stops switching
    [0.13, 0.28]
    """
    progress = reporter("progress", progress)
    runs, refused = _run(problem, progress)
    if refused:
        problem = replace(problem, laws={name: problem.laws[name] for name in runs})
    # Long enough for the slowest root to dominate.
    horizon = max(4.0 * problem.horizon, 30.0 * problem.plant.longest_delay)
    if problem.step is not None:
        held_inputs = max(1.0, problem.plant.longest_delay / problem.step)
        most = min(_MOST_PERIODS, _MOST_WORK / held_inputs)
        horizon = max(problem.horizon, min(horizon, most * problem.step))
    held = []
    for mode in range(problem.plant.modes):
        progress(f"simulating: {problem.modes[mode]} held")
        held.append(problem.hold(mode, horizon))
    measured = tuple(-run.metrics()["decay_rate"] for run in held)
    growth = held_growth(problem, next(iter(problem.laws.values()))) or measured
    return Comparison(problem, runs, refused, tuple(held), growth, measured)


def _run(problem: Problem, progress: Progress) -> tuple[dict[str, Trajectory], dict[str, str]]:
    """The runs of all laws that have one, and why the others have none."""
    runs: dict[str, Trajectory] = {}
    refused: dict[str, ArgumentError] = {}
    for name in problem.laws:
        progress(f"simulating: {name}")
        try:
            runs[name] = problem.simulate(name)
        except ArgumentError as error:
            if problem.step is not None:
                raise
            refused[name] = error
    if not runs:
        raise next(iter(refused.values()))
    return runs, {name: str(error) for name, error in refused.items()}


def ending(problem: Problem, name: str, run: Trajectory) -> Outcome:
    """The outcome of a law's run; a forced run is compared with one from another state."""
    law = problem.laws[name]
    if not is_pushed(law, problem.imperfections):
        return outcome_of(run, problem.horizon)
    other = replace(problem, x0=elsewhere(problem.x0))
    return outcome_of(run, problem.horizon, lambda: other.run(law), problem.imperfections)


def held_growth(problem: Problem, law: Law) -> tuple[float, ...]:
    """Growth rates of a law's loop in every mode, 1/s, from its spectrum.

    None where that takes long, or the law has no such rates.
    """
    plant, step = problem.plant, problem.step
    if why_left_out("growth rate", plant, law, step):
        return ()
    try:
        return tuple(growth_rate(plant, law, mode, step) for mode in range(plant.modes))
    except ArgumentError:
        return ()
