"""The verdict: the measurements of a comparison in plain sentences."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import amount, as_rate, compact, sentence_of
from deadtime.feedback import Law
from deadtime.laws import (
    DelayedStateFeedback,
    ExactPredictor,
    ExpectedPredictor,
    MeanPredictor,
    SingleModePredictor,
)
from deadtime.plant.weight import text_of
from deadtime.problems import Problem
from deadtime.problems.comparison import Comparison
from deadtime.problems.law_registry import the_problem_law
from deadtime.problems.unit_checks import disagreement_of, unit_checks_of
from deadtime.reports.metrics import SETTLES, settling_text
from deadtime.simulation import Trajectory
from deadtime.simulation.outcome import NOISES, why_untested
from deadtime.simulation.tracking import TRACKING_ERROR
from deadtime.spectrum import growth_rate, least_growth
from deadtime.spectrum.held_mode_checks import why_left_out

_SAME = 1e-9  # costs that differ by less, relative, differ by round-off


def verdict(result: Comparison) -> list[str]:
    """Plain sentences, each made from measured figures; unit checks come first.

    Examples
    --------
    >>> import deadtime as dt
    >>> from deadtime.problems.comparison import compare
    >>> print(verdict(compare(dt.problems.paper()))[2])
    Ignoring the delay fails: |x| reaches 1.5 × 10¹³ by the end.
    """
    lead = why_untested(result.runs[result.lead], result.outcomes[result.lead])
    sentences = [*unit_checks_of(result.problem), _headline(result), *([lead] if lead else [])]
    sentences += result.problem.operating_sentences
    sentences += [f"{name} was left out: {why}" for name, why in result.reasons.items()]
    sentences += _imperfections(result) + observer_reads_mode(result.problem, result.runs)
    sentences += _slow_observer(result)
    if result.problem.weight is not None:
        sentences.append(f"The cost is {result.problem.weight.text}.")
    sentences += _best_follower(result)
    early = [name for name, run in result.runs.items() if _ends_early(result, run)]
    if early:
        # Figures of runs of different length do not compare.
        chatter = f"Runs that chatter end early: {', '.join(early)}; see their messages."
        return [*sentences, chatter]
    settled = not any(run.message and not run.diverged for run in result.held)
    sentences += [_without_switching(result)] if result.problem.plant.modes > 1 and settled else []
    sentences += [_baseline(result, name) for name in _names_of(result, DelayedStateFeedback)[:1]]
    if result.problem.plant.modes > 1:  # with one mode these laws are all the same
        singles = _names_of(result, SingleModePredictor)
        sentences += [_single_modes(result, singles)] if singles else []
        oracles = _names_of(result, ExactPredictor)[:1]
        sentences += [_against_the_oracle(result, name) for name in oracles]
    return [*sentences, *disagreement_of(result)]


def _ends_early(result: Comparison, run: Trajectory) -> bool:
    return not run.diverged and run.end < result.problem.horizon


def _names_of(result: Comparison, kind: type[Law]) -> list[str]:
    """Names of the laws of one kind, the lead aside."""
    return [
        name
        for name, law in result.problem.laws.items()
        if isinstance(law, kind) and name != result.lead
    ]


def _headline(result: Comparison) -> str:
    problem, run = result.problem, result.runs[result.lead]
    signal = result.signal
    switches = int(np.sum(signal.times[1:] < run.end))
    setting = f"in {problem.horizon:g} s without a switch"
    if switches:
        count = f"{switches} switches" if switches > 1 else "one switch"
        setting = (
            f"on a signal with {count} in {problem.horizon:g} s "
            f"(shortest sojourn in this run {float(f'{signal.dwell_time:.2g}'):g} s)"
        )
    law = the_problem_law(result.lead)
    law = law[0].upper() + law[1:]
    if run.diverged:
        return f"{law} loses the plant {setting}: {run.message}"
    if _ends_early(result, run):
        return f"The run of {the_problem_law(result.lead)} ends early: {run.message}"
    outcome = result.outcomes[result.lead]
    if outcome.kind == "grows":
        verb = "fails" if outcome.start else "has not settled"
    else:
        verb = "keeps the loop stable" if outcome.kind == "bounded" else "works"
    return f"{law} {verb} {setting}: {outcome.sentence}."


def _imperfections(result: Comparison) -> list[str]:
    """Imperfections of the runs, which laws do not know of."""
    problem, parts = result.problem, []
    if problem.model is not None:
        plant, model = problem.plant, problem.model
        differ = [X for X in "AB" if not np.array_equal(getattr(plant, X), getattr(model, X))]
        parts += [f"{' and '.join(differ)} of the plant differ from the laws' model"] * bool(differ)
        if not np.array_equal(plant.delays, model.delays):
            delays = plant.delay_text, model.delay_text
            parts.append("the true delay is {} s, the model's {} s".format(*delays))
    parts += problem.imperfections_in_words
    return [f"The runs are imperfect: {'; '.join(parts)}."] if parts else []


def observer_reads_mode(problem: Problem, laws: Iterable[str]) -> list[str]:
    """A sentence on the laws that need the mode for their observer alone, if there are any."""
    names = [the_problem_law(name) for name in laws if name in problem.observer_alone_reads_mode]
    if not names:
        return []
    last = f" and {names[-1]}" if len(names) > 1 else ""
    return [
        f"The observer needs the mode at every sample, although {', '.join(names[:-1] or names)}"
        f"{last} {'do' if last else 'does'} not. Where the mode is not measured, [observer] "
        'model = "mean" needs none.'
    ]


def _slow_observer(result: Comparison) -> list[str]:
    """A sentence where the observer error of the first law lasts twice as long as its loop."""
    law, step = result.problem.laws[result.lead], result.problem.step
    if law.observer is None:
        return []
    inner = law.row_law
    if why_left_out("growth rate", inner.plant, inner, step):
        return []
    try:
        loop = [growth_rate(inner.plant, inner, i, step) for i in range(inner.plant.modes)]
    except ArgumentError:
        return []
    slow = [i for i, rate in enumerate(law.observer.rates) if 0.5 * loop[i] < rate < 0.0]
    if not slow:
        return []
    i = max(slow, key=lambda mode: law.observer.rates[mode] - loop[mode])
    return [
        f"The observer is slower than the loop that it serves: held in {result.problem.modes[i]} "
        f"its error decays at {compact(-law.observer.rates[i])} /s, the loop on the true state at "
        f"{compact(-loop[i])} /s. A larger process noise or faster poles speed it up."
    ]


def _best_follower(result: Comparison) -> list[str]:
    """Which law follows the reference best, where there are several."""
    if result.measure != "iae" or len(result.runs) < 2:
        return []
    errors = {
        name: math.inf if result.outcomes[name].lost else row["iae"]
        for name, row in result.metrics.items()
    }
    first, second, *_ = sorted(errors, key=lambda name: errors[name])
    if not math.isfinite(errors[first]):
        return []
    if not math.isfinite(errors[second]):
        return [f"{sentence_of(the_problem_law(first))[:-1]} alone follows its reference."]
    if errors[second] <= errors[first] * (1.0 + _SAME):
        return [f"By {TRACKING_ERROR} no law is the best."]
    return [
        f"By {TRACKING_ERROR} over the whole run {the_problem_law(first)} follows best, "
        f"{amount(errors[first])}; next is {the_problem_law(second)}, {amount(errors[second])}."
    ]


def _without_switching(result: Comparison) -> str:
    same = (
        "Without its imperfections the same loop"
        if result.problem.imperfections
        else "The same loop"
    )
    judged, how = held_in_words(result.problem, result.growth)
    if judged == "stable" or (judged == "unstable" and result.outcomes[result.lead].lost):
        return f"{same} is {judged} without switching, too: {how}."
    return f"Yet {same[0].lower()}{same[1:]} is {judged} if it stops switching: {how}."


def held_in_words(problem: Problem, growth: Sequence[float]) -> tuple[str, str]:
    """Whether a loop with these growth rates, 1/s, is stable with each mode held, and a clause why.

    Examples
    --------
    >>> import deadtime as dt
    >>> held_in_words(dt.problems.follower(), [-0.5, 0.25])
    ('unstable', 'held in brake it grows at +0.250 /s (in the other modes it decays)')
    """
    names, least = problem.modes, least_growth(problem.plant)
    if len(growth) == 1:
        if abs(growth[0]) <= least:
            return "not stable", "it neither grows nor decays"
        grows, finite = growth[0] > least, math.isfinite(growth[0])
        rate = f" at {as_rate(growth[0]) if grows else compact(-growth[0])} /s" if finite else ""
        return ("unstable", f"it grows{rate}") if grows else ("stable", f"it decays{rate}")
    if not growth:
        return "not judged", "it has no growth rates with a mode held"
    unstable = [i for i, rate in enumerate(growth) if rate > least]
    still = [i for i, rate in enumerate(growth) if abs(rate) <= least]
    if still and not unstable:
        where = " and in ".join(names[i] for i in still)
        return "not stable", f"held in {where} it neither grows nor decays"
    if not unstable:
        slowest = int(np.argmax(growth))
        rate = f" (at {compact(-growth[slowest])} /s)" if math.isfinite(growth[slowest]) else ""
        return "stable", f"held in any one mode it decays, slowest in {names[slowest]}{rate}"
    rates = []
    for i in unstable:
        finite = math.isfinite(growth[i])
        rate = f"{as_rate(growth[i])} /s" if finite else "a rate too large to compute"
        rates.append(f"held in {names[i]} {'' if rates else 'it grows '}at {rate}")
    calm = "does not grow" if still else "decays"
    others = "" if len(unstable) == len(growth) else f" (in the other modes it {calm})"
    return "unstable", ", ".join(rates) + others


def _baseline(result: Comparison, name: str) -> str:
    outcome = result.outcomes[name]
    if outcome.kind == "diverged":
        return "Ignoring the delay fails: " + result.runs[name].message
    if outcome.kind == "grows":
        return f"Ignoring the delay fails: |x| reaches {amount(outcome.final)} by the end."
    ends = outcome.sentence
    if outcome.kind == "falls":
        ends = f"|x| falls to {amount(outcome.final)} here"
    times, formula = _times(result, name, result.lead), text_of(result.problem.weight)
    return (
        f"Even ignoring the delay, {ends}, at {times} the cost ({formula}) of "
        f"{the_problem_law(result.lead)}."
    )


def _times(result: Comparison, name: str, other: str) -> str:
    cost, base = (result.metrics[law]["cost"] for law in (name, other))
    if cost == base:
        return f"{amount(1.0)} times"
    return f"{amount(cost / base)} times" if base > 0.0 else "many times"


def _single_modes(result: Comparison, singles: list[str]) -> str:
    modes = result.problem.modes
    ratios = []
    for name in singles:
        law = result.problem.laws[name]
        assert isinstance(law, SingleModePredictor)
        grows = " (and |x| grows)" if result.outcomes[name].lost else ""
        ratios.append(f"{_times(result, name, result.lead)}{grows} for {modes[law.mode]}")
    return (
        "Predicting as if the plant stayed in one mode costs, compared with "
        f"{the_problem_law(result.lead)}, " + ", ".join(ratios) + "."
    )


def _against_the_oracle(result: Comparison, oracle: str) -> str:
    text = (
        f"Compared with an oracle that knows the future, {the_problem_law(result.lead)} costs "
        f"{_times(result, result.lead, oracle)} as much"
    )
    others = [*_names_of(result, MeanPredictor)[:1], *_names_of(result, ExpectedPredictor)[:1]]
    costs = {
        name: math.inf if result.runs[name].diverged else row["cost"]
        for name, row in result.metrics.items()
        if not result.problem.laws[name].needs_preview
    }
    best = min(costs, key=lambda name: costs[name])
    # Named only if it is cheaper than those that are named anyway.
    if costs[best] * (1.0 + _SAME) < min(costs[name] for name in (result.lead, *others)):
        others.append(best)
    text += "".join(f", {the_problem_law(name)} {_times(result, name, oracle)}" for name in others)
    named = {name: costs[name] for name in (result.lead, *others)}
    best = min(named, key=lambda name: named[name])
    if not others or not math.isfinite(named[best]):
        return text + "."
    if max(named.values()) <= named[best] * (1.0 + _SAME):
        return text + ": on this signal they cost the same."
    law = the_problem_law(best)
    return f"{text}: on this signal {law} is the cheapest of those that do not know the future."


def table(result: Comparison) -> list[tuple[str, ...]]:
    """Rows of the table of metrics, columns as in `headings_of`: what ranks the laws comes first.

    A run settles where it comes to rest, which need not be 0.
    """
    followed = result.measure != "cost"
    return [
        (
            name,
            *([compact(row[result.measure])] if followed else []),
            compact(row["ise"]),
            compact(row["energy"]),
            compact(row["cost"]),
            compact(row["peak"]),
            settling_text(result.outcomes[name].settling),
            *(
                []
                if followed
                else ["in noise" if _at_floor(result, name) else as_rate(row["decay_rate"])]
            ),
            compact(row["final_norm"]),
        )
        for name, row in result.metrics.items()
    ]


def _at_floor(result: Comparison, name: str) -> bool:
    """Whether a run has settled in its noise, so that |x| no longer shows a decay rate."""
    noisy = any(isinstance(one, NOISES) for one in result.problem.imperfections)
    # The rate is that of the last half of the run.
    flat = abs(result.metrics[name]["decay_rate"]) * 0.5 * result.runs[name].end < 1.0
    return noisy and flat and math.isfinite(result.outcomes[name].settling)


def headings_of(result: Comparison) -> tuple[str, ...]:
    """Headings of the columns of `table`."""
    if result.measure == "cost":
        return HEADINGS
    law, *others = (heading for heading in HEADINGS if heading != DECAY)
    return law, TRACKING_ERROR, *others


DECAY = "decay in\nrun, 1/s"  # of |x|, which a law with a reference does not bring to 0
HEADINGS = ("law", "∫|x|²", "∫|u|²", "cost", "max |x|", SETTLES, DECAY, "|x(T)|")
