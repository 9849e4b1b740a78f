"""The application that the commands register with, and its entry point."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NoReturn

from cyclopts import App, CycloptsError, Parameter

from deadtime.errors import DeadtimeError
from deadtime.version import __version__

app = App(
    name="deadtime",
    help="Predictor feedback for switched linear plants with a long input delay.",
    version=__version__,
    suppress_keyboard_interrupt=False,  # `main` says that the command was interrupted
)

AsJson = Annotated[bool, Parameter(name="--json", negative="")]
Folder = Annotated[Path, Parameter(alias="-o")]
File = Annotated[Path | None, Parameter(alias="-o")]


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit; a command returns its code, errors become one line and 2."""
    try:
        code = app(
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
    raise SystemExit(code if isinstance(code, int) else 0)
