"""Run docs/tutorial.md with an installed deadtime, in a folder that is empty: for `make wheel`.

    PYTHON scripts/tutorial.py FOLDER

Nothing but the standard library and what PYTHON has installed; its Python and its commands have to
run, what they print is compared by tests/documents/test_docs_pages.py.
"""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).resolve().parents[1] / "docs" / "tutorial.md"
BLOCK = re.compile(r"^```([^\n`]*)\n(.*?)^```$", re.S | re.M)
NOT_RUN = ("python3 -m venv", "pip ", "deadtime app")


def run(line: str, folder: Path) -> None:
    """A line of a shell, with the commands of this Python."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        shlex.split(line), cwd=folder, env=os.environ | {"PATH": path}, capture_output=True
    )
    if done.returncode or done.stderr:
        raise SystemExit(f"tutorial: {line}: exit code {done.returncode}: {done.stderr.decode()}")


def main(folder: Path) -> None:
    if any(folder.iterdir()):
        raise SystemExit(f"tutorial: {folder} must be empty.")
    text, count = PAGE.read_text(encoding="utf-8"), 0
    os.chdir(folder)
    import deadtime

    if PAGE.parents[1] / "src" in Path(deadtime.__file__).resolve().parents:
        raise SystemExit(f"tutorial: deadtime is that of the repository: {deadtime.__file__}")
    names: dict = {"__name__": "tutorial"}
    for language, block in BLOCK.findall(text):
        file = re.match(r"# ([\w-]+\.\w+)\n", block)
        if file:
            (folder / file[1]).write_text(block, encoding="utf-8")
        if language == "python":
            exec(compile(block, str(PAGE), "exec"), names)
            count += 1
        elif language == "console":
            lines = [line[2:] for line in block.splitlines() if line.startswith("$ ")]
            here = [line for line in lines if not line.startswith(NOT_RUN)]
            for line in here:
                run(line, folder)
            count += len(here)
    print(f"tutorial: {count} blocks and commands ran with deadtime of {deadtime.__file__}")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
