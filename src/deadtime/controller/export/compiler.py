"""This machine's C compiler, the self-check of exported C, and which files may be replaced."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from deadtime.base.errors import ArgumentError

MARK = "Written by deadtime"


def require_own(folder: Path, names: Iterable[str]) -> None:
    """Refuse to replace a file without the mark of deadtime."""
    for name in names:
        path = folder / name
        if path.is_symlink() or path.exists():
            try:
                own = MARK.encode() in path.read_bytes()
            except OSError:
                own = False
            if not own:
                raise ArgumentError(
                    f"folder {str(folder)!r} has a {name} that deadtime did not write (it lacks "
                    f'"{MARK}"): move it away, or give another folder.'
                )


def require_suffix(path: Path, suffix: str) -> None:
    """Refuse a path of another suffix."""
    if path.suffix != suffix:
        raise ArgumentError(f"path must end in {suffix}, got {str(path)!r}.")


WARNINGS = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-Wconversion")
_PATIENCE = 300.0  # seconds


class SelfCheck(NamedTuple):
    """The result of a self-check: `passed` is None where there was none."""

    passed: bool | None
    message: str


def compiler() -> list[str] | None:
    """The command that compiles C: $CC, or cc, gcc or clang where there is one."""
    asked = os.environ.get("CC", "").strip()
    for command in [asked] if asked else ["cc", "gcc", "clang"]:
        try:
            words = shlex.split(command)
        except ValueError:  # a quotation that does not end
            return None
        if words and shutil.which(words[0]):
            return words
    return None


def no_compiler() -> str:
    """Why there is no compiler."""
    asked = os.environ.get("CC", "").strip()
    if asked:
        return f"the compiler CC={asked!r} was not found"
    return "no C compiler was found (set CC)"


def compile_and_link(sources: list[Path], target: Path, *options: str) -> str | None:
    """Compile and link; return the complaint, or None."""
    command = compiler()
    if command is None:
        return no_compiler()
    files = [str(path) for path in sources]
    try:
        result = subprocess.run(
            [*command, *WARNINGS, "-O2", *options, *files, "-o", str(target)],
            capture_output=True,
            text=True,
            timeout=_PATIENCE,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    return result.stderr.strip() or f"exit code {result.returncode}" if result.returncode else None


def self_check(folder: Path, name: str) -> SelfCheck:
    """Compile the controller with its check, outside the folder, and run the vectors."""
    command = compiler()
    if command is None:
        return SelfCheck(None, f"not checked: {no_compiler()}")
    with tempfile.TemporaryDirectory() as place:
        program = Path(place) / "check"
        sources = [folder / f"{name}.c", folder / f"{name}_check.c"]
        complaint = compile_and_link(sources, program)
        if complaint is not None:
            return SelfCheck(False, f"{command[0]} does not compile it: {complaint}")
        vectors = str(folder / f"{name}_vectors.csv")
        try:
            run = subprocess.run(
                [str(program), vectors],
                capture_output=True,
                text=True,
                timeout=_PATIENCE,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            return SelfCheck(
                None, f"not checked: what {command[0]} compiled does not run here: {error}"
            )
    last = (run.stdout.splitlines() or ["no answer"])[-1]
    return SelfCheck(run.returncode == 0, f"compiled with {command[0]}: {last}")
