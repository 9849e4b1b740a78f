"""What `deadtime certify` brackets: least dwell times and longest lags of the mode."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import with_names
from deadtime.cli.printing import print_json, print_table, progress_bar

if TYPE_CHECKING:
    from deadtime.feedback import Law
    from deadtime.problems import Problem
    from deadtime.problems.asked import AskedSignals
    from deadtime.switching import SignalClass


class ProvedBracket(NamedTuple):
    """What is proved of a law and what refuted, seconds; None where nothing is known."""

    certified: float | None
    refuted: float | None
    message: str
    certified_each: tuple[float, ...] | None = None
    refuted_each: tuple[float, ...] | None = None

    def record(self) -> dict[str, object]:
        """For JSON; the dwell times of each mode where they are not one and the same."""
        found = self._asdict()
        return (
            found if _several(self) else {name: found[name] for name in ProvedBracket._fields[:3]}
        )


def least_dwell_times(
    problem: Problem, law: str | None, signals: SignalClass, mode: int | None, json_output: bool
) -> int:
    """The bracket of every law, or of one; 1 if that one has none."""
    from deadtime.margins import least_dwell_time
    from deadtime.problems.asked import step_of
    from deadtime.reports.tables.certificates import left_out

    period = step_of(problem)

    def bracket(one: Law) -> ProvedBracket:
        margin = least_dwell_time(problem.plant, one, period, dwell_time=signals, mode=mode)
        return ProvedBracket(*(getattr(margin, field) for field in ProvedBracket._fields))

    brackets = _brackets(problem, law, bracket, json_output)
    if json_output:
        record = about(problem, period) | for_json(signals, problem.plant.modes)
        if mode is not None:
            record["mode"] = mode
        elif not isinstance(record["dwell_time"], tuple):
            del record["dwell_time"]
        each = {name: one.record() for name, one in brackets.items()}
        print_json(record | {"least_dwell_times": each})
    else:
        said = [
            f"Sampling period {period:g} s.",
            *_limits(signals, problem.plant.modes, mode),
            *left_out(problem),
        ]
        print("\n".join((problem.title, *(with_names(one, problem.modes) for one in said), "")))
        rows = [
            (
                name,
                _seconds(one.certified, one.certified_each, up=True),
                _seconds(one.refuted, one.refuted_each),
            )
            for name, one in brackets.items()
        ]
        print_table(("law", "proved from", "refuted up to"), rows)
        for name, one in brackets.items():
            print(f"• {name}: {with_names(one.message, problem.modes)}")
    return 0 if law is None or brackets[law].certified is not None else 1


def longest_mode_lags(
    problem: Problem, law: str | None, asked: AskedSignals, period: float, json_output: bool
) -> int:
    """The bracket of every law, or of one, in periods; 1 if that one has none."""
    from deadtime.margins import longest_mode_lag
    from deadtime.reports.tables.certificates import left_out

    (dwell, source), signals = asked
    if signals.chatter > 1:
        raise ArgumentError(
            "--longest-mode-lag is asked of a dwell time, not of an average one: give "
            "--dwell-time and --chatter 1."
        )

    def bracket(one: Law) -> ProvedBracket:
        found = longest_mode_lag(problem.plant, one, signals, period)
        return ProvedBracket(found.certified_seconds, found.refuted_seconds, found.message)

    brackets = _brackets(problem, law, bracket, json_output)
    if json_output:
        record = about(problem, period) | for_json(signals, problem.plant.modes)
        each = {name: one.record() for name, one in brackets.items()}
        print_json(record | {"longest_mode_lags": each})
    else:
        said = f"Sampling period {period:g} s, dwell time {dwell:.4g} s ({source})."
        if not signals.is_plain(problem.plant.modes):
            stays, switches = signals.in_words(problem.plant.modes)
            said = f"Sampling period {period:g} s; every signal that {stays}, {switches}."
            said = with_names(said, problem.modes)
        print("\n".join((problem.title, said, *left_out(problem), "")))
        rows = [(name, _lag(one.certified), _lag(one.refuted)) for name, one in brackets.items()]
        print_table(("law", "proved up to", "refuted at"), rows)
        for name, one in brackets.items():
            print(f"• {name}: {with_names(one.message, problem.modes)}")
    return 0 if law is None or brackets[law].certified is not None else 1


def _brackets(
    problem: Problem, law: str | None, bracket: Callable[[Law], ProvedBracket], json_output: bool
) -> dict[str, ProvedBracket]:
    """The bracket of every law, with what refuses it in place of one, or of one law."""
    names, found = list(problem.laws) if law is None else [law], dict[str, ProvedBracket]()
    laws = [problem.law(name) for name in names]
    with progress_bar(len(names), json_output, f"looking at {names[0]}") as advance:
        for name, one in zip(names, laws, strict=True):
            try:
                found[name] = bracket(one)
            except ArgumentError as error:
                if law is not None:
                    raise
                found[name] = ProvedBracket(None, None, str(error))
            advance(name)
    return found


def _limits(signals: SignalClass, modes: int, mode: int | None) -> list[str]:
    """What the search keeps of the signals, where it keeps anything."""
    limits, found = signals.limits(modes), []
    if mode is not None:
        found.append(f"The dwell time of mode {mode} moves; the others stay.")
    elif len(set(limits.dwell_time)) > 1:
        times = ", ".join(f"{one:g}" for one in limits.dwell_time)
        found.append(f"Dwell times of the modes stay in proportion to {times} s.")
    if signals.chatter > 1:
        found.append(
            f"Dwell times τ are averages: {signals.chatter} + T/τ switches in any T seconds at "
            "most, one in a period."
        )
    if len(limits.lasting) < modes:
        found.append("No sojourn is longer than the maximum dwell time of its mode.")
    if signals.at == "samples":
        found.append("Modes change at samples only.")
    if not limits.is_free:
        found.append("Only those switches are taken to happen that the problem allows.")
    return found


def for_json(signals: SignalClass, modes: int) -> dict[str, object]:
    """The signals that were asked about; nothing where there is no limit, null for none."""
    from deadtime.switching import SignalClass
    from deadtime.switching.constraint import one_or_each

    limits = signals.limits(modes)
    found: dict[str, object] = {"dwell_time": one_or_each(limits.dwell_time)}
    if len(limits.lasting) < modes:
        longest = limits.maximum_dwell
        found["maximum_dwell"] = [None if one == float("inf") else one for one in longest]
    if not limits.is_free:
        found["transitions"] = limits.transitions.astype(int)
    usual, names = SignalClass(1.0), ("at", "chatter", "mode_lag", "lost_samples")
    more = {name: getattr(signals, name) for name in names}
    return found | {name: x for name, x in more.items() if x != getattr(usual, name)}


def _lag(seconds: float | None) -> str:
    return "–" if seconds is None else f"{seconds:.4g} s"


def about(problem: Problem, step: float) -> dict[str, object]:
    """What the answers are about, for JSON."""
    without = problem.imperfections_in_words
    return {"problem": problem.name, "step": step, "imperfections_left_out": without}


def _several(one: ProvedBracket) -> bool:
    """Whether modes have dwell times of their own."""
    return any(len(set(each)) > 1 for each in (one.certified_each, one.refuted_each) if each)


def _seconds(value: float | None, each: tuple[float, ...] | None, up: bool = False) -> str:
    from deadtime.margins.dwell_time import in_words

    if value is None or value == float("inf"):
        return "–" if value is None else "any"
    times = (value,) if each is None or len(set(each)) == 1 else each
    return ", ".join(in_words(one, up=up) for one in times) + " s"
