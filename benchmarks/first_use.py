"""What does a new user wait for? Every command with nothing compiled, then warm, beside its peers.

    python benchmarks/first_use.py [--full]

Each command runs in a process of its own, as a shell starts it, with bytecode on disk and an empty
folder for compiled code; the second run finds what the first has compiled. Beside the seconds of
the clock are those of processors, which other programs on the machine make larger by less. The
plant is the follower. Peers on the same machine: `import numpy`, and the first step response of
python-control with its figure written. --full adds the commands that compare many signals and
search, and all that docs/tutorial.md runs, from the first command to the last, with one folder for
compiled code.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import resource
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

QUICK = [
    ["--help"],
    ["simulate", "car.toml"],
    ["export", "car.toml", "--c", "c"],
]
FULL = [
    ["certify", "car.toml"],
    ["robustness", "car.toml"],
    ["monte-carlo", "car.toml"],
]
CONTROL = """
import control, matplotlib
matplotlib.use("agg")
control.step_response(control.tf([1], [1, 1])).plot()
matplotlib.pyplot.savefig("step.png")
"""


TUTORIAL = Path(__file__).resolve().parents[1] / "docs" / "tutorial.md"
NOT_RUN = ("python3 -m venv", "pip ", "deadtime app")


class Taken(NamedTuple):
    """Seconds of the clock, and of the processors."""

    clock: float
    busy: float

    def __str__(self) -> str:
        return f"{self.clock:8.1f} {self.busy:8.1f}"


def seconds(command: list[str], folder: Path) -> Taken:
    """The time of one process, which must not fail."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "compiled")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    took, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 1):
        raise SystemExit(f"{' '.join(command)} failed: {done.stderr[-500:]}")
    user, system = after.ru_utime - before.ru_utime, after.ru_stime - before.ru_stime
    return Taken(took, user + system)


def tutorial(program: list[str]) -> tuple[Taken, Taken]:
    """All commands and scripts of the tutorial, with nothing compiled and once more, in seconds."""
    blocks = re.findall(r"^```([^\n`]*)\n(.*?)^```$", TUTORIAL.read_text("utf-8"), re.S | re.M)
    with tempfile.TemporaryDirectory() as name:
        both = [_lesson(blocks, program, Path(name)) for _ in range(2)]
    return both[0], both[1]


def _lesson(blocks: list[tuple[str, str]], program: list[str], folder: Path) -> Taken:
    taken, script = [], ""
    for language, block in blocks:
        if file := re.match(r"# ([\w-]+\.\w+)\n", block):
            (folder / file[1]).write_text(block, encoding="utf-8")
        if language == "python":  # one session, which goes on from block to block
            script += block
        elif language == "console":
            lines = [line[2:] for line in block.splitlines() if line.startswith("$ ")]
            for line in (line for line in lines if not line.startswith(NOT_RUN)):
                first, *rest = shlex.split(line)
                start = {"deadtime": program, "python": [sys.executable]}.get(first, [first])
                if rest[:1] == ["init"]:
                    rest.append("--force")
                taken.append(seconds([*start, *rest], folder))
    taken.append(seconds([sys.executable, "-c", script], folder))
    return Taken(*map(sum, zip(*taken, strict=True)))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--full", action="store_true", help="certify, robustness, monte-carlo, too")
    full = parser.parse_args().full
    python = sys.executable
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program = [python, "-m", "deadtime"]
        seconds([*program, "init", "car.toml", "--example", "follower"], folder)
        numpy = [seconds([python, "-c", "import numpy"], folder) for _ in range(5)]
        own = [seconds([python, "-c", "import deadtime"], folder) for _ in range(5)]
        (base, _), (light, _) = min(numpy), min(own)
        print(f"import numpy {base:.2f} s, import deadtime {light:.2f} s")
        if importlib.util.find_spec("control"):
            taken = [seconds([python, "-c", CONTROL], folder) for _ in range(2)]
            print(f"python-control, step response and its figure: {min(taken).clock:.1f} s")
        print(f"{'':32s} {'first, s':>8s} {'CPU s':>8s} {'then, s':>8s} {'CPU s':>8s}")
        for command in QUICK + FULL * full:
            for old in (folder / "compiled").rglob("*.nb?"):
                old.unlink()
            first = seconds([*program, *command], folder)
            then = min(seconds([*program, *command], folder) for _ in range(2))
            print(f"{' '.join(command)[:32]:32s} {first} {then}", flush=True)
        if full:
            first, then = tutorial(program)
            print(f"{'the tutorial, all of it':32s} {first} {then}")


if __name__ == "__main__":
    main()
