"""Work in threads."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
from queue import SimpleQueue
from typing import Any

_CHECK = 0.2  # seconds between checks for Ctrl-C
_MOST = 8  # threads: each takes memory, and their work in Python is done in turns
_SERVING: list[threading.Thread] = []


def processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def at_work() -> bool:
    """Whether threads of `in_order` run.

    Compiled code that returns to Python while that exits would abort the process.

    Examples
    --------
    >>> at_work()
    False
    """
    return any(thread.is_alive() for thread in _SERVING)


def in_order(work: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
    """work(item) of every item, in their order, in a thread per processor, at most 8.

    Work outside Python, such as a solver's, runs in parallel. Ctrl-C ends it at once, without
    waiting for threads that are at work: an executor of the standard library would wait for them.

    Examples
    --------
    >>> list(in_order(abs, [3, -1, -2]))
    [3, 1, 2]
    """
    count = min(processors(), _MOST, len(items))
    if count < 2:
        yield from map(work, items)
        return
    waiting: SimpleQueue[tuple[Future[Any], Any] | None] = SimpleQueue()
    futures = [Future[Any]() for _ in items]
    for one in [*zip(futures, items, strict=True), *[None] * count]:
        waiting.put(one)

    def serve() -> None:
        while (one := waiting.get()) is not None:
            future, item = one
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(work(item))
            except BaseException as error:
                future.set_exception(error)

    _SERVING[:] = [thread for thread in _SERVING if thread.is_alive()]
    for _ in range(count):
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        _SERVING.append(thread)
    try:
        for future in futures:
            # A wait without a limit would not be interrupted by Ctrl-C on every system.
            while not future.done():
                wait([future], _CHECK)
            yield future.result()
    finally:
        for future in futures:
            future.cancel()
