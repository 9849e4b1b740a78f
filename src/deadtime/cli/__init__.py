"""The command line, `deadtime`: one file per group of commands.

`init`, `simulate`, `reproduce`; `certify`, `verify`, `bound`, `loop`, `robustness`; `monte-carlo`,
`study`, `sweep`, `plot`; `design`, `export`, `fit`, `identify`, `experiment`; `schema`,
`completion`.

Exit codes: 0 when the command did its work (a loop that diverges is a result), 1 when the answer
is no (`certify --law` proves nothing, `verify` finds that a file proves nothing, `design` does not
reach its margin, the C of `export` fails its self-check), 2 when something in the request is
wrong, 70 for a bug in deadtime, 130 when interrupted (`monte-carlo` then prints and saves the
finished scenarios), 141 when the output's pipe is closed. Errors are one line on
stderr; with `--json` stdout then stays empty.
"""

from deadtime.cli import (  # noqa: F401 (each registers its commands)
    certificates,
    design,
    experiment,
    export,
    identify,
    init,
    loop,
    monte_carlo,
    plot,
    runs,
    sweep,
)
from deadtime.cli.application import app, main

__all__ = ["app", "main"]
