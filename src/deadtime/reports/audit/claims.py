"""The claims about the example at its own dwell time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from deadtime.base.wording import amount, as_rate
from deadtime.problems import Problem
from deadtime.reports.audit.claim import Claim
from deadtime.reports.audit.measure import LEAD, MEAN, TRANSIENT, AuditEvidence, is_stabilised
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
    rates = ", ".join(
        f"{as_rate(rate)} /s in {mode}"
        for mode, rate in zip(problem.modes, _constant_mode_growth(problem, name), strict=True)
    )
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
        f"dwell time, too; under constant switching signals |x| grows or decays at {rates}.",
        proportion=Proportion.of(good),
    )


def _constant_mode_growth(problem: Problem, name: str) -> list[float]:
    """Growth rates with each mode held, 1/s."""
    longer = replace(problem, horizon=4.0 * problem.horizon)
    runs = [
        longer.simulate(name, SwitchingSignal.constant(mode)) for mode in range(problem.plant.modes)
    ]
    return [-run.metrics()["decay_rate"] for run in runs]


def single_is_worse(evidence: AuditEvidence, mode: int, name: str) -> Claim:
    """A law that believes in one mode performs worse than law (2)."""
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
