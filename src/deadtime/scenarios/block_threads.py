"""Blocks of scenarios on threads, with progress, and with an end when the user asks for one."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager

from deadtime.base.errors import ArgumentError

Progress = Callable[[int, int], None]
RunBlock = Callable[[int, int, Callable[[], bool]], int]

_CHECK = 0.2  # seconds between looks at the keyboard


def run_blocks(
    run: RunBlock, scenarios: int, size: int, threads: int, progress: Progress
) -> tuple[int, bool]:
    """Run all scenarios in blocks of `size`; the sum of what blocks return, and if cut short.

    Ctrl-C ends the run within a block's time: blocks in hand are left, those done are kept. An
    error in a block ends the run, too.
    """
    starts = iter(range(0, scenarios, size))
    stop = threading.Event()
    total, done, running = 0, 0, {}
    pool = ThreadPoolExecutor(threads, thread_name_prefix="deadtime")
    try:
        while True:
            # No more are handed over than are needed to keep all threads busy.
            while len(running) < threads + 1 and (start := next(starts, None)) is not None:
                count = min(size, scenarios - start)
                running[pool.submit(run, start, count, stop.is_set)] = count
            if not running:
                return total, False
            finished, _ = wait(running, _CHECK, FIRST_COMPLETED)
            for future in finished:
                done += running.pop(future)
                total += future.result()
                progress(done, scenarios)
    except KeyboardInterrupt:
        stop.set()
        return total + _rest(running), True
    finally:
        stop.set()
        pool.shutdown(wait=True, cancel_futures=True)


def _rest(running: dict[Future[int], int]) -> int:
    """What blocks return that were in hand at the end."""
    for future in running:
        future.cancel()
    finished, _ = wait(running)
    return sum(
        future.result() for future in finished if not future.cancelled() and not future.exception()
    )


@contextmanager
def show_progress(progress: Progress | bool | None, scenarios: int) -> Iterator[Progress]:
    """The function to report progress to: the user's, a bar on the terminal, or none."""
    if progress is None or progress is False:
        yield lambda done, total: None
    elif progress is True:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

        console = Console(stderr=True)
        columns = (BarColumn(), MofNCompleteColumn(), "scenarios", TimeRemainingColumn())
        with Progress(*columns, console=console, transient=True) as bar:
            task = bar.add_task("", total=scenarios)
            yield lambda done, total: bar.update(task, completed=done)
    elif callable(progress):
        yield progress
    else:
        raise ArgumentError(
            f"progress must be True, False or a function (done, total), got {progress!r}."
        )
