"""One problem under every law of its list, and under its first law when switching stops."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from deadtime.problems import Problem
from deadtime.simulation import Trajectory
from deadtime.switching import SwitchingSignal

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Comparison:
    """What `compare` measured.

    Attributes
    ----------
    problem : Problem
    runs : mapping
        One run per law, on the problem's signal.
    metrics : mapping
        `Trajectory.metrics()` of each run.
    held : tuple of Trajectory
        The problem's first law with mode 0, 1, … for ever.
    growth : tuple of float
        Growth rate of each of these, 1/s: positive means unstable.
    """

    problem: Problem
    runs: Mapping[str, Trajectory]
    metrics: Mapping[str, Mapping[str, float]]
    held: tuple[Trajectory, ...]
    growth: tuple[float, ...]

    @property
    def signal(self) -> SwitchingSignal:
        """The switching signal of the problem; what the first law's run made of it for a rule."""
        return self.runs[self.lead].signal

    @property
    def lead(self) -> str:
        """Name of the law that the problem is about, its first."""
        return next(iter(self.runs))


def compare(problem: Problem, progress: Progress = lambda _: None) -> Comparison:
    """Run every law of a problem, then its first law without any switching.

    Parameters
    ----------
    problem : Problem
        The setting.
    progress : callable
        Called with a few words before each piece of work.

    Examples
    --------
    >>> import deadtime as dt
    >>> from deadtime.comparison import compare
    >>> result = compare(dt.problems.paper())
    >>> [round(rate, 2) for rate in result.growth]      # unstable if it stops switching
    [0.13, 0.28]
    """
    runs = {}
    for name in problem.laws:
        progress(f"simulating: {name}")
        runs[name] = problem.simulate(name)
    # Long enough for the slowest root to stand out.
    horizon = max(4.0 * problem.horizon, 30.0 * problem.plant.delay)
    held = []
    for mode in range(problem.plant.modes):
        progress(f"simulating: {problem.modes[mode]} for ever")
        held.append(problem.hold(mode, horizon))
    metrics = {name: run.metrics() for name, run in runs.items()}
    growth = tuple(-run.metrics()["decay_rate"] for run in held)
    return Comparison(problem, runs, metrics, tuple(held), growth)
