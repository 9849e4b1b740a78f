"""What `deadtime certify` brackets: least dwell times and longest lags of the mode."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from deadtime.base.errors import ArgumentError
from deadtime.cli.printing import print_json, print_table, progress_bar

if TYPE_CHECKING:
    from deadtime.problems import Problem
    from deadtime.problems.asked import Given


class Bracket(NamedTuple):
    """What is proved of a law and what refuted, seconds; None where nothing is known."""

    certified: float | None
    refuted: float | None
    message: str


def least_dwell_times(problem: Problem, law: str | None, json_output: bool) -> int:
    """The bracket of every law, or of one; 1 if that one has none."""
    from deadtime.margins import least_dwell_time
    from deadtime.problems.asked import step_of
    from deadtime.reports.tables.certificates import left_out

    period, names = step_of(problem), list(problem.laws) if law is None else [law]
    laws, brackets = [problem.law(name) for name in names], dict[str, Bracket]()
    with progress_bar(len(names), json_output, f"looking at {names[0]}") as advance:
        for name, one in zip(names, laws, strict=True):
            try:
                margin = least_dwell_time(problem.plant, one, period)
                brackets[name] = Bracket(margin.certified, margin.refuted, margin.message)
            except ArgumentError as error:
                if law is not None:
                    raise
                brackets[name] = Bracket(None, None, str(error))
            advance(name)
    if json_output:
        print_json(about(problem, period) | {"least_dwell_times": brackets})
    else:
        said = [f"Sampling period {period:g} s.", *_unlimited(problem), *left_out(problem)]
        print("\n".join((problem.title, *said, "")))
        rows = [
            (name, _seconds(one.certified, up=True), _seconds(one.refuted))
            for name, one in brackets.items()
        ]
        print_table(("law", "proved from", "refuted up to"), rows)
        for name, one in brackets.items():
            print(f"• {name}: {one.message}")
    return 0 if law is None or brackets[law].certified is not None else 1


def longest_mode_lags(
    problem: Problem, law: str | None, dwell: Given, period: float, json_output: bool
) -> int:
    """The bracket of every law, or of one, in periods; 1 if that one has none."""
    from deadtime.margins import longest_mode_lag
    from deadtime.reports.tables.certificates import left_out

    names, brackets = list(problem.laws) if law is None else [law], dict[str, Bracket]()
    laws = [problem.law(name) for name in names]
    with progress_bar(len(names), quiet=json_output) as advance:
        for name, one in zip(names, laws, strict=True):
            try:
                found = longest_mode_lag(problem.plant, one, dwell.value, period)
                certified, refuted = found.certified_seconds, found.refuted_seconds
                brackets[name] = Bracket(certified, refuted, found.message)
            except ArgumentError as error:
                if law is not None:
                    raise
                brackets[name] = Bracket(None, None, str(error))
            advance(name)
    if json_output:
        record = about(problem, period) | {"dwell_time": dwell.value}
        print_json(record | {"longest_mode_lags": brackets})
    else:
        said = f"Sampling period {period:g} s, dwell time {dwell.value:.4g} s ({dwell.source})."
        print("\n".join((problem.title, said, *_unlimited(problem), *left_out(problem), "")))
        rows = [(name, _lag(one.certified), _lag(one.refuted)) for name, one in brackets.items()]
        print_table(("law", "proved up to", "refuted at"), rows)
        for name, one in brackets.items():
            print(f"• {name}: {one.message}")
    return 0 if law is None or brackets[law].certified is not None else 1


def _unlimited(problem: Problem) -> list[str]:
    """That the answer is about more signals than the problem allows, where it limits them."""
    if problem.constraint is None or problem.constraint.is_plain:
        return []
    return ["Every switch and every longer sojourn is taken to be allowed, whatever the file says."]


def _lag(seconds: float | None) -> str:
    return "–" if seconds is None else f"{seconds:.4g} s"


def about(problem: Problem, step: float) -> dict[str, object]:
    """What the answers are about, for JSON."""
    without = problem.imperfections_in_words
    return {"problem": problem.name, "step": step, "imperfections_left_out": without}


def _seconds(value: float | None, up: bool = False) -> str:
    from deadtime.margins.dwell_time import in_words

    return (
        "–" if value is None else "any" if value == float("inf") else f"{in_words(value, up=up)} s"
    )
