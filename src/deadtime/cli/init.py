"""`deadtime init`, `schema` and `completion`: a first problem file, and files for tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from deadtime.base.errors import ArgumentError
from deadtime.cli import options
from deadtime.cli.application import FILES, START, app, lines
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
    force: options.Flag = False,
    json_output: options.AsJson = False,
) -> None:
    """Write a commented problem file to start from.

    Parameters
    ----------
    path
        The file to write.
    example
        The example whose numbers the file has.
    force
        Replace an existing file.
    """
    from deadtime.base.files import replacing
    from deadtime.problems.templates import template

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


@app.command(group=FILES, help_epilogue=lines("deadtime schema > problem.schema.json"))
def schema(*, json_output: options.AsJson = False) -> None:
    """Print the JSON Schema of problem files, for editors that complete and check TOML.

    The output is the same with `--json`.
    """
    from deadtime.problems.file import json_schema

    print_json(json_schema())


Shell = Literal["bash", "zsh", "fish"]


@app.command(
    group=FILES,
    help_epilogue=lines(
        "deadtime completion --install", "deadtime completion zsh > ~/.zfunc/_deadtime"
    ),
)
def completion(
    shell: Shell | None = None,
    *,
    install: options.Flag = False,
    json_output: options.AsJson = False,
) -> None:
    """Print a script that lets a shell complete commands, options and files, or install it.

    `deadtime --install-completion` is the same as `deadtime completion --install`.

    Parameters
    ----------
    shell
        bash, zsh or fish; the current one by default.
    install
        Write the script where the shell looks for it, and load it in its start-up file.
    """
    chosen = shell or _shell()
    script = app.generate_completion(shell=chosen)
    if chosen == "bash":  # so that folders end in a slash
        script = script.replace("complete -F", "complete -o filenames -F")
    written = [_install(chosen, script)] if install else []
    if json_output:
        print_json({"shell": chosen, "script": script}, written)
    elif written:
        print(f"Wrote {written[0]}. Next: open a new {chosen}.")
    else:
        print(script, end="")


def _shell() -> Shell:
    from cyclopts.completion.detect import ShellDetectionError, detect_shell

    try:
        detected = detect_shell()
    except ShellDetectionError:
        detected = None
    if detected in ("bash", "zsh", "fish"):
        return detected
    raise ArgumentError(
        "shell must be one of bash, zsh, fish where it cannot be detected, got none: "
        "deadtime completion bash."
    )


def _install(shell: Shell, script: str) -> Path:
    from deadtime.base.files import replacing

    try:
        path = app.install_completion(shell=shell)
        with replacing(path) as place:
            place.write_text(script, encoding="utf-8")
    except OSError as error:
        raise ArgumentError(
            f"the script cannot be written ({error.strerror}): print it with deadtime completion "
            f"{shell}, and store it where your shell looks."
        ) from None
    return path
