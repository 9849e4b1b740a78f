"""The console of the commands: styled on terminals, plain text elsewhere."""

from __future__ import annotations

import os
from typing import NoReturn

from rich.console import Console


class Terminal(Console):
    """A console that writes escape sequences to terminals only.

    NO_COLOR turns all styles off, FORCE_COLOR turns them on in a pipe; NO_COLOR takes precedence.
    A closed pipe raises BrokenPipeError, which the entry point handles.
    """

    def __init__(self, stderr: bool = False) -> None:
        plain = bool(os.environ.get("NO_COLOR"))
        super().__init__(
            stderr=stderr, highlight=False, soft_wrap=False, color_system=None if plain else "auto"
        )

    def on_broken_pipe(self) -> NoReturn:
        raise BrokenPipeError
