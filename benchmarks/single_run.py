"""What does one simulation cost? Warm, cold, and against the loops people write.

    python benchmarks/single_run.py

The paper's example under the averaged law, T = 10 s, h = 0.01 s (N = 100), a random signal with
off-grid switches. Peers run in the same process: the same loop in NumPy, and compiled by Numba
with everything but the loop itself left out (tables and transitions prepared beforehand).
Their switches are rounded to samples, since neither handles any other. Accuracy is asserted
outside the timed region: on a signal whose switches are on the grid all three agree.
"""

from __future__ import annotations

import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import scipy.linalg
from numba import njit

import deadtime as dt
from deadtime.numerics import kernels

HORIZON, STEP = 10.0, 0.01


def plant_steps(plant: dt.SwitchedSystem) -> np.ndarray:
    """[Φ Γ] of every mode over one step, by SciPy."""
    n, m = plant.states, plant.inputs
    result = []
    for A, B in zip(plant.A, plant.B, strict=True):
        block = np.zeros((n + m, n + m))
        block[:n, :n], block[:n, n:] = A * STEP, B * STEP
        result.append(scipy.linalg.expm(block)[:n])
    return np.array(result)


def numpy_loop(step, F, G, mode, x0):
    """The loop as one would write it: D a multiple of h, switches at samples."""
    n, N = x0.size, G.shape[0]
    samples = mode.size
    x, u = np.empty((samples, n)), np.zeros(N + samples)
    x[0] = x0
    for k in range(samples):
        u[N + k] = F @ x[k] + G @ u[k : k + N]
        if k + 1 < samples:
            M = step[mode[k]]
            x[k + 1] = M[:, :n] @ x[k] + M[:, n] * u[k]
    return x


@njit(fastmath=True)
def compiled_loop(step, F, G, mode, x0):
    """The same loop, compiled."""
    n, N = x0.size, G.shape[0]
    samples = mode.size
    x, u = np.empty((samples, n)), np.zeros(N + samples)
    x[0] = x0
    for k in range(samples):
        total = 0.0
        for i in range(n):
            total += F[i] * x[k, i]
        for j in range(N):
            total += G[j] * u[k + j]
        u[N + k] = total
        if k + 1 < samples:
            M = step[mode[k]]
            for i in range(n):
                value = M[i, n] * u[k]
                for j in range(n):
                    value += M[i, j] * x[k, j]
                x[k + 1, i] = value
    return x


def median_ms(work, repeats: int) -> float:
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def fresh_process(code: str, cache: Path | None = None) -> float:
    """Median seconds that `code` prints in a new interpreter."""
    environment = dict(os.environ) | ({"NUMBA_CACHE_DIR": str(cache)} if cache else {})
    command = [sys.executable, "-c", code]
    runs = [
        float(subprocess.check_output(command, env=environment, text=True))
        for _ in range(1 if cache else 5)
    ]
    return statistics.median(runs)


IMPORT = "import time; t = time.perf_counter(); import deadtime; print(time.perf_counter() - t)"
FIRST = """
import time, deadtime as dt
problem = dt.problems.paper()
t = time.perf_counter()
problem.simulate("averaged")
print(time.perf_counter() - t)
"""


def main() -> None:
    kernels.WISH = "always"  # what is timed is warm
    problem = dt.problems.paper()
    plant, law = problem.plant, problem.laws["averaged"]
    off_grid = problem.signal
    times = np.round(off_grid.times / STEP) * STEP
    on_grid = dt.SwitchingSignal(times, off_grid.modes, off_grid.end)

    samples = round(HORIZON / STEP) + 1
    mode = on_grid(np.arange(samples) * STEP + 1e-12)
    table = law.digital(STEP)
    step, F = plant_steps(plant), table.state_gain[0, 0]
    G = np.ascontiguousarray(table.input_gain[0, ::-1, 0, 0])
    loop = (step, F, G, mode, problem.x0)

    def ours(signal=off_grid):
        return dt.simulate(plant, law, signal, problem.x0, HORIZON, step=STEP)

    reference = ours(on_grid).states.T
    for peer in (numpy_loop, compiled_loop):
        error = np.abs(peer(*loop) - reference).max() / np.abs(reference).max()
        assert error < 1e-11, (peer.__name__, error)

    warm = median_ms(ours, 500)
    numpy_time = median_ms(lambda: numpy_loop(*loop), 30)
    bare = median_ms(lambda: compiled_loop(*loop), 500)
    rows = [
        ("simulate, warm, everything included", f"{warm:.3f} ms", "1"),
        ("the same + metrics()", f"{median_ms(lambda: ours().metrics(), 200):.3f} ms", ""),
        ("NumPy loop, on the grid only", f"{numpy_time:.2f} ms", f"{numpy_time / warm:.1f}"),
        ("bare compiled loop, on the grid only", f"{bare:.4f} ms", f"{bare / warm:.3f}"),
        ("import deadtime", f"{fresh_process(IMPORT):.3f} s", ""),
        ("first simulate in a process, cache warm", f"{fresh_process(FIRST):.2f} s", ""),
    ]  # fmt: skip
    with tempfile.TemporaryDirectory() as cache:
        cold = fresh_process(FIRST, Path(cache))
    rows.append(("first simulate ever (compiles)", f"{cold:.1f} s", ""))

    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
    )
    print(f"deadtime {dt.__version__} at {commit.stdout.strip() or 'no commit'}, ", end="")
    print(f"Python {platform.python_version()}, {os.cpu_count()} cores, {_processor()}\n")
    print("| what | median | ratio |\n|---|---|---|")
    for row in rows:
        print("| " + " | ".join(row) + " |")


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


if __name__ == "__main__":
    main()
