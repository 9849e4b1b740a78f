"""Options that several commands have, and their values: problems, laws, numbers, signals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from cyclopts import Parameter

from deadtime.base.errors import ArgumentError

if TYPE_CHECKING:
    import numpy as np

    from deadtime.feedback import Law
    from deadtime.problems import Problem
    from deadtime.problems.switching_assumptions import AssumedSignals
    from deadtime.switching import SignalClass
    from deadtime.switching.signal_class import Instants

AsJson = Annotated[
    bool,
    Parameter(
        name="--json",
        negative="",
        show_default=False,
        help="Print the result as JSON instead of text.",
    ),
]
ProblemFile = Annotated[Path, Parameter(help="A problem file, or paper, three-mode, follower.")]
StudyFile = Annotated[Path, Parameter(help="A study file; studies/paper.toml is a commented one.")]
CellSignals = Annotated[
    int | None, Parameter(help="Signals per cell of the grid, instead of the file's.")
]
FirstLaw = Annotated[
    str | None,
    Parameter(help="One law of the problem, by its name in the tables; the first by default."),
]
AllLaws = Annotated[
    str | None,
    Parameter(help="One law of the problem, by its name in the tables; all by default."),
]
_PERIOD = "Sampling period in seconds{}; the problem's by default{}."
Step = Annotated[float | None, Parameter(help=_PERIOD.format("", ", 0.01 where its loop is ideal"))]
StepOrIdeal = Annotated[
    float | Literal["ideal"] | None, Parameter(help=_PERIOD.format(", or ideal", ""))
]
Picture = Annotated[
    Path | None,
    Parameter(
        alias="-o",
        help="The figure, PNG, SVG, PDF or PGF; by default in the current folder, named after the "
        "problem.",
    ),
]
Flag = Annotated[bool, Parameter(negative="", show_default=False)]
Folder = Annotated[Path, Parameter(alias="-o")]
File = Annotated[Path | None, Parameter(alias="-o")]
FigureWidth: TypeAlias = Annotated[
    Literal["column", "page"] | float | None,
    Parameter(
        help="Width of figures: column (3.5 in), page (7.16 in), or inches; by default as their "
        "panels need."
    ),
]


def problem_of(place: Path) -> Problem:
    """A named problem, or one from a file."""
    from deadtime.problems import NAMED
    from deadtime.problems.file import load_problem
    from deadtime.problems.templates import is_named

    return NAMED[str(place)]() if is_named(place) else load_problem(place)


def problem_with(
    place: Path, step: float | str | None, horizon: float | None, x0: str | None
) -> Problem:
    """A problem with another sampling period, horizon or initial state, where given.

    It is rebuilt, so that signals cover the run and observers have its period.
    """
    from deadtime.problems.file.load import problem_with_run

    run: dict[str, Any] = {"step": step, "horizon": horizon}
    run["x0"] = None if x0 is None else numbers_of("x0", x0)
    changes = {key: value for key, value in run.items() if value is not None}
    return problem_with_run(place, changes) if changes else problem_of(place)


def mode_of(problem: Problem, mode: str | None) -> int | None:
    """The number of a mode that is given by its name or, if none has that, its number."""
    from deadtime.base.checks import index
    from deadtime.problems.file.mode_names import mode_numbers

    if mode is None:
        return None
    digits = mode not in problem.modes and mode.removeprefix("-").isdecimal()
    number = mode_numbers("mode", int(mode) if digits else mode, problem.modes)
    return index("mode", number, problem.plant.modes)


def law_of(problem: Problem, name: str | None) -> tuple[str, Law]:
    """A law of the problem with its name; the first by default."""
    chosen = next(iter(problem.laws)) if name is None else name
    return chosen, problem.law(chosen)


def with_law(problem: Problem, name: str | None) -> Problem:
    """The problem with one of its laws; all by default."""
    return problem if name is None else replace(problem, laws={name: problem.law(name)})


def process_noise(problem: Problem) -> np.ndarray:
    """The intensity (modes, n, n) of the file's white disturbances, which add up."""
    import numpy as np

    from deadtime.imperfections import WhiteDisturbance

    eye = np.eye(problem.plant.states)
    W = np.zeros((problem.plant.modes, *eye.shape))
    for one in problem.imperfections:
        if isinstance(one, WhiteDisturbance):
            intensity = np.asarray(one.intensity, dtype=float)
            W = W + (intensity if intensity.ndim > 1 else intensity * eye)
    return W


def sensor_variances(problem: Problem) -> np.ndarray:
    """The variances (n,) of the file's noise of measured states, which add up."""
    import numpy as np

    from deadtime.imperfections import Noise

    variance = np.zeros(problem.plant.states)
    for one in problem.imperfections:
        if isinstance(one, Noise):
            variance = variance + np.asarray(one.std, dtype=float) ** 2
    return variance


def one_or_several(name: str, text: str) -> float | list[float]:
    """One number for all, or several separated by commas."""
    numbers = numbers_of(name, text)
    return numbers[0] if len(numbers) == 1 else numbers


def numbers_of(name: str, text: str) -> list[float]:
    """Numbers separated by commas."""
    try:
        return [float(number) for number in text.split(",")]
    except ValueError:
        raise ArgumentError(
            f"{name} must be numbers separated by commas, such as --{name} 1,-0.5, got {text!r}."
        ) from None


def with_step(problem: Problem, step: float | None) -> Problem:
    """A problem at another period; modes change anywhere unless it divides the old one."""
    from deadtime.base.checks import positive
    from deadtime.plant.discretisation import snap

    if step is None:
        return problem
    divides = snap((problem.step or 0.0) / positive("step", step)).is_integer()
    at = problem.signals.at if divides else "anywhere"
    return replace(problem, step=step, signals=replace(problem.signals, at=at))


def delays_from(text: str) -> float | list[float] | list[list[float]]:
    """Delays as a problem file writes them: a number, or lists in brackets."""
    import json

    try:
        value = json.loads(text)
    except ValueError:
        value = None
    if isinstance(value, bool) or not isinstance(value, (int, float, list)):
        raise ArgumentError(
            f"--delays must be two numbers, or two lists such as [0.3,0.1], got {text!r}: leave "
            "out spaces, or quote each list."
        )
    return value


def times_from(name: str, text: str | None) -> list[float] | None:
    """Seconds separated by commas."""
    return None if text is None else numbers_of(name, text)


def signals_and_step(
    problem: Problem,
    dwell_time: str | None,
    maximum_dwell: str | None,
    chatter: int | None,
    **others: Any,
) -> tuple[AssumedSignals, float]:
    """The signals to cover and the sampling period, in seconds, of a problem.

    `others` are further arguments of `signals_of`.
    """
    from deadtime.problems.switching_assumptions import signals_of, step_of

    promised = problem.signals.dwell_time is not None
    if dwell_time is None and not promised and problem.switching is not None:
        # Sojourns that begin above 0, as expon with loc = 60, suggest a dwell time.
        sojourns = getattr(problem.switching, "sojourn", ())
        least = [float(x.support()[0]) if hasattr(x, "support") else 0.0 for x in sojourns]
        known = f" = {min(least):g}" if least and min(least) > 0.0 else ""
        instead = f", or write dwell_time{known} in [switching]" if sojourns else ""
        raise ArgumentError(
            f"neither [switching] nor [signal] of the problem {problem.name!r} states a dwell "
            "time, and the shortest sojourn of one drawn signal says nothing of others: give "
            f"--dwell-time{instead}."
        )
    times = times_from("dwell-time", dwell_time), times_from("maximum-dwell", maximum_dwell)
    return signals_of(problem, problem.signal, *times, chatter, **others), step_of(problem)


def kept_by_search(
    problem: Problem,
    dwell_time: str | None,
    maximum_dwell: str | None,
    mode: int | None,
    chatter: int | None,
    at: Instants | None,
) -> SignalClass:
    """The signals of a search for the least dwell time, which keeps proportions and limits."""
    from deadtime.margins.dwell_time import SHORT
    from deadtime.problems.switching_assumptions import signals_of, step_of

    times = times_from("dwell-time", dwell_time), times_from("maximum-dwell", maximum_dwell)
    least = times[0]
    if least is None and mode is None and len(set(problem.limits.dwell_time)) == 1:
        least = [SHORT * step_of(problem)]  # one for all modes says nothing of their proportions
    return signals_of(problem, problem.signal, least, times[1], chatter, at).signals
