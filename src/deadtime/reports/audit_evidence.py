"""The evidence of the audit: runs of every law on random signals, and the record of a claim."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Feedback
from deadtime.problems import Problem
from deadtime.problems.comparison import Progress
from deadtime.scenarios import scenario_seed
from deadtime.scenarios.paired_statistics import Proportion
from deadtime.simulation import Trajectory
from deadtime.simulation.digital_record import DigitalRecord
from deadtime.switching import SwitchingSignal


@dataclass(frozen=True, eq=False)
class Claim:
    """A claim of the paper, in our words, and what became of it.

    Attributes
    ----------
    key, title : str
        A short identifier, and a few words for figures.
    where : str
        Where the paper makes the claim.
    statement : str
        The claim.
    test : str
        What has to be true of a run (or a signal) for the claim to hold there.
    one_run : str
        What the problem's own signal shows.
    holds_in_run : bool or None
        Whether the claim holds there; None when one run cannot decide it.
    many : str
        What many random signals show.
    proportion : Proportion or None
        On how many of them the claim holds; None for a claim about no signal.
    """

    key: str
    title: str
    where: str
    statement: str
    test: str
    one_run: str
    holds_in_run: bool | None
    many: str
    proportion: Proportion | None = None

    @property
    def verdict(self) -> str:
        """The answer of the numbers alone.

        A claim "holds" when no signal drawn contradicts it, "holds on most signals" when its
        whole confidence interval lies above one half (which the first also needs), "does not
        hold on most signals" when all of it lies below, and is "not decided" otherwise. A
        claim about no signal "holds" or "does not hold" as it does in its one computation.
        """
        if self.proportion is None:
            return "holds" if self.holds_in_run else "does not hold"
        low, high = self.proportion.interval
        if low <= 0.5:
            return "does not hold on most signals" if high < 0.5 else "not decided"
        everywhere = self.proportion.count == self.proportion.trials
        return "holds" if everywhere else "holds on most signals"


LEAD, MEAN = "averaged", "mean"
TRANSIENT = 5.0  # seconds: five delays of the example
BLOCKS = 10

Figures = Mapping[str, Mapping[str, np.ndarray]]  # law → figure → one entry per signal


@dataclass(frozen=True, eq=False)
class AuditEvidence:
    """The runs that the claims about the example are judged by.

    `one` is of the problem's own signal, `many` of random ones with the dwell time, in seconds: law
    → figure → array over the signals. Figures are those of `figures_of_run` and
    `figures_of_transient`, and `command_error`, the rms of `commands` minus `exact_commands` along
    the run of law (2).
    """

    problem: Problem
    dwell_time: float
    one: Figures
    many: Figures

    @property
    def singles(self) -> list[str]:
        """Names of the laws that predict with one mode held, in the order of the modes."""
        return [name for name in self.one if name not in (LEAD, MEAN)]


def random_signals(
    problem: Problem, dwell_time: float, count: int, seed: int
) -> list[SwitchingSignal]:
    """Signals with sojourns τ_d + Exp(τ_d), known up to the horizon plus the delay.

    Signal i of one dwell time is signal i of another one, stretched in time.
    """
    return [
        SwitchingSignal.random(
            problem.plant.modes,
            problem.horizon + problem.plant.longest_delay,
            dwell_time=dwell_time,
            seed=scenario_seed(seed, i),
        )
        for i in range(count)
    ]


def gather(
    problem: Problem, signals: Sequence[SwitchingSignal], before_block: Callable[[], None]
) -> Figures:
    """Every law of the audit on every signal; `before_block` is called `BLOCKS` times."""
    assert problem.step is not None
    names = [name for name in problem.laws if name in (LEAD, MEAN) or name.endswith(" only")]
    tables = [problem.laws[name].digital(problem.step) for name in names]
    rows: dict[str, list[dict[str, float]]] = {name: [] for name in names}
    for block in np.array_split(np.arange(len(signals)), BLOCKS):
        before_block()
        for i in block:
            runs = {name: problem.simulate(name, signals[i]) for name in names}
            exact = exact_commands(runs[LEAD])
            for name, table in zip(names, tables, strict=True):
                error = _rms(commands(runs[LEAD], table) - exact)
                figures = figures_of_run(runs[name]) | {"command_error": error}
                figures |= figures_of_transient(runs[name]) if name in (LEAD, MEAN) else {}
                rows[name].append(figures)
    return {
        name: {key: np.array([row[key] for row in rows[name]]) for key in rows[name][0]}
        for name in names
    }


def figures_of_run(run: Trajectory) -> dict[str, float]:
    """The metrics of a run, and its mismatch relative to the exact commands (both rms)."""
    exact = _rms(exact_commands(run))
    mismatch = _rms(run.inputs.T - exact_commands(run))
    return run.metrics() | {"relative_error": mismatch / exact if exact > 0.0 else 0.0}


def figures_of_transient(run: Trajectory) -> dict[str, float]:
    """∫|x|² and the peak of |x| over the first seconds."""
    early = min(TRANSIENT, run.end)
    return {
        "early_ise": run.record.integrals(early)[0],
        "early_peak": float(np.linalg.norm(run.states[:, run.time <= early], axis=0).max()),
    }


def exact_commands(run: Trajectory) -> Float[np.ndarray, "T m"]:
    """K_σ(t+D) x(t+D): what the law should have commanded at each time of a run.

    Inputs after t do not reach x(t + D), so along one run it is the same for every law.
    """
    assert run.mismatch is not None  # every law of the audit has gains
    return (run.inputs - run.mismatch).T


def commands(run: Trajectory, table: Feedback) -> Float[np.ndarray, "T m"]:
    """Commands of a law of one row, given the states and past inputs of a run (of another)."""
    assert isinstance(run.record, DigitalRecord)
    inputs, first = run.record.inputs, run.record.past - 1
    result = run.states.T @ table.state_gain[0].T
    for i, j in np.ndindex(table.input_gain.shape[2:]):
        taps = table.input_gain[0, :, i, j]
        result[:, i] += np.convolve(inputs[:, j], taps)[first : first + len(result)]
    return result


def is_stabilised(problem: Problem, figures: Mapping[str, np.ndarray]) -> np.ndarray:
    """Where |x| ends below where it started, and still falls over the second half of the run."""
    start = np.linalg.norm(problem.x0)
    return (figures["final_norm"] < start) & (figures["decay_rate"] > 0.0)


def gather_all(
    problem: Problem, dwell_time: float, scenarios: int, seed: int, progress: Progress
) -> AuditEvidence:
    """The evidence on the problem's own signal and on random ones."""
    one = gather(problem, [problem.given_signal], lambda: None)
    signals = random_signals(problem, dwell_time, scenarios, seed)
    many = gather(
        problem, signals, lambda: progress(f"audit: every law on {scenarios:,} random signals")
    )
    return AuditEvidence(problem, dwell_time, one, many)


def _rms(array: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(array))))
