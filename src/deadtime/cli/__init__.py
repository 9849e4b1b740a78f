"""The command line: `deadtime reproduce`, `simulate`, `certify`, `verify`, `bound`, `design`,
`robustness`, `monte-carlo`, `sweep`, `plot`, `export`, `fit`, `study`, `init`, `schema`.

Exit codes: 0 when the command did its work (a loop that diverges is a result), 1 when `verify`
finds that a file proves nothing, `design` does not reach its margin or the C of `export` fails its
self-check, 2 when something in the
request is wrong, 130 when interrupted (`monte-carlo` then prints and
saves what is done). Errors are one line on stderr.
"""

from deadtime.cli import (
    certificates,
    design,
    explorer,
    export,
    files,
    models,
    monte_carlo,
    plot,
    robustness,
    runs,
    sweep,
    theorem,
)
from deadtime.cli.entry import app, main

__all__ = [
    "app",
    "certificates",
    "design",
    "explorer",
    "export",
    "files",
    "main",
    "models",
    "monte_carlo",
    "plot",
    "robustness",
    "runs",
    "sweep",
    "theorem",
]
