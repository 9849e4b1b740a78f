"""What does a period of the exported C cost on this machine, and is it flat?

    python benchmarks/c_controller.py [--steps 1000000]

The paper's law at N = 100 to 10,000 past inputs (factorised), dwell-aware ones (dense) and ones of
low rank, as `export_c` writes them, compiled with -O2. Calls are timed in batches, which the
clock's own time does not touch, and one by one, less an empty interval: median, 99.9 % quantile,
worst. The worst is also given where each call is the best of 31 passes over the same calls, which
spares it what else the machine does. Before the timing, each is held against rows of the law's
table: at most 1e-12 of Σ|terms| (2e-5 in single precision).
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.stats
from machine import heading

import deadtime as dt
from deadtime.controller.export.compiler import WARNINGS, compiler

TIMER = """
#define _POSIX_C_SOURCE 200112L
#include <time.h>
#include "controller.h"
static long now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000L + t.tv_nsec;
}
int size(void) { return (int)sizeof(controller_controller); }
/* Nanoseconds of every call, of an empty interval before it, and of the whole. */
long drive(controller_controller *c, long count, const double *x, const int *mode, double *u,
           int *spent, int *empty)
{
    controller_real xs[CONTROLLER_STATES], us[CONTROLLER_INPUTS];
    long k, start = now();
    for (k = 0; k < count; k++) {
        long a, b, d;
        int i;
        for (i = 0; i < CONTROLLER_STATES; i++) {
            xs[i] = (controller_real)x[k * CONTROLLER_STATES + i];
        }
        if (spent != 0) {
            d = now();
            a = now();
            controller_update(c, xs, mode[k], 0, 0, us);
            b = now();
            spent[k] = (int)(b - a);
            empty[k] = (int)(a - d);
        } else {
            controller_update(c, xs, mode[k], 0, 0, us);
        }
        for (i = 0; i < CONTROLLER_INPUTS; i++) u[k * CONTROLLER_INPUTS + i] = (double)us[i];
    }
    return now() - start;
}
"""


PASSES = 31
HEADINGS = (
    *("law", "N", "form", "ns a call", "timed singly", "99.9 %", "worst", "worst, best of passes"),
    *("ROM", "RAM", "error"),
)


class Row(NamedTuple):
    """Nanoseconds and bytes."""

    what: str
    taps: int
    form: str
    batch: float
    median: float
    tail: float
    worst: float
    quiet: float
    rom: int
    ram: int
    error: float


def measured(what: str, law: dt.Law, step: float, count: int, **options: object) -> Row:
    """Export, compile, check and time one law."""
    plant, table = law.plant, law.digital(step)
    rng = np.random.default_rng(0)
    x = rng.normal(size=(count, plant.states))
    modes = np.repeat(rng.integers(0, plant.modes, count // 50 + 1), 50)[:count].astype(np.int32)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        written = dt.Controller(law, step, limits=(-2.0, 2.0)).export_c(folder, **options)
        assert written.check.passed, written.check
        (folder / "drive.c").write_text(TIMER, encoding="utf-8")
        command = [*(compiler() or ["cc"]), *WARNINGS, "-Wno-conversion", "-O2", "-fPIC", "-shared"]
        files = [str(folder / name) for name in ("controller.c", "drive.c")]
        subprocess.run([*command, *files, "-o", str(folder / "timer.so")], check=True)
        library = ctypes.CDLL(str(folder / "timer.so"))
        library.drive.restype = ctypes.c_long
        state = ctypes.create_string_buffer(library.size())

        def drive(n: int, spent: np.ndarray | None = None, empty: np.ndarray | None = None):
            u = np.empty((n, plant.inputs))
            library.controller_reset(state, None, 0)
            pointers = map(_pointer, (x, modes, u, spent, empty))
            return u, library.drive(state, ctypes.c_long(n), *pointers)

        checked = min(count, 3 * table.taps + 500)
        u, _ = drive(checked)
        error = _error(table, x, modes, u)
        assert error <= (2e-5 if options.get("precision") == "float" else 1e-12), error
        spent, empty = np.zeros((2, count), np.int32)
        drive(count, spent, empty)
        quiet = spent.copy()
        for _ in range(PASSES - 1):  # the same calls again: what interrupts one pass spares another
            once = np.zeros(count, np.int32)
            drive(count, once, empty)
            quiet = np.minimum(quiet, once)
        rounds = [drive(1000 * max(1, count // 20_000))[1] for _ in range(9)]
        batch = float(np.median(rounds)) / (1000 * max(1, count // 20_000))
    own = float(np.median(empty))
    return Row(
        what,
        table.taps,
        written.form.split(":")[0],
        batch,
        float(np.median(spent)) - own,
        float(np.quantile(spent, 0.999)) - own,
        float(spent.max()) - own,
        float(quiet.max()) - own,
        written.rom,
        written.ram,
        error,
    )


def _pointer(array: np.ndarray | None) -> ctypes.c_void_p | None:
    return None if array is None else array.ctypes.data_as(ctypes.c_void_p)


def _error(table: dt.Feedback, x: np.ndarray, modes: np.ndarray, u: np.ndarray) -> float:
    """The largest |u − row|/Σ|terms|, of rows whose answer the limits did not cut."""
    taps, m = table.input_gain.shape[1:3]
    rows, past = table.rows(modes[: len(u)]), np.concatenate((np.zeros((taps, m)), u))
    worst = 0.0
    for k in range(0, len(u), 7):
        seen = past[k : k + taps][::-1]
        F, G = table.state_gain[rows[k]], table.input_gain[rows[k]]
        asked = F @ x[k] + np.einsum("jab,jb->a", G, seen)
        scale = np.abs(F) @ np.abs(x[k]) + np.einsum("jab,jb->a", np.abs(G), np.abs(seen))
        worst = max(worst, float((np.abs(np.clip(asked, -2.0, 2.0) - u[k]) / scale).max()))
    return worst


def rows(count: int) -> list[Row]:
    """Every row of the table."""
    problem = dt.problems.paper()
    plant, gains = problem.plant, problem.gains
    averaged = dt.AveragedPredictor(plant, gains)
    rates = dt.Markov([[0.0, 1.0], [1.0, 0.0]])
    expected = dt.ExpectedPredictor(plant, gains, rates, allow_unstable=True)
    dwelling = dt.AveragedPredictor(plant, gains, None, 0.3)
    sojourn = scipy.stats.gamma(4.0, scale=0.15)
    model = dt.SemiMarkov(sojourn, modes=plant.modes)
    ageing = dt.ExpectedPredictor(plant, gains, model, allow_unstable=True)
    delay = plant.delay
    found = [
        measured("averaged", averaged, delay / N, max(20_000, count if N in (100, 10_000) else 0))
        for N in (100, 1000, 10_000)
    ]
    found += [
        measured("averaged, float", averaged, delay / 100, count // 10, precision="float"),
        measured("averaged, N small", averaged, delay / 20, count // 10),
        measured("expected, Markov", expected, delay / 100, count // 10),
        measured("averaged, dwell-aware", dwelling, delay / 100, count // 10),
        measured("averaged, dwell-aware", dwelling, delay / 1000, 20_000),
        measured("expected, gamma sojourns", ageing, delay / 100, count // 10),
        measured("delay ignored", dt.DelayedStateFeedback(plant, gains), delay / 100, count // 10),
    ]
    return found


def main() -> None:
    """Print the table, and hold the factorised rows to what is claimed of them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=1_000_000)
    count = parser.parse_args().steps
    found = rows(count)
    command = compiler() or ["cc"]
    version = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False)
    print(f"{heading()}, {version.stdout.splitlines()[0]}\n")
    print(f"| {' | '.join(HEADINGS)} |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for row in found:
        print(
            f"| {row.what} | {row.taps:,} | {row.form} | {row.batch:.0f} | {row.median:.0f} | "
            f"{row.tail:.0f} | {row.worst:,.0f} | {row.quiet:,.0f} | {row.rom:,} | {row.ram:,} | "
            f"{row.error:.0e} |"
        )
    first, _, long = found[:3]
    print(
        f"\nFactorised rows: {first.batch:.0f} ns; N = 10,000 takes {long.batch / first.batch:.2f} "
        f"of N = 100; worst of {count:,} calls over their median {first.quiet / first.median:.1f} "
        f"where each is the best of {PASSES} passes, {first.worst / first.median:,.0f} in one pass."
    )


if __name__ == "__main__":
    main()
