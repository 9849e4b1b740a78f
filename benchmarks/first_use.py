"""What does a new user wait for? Every command with nothing compiled, then warm, beside its peers.

    python benchmarks/first_use.py [--full]

Each command runs in a process of its own, as a shell starts it, with bytecode on disk and an empty
folder for compiled code; the second run finds what the first has compiled. The plant is the
follower. Peers on the same machine: `import numpy`, and the first step response of python-control
with its figure written. --full adds the commands that compare many signals and search.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

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


def seconds(command: list[str], folder: Path) -> float:
    """The time of one process, which must not fail."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "compiled")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    began = time.perf_counter()
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 1):
        raise SystemExit(f"{' '.join(command)} failed: {done.stderr[-500:]}")
    return time.perf_counter() - began


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
        print(f"import numpy {min(numpy):.2f} s, import deadtime {min(own):.2f} s")
        if importlib.util.find_spec("control"):
            taken = [seconds([python, "-c", CONTROL], folder) for _ in range(2)]
            print(f"python-control, step response and its figure: {min(taken):.1f} s")
        print(f"{'command':32s} {'first, s':>9s} {'then, s':>9s}")
        for command in QUICK + FULL * full:
            for old in (folder / "compiled").rglob("*.nb?"):
                old.unlink()
            first = seconds([*program, *command], folder)
            then = min(seconds([*program, *command], folder) for _ in range(2))
            print(f"{' '.join(command)[:32]:32s} {first:9.1f} {then:9.1f}")


if __name__ == "__main__":
    main()
