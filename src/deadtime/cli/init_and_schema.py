"""`deadtime init` and `schema`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from deadtime.base.errors import ArgumentError
from deadtime.cli.application import FILES, START, AsJson, Flag, app, lines
from deadtime.cli.printing import print_json, require_writable

Name = Literal["paper", "three-mode", "follower", "motor", "quadrotor"]


@app.command(
    group=START,
    help_epilogue=lines(
        "deadtime init",
        "deadtime init car.toml --example follower",
        "deadtime init servo.toml --example quadrotor",
    ),
)
def init(
    path: Path = Path("problem.toml"),
    *,
    example: Annotated[Name, Parameter(name=["--example", "-e"])] = "paper",
    force: Flag = False,
    json_output: AsJson = False,
) -> None:
    """Write a commented problem file to start from.

    Parameters
    ----------
    path
        The file to write.
    example
        Whose numbers to start with.
    force
        Replace a file that exists.
    """
    from deadtime.base.files import replacing
    from deadtime.problems.file.named_problems import template

    if path.exists() and not force:
        raise ArgumentError(f"{path} exists: choose another name, or replace it with --force.")
    require_writable("path", path)
    text = template(example)
    with replacing(path) as place:
        place.write_text(text.replace("problem.toml", path.name), encoding="utf-8")
    if json_output:
        print_json({"example": example}, [path])
        return
    print(f"Wrote {path}. Next: deadtime simulate {path}")


@app.command(
    group=FILES,
    help_epilogue=lines(
        "deadtime schema > problem.schema.json",
    ),
)
def schema(*, json_output: AsJson = False) -> None:
    """Print the JSON Schema of problem files, for editors that complete and check TOML.

    With and without `--json`.
    """
    from deadtime.problems.file import json_schema

    print_json(json_schema())
