"""Problems by name or by file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from deadtime.base.errors import ArgumentError

if TYPE_CHECKING:
    from deadtime.problems import Problem


def problem_of(place: Path) -> Problem:
    """A named problem, or one from a file."""
    from deadtime.problems import NAMED
    from deadtime.problems.file import load_problem
    from deadtime.problems.file.named_problems import is_named

    return NAMED[str(place)]() if is_named(place) else load_problem(place)


def problem_with(
    place: Path, step: float | str | None, horizon: float | None, x0: str | None
) -> Problem:
    """A problem with another sampling period, horizon or state at the start, where they are given.

    It is built anew: signals reach as far as the run, observers have its period.
    """
    from deadtime.problems.file.load import problem_with_run

    run: dict[str, Any] = {"step": step, "horizon": horizon}
    run["x0"] = None if x0 is None else numbers_of("x0", x0)
    changes = {key: value for key, value in run.items() if value is not None}
    return problem_with_run(place, changes) if changes else problem_of(place)


def one_or_several(name: str, text: str) -> float | list[float]:
    """One number for all, or several with commas between them."""
    numbers = numbers_of(name, text)
    return numbers[0] if len(numbers) == 1 else numbers


def numbers_of(name: str, text: str) -> list[float]:
    """Numbers with commas between them."""
    try:
        return [float(number) for number in text.split(",")]
    except ValueError:
        raise ArgumentError(
            f"{name} must be numbers with commas between them, such as --{name} 1,-0.5, "
            f"got {text!r}."
        ) from None
