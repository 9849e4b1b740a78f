"""Printing of verdicts, tables, JSON and progress; figures on disk."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from deadtime.base.errors import ArgumentError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.progress import Progress, ProgressColumn

    from deadtime.cli import options
    from deadtime.problems import Problem
    from deadtime.problems.comparison import Comparison
    from deadtime.reports.study.phrases import Answer

PICTURES = (".png", ".svg", ".pdf", ".pgf")
TABLES = (".tex",)


class Advance(Protocol):
    """Takes the name of the next task, and how many steps have been finished."""

    def __call__(self, what: str, /, done: int = 1) -> None: ...


def print_json(record: Mapping[str, Any], written: Iterable[Path] | None = None) -> None:
    """Print one JSON document; `written` are the files that the command made."""
    from deadtime.base.json_records import json_text

    whole = dict(record) if written is None else {**record, "written": [*map(str, written)]}
    wide = (sys.stdout.encoding or "").lower().startswith("utf")
    print(json_text(whole, ascii_only=not wide))


def print_answer(answer: str, *about: str) -> None:
    """Print the answer of a command, in bold on terminals, and lines on its subject."""
    from deadtime.cli.console import Terminal

    console = Terminal()
    console.print(answer, style="bold", markup=False)
    for line in about:
        console.print(line, markup=False)


def print_details(sentences: Iterable[str]) -> None:
    """Print each sentence after a bullet."""
    from deadtime.cli.console import Terminal

    for sentence in sentences:
        Terminal().print(f"• {sentence}", markup=False)


def nominal_plant_sentence(problem: Problem) -> list[str]:
    """A sentence on an [uncertainty], which runs leave out."""
    if problem.uncertain is None:
        return []
    return [
        "The nominal plant was run, not those of [uncertainty]: `deadtime robustness` takes plants "
        "drawn from it, and `deadtime certify --uncertain` all of them."
    ]


def print_result(problem: Problem, sentences: list[str], result: Comparison) -> None:
    from deadtime.reports import metrics
    from deadtime.reports.verdict import headings_of, table

    answer, *details = sentences
    print_answer(answer, problem.title, "")
    rows = table(result)
    print_table(headings_of(result), rows)
    shown: list[Sequence[Sequence[str]]] = [rows]
    for heading, rows_of_one in metrics.tracking_of_runs(result):
        print(f"\n{heading}")
        shown.append(rows_of_one)
        print_table(metrics.HEADINGS, rows_of_one)
    print_never(shown)
    print()
    print_details(details)


def print_never(tables: Iterable[Sequence[Sequence[str]]]) -> None:
    """Explain the dash in the tables, where there is one."""
    from deadtime.reports.metrics import LEGEND, NEVER

    if any(NEVER in row for rows in tables for row in rows):
        print(LEGEND)


def print_answers(title: str, answers: Sequence[Answer]) -> None:
    print_answer(title)
    for answer in answers:
        print_answer("", answer.question)
        print_details(answer.sentences)
    print()


def print_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich.table import Table
    from rich.text import Text

    from deadtime.cli.console import Terminal

    grid = Table(box=None, pad_edge=False)
    for i, heading in enumerate(headings):
        grid.add_column(heading, justify="right" if i else "left", no_wrap=i > 0)
    for row in rows:
        grid.add_row(*map(Text, row))
    Terminal().print(grid)


@contextmanager
def progress_bar(total: int, quiet: bool, first: str = "starting") -> Iterator[Advance]:
    """Show a bar and a clock on stderr if it is a terminal; `first` names the first task.

    Yields a function of the name of the next task and of the number of finished steps.
    """
    if quiet or not on_terminal():
        yield lambda _, done=1: None
        return
    from rich.progress import BarColumn, MofNCompleteColumn

    with _live(BarColumn(), MofNCompleteColumn()) as bar:
        task = bar.add_task(first, total=total)

        def advance(what: str, done: int = 1) -> None:
            bar.update(task, advance=done, description=what)

        yield advance


@contextmanager
def stage_line(quiet: bool) -> Iterator[Callable[[str], None]]:
    """Show a clock and a stage on stderr if it is a terminal; yields a function of the stage."""
    if quiet or not on_terminal():
        yield lambda _: None
        return
    from rich.progress import SpinnerColumn

    with _live(SpinnerColumn()) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda what: bar.update(task, description=what)


def _live(*columns: ProgressColumn) -> Progress:
    """A line on stderr that is redrawn: columns, a clock, and the task."""
    from rich.progress import Progress, TextColumn, TimeElapsedColumn

    from deadtime.cli.console import Terminal

    what = TextColumn("{task.description}", markup=False)
    every = *columns, TimeElapsedColumn(), what
    return Progress(*every, console=Terminal(stderr=True), transient=True)


def on_terminal() -> bool:
    """Whether stderr is a terminal; FORCE_COLOR has no effect on this."""
    return sys.stderr.isatty()


def output_file(
    name: str, given: Path | None, default: str = "", kinds: tuple[str, ...] = PICTURES
) -> Path:
    """The file to write, with a suffix; refused before any work if it cannot be written.

    Examples
    --------
    >>> output_file("out", None, "paper").name, output_file("out", Path("run"), "paper").name
    ('paper.png', 'run.png')
    """
    path = Path(default) if given is None else given
    require_name(name, path)
    if not path.suffix:
        path = path.with_name(f"{path.name}{kinds[0]}")
    require_writable(name, path, kinds)
    return path


def output_folder(name: str, path: Path) -> Path:
    """A folder to write into; refused before any work if it cannot be written."""
    from deadtime.base.files import require_no_root

    require_no_root(name, path)
    around = next(one for one in (path, *path.absolute().parents) if os.path.lexists(one))
    if not around.is_dir():
        reason = f"{str(around)!r} is no folder"
    elif not os.access(around, os.W_OK):
        reason = "permission denied"
    else:
        return path
    raise ArgumentError(f"{name} {str(path)!r} cannot be written: {reason}.")


def require_writable(name: str, path: Path | None, kinds: tuple[str, ...] = ()) -> None:
    """Refuse a file that cannot be written, or has another suffix, before any work."""
    if path is None:
        return
    require_name(name, path)
    if kinds and path.suffix.lower() not in kinds:
        raise ArgumentError(f"{name} must end in {' or '.join(kinds)}, got {str(path)!r}.")
    if not path.parent.is_dir():
        reason = f"there is no folder {str(path.parent)!r}"
    elif path.is_dir():
        reason = "it is a folder"
    elif not os.access(path if path.exists() else path.parent, os.W_OK):
        reason = "permission denied"
    else:
        return
    raise ArgumentError(f"{name} {str(path)!r} cannot be written: {reason}.")


def require_width(width: options.FigureWidth) -> None:
    """Refuse a width at which no figure can be drawn, before any work."""
    if width is not None:
        from deadtime.base.figure_files import inches

        inches(width)


def save_text(name: str, path: Path, text: str) -> None:
    """Write a file that an option names."""
    from deadtime.base.files import replacing

    with replacing(path, name) as place:
        place.write_text(text, encoding="utf-8")


def require_name(name: str, path: Path) -> None:
    """Refuse a path that names no file, such as a dot, before any work."""
    if path.name in ("", ".."):  # an empty --out= becomes a dot, which has no name
        raise ArgumentError(f"{name} must be the name of a file, got {str(path)!r}.")


def save_figure(figure: Figure, target: Path) -> None:
    """Write a figure in the format of its suffix."""
    from io import BytesIO

    from deadtime.base.files import replacing

    if target.suffix == ".pgf":  # with its images in files beside it
        try:
            return figure.savefig(target)
        except OSError as error:
            reason = error.strerror
            raise ArgumentError(f"figure {str(target)!r} cannot be written: {reason}.") from None
    drawn = BytesIO()  # in memory, since PDF writers fail in their own ways on a full disk
    figure.savefig(drawn, format=target.suffix[1:])
    with replacing(target, "figure") as place:
        place.write_bytes(drawn.getvalue())
