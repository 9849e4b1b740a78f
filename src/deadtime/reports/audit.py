"""The audit: every claim of the paper about its example, tested on many random signals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from deadtime.base.checks import positive, reporter
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import amount, as_rate
from deadtime.gains import place
from deadtime.laws import AveragedPredictor, MeanPredictor
from deadtime.problems import Problem
from deadtime.problems.comparison import Progress, held_growth
from deadtime.reports.audit_evidence import (
    BLOCKS,
    LEAD,
    MEAN,
    TRANSIENT,
    AuditEvidence,
    Claim,
    gather_all,
    is_stabilised,
    random_signals,
)
from deadtime.reports.verdict import held_in_words
from deadtime.scenarios import monte_carlo
from deadtime.scenarios.paired_statistics import Proportion
from deadtime.switching import SwitchingSignal

NUMBER = {LEAD: "(2)", MEAN: "(80)"}


def claims_at_dwell_time(evidence: AuditEvidence) -> Iterator[Claim]:
    """In the order of the paper."""
    yield printed_numbers(evidence.problem)
    yield stabilises(evidence, LEAD, "Section III, Figure 3")
    for mode, name in enumerate(evidence.singles):
        yield single_is_worse(evidence, mode, name)
    yield predicts_better(evidence)
    yield stabilises(evidence, MEAN, "Section III, Figure 6")
    yield converges_faster(evidence)
    yield better_transient(evidence)


def printed_numbers(problem: Problem) -> Claim:
    """The gains and ε, against their printed digits."""
    gaps = {row.name: float(np.abs(row.printed - row.computed).max()) for row in problem.published}
    agree = all(gap <= 0.5e-4 for gap in gaps.values())
    return Claim(
        key="numbers",
        title="gains and ε as printed",
        where="Section III, equations (78) and (81), and ε of (5)",
        statement="Poles at −1, −2 give the printed gains, and the modes' distance is ε = 0.7895.",
        test="Recomputed, each number agrees with its four printed decimals.",
        one_run="Computed and printed numbers differ by at most "
        + ", ".join(f"{amount(gap)} ({name})" for name, gap in gaps.items())
        + ".",
        holds_in_run=agree,
        many="No signal enters here.",
    )


def stabilises(evidence: AuditEvidence, name: str, where: str) -> Claim:
    """Law (2) or (80) brings the state to rest."""
    problem, one, many = evidence.problem, evidence.one[name], evidence.many[name]
    good = is_stabilised(problem, many)
    start, end = np.linalg.norm(problem.x0), float(one["final_norm"][0])
    judged, how = held_in_words(problem, held_growth(problem, problem.laws[name]))
    return Claim(
        key=f"{name}-stabilises",
        title=f"{NUMBER[name]} stabilises",
        where=where,
        statement=f"On signals with dwell time {evidence.dwell_time:g} s that keep switching, law "
        f"{NUMBER[name]} stabilises the example.",
        test=f"At {problem.horizon:g} s, |x| is smaller than at 0 s, and log |x| falls over the "
        "second half of the run.",
        one_run=f"|x| goes from {amount(float(start))} to {amount(end)}, and decays at "
        f"{as_rate(float(one['decay_rate'][0]))} /s.",
        holds_in_run=bool(is_stabilised(problem, one)[0]),
        many=f"So on {Proportion.of(good)} signals; median |x| at the end "
        f"{amount(float(np.median(many['final_norm'])))}, largest "
        f"{amount(float(many['final_norm'].max()))}. A signal that stops switching keeps the "
        f"dwell time, too; then the loop is {judged}: {how}.",
        proportion=Proportion.of(good),
    )


def single_is_worse(evidence: AuditEvidence, mode: int, name: str) -> Claim:
    """A law of one mode performs worse than law (2)."""
    one, many = evidence.one, evidence.many
    worse = many[name]["ise"] > many[LEAD]["ise"]
    calm = Proportion.of(is_stabilised(evidence.problem, many[name]))
    ratio = float(np.median(many[name]["ise"] / many[LEAD]["ise"]))
    return Claim(
        key=f"mode-{mode}-worse",
        title=f"(79), mode {mode}, does worse than (2)",
        where=f"Section III, Figure {4 + mode}",
        statement=f"Predicting as if mode {mode} were held, law (79) does worse than (2).",
        test="∫|x|² over the run is larger under law (79) than under (2), on the same signal.",
        one_run=f"∫|x|² is {amount(float(one[name]['ise'][0]))} instead of "
        f"{amount(float(one[LEAD]['ise'][0]))}, and |x| ends at "
        f"{amount(float(one[name]['final_norm'][0]))}.",
        holds_in_run=bool(one[name]["ise"][0] > one[LEAD]["ise"][0]),
        many=f"Worse on {Proportion.of(worse)} signals, {amount(ratio)} times in the median. "
        f"Law (79) for mode {mode} stabilises {calm}.",
        proportion=Proportion.of(worse),
    )


def predicts_better(evidence: AuditEvidence) -> Claim:
    """Law (2) predicts better than the laws of one mode."""
    one, many, singles = evidence.one, evidence.many, evidence.singles

    def best(figures) -> np.ndarray:
        others = np.min([figures[name]["command_error"] for name in singles], axis=0)
        return figures[LEAD]["command_error"] < others

    def say(figures, key: str) -> str:
        values = [amount(float(np.median(figures[name][key]))) for name in (LEAD, *singles)]
        return f"{values[0]} under (2), " + ", ".join(
            f"{value} under (79) for mode {mode}" for mode, value in enumerate(values[1:])
        )

    mean = Proportion.of(many[LEAD]["command_error"] < many[MEAN]["command_error"])
    return Claim(
        key="predicts-better",
        title="(2) predicts better than (79)",
        where="Section III, comment on Figures 4 and 5",
        statement="Law (2) does better than (79) because it predicts more accurately.",
        test="Along the run of (2), each law computes its command from the same state and past "
        "inputs; that of (2) has the smallest rms distance from K x(t + D) of the mode at t + D.",
        one_run=f"Rms distance {say(one, 'command_error')}.",
        holds_in_run=bool(best(one)[0]),
        many=f"So on {Proportion.of(best(many))} signals; medians {say(many, 'command_error')}. "
        "Along each law's own run, relative to the exact command: "
        f"{say(many, 'relative_error')}. The command of law (80), though, is farther off "
        f"than that of (2) on only {mean}.",
        proportion=Proportion.of(best(many)),
    )


def converges_faster(evidence: AuditEvidence) -> Claim:
    """Law (2) settles sooner than law (80)."""
    one, many = evidence.one, evidence.many
    sooner = many[LEAD]["settling_time"] < many[MEAN]["settling_time"]
    later = Proportion.of(many[LEAD]["settling_time"] > many[MEAN]["settling_time"])
    steeper = Proportion.of(many[LEAD]["decay_rate"] > many[MEAN]["decay_rate"])
    times = [_settling(float(one[name]["settling_time"][0])) for name in (LEAD, MEAN)]
    rates = [f"{one[name]['decay_rate'][0]:.3f}" for name in (LEAD, MEAN)]
    return Claim(
        key="faster",
        title="(2) converges faster than (80)",
        where="Section III, Figures 3 and 6",
        statement="The state converges more slowly under law (80) than under (2).",
        test="|x| comes to stay within 2 % of its peak sooner under law (2); where it does under "
        "neither law, the claim does not hold.",
        one_run=f"It does after {times[0]} under (2), {times[1]} under (80); decay rates over the "
        f"second half: {rates[0]} and {rates[1]} /s.",
        holds_in_run=bool(one[LEAD]["settling_time"][0] < one[MEAN]["settling_time"][0]),
        many=f"Sooner on {Proportion.of(sooner)} signals, later on {later}. The decay rate over "
        f"the second half is larger under (2) on {steeper}.",
        proportion=Proportion.of(sooner),
    )


def better_transient(evidence: AuditEvidence) -> Claim:
    """Law (2) has the better start."""

    def is_better(figures, key: str) -> np.ndarray:
        return figures[LEAD][key] < figures[MEAN][key]

    one, many = evidence.one, evidence.many
    both = is_better(many, "early_ise") & is_better(many, "early_peak")
    neither = Proportion.of(~is_better(many, "early_ise") & ~is_better(many, "early_peak"))
    energy, peak = (Proportion.of(is_better(many, key)) for key in ("early_ise", "early_peak"))
    ise, top = (
        [amount(float(one[name][key][0])) for name in (LEAD, MEAN)]
        for key in ("early_ise", "early_peak")
    )
    return Claim(
        key="transient",
        title="(2) has the better transient",
        where="Section III, Figures 3 and 6",
        statement="The transient is better under law (2) than under (80).",
        test=f"Over the first {TRANSIENT:g} s both ∫|x|² and the peak of |x| are smaller under law "
        "(2).",
        one_run=f"∫|x|² is {ise[0]} under (2) and {ise[1]} under (80); peaks {top[0]} and "
        f"{top[1]}.",
        holds_in_run=bool((is_better(one, "early_ise") & is_better(one, "early_peak"))[0]),
        many=f"Both on {Proportion.of(both)} signals, neither on {neither}; ∫|x|² alone on "
        f"{energy}, the peak alone on {peak}.",
        proportion=Proportion.of(both),
    )


def _settling(time: float) -> str:
    return f"{time:.2f} s" if np.isfinite(time) else "more than the run"


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
    """The runs of the evidence, at the example's own dwell time and distance."""
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
    """Claims on law (2), alone and against (80), as the dwell time decreases."""
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
    )


def claim_about_distance(
    evidence: AuditEvidence, count: int, seed: int, progress: Progress
) -> Claim:
    """Whether law (80) tolerates modes farther apart than (2) does."""
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
    return _tolerates_more(runs, epsilons)


def _tolerates_more(runs: list[Pairs], epsilons: list[float]) -> Claim:
    # (law, signal): number of distances, from the smallest on, without a failure in between.
    reach = np.cumprod([run.stabilised for run in runs], axis=0).sum(axis=0)
    decided = reach[0, 1:] != reach[1, 1:]
    further = Proportion.of((reach[1, 1:] > reach[0, 1:])[decided])
    shares = [100.0 * run.stabilised[:, 1:].mean(axis=1) for run in runs]
    listed = "; ".join(
        f"α = {alpha:g} (ε = {epsilon:.2f}): averaged law (2) {averaged:.1f} %, "
        f"mean law (80) {mean:.1f} %"
        for alpha, epsilon, (averaged, mean) in zip(DISTANCES, epsilons, shares, strict=True)
    )
    own = [f"α = {DISTANCES[r - 1]:g}" if r else "none" for r in reach[:, 0]]
    return Claim(
        key="distance",
        title="(80) tolerates more distant modes than (2)",
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
    )


SWEEP_SHARE = 0.4  # of the scenarios, for each point of a sweep
STEPS = BLOCKS + (len(STRETCH) - 1) + (len(DISTANCES) - 1)  # how often `audit` reports progress


def audit(
    problem: Problem,
    scenarios: int = 1000,
    seed: int = 0,
    progress: Progress | None = None,
    dwell_time: float = 0.2,
) -> list[Claim]:
    r"""Test every claim of the paper about its example's runs on many random signals.

    Random signals have sojourns of the dwell time :math:`\tau_d` plus an exponential time of that
    mean. Claims about a trend are measured at four points each, on 0.4 times as many signals, the
    same at each point.

    Parameters
    ----------
    problem : Problem
        The paper's example, `deadtime.problems.paper()`.
    scenarios : int
        Number of random signals, ≥ 1.
    seed : int
        Of the signals; at least 0.
    progress : callable, optional
        Called with a few words before each piece of work, `STEPS` times in all.
    dwell_time : float
        :math:`\tau_d` of the random signals, in seconds; the example's is 0.2.

    Returns
    -------
    list of Claim
        In the order of the paper.

    Raises
    ------
    ArgumentError
        If the problem is another one, or a number is out of range.

    Examples
    --------
    >>> import deadtime as dt
    >>> from deadtime.reports.audit import audit
    >>> for claim in audit(dt.problems.paper(), scenarios=20)[:2]:
    ...     print(claim.title, "–", claim.verdict)
    gains and ε as printed – holds
    (2) stabilises – holds
    """
    if problem.name != "paper":
        raise ArgumentError(
            f"problem must be the paper's example, deadtime.problems.paper(), got "
            f"{problem.name!r}: the audit is about claims made of that example."
        )
    for name, value, least in (("scenarios", scenarios, 1), ("seed", seed, 0)):
        if isinstance(value, bool) or value < least:
            raise ArgumentError(f"{name} must be an integer ≥ {least}, got {value!r}.")
    if problem.step is None:
        raise ArgumentError("problem.step must be a period in seconds: the audit is digital.")
    dwell_time = positive("dwell_time", dwell_time)
    progress = reporter("progress", progress)
    count = max(1, round(SWEEP_SHARE * scenarios))
    evidence = gather_all(problem, dwell_time, scenarios, seed, progress)
    return [
        *claims_at_dwell_time(evidence),
        *claims_about_dwell_time(evidence, count, seed, progress),
        claim_about_distance(evidence, count, seed, progress),
    ]
