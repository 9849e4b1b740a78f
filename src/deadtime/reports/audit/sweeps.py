"""The claims about trends: shorter dwell times, and modes farther apart."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from deadtime.base.wording import amount
from deadtime.gains import place
from deadtime.laws import AveragedPredictor, MeanPredictor
from deadtime.problems import Problem
from deadtime.problems.comparison import Progress
from deadtime.reports.audit.claim import Claim, Sweep
from deadtime.reports.audit.measure import LEAD, MEAN, AuditEvidence, is_stabilised, random_signals
from deadtime.scenarios import monte_carlo
from deadtime.scenarios.paired_statistics import Proportion
from deadtime.switching import SwitchingSignal

STRETCH = (0.5, 1.0, 2.0, 4.0)  # dwell times, as multiples of the example's
DISTANCES = (0.5, 1.0, 1.5, 2.0)  # α
POLES = (-1.0, -2.0)


@dataclass(frozen=True, eq=False)
class Pairs:
    """Laws (2) and (80) on the same signals: rows (2), (80); entry 0 is the problem's signal."""

    ise: np.ndarray
    stabilised: np.ndarray

    @property
    def ratio(self) -> np.ndarray:
        """∫|x|² under (2) over that under (80)."""
        return self.ise[0] / self.ise[1]

    @property
    def medians(self) -> np.ndarray:
        """Median ∫|x|² under (2) and (80) over the random signals."""
        return np.median(self.ise[:, 1:], axis=1)


def pairs(problem: Problem, own: SwitchingSignal, signals: list[SwitchingSignal]) -> Pairs:
    """Run laws (2) and (80) of a problem."""
    assert problem.step is not None
    laws = {name: problem.laws[name] for name in (LEAD, MEAN)}
    data = monte_carlo(
        problem.plant, laws, [own, *signals], problem.x0, problem.horizon, problem.step
    )
    figures = {name: data[name].values for name in ("ise", "final_norm", "decay_rate")}
    return Pairs(figures["ise"], is_stabilised(problem, figures))


def at_the_example(evidence: AuditEvidence, count: int) -> Pairs:
    """The same from the evidence at the example's own dwell time and distance."""
    joined = {
        name: {
            key: np.concatenate((evidence.one[name][key], evidence.many[name][key][:count]))
            for key in ("ise", "final_norm", "decay_rate")
        }
        for name in (LEAD, MEAN)
    }
    return Pairs(
        np.array([figures["ise"] for figures in joined.values()]),
        np.array([is_stabilised(evidence.problem, figures) for figures in joined.values()]),
    )


def stretch(signal: SwitchingSignal, factor: float) -> SwitchingSignal:
    """The signal, slower by a factor."""
    return SwitchingSignal(signal.times * factor, signal.modes, signal.end * factor)


def move_modes(problem: Problem, alpha: float) -> tuple[Problem, float]:
    """The problem with its modes α times as far from mode 0, gains placed anew; and its ε."""
    plant = problem.plant.apart(alpha)
    gains = place(plant, POLES)
    laws = {
        LEAD: AveragedPredictor(plant, gains),
        MEAN: MeanPredictor(plant, place(plant.mean(), POLES)[0], gains),
    }
    matrices = (plant.A, plant.B, gains)
    epsilon = max(np.linalg.norm(M - N, 2) for Ms in matrices for M in Ms for N in Ms)
    return replace(problem, plant=plant, gains=gains, laws=laws), float(epsilon)


def claims_about_dwell_time(
    evidence: AuditEvidence, count: int, seed: int, progress: Progress
) -> Iterator[Claim]:
    """What happens to law (2), alone and against (80), as the dwell time decreases."""
    problem, runs = evidence.problem, []
    times = tuple(evidence.dwell_time * factor for factor in STRETCH)
    for factor, time in zip(STRETCH, times, strict=True):
        if factor == 1.0:
            runs.append(at_the_example(evidence, count))
            continue
        progress(f"audit: laws (2) and (80), dwell time {time:g} s")
        # The problem's own signal is too short to be run faster, only slower.
        own = stretch(problem.given_signal, max(factor, 1.0))
        runs.append(pairs(problem, own, random_signals(problem, time, count, seed)))
    yield _better_when_shorter(runs, times)
    yield _gains_when_shorter(runs, times)


def _better_when_shorter(runs: list[Pairs], times: tuple[float, ...]) -> Claim:
    short, long = f"{times[0]:g}", f"{times[-1]:g}"
    better = Proportion.of(runs[0].ise[0, 1:] < runs[-1].ise[0, 1:])
    medians = ", ".join(
        f"{amount(float(run.medians[0]))} at {time:g} s"
        for run, time in zip(runs, times, strict=True)
    )
    own = [float(run.ise[0, 0]) for run in runs[1:]]
    return Claim(
        key="shorter-dwell-better",
        title="(2) does better at short dwell times",
        where="Section III, last paragraph",
        statement="Law (2) is the more efficient, the shorter the dwell time.",
        test=f"∫|x|² under law (2) is smaller at a dwell time of {short} s than at {long} s, on "
        "the same signal run faster.",
        one_run="On the problem's signal run 1, 2 and 4 times slower, ∫|x|² is "
        f"{amount(own[0])}, {amount(own[1])} and {amount(own[2])}.",
        holds_in_run=own[0] < own[-1],
        many=f"So on {better} signals; medians {medians}.",
        proportion=better,
    )


def _gains_when_shorter(runs: list[Pairs], times: tuple[float, ...]) -> Claim:
    gains = Proportion.of(runs[0].ratio[1:] < runs[-1].ratio[1:])
    lower = tuple(Proportion.of(run.ratio[1:] < 1.0) for run in runs)
    ratio = tuple(float(run.medians[0] / run.medians[1]) for run in runs)
    listed = "; ".join(
        f"at {time:g} s on {share}, ratio of medians {r:.2f}"
        for time, share, r in zip(times, lower, ratio, strict=True)
    )
    own = [float(run.ratio[0]) for run in runs[1:]]
    return Claim(
        key="shorter-dwell-gains",
        title="(2) gains on (80) at short dwell times",
        where="Section III, last paragraph",
        statement="As the dwell time decreases, law (2) gains on law (80).",
        test="∫|x|² under (2), divided by that under (80), is smaller at a dwell time of "
        f"{times[0]:g} s than at {times[-1]:g} s, on the same signal run faster.",
        one_run="On the problem's signal run 1, 2 and 4 times slower, the quotient is "
        f"{own[0]:.2f}, {own[1]:.2f} and {own[2]:.2f}.",
        holds_in_run=own[0] < own[-1],
        many=f"So on {gains} signals. Law (2) has the smaller ∫|x|² {listed}.",
        proportion=gains,
        sweep=Sweep(
            "dwell time (s)",
            times,
            tuple(f"{time:g}" for time in times),
            {"(2) has the smaller ∫|x|²": lower},
            ratio,
        ),
    )


def claim_about_distance(
    evidence: AuditEvidence, count: int, seed: int, progress: Progress
) -> Claim:
    """Whether law (80) bears modes farther apart than (2) does."""
    problem = evidence.problem
    signals = random_signals(problem, evidence.dwell_time, count, seed)
    runs, epsilons = [], []
    for alpha in DISTANCES:
        apart, epsilon = move_modes(problem, alpha)
        epsilons.append(epsilon)
        if alpha == 1.0:
            runs.append(at_the_example(evidence, count))
            continue
        progress(f"audit: laws (2) and (80), distance of the modes × {alpha:g}")
        runs.append(pairs(apart, problem.given_signal, signals))
    return _bears_more(runs, epsilons)


def _bears_more(runs: list[Pairs], epsilons: list[float]) -> Claim:
    # How many of the distances, from the smallest on, a law bears: (law, signal).
    reach = np.cumprod([run.stabilised for run in runs], axis=0).sum(axis=0)
    decided = reach[0, 1:] != reach[1, 1:]
    further = Proportion.of((reach[1, 1:] > reach[0, 1:])[decided])
    shares = {
        law: tuple(Proportion.of(run.stabilised[row, 1:]) for run in runs)
        for row, law in enumerate(("averaged law (2)", "mean law (80)"))
    }
    listed = "; ".join(
        f"α = {alpha:g} (ε = {epsilon:.2f}): "
        + ", ".join(f"{name} {100 * share[i].fraction:.1f} %" for name, share in shares.items())
        for i, (alpha, epsilon) in enumerate(zip(DISTANCES, epsilons, strict=True))
    )
    own = [f"α = {DISTANCES[r - 1]:g}" if r else "none" for r in reach[:, 0]]
    return Claim(
        key="distance",
        title="(80) bears more distant modes than (2)",
        where="Section III, last paragraph",
        statement="Law (80) may be the more robust one when the modes differ more.",
        test="With the modes' difference scaled by α = 0.5, 1, 1.5, 2 and gains placed anew, law "
        "(80) stabilises the signal up to a larger α than (2); signals with the same α for both "
        "are left out.",
        one_run=f"Stabilised up to {own[0]} under (2), {own[1]} under (80).",
        holds_in_run=None if reach[0, 0] == reach[1, 0] else bool(reach[1, 0] > reach[0, 0]),
        many=f"The laws differ on {further.trials:,} of {decided.size:,} signals; (80) reaches "
        f"further on {further}. Stabilised at {listed}.",
        proportion=further,
        sweep=Sweep(
            "α, scale of the difference of the modes",
            DISTANCES,
            tuple(f"{a:g}\nε = {e:.2f}" for a, e in zip(DISTANCES, epsilons, strict=True)),
            shares,
            tuple(float(run.medians[0] / run.medians[1]) for run in runs),
        ),
    )
