"""The command line: `deadtime reproduce`, `simulate`, `bound`, `fit`, `study`, `init`,
`schema`.

Exit codes: 0 when the command did its work (a loop that diverges is a result), 2 when
something in the request is wrong, 130 when interrupted. Errors are one line on stderr.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter

from deadtime.errors import ArgumentError, DeadtimeError
from deadtime.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deadtime.comparison import Comparison
    from deadtime.problems import Problem
    from deadtime.study.phrases import Answer

app = App(
    name="deadtime",
    help="Predictor feedback for switched linear plants with a long input delay.",
    version=__version__,
)

Name = Literal["paper", "three-mode", "follower"]


@app.command
def reproduce(
    problem: str = "paper",
    *,
    out: Annotated[Path, Parameter(alias="-o")] = Path("report"),
    json_output: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> None:
    """Run a problem under every law and write a report: the paper's comparison by default.

    Examples: `deadtime reproduce`, `deadtime reproduce follower`,
    `deadtime reproduce problem.toml --out report`.

    Parameters
    ----------
    problem
        paper, three-mode, follower, or a problem file.
    out
        Folder for the report.
    json_output
        Print the metrics as JSON instead of text.
    """
    from deadtime.report import steps_of, write_report

    chosen = _problem(problem)
    command = f"deadtime reproduce {problem}"
    with _progress(steps_of(chosen), quiet=json_output) as advance:
        report = write_report(chosen, out, advance, command)
    if json_output:
        print((out / "metrics.json").read_text(encoding="utf-8"), end="")
        return
    _print_result(chosen, report.sentences, report.comparison)
    print(f"\nReport: {report.path}")


@app.command
def simulate(
    problem: str,
    *,
    out: Annotated[Path | None, Parameter(alias="-o")] = None,
    json_output: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> None:
    """Simulate a problem file: a verdict, metrics and a figure.

    Examples: `deadtime simulate problem.toml`, `deadtime simulate problem.toml --out run.png`.

    Parameters
    ----------
    problem
        A problem file, or paper, three-mode, follower.
    out
        The figure, PNG, SVG or PDF; next to where you are, named after the problem, by default.
        With several laws a second figure compares them.
    json_output
        Print the metrics as JSON instead of text.
    """
    from deadtime.comparison import compare
    from deadtime.report import metrics_of
    from deadtime.verdict import verdict

    chosen = _problem(problem)
    steps = len(chosen.laws) + chosen.plant.modes
    with _progress(steps, quiet=json_output) as advance:
        result = compare(chosen, advance)
    saved = _save_figures(result, _picture(chosen, out))
    if json_output:
        print(json.dumps(metrics_of(result), indent=2, ensure_ascii=False))
        return
    _print_result(chosen, verdict(result), result)
    print("\nFigure: " + ", ".join(map(str, saved)))


@app.command
def init(
    path: Path = Path("problem.toml"),
    *,
    example: Annotated[Name, Parameter(name=["--example", "-e"])] = "paper",
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Write a commented problem file to start from.

    Examples: `deadtime init`, `deadtime init car.toml --example follower`.

    Parameters
    ----------
    path
        The file to write.
    example
        Whose numbers to start with.
    force
        Replace a file that exists.
    """
    if path.exists() and not force:
        raise ArgumentError(f"{path} exists: choose another name, or replace it with --force.")
    text = files("deadtime").joinpath("templates", f"{example}.toml").read_text(encoding="utf-8")
    try:
        path.write_text(text.replace("problem.toml", path.name), encoding="utf-8")
    except OSError as error:
        raise ArgumentError(f"{path} cannot be written: {error.strerror}.") from None
    print(f"Wrote {path}. Next: deadtime simulate {path}")


@app.command
def bound(
    problem: str,
    *,
    dwell_time: float | None = None,
    json_output: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> None:
    """What the paper's stability theorem says about a plant: its constants in three forms.

    Examples: `deadtime bound problem.toml`, `deadtime bound paper --dwell-time 0.2`.

    Parameters
    ----------
    problem
        A problem file, or paper, three-mode, follower.
    dwell_time
        Dwell time in seconds; that of the problem's signal by default.
    json_output
        Print the constants as JSON instead of a table.
    """
    from deadtime.constants_table import bound_rows, bound_sentence, bounds_of, bounds_record

    chosen = _problem(problem)
    dwell = chosen.given_signal.dwell_time if dwell_time is None else dwell_time
    bounds = bounds_of(chosen, min(dwell, 1e6 * chosen.horizon))
    if json_output:
        print(json.dumps(bounds_record(bounds), indent=2, ensure_ascii=False))
        return
    headings = ("constant", "as printed", "corrected", "sharp")
    rows = bound_rows(bounds, chosen.constants)
    _print_table((*headings, "figure in the text") if chosen.constants else headings, rows)
    print("\n" + bound_sentence(bounds))


@app.command
def fit(
    *logs: Path,
    family: str = "auto",
    first: Literal["whole", "drop"] = "whole",
    labels: dict[str, int] | None = None,
    out: Annotated[Path, Parameter(alias="-o")] = Path("fit.png"),
    json_output: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> None:
    """Fit a model of the switching to logs, and print it as a section for a problem file.

    Examples: `deadtime fit log.csv`, `deadtime fit week-*.csv --first drop`,
    `deadtime fit log.csv --labels.throttle 0 --labels.brake 1`.

    Parameters
    ----------
    logs
        CSV files with the columns time (seconds) and mode.
    family
        Family of the sojourns: exponential, shifted exponential, gamma, weibull, uniform,
        lognormal, fixed; auto takes the best.
    first
        drop, if the logs begin in the middle of a sojourn.
    labels
        Mode of each text in the logs.
    out
        The figure, PNG, SVG or PDF.
    json_output
        Print the fit as JSON instead of text.
    """
    from deadtime import fit_report
    from deadtime.fit_plots import plot_fit
    from deadtime.switching import SemiMarkov, SwitchingSignal

    if not logs:
        raise ArgumentError("logs must be given: the CSV files to fit a model to.")
    signals = [SwitchingSignal.from_csv(log, labels=labels) for log in logs]
    model = SemiMarkov.fit(signals, family=family, first=first)
    texts = {mode: text for text, mode in (labels or {}).items()}
    names = [texts.get(mode, f"mode {mode}") for mode in range(model.modes)]
    _save_figure(plot_fit(model, signals, names, first=first), out)
    if json_output:
        print(json.dumps(fit_report.fit_record(model, names), indent=2, ensure_ascii=False))
        return
    _print_table(fit_report.HEADINGS, fit_report.fit_rows(model, names))
    print(f"\n{fit_report.fit_sentence(model, names)}\n\n{fit_report.switching_section(model)}")
    print(f"\nFigure: {out}")


@app.command
def study(
    file: Path,
    *,
    out: Annotated[Path, Parameter(alias="-o")] = Path("study-report"),
    scenarios: int | None = None,
    workers: int | None = None,
    json_output: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> None:
    """Run laws over a grid of plants and switching, and write a report with maps and answers.

    Examples: `deadtime study studies/paper.toml`,
    `deadtime study studies/paper.toml --scenarios 20 --out quick-look`.

    Parameters
    ----------
    file
        A study file; studies/paper.toml is a commented one.
    out
        Folder for the report.
    scenarios
        Signals per cell of the grid, instead of the file's.
    workers
        Processes; as many as there are processors by default. The result is the same.
    json_output
        Print the findings as JSON instead of text.
    """
    from dataclasses import replace

    from deadtime.checks import count
    from deadtime.study import load_study
    from deadtime.study.report import write_study

    chosen, command = load_study(file), f"deadtime study {file}"
    if scenarios is not None:
        chosen = replace(chosen, scenarios=count("scenarios", scenarios))
        command += f" --scenarios {scenarios}"
    with _progress(chosen.size + 1, quiet=json_output) as advance:
        report = write_study(chosen, out, workers, advance, command)
    if json_output:
        print((out / "metrics.json").read_text(encoding="utf-8"), end="")
        return
    _print_answers(chosen.title, report.answers)
    print(f"Report: {report.path}")


@app.command
def schema() -> None:
    """Print the JSON Schema of problem files, for editors that complete and check TOML."""
    from deadtime.problem_file import json_schema

    print(json.dumps(json_schema(), indent=2, ensure_ascii=False))


def _problem(name: str) -> Problem:
    from deadtime.problem_file import load_problem
    from deadtime.problems import NAMED

    if name in NAMED:
        return NAMED[name]()
    if not Path(name).suffix and not Path(name).exists():
        raise ArgumentError(
            f"problem must be one of {', '.join(NAMED)}, or a file that exists, got {name!r}."
        )
    return load_problem(name)


def _picture(problem: Problem, out: Path | None) -> Path:
    """Where the figure goes; PNG unless the name says otherwise."""
    path = Path(f"{problem.name}.png") if out is None else out
    return path if path.suffix else path.with_suffix(".png")


def _save_figures(result: Comparison, path: Path) -> list[Path]:
    """The first law's run, and all laws on one axis when there are several."""
    from deadtime import plotting

    problem = result.problem
    run = result.runs[result.lead]
    title = f"Law: {result.lead}"
    figures = [(path, plotting.plot_run(run, title, problem.states, problem.modes))]
    if len(result.runs) > 1:
        second = path.with_stem(path.stem + "-all-laws")
        figures.append((second, plotting.plot_norms(result.runs)))
    for target, figure in figures:
        _save_figure(figure, target)
    return [target for target, _ in figures]


def _save_figure(figure: Figure, target: Path) -> None:
    try:
        figure.savefig(target)
    except (OSError, ValueError) as error:
        raise ArgumentError(f"figure {str(target)!r} cannot be written: {error}") from None


def _print_result(problem: Problem, sentences: list[str], result: Comparison) -> None:
    from rich.console import Console

    from deadtime.verdict import HEADINGS, table

    console = Console(highlight=False, soft_wrap=False)
    console.print(problem.title, style="bold", markup=False)
    for sentence in sentences:
        console.print(f"• {sentence}", markup=False)
    console.print()
    _print_table(HEADINGS, table(result.metrics))


def _print_answers(title: str, answers: Sequence[Answer]) -> None:
    from rich.console import Console

    console = Console(highlight=False, soft_wrap=False)
    console.print(title, style="bold", markup=False)
    for answer in answers:
        console.print(f"\n{answer.question}", markup=False)
        for sentence in answer.sentences:
            console.print(f"• {sentence}", markup=False)
    console.print()


def _print_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    grid = Table(box=None, pad_edge=False)
    for i, heading in enumerate(headings):
        grid.add_column(heading, justify="right" if i else "left", no_wrap=i > 0)
    for row in rows:
        grid.add_row(*map(Text, row))
    Console(highlight=False).print(grid)


@contextmanager
def _progress(total: int, quiet: bool) -> Iterator[Callable[[str], None]]:
    """A progress bar on stderr, only when that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    console = Console(stderr=True)
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    hidden = quiet or not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task("starting", total=total)

        def advance(what: str) -> None:
            bar.update(task, advance=1, description=what)

        yield advance


def main(arguments: Sequence[str] | None = None) -> Any:
    """Run the command line and exit; errors become one line and a code."""
    try:
        app(
            sys.argv[1:] if arguments is None else list(arguments),
            exit_on_error=False,
            print_error=False,
            result_action="return_value",
        )
    except (DeadtimeError, CycloptsError) as error:
        text = " ".join(str(error).split())
        print(f"deadtime: error: {text}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("deadtime: interrupted", file=sys.stderr)
        raise SystemExit(130) from None
    raise SystemExit(0)
