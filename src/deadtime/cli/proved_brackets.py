"""The searches of `deadtime certify`: least dwell times and longest mode detection delays."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import with_names
from deadtime.cli.printing import (
    print_answer,
    print_details,
    print_json,
    print_table,
    progress_bar,
)

if TYPE_CHECKING:
    from deadtime.feedback import Law
    from deadtime.problems import Problem
    from deadtime.problems.switching_assumptions import AssumedSignals
    from deadtime.switching import SignalClass


class ProvedBracket(NamedTuple):
    """The ends of a bracket, proved and refuted, in seconds; None where nothing is known."""

    certified: float | None
    refuted: float | None
    message: str
    certified_each: tuple[float, ...] | None = None
    refuted_each: tuple[float, ...] | None = None

    def record(self) -> dict[str, object]:
        """For JSON, with the dwell times of the modes if they differ."""
        each = self.certified_each, self.refuted_each
        several = any(len(set(one)) > 1 for one in each if one)
        kept = self._fields if several else self._fields[:3]
        return {name: getattr(self, name) for name in kept}


def least_dwell_times(
    problem: Problem, law: str | None, signals: SignalClass, mode: int | None, json_output: bool
) -> int:
    """Print the bracket of every law, or of one; 1 if nothing is proved for that one."""
    from deadtime.margins import least_dwell_time
    from deadtime.problems.switching_assumptions import step_of

    period, modes = step_of(problem), problem.plant.modes

    def bracket(one: Law) -> ProvedBracket:
        margin = least_dwell_time(problem.plant, one, period, dwell_time=signals, mode=mode)
        return ProvedBracket(*(getattr(margin, field) for field in ProvedBracket._fields))

    def cells(one: ProvedBracket) -> tuple[str, str]:
        proved = _seconds(one.certified, one.certified_each, up=True)
        return proved, _seconds(one.refuted, one.refuted_each)

    record = setting_record(problem, period, signals)
    if mode is not None:
        record["mode"] = mode
    elif not isinstance(record["dwell_time"], tuple):
        del record["dwell_time"]
    kept = (with_names(one, problem.modes) for one in _kept_limits(signals, modes, mode))
    notes = [f"Sampling period {period:g} s.", *kept]
    table = ("law", "proved dwell time, s", "refuted dwell time, s"), cells
    return _answer(problem, law, bracket, ("least_dwell_times", record), notes, table, json_output)


def longest_mode_lags(
    problem: Problem, law: str | None, assumed: AssumedSignals, period: float, json_output: bool
) -> int:
    """Print the bracket of every law, or of one; 1 if nothing is proved for that one."""
    from deadtime.margins import longest_mode_lag

    signals = assumed.signals
    if signals.chatter > 1:
        raise ArgumentError(
            "--longest-mode-lag needs a dwell time, not an average one: give --dwell-time and "
            "--chatter 1."
        )

    def bracket(one: Law) -> ProvedBracket:
        lag = longest_mode_lag(problem.plant, one, signals, period)
        return ProvedBracket(lag.certified_seconds, lag.refuted_seconds, lag.message)

    def cells(one: ProvedBracket) -> tuple[str, str]:
        ends = one.certified, one.refuted
        low, high = ("–" if seconds is None else f"{seconds:.4g}" for seconds in ends)
        return low, high

    record = setting_record(problem, period, signals)
    notes = [assumed.in_words(problem.modes, period)]
    table = "law", "proved lag, s", "refuted lag, s"
    given = ("longest_mode_lags", record), notes, (table, cells)
    return _answer(problem, law, bracket, *given, json_output)


def _answer(
    problem: Problem,
    law: str | None,
    bracket: Callable[[Law], ProvedBracket],
    record: tuple[str, dict[str, object]],
    notes: list[str],
    table: tuple[tuple[str, ...], Callable[[ProvedBracket], tuple[str, str]]],
    json_output: bool,
) -> int:
    """Print the bracket of every law, or the reason why it has none; or that of one law."""
    from deadtime.reports.certificate_tables import left_out

    names, brackets = list(problem.laws) if law is None else [law], dict[str, ProvedBracket]()
    laws = [problem.law(name) for name in names]
    with progress_bar(len(names), json_output, f"searching: {names[0]}") as advance:
        for name, one in zip(names, laws, strict=True):
            try:
                brackets[name] = bracket(one)
            except ArgumentError as error:
                if law is not None:
                    raise
                brackets[name] = ProvedBracket(None, None, str(error))
            advance(name)
    if json_output:
        key, about_them = record
        print_json(about_them | {key: {name: one.record() for name, one in brackets.items()}})
    else:
        headings, cells = table
        sentences = [
            f"{name}: {with_names(x.message, problem.modes)}" for name, x in brackets.items()
        ]
        proved = [name for name, one in brackets.items() if one.certified is not None]
        answer = f"Proved for {', '.join(proved)}." if proved else "Nothing is proved for any law."
        alone = len(sentences) == 1
        print_answer(sentences[0] if alone else answer, problem.title, *notes, "")
        print_table(headings, [(name, *cells(one)) for name, one in brackets.items()])
        print()
        print_details([*([] if alone else sentences), *left_out(problem)])
    return 0 if law is None or brackets[law].certified is not None else 1


def _kept_limits(signals: SignalClass, modes: int, mode: int | None) -> list[str]:
    """Sentences on the limits of the signals that a search for dwell times keeps."""
    limits, sentences = signals.limits(modes), []
    if mode is not None:
        sentences.append(f"The dwell time of mode {mode} varies; the others are kept.")
    elif len(set(limits.dwell_time)) > 1:
        times = ", ".join(f"{one:g}" for one in limits.dwell_time)
        sentences.append(f"Dwell times of the modes stay in proportion to {times} s.")
    if signals.chatter > 1:
        often = f"{signals.chatter} + T/τ switches in any T seconds at most"
        sentences.append(f"Dwell times τ are averages: {often}.")
    if len(limits.lasting) < modes:
        sentences.append("No sojourn is longer than the maximum dwell time of its mode.")
    if signals.at == "samples" or signals.chatter > 1 or not limits.is_free:
        sentences.append(f"Every signal {signals.in_words(modes)[1]}.")
    return sentences


def setting_record(
    problem: Problem, step: float, signals: SignalClass, covered: SignalClass | None = None
) -> dict[str, object]:
    """Problem, period, imperfections that no proof for `covered` covers, and limits of signals."""
    from deadtime.reports.certificate_tables import without_imperfections
    from deadtime.switching import SignalClass
    from deadtime.switching.constraint import one_or_each

    modes, limits = problem.plant.modes, signals.limits(problem.plant.modes)
    record: dict[str, object] = {"problem": problem.name, "step": step}
    record["imperfections_left_out"] = without_imperfections(problem, covered)
    record["dwell_time"] = one_or_each(limits.dwell_time)
    if len(limits.lasting) < modes:
        longest = limits.maximum_dwell
        record["maximum_dwell"] = [None if one == float("inf") else one for one in longest]
    if not limits.is_free:
        record["transitions"] = limits.transitions.astype(int)
    usual, names = SignalClass(1.0), ("at", "chatter", "mode_lag", "lost_samples")
    more = {name: getattr(signals, name) for name in names}
    return record | {name: x for name, x in more.items() if x != getattr(usual, name)}


def _seconds(value: float | None, each: tuple[float, ...] | None, up: bool = False) -> str:
    from deadtime.base.wording import rounded

    if value is None or value == float("inf"):
        return "–" if value is None else "any"
    times = (value,) if each is None or len(set(each)) == 1 else each
    return ", ".join(rounded(one, 5, up=up) for one in times)
