"""What does a scenario-step cost, and how far is that from what the machine can do?

    python benchmarks/batch.py [--quick]

A scenario-step is one period of one scenario: law, window, plant and all metrics. The paper's
example from x₀ = (−1, 1), mean sojourn 0.4 s: at N = 100, T = 10 s and h = 0.01 s; at other N,
h = D/N, T = 4 s and sojourns of as many periods, so that only N changes. deadtime's rows are calls
of `monte_carlo`: tables, laying signals on the grid, the loop, the dataset; `drawn` draws the
signals, too. Peers (`batch_peers.py`) get modes per period, tables and transitions ready-made,
switch on the grid only and have three metrics of seven. Every figure of deadtime is compared with
`simulate(…).metrics()` to 1e-9, and its inputs with the dense row by exact sums, outside the
timed region.

Fused multiply-adds that a scenario-step asks for, with n states, m inputs, z = n + m or n + 2m
of what acts on the plant, a window of order q with blocks of size p, and r rows:

    metrics      n norm + 1 peak + m + 1 energy + 2 of log|x| (4 in the second half)
    law          r m (n + m + q): state, last input, window
    window       q (m + p) forward, and q m + r m q carried from block to block
    plant        n z, and z (z + 1)/2 + z for ∫|x|²

Averaged law: 7 + 7 + 16 + 15 = 45 with n = 2, m = 1, z = 3, q = 4, p = 1, r = 1. Dense rows have
m (N m + n) for law and window; the oracle has two maps of 2 n² and m (n + m) for the prediction,
and n (n + m) + 2 (n³ + n²) to let a period into the window. Comparisons, the series of cut periods
and drawing are not counted.
The bound is that number of operations at the measured rate of independent fmas, the better of
two measurements, before and after.
"""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from typing import NamedTuple

import batch_peers as peers
import numpy as np
from batch_problem import (
    LAWS,
    LONG,
    LONGEST,
    MODEL,
    USUAL,
    Setting,
    fmas_of,
    modes_of,
    on_grid,
    require_accuracy,
    run,
)
from machine import Machine, heading, measured, median_of, processors

import deadtime as dt
from deadtime.numerics import kernels
from deadtime.switching import SignalBatch

QUICK = "--quick" in sys.argv[1:]
ANYWHERE, DRAWN = ", switches anywhere", ", switches anywhere, drawing counted"


class Row(NamedTuple):
    """A line of the table: scenario-steps per second; fmas of one, 0 where they are not counted."""

    what: str
    rate: float
    fmas: float
    threads: int
    note: str = ""


# law, setting, scenarios, where switches are, threads (0: all), note
PLAN = [
    ("averaged", USUAL, 262_144, "", 0, ""),
    ("averaged", USUAL, 262_144, "", 1, ""),
    ("mean", USUAL, 262_144, "", 0, ""),
    ("expected, Markov", USUAL, 262_144, "", 0, ""),
    ("averaged", USUAL, 131_072, ANYWHERE, 0, ""),
    ("averaged", USUAL, 131_072, ANYWHERE, 1, ""),
    ("averaged", USUAL, 131_072, DRAWN, 0, ""),
    ("averaged", USUAL, 131_072, DRAWN, 1, ""),
    ("averaged", LONG, 65_536, "", 0, ""),
    ("averaged", LONGEST, 8192, "", 0, ""),
    ("averaged, dwell-aware", USUAL, 32_768, "", 0, "dense, a row per mode and age"),
    ("expected, semi-Markov", USUAL, 32_768, "", 0, "dense, a row per mode and age"),
    ("oracle", USUAL, 131_072, "", 0, "a prediction per scenario and period"),
]


def fewer(scenarios: int) -> int:
    """Scenarios, or what a smoke run takes of them."""
    return max(64, scenarios // 64) if QUICK else scenarios


def ours() -> list[Row]:
    """deadtime's rows."""
    rows = []
    for name, setting, scenarios, where, threads, note in PLAN:
        law, size, used = LAWS[name], fewer(scenarios), threads or processors()
        batch = MODEL.draw(12.0, 3, 0, size) if where else on_grid(setting, size)
        require_accuracy(law, batch, setting)
        model = MODEL if where == DRAWN else batch

        def work(law=law, model=model, setting=setting, size=size, used=used) -> None:
            run(law, model, setting, size, threads=used)

        spent = median_of(work, 3 if QUICK else 5)
        what = f"deadtime, {name}, N = {setting.taps:,}{where}" + ", one thread" * (threads == 1)
        rows.append(Row(what, size * setting.periods / spent, fmas_of(law, setting), used, note))
    return rows


def peer_error(law: dt.Law, figures: np.ndarray, batch: SignalBatch, setting: Setting) -> float:
    """The largest relative difference to deadtime, of three figures over the first scenarios."""
    few = min(64, len(batch), figures.shape[1])
    data = run(law, batch.slice(0, few), setting).sel(law="law")
    # The peak of deadtime is that of |x|, and its energy an integral.
    same = [data.ise.values, data.energy.values / setting.step, data.peak.values**2]
    return float(np.abs(figures[:, :few] / np.array(same) - 1.0).max())


Work = Callable[[np.ndarray], np.ndarray]


def peer_rows() -> list[Row]:
    """The peers' rows, their errors in the notes."""
    rows = []
    averaged, aware = LAWS["averaged"], LAWS["averaged, dwell-aware"]
    semi, same = LAWS["expected, semi-Markov"], peers.problem_of(LAWS["averaged"])
    numbers = peers.numbers_of(same)
    plan: list[tuple[str, dt.Law, int, float, Work]] = [
        ("plain recursion", averaged, 65_536, 1e-3, lambda modes: peers.plain(same, modes)),
        ("plain recursion, 64 scenarios side by side", averaged, 65_536, 1e-3,
         lambda modes: peers.side_by_side(numbers, USUAL.taps, modes)),
        ("dense, one row", averaged, 16_384, 1e-9, lambda modes: peers.dense(same, modes)),
        ("dense, dwell-aware", aware, 16_384, 1e-9, _dense_work(aware)),
        ("dense, expected", semi, 16_384, 1e-9, _dense_work(semi)),
        ("ring buffer, dwell-aware", aware, 8192, 1e-9, _dense_work(aware, peers.ring_buffer)),
        ("ring buffer, expected", semi, 8192, 1e-9, _dense_work(semi, peers.ring_buffer)),
    ]  # fmt: skip
    for name, law, scenarios, allowed, work in plan:
        batch = on_grid(USUAL, fewer(scenarios))
        modes = modes_of(batch, USUAL)
        given = peers.blocks_of(modes) if "side by side" in name else modes
        error = peer_error(law, work(given), batch, USUAL)
        assert error < allowed, (name, error)
        spent = median_of(lambda work=work, given=given: work(given), 3)
        note = f"off by {error:.0e}" if allowed > 1e-9 else ""
        rows.append(Row(f"peer: {name}", modes.size / spent, 0.0, processors(), note))
    return rows


def _dense_work(law: dt.Law, loop: Callable[..., np.ndarray] = peers.dense) -> Work:
    problem = peers.problem_of(law)
    return lambda modes: loop(problem, modes)


def plain_error(horizon: float) -> float:
    """How far the plain recursion is off, by its worst of 64 scenarios."""
    setting = Setting(100, round(100 * horizon))
    batch = on_grid(setting, 64)
    figures = peers.plain(peers.problem_of(LAWS["averaged"]), modes_of(batch, setting))
    return peer_error(LAWS["averaged"], figures, batch, setting)


def window_error(setting: Setting) -> float:
    """Inputs along one scenario against the dense row, summed exactly, relative to Σ|terms|."""
    law, batch = LAWS["averaged"], on_grid(setting, 8)
    data = run(law, batch, setting, trajectories=True)
    x, u = data.x.values[0, 0], data.u.values[0, 0, 0]
    feedback = law.digital(setting.step)
    F, G, worst = feedback.state_gain[0, 0], feedback.input_gain[0, :, 0, 0], 0.0
    for k in np.linspace(setting.taps, setting.periods, 200).astype(int):
        terms = [*F.tolist(), *G.tolist()]
        with_what = [*x[:, k].tolist(), *u[k - setting.taps : k][::-1].tolist()]
        products = [a * b for a, b in zip(terms, with_what, strict=True)]
        scale = math.fsum(map(abs, products))
        worst = max(worst, abs(u[k] - math.fsum(products)) / scale)
    return worst


MILLION = """
import resource, time, deadtime as dt
from scipy.stats import expon
p, model = dt.problems.paper(), dt.SemiMarkov(expon(loc=0.2, scale=0.2))
laws = {name: p.laws[name] for name in ("averaged", "mean")}
laws |= {str(i): dt.SingleModePredictor(p.plant, p.gains, i) for i in (0, 1)}
dt.monte_carlo(p.plant, laws, model, (-1.0, 1.0), 10.0, scenarios=8)
start = time.perf_counter()
dt.monte_carlo(p.plant, laws, model, (-1.0, 1.0), 10.0, scenarios=1_000_000)
print(time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def table(rows: list[Row], machine: Machine) -> None:
    """Print the table; ratios are times relative to the first row."""
    print(
        "| what | scenario-steps/s | ratio | fraction of FMA bound | note |\n|---|---|---|---|---|"
    )
    for row in rows:
        peak = machine.fma_one if row.threads == 1 else machine.fma_all
        bound = f"{2.0 * row.fmas * row.rate / peak:.2f}" if row.fmas else ""
        counted = f"{row.fmas:.0f} fmas" if row.fmas else ""
        note = "; ".join(part for part in (counted, row.note) if part)
        ratio, rate = rows[0].rate / row.rate, millions(row.rate)
        print(f"| {row.what} | {rate} | {ratio:,.2f} | {bound} | {note} |")


def millions(rate: float) -> str:
    """Three digits, in millions."""
    number = 1e-6 * rate
    return f"{number:,.0f} M" if number >= 100.0 else f"{number:.3g} M"


def bounds(machine: Machine) -> str:
    """The machine in words. A window stores u and reads four old inputs and a carried sum.

    It reads the inputs again and stores the sums where a block ends: 7 numbers with m = r = 1.
    """
    return (
        f"Fused multiply-adds: {1e-9 * machine.fma_one:.1f} GFlop/s on one core, "
        f"{1e-9 * machine.fma_all:.1f} on all. A chain of them that waits for itself says "
        f"{1e-9 * machine.clock:.2f} GHz, if one takes 4 cycles, so "
        f"{machine.fma_one / machine.clock:.1f} operations a cycle: 16 are two ports of 256 bits. "
        f"Triad: {1e-9 * machine.triad_one:.1f} GB/s on one core, {1e-9 * machine.triad_all:.1f} "
        f"on all: {millions(machine.triad_all / 56.0)} scenario-steps/s if the 56 bytes of a step "
        "in the window came from memory (at N = 10,000 the window of eight scenarios, "
        "1.3 MB, is in the caches)."
    )


def comparison(rows: list[Row]) -> str:
    """Ratios to the peers that do the same, and what a call costs before its first scenario."""
    rate = {row.what: row.rate for row in rows}

    def times(what: str, peer: str) -> str:
        return f"{rate['deadtime, ' + what + ', N = 100'] / rate['peer: ' + peer]:.1f}"

    averaged, few = LAWS["averaged"], on_grid(USUAL, 8)
    fixed = median_of(lambda: run(averaged, few, USUAL), 5)
    batch = on_grid(USUAL, fewer(262_144))
    spent = median_of(lambda: run(averaged, batch, USUAL), 3)
    return (
        f"Rates relative to the peer with the same rows: {times('averaged', 'plain recursion')} "
        f"(factorised, plain recursion), {times('averaged', 'dense, one row')} (factorised, dense "
        f"row), {times('averaged, dwell-aware', 'dense, dwell-aware')} and "
        f"{times('expected, semi-Markov', 'dense, expected')} (dense both), "
        f"{times('averaged, dwell-aware', 'ring buffer, dwell-aware')} and "
        f"{times('expected, semi-Markov', 'ring buffer, expected')} (dense, ring buffer). A call "
        f"for eight scenarios takes {1e3 * fixed:.0f} ms. The first row, timed again at the end: "
        f"{millions(len(batch) * USUAL.periods / spent)}."
    )


def accuracy() -> str:
    """What the plain recursion loses, and deadtime does not."""
    plain = [f"{plain_error(horizon):.0e} at {horizon:.0f} s" for horizon in (10.0, 20.0, 30.0)]
    window = [window_error(setting) for setting in (USUAL, LONGEST)]
    assert max(window) < 1e-12, window
    return (
        f"Figures of the plain recursion are off by {', '.join(plain)}, relative. deadtime's "
        f"inputs agree with the dense row, summed exactly, to {window[0]:.0e} of Σ|terms| at "
        f"N = 100 and {window[1]:.0e} at N = 10,000."
    )


def million() -> str:
    """Time and memory of a large run, in a process of its own."""
    command = [sys.executable, "-c", MILLION]
    seconds, kilobytes = map(float, subprocess.check_output(command, text=True).split())
    return (
        f"1,000,000 scenarios × 1,000 periods × 4 laws, signals drawn: {seconds:.1f} s "
        f"({millions(4e9 / seconds)} scenario-steps/s), peak memory {kilobytes / 2**20:.2f} GiB."
    )


def main() -> None:
    kernels.WISH = "always"  # what is timed is warm
    before = measured(QUICK)
    rows = [*ours(), *peer_rows()]
    machine = Machine(*map(max, before, measured(QUICK)))
    print(f"{heading()}\n\n{bounds(machine)}\n")
    table(rows, machine)
    print(f"\n{comparison(rows)}\n\n{accuracy()}")
    if not QUICK:
        print(f"\n{million()}")


if __name__ == "__main__":
    main()
