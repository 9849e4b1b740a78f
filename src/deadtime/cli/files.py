"""`deadtime init` and `schema`."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from deadtime.cli.entry import app
from deadtime.errors import ArgumentError

Name = Literal["paper", "three-mode", "follower"]


@app.command
def init(
    path: Path = Path("problem.toml"),
    *,
    example: Annotated[Name, Parameter(name=["--example", "-e"])] = "paper",
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Write a commented problem file to start from.

    Examples: `deadtime init`, `deadtime init car.toml --example follower`.

    Parameters
    ----------
    path
        The file to write.
    example
        Whose numbers to start with.
    force
        Replace a file that exists.
    """
    if path.exists() and not force:
        raise ArgumentError(f"{path} exists: choose another name, or replace it with --force.")
    text = files("deadtime").joinpath("templates", f"{example}.toml").read_text(encoding="utf-8")
    try:
        path.write_text(text.replace("problem.toml", path.name), encoding="utf-8")
    except OSError as error:
        raise ArgumentError(f"{path} cannot be written: {error.strerror}.") from None
    print(f"Wrote {path}. Next: deadtime simulate {path}")


@app.command
def schema() -> None:
    """Print the JSON Schema of problem files, for editors that complete and check TOML."""
    from deadtime.problem_file import json_schema

    print(json.dumps(json_schema(), indent=2, ensure_ascii=False))
