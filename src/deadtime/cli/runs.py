"""`deadtime reproduce`, `simulate` and `app`: a problem under its laws."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from deadtime.base.errors import ArgumentError
from deadtime.cli import options
from deadtime.cli.application import START, app as commands, lines
from deadtime.cli.printing import (
    nominal_plant_sentence,
    output_file,
    output_folder,
    print_json,
    print_result,
    progress_bar,
    require_width,
    save_figure,
    stage_line,
)

if TYPE_CHECKING:
    from deadtime.problems.comparison import Comparison


@commands.command(
    group=START,
    help_epilogue=lines(
        "deadtime reproduce",
        "deadtime reproduce follower",
        "deadtime reproduce problem.toml --out report",
    ),
)
def reproduce(
    problem: options.ProblemFile = Path("paper"),
    *,
    out: options.Folder = Path("report"),
    certificates: bool = True,
    json_output: options.AsJson = False,
) -> None:
    """Run a problem under every law and write a report: the paper's comparison by default.

    Parameters
    ----------
    out
        Folder for the report.
    certificates
        Certify every law, which takes about half a minute.
    """
    from deadtime.reports.metrics import metrics_of
    from deadtime.reports.report import steps_of, write_report

    chosen, out = options.problem_of(problem), output_folder("out", out)
    command = f"deadtime reproduce {problem}" + ("" if certificates else " --no-certificates")
    with progress_bar(steps_of(chosen, certificates), quiet=json_output) as advance:
        report = write_report(chosen, out, advance, command, certificates)
    if json_output:
        print_json(metrics_of(report.comparison), [report.path])
        return
    print_result(chosen, report.sentences, report.comparison)
    print(f"\nReport: {report.path}")


@commands.command(
    group=START,
    help_epilogue=lines(
        "deadtime simulate problem.toml",
        "deadtime simulate paper --out run.svg",
        "deadtime simulate paper --law averaged --step 0.05 --horizon 8 --x0 1,-1",
        "deadtime simulate problem.toml --law averaged --csv run.csv",
    ),
)
def simulate(
    problem: options.ProblemFile,
    *,
    law: options.AllLaws = None,
    step: options.StepOrIdeal = None,
    horizon: float | None = None,
    x0: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    out: options.File = None,
    width: options.FigureWidth = None,
    csv: Path | None = None,
    json_output: options.AsJson = False,
) -> None:
    """Simulate a problem file: a verdict, metrics and a figure.

    Parameters
    ----------
    horizon
        Length of the run in seconds; the problem's by default.
    x0
        Initial state, such as --x0 1,-0.5; the problem's by default.
    out
        The figure, PNG, SVG, PDF or PGF; by default in the current folder, named after the
        problem. With several laws a second figure compares them.
    csv
        File for the run as a log for deadtime identify: time, states, inputs, the mode and, with a
        reference, outputs; for several laws, one file each, named after the law.
    """
    from deadtime.problems.comparison import compare
    from deadtime.reports.certificate_tables import delay_sentence
    from deadtime.reports.metrics import metrics_of
    from deadtime.reports.verdict import verdict

    require_width(width)
    log = None if csv is None else output_file("csv", csv, kinds=(".csv",))
    chosen = options.with_law(options.problem_with(problem, step, horizon, x0), law)
    picture = output_file("out", out, chosen.name)
    steps = len(chosen.laws) + chosen.plant.modes
    with progress_bar(steps, quiet=json_output) as advance:
        result = compare(chosen, advance)
    saved = _save_figures(result, picture, width)
    logs = [] if log is None else _save_logs(result, log)
    if json_output:
        print_json(metrics_of(result), [*saved, *logs])
        return
    sentences = [*verdict(result), *delay_sentence(chosen), *nominal_plant_sentence(chosen)]
    print_result(chosen, sentences, result)
    print("\nFigure: " + ", ".join(map(str, saved)))
    if logs:
        print("Log: " + ", ".join(map(str, logs)))


def _save_logs(result: Comparison, path: Path) -> list[Path]:
    """The runs as CSV, one file for each law."""
    from deadtime.base.wording import file_names

    problem, saved, names = result.problem, [], file_names(result.runs)
    for name, run in result.runs.items():
        target = path if len(names) == 1 else path.with_stem(f"{path.stem}-{names[name]}")
        run.to_csv(target, *problem.curve_names, problem.tracked)
        saved.append(target)
    return saved


def _save_figures(result: Comparison, path: Path, width: options.FigureWidth) -> list[Path]:
    """The first law's run, and all laws on one axis when there are several."""
    from deadtime.reports.figures.runs import all_laws
    from deadtime.simulation.run_figure import plot_run

    problem = result.problem
    run = result.runs[result.lead]
    title = f"Law: {result.lead}"
    states, inputs = problem.curve_names
    figures = [(path, plot_run(run, title, states, problem.modes, inputs, width))]
    if len(result.runs) > 1:
        second = path.with_stem(path.stem + "-all-laws")
        figures.append((second, all_laws(result, width)[1]))
    for target, figure in figures:
        save_figure(figure, target)
    return [target for target, _ in figures]


@commands.command(
    group=START,
    help_epilogue=lines(
        "deadtime app",
        "deadtime app problem.toml",
        "deadtime app follower --port 8000 --no-browser",
        "deadtime app --address 0.0.0.0   # for the whole network: there is no password",
    ),
)
def app(
    problem: options.ProblemFile = Path("paper"),
    *,
    port: int | None = None,
    address: str = "127.0.0.1",
    origin: tuple[str, ...] = (),
    browser: Annotated[bool, Parameter(negative="--no-browser")] = True,
    sessions: int = 40,
    json_output: options.AsJson = False,
) -> None:
    """Explore a problem on a page: change its numbers, draw its signal, compare its laws.

    Parameters
    ----------
    port
        Port of the server; by default the first free one from 5006 on.
    address
        127.0.0.1 for this machine alone; 0.0.0.0 for the whole network.
    origin
        A name, host:port, by which browsers reach the page behind a proxy.
    browser
        Open a browser.
    sessions
        Largest number of open pages; further visitors are asked to come later.
    """
    if not json_output:
        print(f"Starting the explorer with {problem}: half a minute the first time.", flush=True)
    with ExitStack() as starting:
        stage = starting.enter_context(stage_line(quiet=json_output))
        stage("loading libraries")
        try:
            from deadtime.app.server import is_loopback, serve
        except ModuleNotFoundError as error:
            raise ArgumentError(
                f"the explorer needs {error.name}: pip install '.[app]' in a clone of deadtime."
            ) from None

        def on_started(url: str) -> None:
            starting.close()
            alone = is_loopback(address)
            if json_output:
                print_json({"url": url, "only_this_machine": alone})
                sys.stdout.flush()
                return
            print(f"Explorer: {url}")
            if alone:
                print("Only this machine can reach it (--address 0.0.0.0 lets the network in).")
            else:
                print("Everyone who can reach this machine can use it; there is no password.")
            print(f"It serves {sessions} pages at once (--sessions). Ctrl-C ends it.", flush=True)

        serve(
            str(problem), address, port, browser, origin,
            sessions=sessions, started=on_started, progress=stage,
        )  # fmt: skip
