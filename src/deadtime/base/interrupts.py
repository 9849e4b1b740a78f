"""Ctrl-C: where work is done it is an exception, before and after that the end of the process."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

INTERRUPTED = 130  # what a shell says of a command that Ctrl-C has ended


def end_on_interrupt() -> None:
    """Let Ctrl-C end the process in one line, where nothing is open yet or any more.

    While modules load and while Python takes itself down, an exception would become a traceback.
    Who was started with interrupts ignored, as in the background of a shell, goes on ignoring.
    """
    _hand_over(signal.default_int_handler, _end)


@contextmanager
def raising_on_interrupt() -> Iterator[None]:
    """Where Ctrl-C is a KeyboardInterrupt; afterwards it is again what it was before."""
    changed = _hand_over(_end, signal.default_int_handler)
    try:
        yield
    finally:
        if changed:
            _hand_over(signal.default_int_handler, _end)


def _hand_over(old: Any, new: Any) -> bool:
    """Whether Ctrl-C was handled by `old`, as it then is by `new`."""
    at_hand = threading.current_thread() is threading.main_thread()
    if not at_hand or signal.getsignal(signal.SIGINT) is not old:
        return False
    signal.signal(signal.SIGINT, new)
    return True


def _end(*_: object) -> None:
    try:
        os.write(2, b"deadtime: interrupted\n")
    finally:
        os._exit(INTERRUPTED)
