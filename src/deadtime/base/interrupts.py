"""Ctrl-C: an exception while work is done, the end of the process before and after that."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

INTERRUPTED = 130  # the exit status that shells give to a command that Ctrl-C has ended


def end_on_interrupt() -> None:
    """Let Ctrl-C end the process with one line, while modules load and while Python exits.

    An exception would become a traceback there. A process that was started with interrupts ignored,
    as in the background of a shell, ignores them still.
    """
    _hand_over(signal.default_int_handler, _end)


@contextmanager
def raising_on_interrupt() -> Iterator[None]:
    """A block in which Ctrl-C raises KeyboardInterrupt; the former handler is restored after it."""
    changed = _hand_over(_end, signal.default_int_handler)
    try:
        yield
    finally:
        if changed:
            _hand_over(signal.default_int_handler, _end)


def _hand_over(old: Any, new: Any) -> bool:
    """Replace the handler `old` by `new`; False if another one is installed."""
    in_main = threading.current_thread() is threading.main_thread()  # others may set no handler
    if not in_main or signal.getsignal(signal.SIGINT) is not old:
        return False
    signal.signal(signal.SIGINT, new)
    return True


def _end(*_: object) -> None:
    try:
        os.write(2, b"deadtime: interrupted\n")
    finally:
        os._exit(INTERRUPTED)
