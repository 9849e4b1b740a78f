"""`deadtime sweep` and `study`: a grid of plants and switching, and reports on it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deadtime.base.errors import ArgumentError
from deadtime.cli import options
from deadtime.cli.application import COMPARE, app, lines
from deadtime.cli.printing import (
    TABLES,
    on_terminal,
    output_folder,
    print_answer,
    print_answers,
    print_details,
    print_json,
    print_table,
    require_writable,
    save_text,
    stage_line,
)

if TYPE_CHECKING:
    import xarray as xr

    from deadtime.scenarios.sweeps import FileStudy, Progress
    from deadtime.scenarios.sweeps.plan import Plan


_SHOWN = 24  # rows of a table at most
_EVERY = 10.0  # seconds between lines about a cluster's progress


@app.command(
    group=COMPARE,
    help_epilogue=lines(
        "deadtime sweep studies/paper.toml --store paper.zarr",
        "deadtime sweep study.toml --dry-run",
        "deadtime sweep study.toml --store /shared/one.zarr --scheduler tcp://head:8786",
    ),
)
def sweep(
    file: options.StudyFile,
    *,
    store: str | None = None,
    scenarios: options.CellSignals = None,
    scheduler: str | None = None,
    workers: int | None = None,
    status: options.Flag = False,
    dry_run: options.Flag = False,
    verify: options.Flag = False,
    table: Path | None = None,
    json_output: options.AsJson = False,
) -> int:
    """Run every cell of a study's grid into a Zarr store: here, or on a Dask cluster.

    Only cells that the store lacks are computed: after Ctrl-C, a crash or a full disk the same
    command continues.

    Parameters
    ----------
    store
        A folder, or a URL for fsspec; by default in the current folder, named after the study.
        Workers of a cluster must reach it under this name.
    scheduler
        Address of a Dask scheduler; by default all cores of this machine work.
    workers
        Number of processes on this machine.
    status
        Print the progress of the store, and stop.
    dry_run
        Print the number of runs, their time and the size of the store, and stop. Some cells run on
        a few signals, for some seconds, to estimate the time.
    verify
        First read everything that is stored, and compute damaged cells again.
    table
        A file for medians and ratios to the oracle in every cell, with intervals, for LaTeX (.tex).
    """
    from deadtime.base.checks import count
    from deadtime.scenarios.sweeps import load_study, sweep as run
    from deadtime.scenarios.sweeps.plan import plan_of

    require_writable("table", table, TABLES)
    chosen = load_study(file)
    if scenarios is not None:
        chosen = with_scenarios(chosen, scenarios)
    place = f"{file.stem}.zarr" if store is None else store
    if not place:
        raise ArgumentError("store must be the name of a folder, or a URL, got ''.")
    if workers is not None:
        count("workers", workers)
    with stage_line(quiet=json_output) as stage:
        stage("timing some of the cells" if dry_run else "reading the store")
        plan = plan_of(chosen, place, trial=dry_run)
    if status or dry_run:
        _print_plan(chosen, plan, dry_run, json_output)
        return 0
    damaged = _verify(place) if verify and plan.exists else []
    for one in damaged:
        print(f"deadtime: {one}", file=sys.stderr)
    try:
        with progress_of(plan, quiet=json_output, remote=scheduler is not None) as report:
            data = run(chosen, place, scheduler, workers=workers, progress=report)
    except KeyboardInterrupt:
        left = plan_of(chosen, place)
        print(
            f"deadtime: interrupted after {left.done:,} of {left.cells:,} cells; the same command "
            "continues",
            file=sys.stderr,
        )
        return 130
    reasons = _reasons(data)
    if table is not None:
        from deadtime.reports.scenario_tables import sweep_table

        save_text("table", table, sweep_table(data).to_latex())
    if json_output:
        from deadtime.base.json_records import plain

        state = {**plain(plan_of(chosen, place)), "damaged": damaged, "reasons": reasons}
        print_json(state, None if table is None else [table])
        return 0
    sizes = " × ".join(f"{size} {name}" for name, size in data.sizes.items())
    wrong = f", failures under {', '.join(reasons)}" if reasons else ""
    print_answer(f"All {plan.cells:,} cells are computed ({sizes}){wrong}", chosen.title)
    print_details(
        f"{law}: in {cells:,} of {plan.cells:,} cells, such as: {example}"
        for law, (cells, example) in reasons.items()
    )
    _print_medians(data)
    if table is not None:
        print(f"\nTable: {table}")
    print(f"\nStore: {place}. Next: deadtime plot {place}")
    return 0


def _print_medians(data: xr.Dataset) -> None:
    """Print medians with their intervals, if the sweep has few of them."""
    from deadtime.reports.scenario_tables import sweep_table

    if data["reason"].size > _SHOWN or not bool((data["done"] == 1).any()):
        return
    medians = sweep_table(data)
    print()
    print_table(medians.headings, medians.rows)
    print(f"({' '.join(medians.notes).removeprefix('deadtime: ')}.)")


def with_scenarios(study: FileStudy, scenarios: int) -> FileStudy:
    """The study with another number of signals per cell."""
    from deadtime.base.checks import count

    return replace(study, scenarios=count("scenarios", scenarios))


def _verify(place: str) -> list[str]:
    """Delete damaged parts of the store, and list them; coordinates are rewritten."""
    from deadtime.scenarios.sweeps.store import open_store, place_of

    target = open_store(place_of(place))
    faults = [f"the values of {name} were damaged" for name in target.restore_coordinates()]
    for number, fault in target.faults():
        target.forget(number)
        faults.append(fault)
    return faults


def _reasons(data: Any) -> dict[str, tuple[int, str]]:
    """Number of failed cells of each law, and an example of the reason."""
    reasons = {}
    for law in data.law.values:
        texts = data.reason.sel(law=law).values.ravel()
        wrong = texts[texts != ""]
        if wrong.size:
            reasons[str(law)] = (int(wrong.size), str(wrong[0]))
    return reasons


def _print_plan(study: FileStudy, plan: Plan, dry_run: bool, as_json: bool) -> None:
    if as_json:
        from deadtime.base.json_records import plain

        print_json(plain(plan))
        return
    axes = " × ".join(f"{len(values)} {name}" for name, values in study.grid.items())
    state = f"{plan.done:,} cells are done, {plan.cells - plan.done:,} to do"
    print_answer(
        f"Store {plan.store}: {state if plan.exists else 'not there yet'}",
        study.title,
        f"{plan.cells:,} cells ({axes or 'no axes'}), {study.scenarios:,} signals in each, "
        f"{len(study.laws)} laws",
    )
    if dry_run:
        timed = "1 cell" if plan.timed == 1 else f"{plan.timed} cells"
        blocks = "1 block" if plan.missing == 1 else f"{plan.missing:,} blocks"
        print(
            f"To do: {plan.runs:,} runs in {blocks} of cells, about {duration(plan.seconds)} of "
            f"one core like this one, beside some seconds to start ({timed} timed)\n"
            if plan.missing
            else "Nothing to do\n",
            end="",
        )
        print(f"Size: at most {_bytes(plan.size)} before compression, {plan.objects:,} objects")


def _bytes(size: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000.0:
            return f"{size:.3g} {unit}"
        size /= 1000.0
    return f"{size:,.3g} TB"


def duration(seconds: float) -> str:
    """Seconds in words.

    Examples
    --------
    >>> duration(3.2), duration(300.0), duration(80_000.0), duration(1e6)
    ('3 s', '5 min', '22.2 h', '11.6 days')
    """
    if seconds < 100.0:
        return f"{max(seconds, 1.0):.0f} s"
    if seconds < 6000.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h" if seconds < 3e5 else f"{seconds / 86400.0:.1f} days"


@contextmanager
def progress_of(plan: Plan, quiet: bool, remote: bool) -> Iterator[Callable[[Progress], None]]:
    """Show progress on stderr: a bar on a terminal, or lines for a cluster."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress as Bar,
        TextColumn,
        TimeRemainingColumn,
    )

    from deadtime.cli.console import Terminal

    if quiet or not (on_terminal() or remote):
        yield lambda _: None
        return
    if remote:
        yield Lines(_EVERY)
        return
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("cells"), TimeRemainingColumn())
    with Bar(*columns, console=Terminal(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=plan.cells, completed=plan.done)
        yield lambda state: bar.update(task, completed=state.done)


class Lines:
    """Print counts, rate and remaining time, a line per interval of seconds."""

    def __init__(self, every: float) -> None:
        self._every, self._next = every, 0.0

    def __call__(self, state: Progress) -> None:
        if state.seconds < self._next and state.done < state.total:
            return
        self._next = state.seconds + self._every
        rate = state.computed / max(state.seconds, 1e-9)
        left = state.seconds * (state.whole_cost / max(state.cost, 1e-9) - 1.0)
        over = state.done == state.total
        when = f"done in {duration(state.seconds)}" if over else f"about {duration(left)} left"
        print(
            f"{state.done:,} of {state.total:,} cells, {rate:.3g} cells/s on {state.threads} "
            f"threads, {when}",
            file=sys.stderr,
        )


@app.command(
    group=COMPARE,
    help_epilogue=lines(
        "deadtime study studies/paper.toml",
        "deadtime study studies/paper.toml --scenarios 20 --out quick-look",
    ),
)
def study(
    file: options.StudyFile,
    *,
    out: options.Folder = Path("study-report"),
    scenarios: options.CellSignals = None,
    workers: int | None = None,
    scheduler: str | None = None,
    json_output: options.AsJson = False,
) -> None:
    """Run laws over a grid of plants and switching, and write a report with maps and answers.

    Cells of the same study in the folder are not computed again: after an interruption the same
    command continues.

    Parameters
    ----------
    out
        Folder for the report.
    workers
        Number of processes, by default one per processor; the result is the same.
    scheduler
        Address of a Dask scheduler, whose workers must reach the folder; by default this machine
        works.
    """
    from deadtime.reports.study.report import write_study
    from deadtime.scenarios.sweeps import load_study
    from deadtime.scenarios.sweeps.plan import plan_of

    chosen, command = load_study(file), f"deadtime study {file}"
    out = output_folder("out", out)
    if scenarios is not None:
        chosen = with_scenarios(chosen, scenarios)
        command += f" --scenarios {scenarios}"
    plan = plan_of(chosen, out / "data" / "study.zarr")
    with progress_of(plan, quiet=json_output, remote=scheduler is not None) as report:
        result = write_study(chosen, out, workers, report, command, scheduler)
    if json_output:
        print_json(result.record, [result.path])
        return
    print_answers(chosen.title, result.answers)
    print(f"Report: {result.path}")
