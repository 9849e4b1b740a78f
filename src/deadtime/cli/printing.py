"""What the commands print: verdicts, tables, progress; and figures on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from deadtime.errors import ArgumentError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deadtime.comparison import Comparison
    from deadtime.problems import Problem
    from deadtime.study.phrases import Answer


def print_result(problem: Problem, sentences: list[str], result: Comparison) -> None:
    from rich.console import Console

    from deadtime.verdict import HEADINGS, table

    console = Console(highlight=False, soft_wrap=False)
    console.print(problem.title, style="bold", markup=False)
    for sentence in sentences:
        console.print(f"• {sentence}", markup=False)
    console.print()
    print_table(HEADINGS, table(result.metrics))


def print_answers(title: str, answers: Sequence[Answer]) -> None:
    from rich.console import Console

    console = Console(highlight=False, soft_wrap=False)
    console.print(title, style="bold", markup=False)
    for answer in answers:
        console.print(f"\n{answer.question}", markup=False)
        for sentence in answer.sentences:
            console.print(f"• {sentence}", markup=False)
    console.print()


def print_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
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
def progress_bar(total: int, quiet: bool) -> Iterator[Callable[[str], None]]:
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


def save_figure(figure: Figure, target: Path) -> None:
    try:
        figure.savefig(target)
    except (OSError, ValueError) as error:
        raise ArgumentError(f"figure {str(target)!r} cannot be written: {error}") from None
