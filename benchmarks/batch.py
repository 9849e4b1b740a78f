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

Averaged law: 6 + 7 + 16 + 15 + … = 45 with n = 2, m = 1, z = 3, q = 4, p = 1, r = 1. Dense rows have
m (N m + n) for law and window. Comparisons, the series of cut periods and drawing are not counted.
The bound is that number of operations at the measured rate of independent fmas.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import batch_peers as peers
import numpy as np
from machine import Machine, heading, measured, median_of, processors
from scipy.stats import expon

import deadtime as dt
from deadtime.monte_carlo.loop import Loop
from deadtime.monte_carlo.window_form import window_form
from deadtime.steps import Window
from deadtime.switching import SignalBatch

PAPER, X0 = dt.problems.paper(), (-1.0, 1.0)
MODEL = dt.SemiMarkov(expon(loc=0.2, scale=0.2))
QUICK = "--quick" in sys.argv[1:]
LAWS: Mapping[str, dt.Law] = {
    "averaged": PAPER.laws["averaged"],
    "mean": PAPER.laws["mean"],
    "expected, Markov": dt.ExpectedPredictor(
        PAPER.plant, PAPER.gains, dt.Markov([[0.0, 2.5], [2.5, 0.0]])
    ),
    "averaged, dwell-aware": dt.AveragedPredictor(PAPER.plant, PAPER.gains, dwell_time=0.2),
    "expected, semi-Markov": dt.ExpectedPredictor(PAPER.plant, PAPER.gains, MODEL),
    "oracle": dt.ExactPredictor(PAPER.plant, PAPER.gains),
}


class Row(NamedTuple):
    """A line of the table: scenario-steps per second; fmas of one, 0 where they are not counted."""

    what: str
    rate: float
    fmas: float
    threads: int
    note: str = ""


class Setting(NamedTuple):
    """N, periods and the seconds of one."""

    taps: int
    periods: int

    @property
    def step(self) -> float:
        return PAPER.plant.delay / self.taps

    @property
    def horizon(self) -> float:
        return self.periods * self.step


USUAL, LONG, LONGEST = Setting(100, 1000), Setting(1000, 4000), Setting(10_000, 40_000)


def on_grid(setting: Setting, scenarios: int) -> tuple[SignalBatch, np.ndarray]:
    """Signals whose sojourns are 20 periods and more, 40 on average; and the mode per period."""
    rng, periods = np.random.default_rng(7), setting.periods
    most = periods // 20 + 2
    sojourns = np.rint(20.0 + rng.exponential(20.0, (scenarios, most)))
    starts = np.concatenate((np.zeros((scenarios, 1)), np.cumsum(sojourns, axis=1)), axis=1)
    kept = starts < periods
    begin = rng.integers(0, 2, (scenarios, 1))
    modes = (begin + np.arange(most + 1)) % 2
    first = np.concatenate(([0], np.cumsum(kept.sum(axis=1))))
    ends, ages = np.full(scenarios, np.inf), np.zeros(scenarios)
    batch = SignalBatch(first, starts[kept] * setting.step, modes[kept], ends, ages)
    switched = np.zeros((scenarios, periods), np.int8)
    if setting == USUAL:  # peers run nothing else
        row, place = np.nonzero(kept)
        switched[row, starts[kept].astype(int)] = place > 0
        switched = (np.cumsum(switched, axis=1) + begin).astype(np.int8) % 2
    return batch, switched


def run(law: dt.Law, model: Any, setting: Setting, scenarios: int = 0, **more: Any) -> Any:
    """`monte_carlo` of one law; a model draws the signals."""
    size, law_of = max(1, scenarios), {"law": law}
    horizon, step = setting.horizon, setting.step
    return dt.monte_carlo(PAPER.plant, law_of, model, X0, horizon, step, size, **more)


def require_accuracy(law: dt.Law, batch: SignalBatch, setting: Setting, **more: Any) -> None:
    """Every figure of some scenarios is that of `simulate` to 1e-9."""
    few = batch.slice(0, 11 if setting == USUAL else 2)
    data = run(law, few, setting, **more).sel(law="law")
    for i in (0, len(few) - 1):
        one = dt.simulate(PAPER.plant, law, few[i], X0, setting.horizon, setting.step)
        for name, value in one.metrics().items():
            np.testing.assert_allclose(data[name].values[i], value, rtol=1e-9, err_msg=name)


def fmas_of(law: dt.Law, setting: Setting) -> float:
    """Fused multiply-adds of a scenario-step; see the module."""
    loop = Loop(PAPER.plant, Window.of(PAPER.plant.delay, setting.step), np.array(X0), 1.0)
    _, n, wide = loop.maps.move.shape
    feedback = law.digital(setting.step, dt.SwitchingSignal.constant(0), 1)
    rows, taps, m, _ = feedback.input_gain.shape
    metrics = n + 1 + m + 1 + 2
    plant = n * wide + wide * (wide + 1) // 2 + wide
    form = window_form(feedback)
    if form is None:
        return metrics + plant + m * (taps * m + n)
    q, block = form.enter.shape[0], form.transition.shape[1]
    return metrics + plant + rows * m * (n + m + q) + q * (m + block) + q * m * (1 + rows)


def ours(quick: bool) -> list[Row]:
    """deadtime's rows."""
    shrink, every = (16, 3) if quick else (1, 5)
    plan = [
        # law, setting, scenarios, where switches are, threads (0: all)
        ("averaged", USUAL, 65_536, "grid", 0),
        ("averaged", USUAL, 65_536, "grid", 1),
        ("averaged", USUAL, 65_536, "anywhere", 0),
        ("averaged", USUAL, 65_536, "anywhere", 1),
        ("averaged", USUAL, 65_536, "drawn", 0),
        ("averaged", USUAL, 65_536, "drawn", 1),
        ("averaged", LONG, 32_768, "grid", 0),
        ("averaged", LONGEST, 4096, "grid", 0),
        ("mean", USUAL, 65_536, "grid", 0),
        ("expected, Markov", USUAL, 65_536, "grid", 0),
        ("averaged, dwell-aware", USUAL, 16_384, "grid", 0),
        ("expected, semi-Markov", USUAL, 16_384, "grid", 0),
        ("oracle", USUAL, 256, "grid", 0),
    ]
    rows = []
    for name, setting, scenarios, where, threads in plan:
        law, size, used = LAWS[name], max(16, scenarios // shrink), threads or processors()
        batch = on_grid(setting, size)[0] if where == "grid" else MODEL.draw(12.0, 3, 0, size)
        require_accuracy(law, batch, setting)
        model = MODEL if where == "drawn" else batch

        def work(law=law, model=model, setting=setting, size=size, used=used) -> None:
            run(law, model, setting, size, threads=used)

        spent = median_of(work, every)
        what = f"deadtime, {name}, N = {setting.taps:,}"
        what += {"grid": "", "anywhere": ", switches anywhere", "drawn": ", switches anywhere"}[where]
        what += ", drawing counted" * (where == "drawn") + ", one thread" * (threads == 1)
        note = {"oracle": "rows of each scenario's own, filled in the time"}.get(name, "")
        if name in ("averaged, dwell-aware", "expected, semi-Markov"):
            note = "dense rows, one per mode and age"
        rate = size * setting.periods / spent
        rows.append(Row(what, rate, fmas_of(law, setting), used, note))
    return rows


def jax_rows(quick: bool) -> list[Row]:
    """The JAX engine on this machine; none where it is missing."""
    rows = []
    for name, size in (("averaged", 8192), ("averaged, dwell-aware", 2048)):
        law, batch = LAWS[name], on_grid(USUAL, size // 8 if quick else size)[0]
        try:
            require_accuracy(law, batch, USUAL, backend="jax")
        except (ImportError, dt.ArgumentError):
            return []
        run(law, batch, USUAL, backend="jax")
        spent = median_of(lambda law=law, batch=batch: run(law, batch, USUAL, backend="jax"), 3)
        rate = len(batch) * USUAL.periods / spent
        what = f'deadtime, {name}, N = 100, backend="jax"'
        rows.append(Row(what, rate, fmas_of(law, USUAL), processors()))
    return rows


def peer_problem(law: dt.Law) -> peers.Problem:
    """The tables of a peer; the window's recursion is that of the averaged law."""
    feedback, averaged = law.digital(USUAL.step), LAWS["averaged"].digital(USUAL.step)
    loop = Loop(PAPER.plant, Window.of(1.0, USUAL.step), np.array(X0), USUAL.horizon)
    factor = averaged.factor
    assert factor is not None
    values, vectors = np.linalg.eig(factor.S)
    into = np.linalg.solve(vectors, factor.input)[:, 0]
    return peers.Problem(
        *map(np.ascontiguousarray, loop.maps),
        np.ascontiguousarray(feedback.state_gain[:, 0]),
        np.ascontiguousarray(feedback.input_gain[:, ::-1, 0, 0]),
        feedback.ages,
        np.array(X0),
        values,
        into,
        values**feedback.taps * into,
        (factor.H[0] @ vectors)[0],
    )


def side_by_side(modes: np.ndarray) -> np.ndarray:
    """Modes (scenario, period) as (block, period, WIDTH)."""
    blocks = modes.reshape(-1, peers.WIDTH, modes.shape[1])
    return np.ascontiguousarray(blocks.transpose(0, 2, 1))


def peer_error(law: dt.Law, figures: np.ndarray, batch: SignalBatch, setting: Setting) -> float:
    """The largest relative difference to deadtime, of three figures over the first scenarios."""
    few = min(64, len(batch), figures.shape[1])
    data = run(law, batch.slice(0, few), setting).sel(law="law")
    # The peak of deadtime is that of |x|, and its energy an integral.
    same = [data.ise.values, data.energy.values / setting.step, data.peak.values**2]
    return float(np.abs(figures[:, :few] / np.array(same) - 1.0).max())


Work = Callable[[np.ndarray], np.ndarray]


def peer_rows(quick: bool) -> list[Row]:
    """The peers' rows, their errors in the notes."""
    shrink, rows = 16 if quick else 1, []
    averaged, aware = LAWS["averaged"], LAWS["averaged, dwell-aware"]
    semi, same = LAWS["expected, semi-Markov"], peer_problem(LAWS["averaged"])
    numbers = peers.numbers_of(same)
    plan: list[tuple[str, dt.Law, int, float, Work | None]] = [
        ("plain recursion", averaged, 65_536, 1.0, lambda modes: peers.plain(same, modes)),
        ("plain recursion, 64 scenarios side by side", averaged, 65_536, 1.0,
         lambda modes: peers.side_by_side(numbers, USUAL.taps, modes)),
        ("dense, one row", averaged, 16_384, 1e-9, lambda modes: peers.dense(same, modes)),
        ("dense, dwell-aware", aware, 16_384, 1e-9, _dense_work(aware)),
        ("dense, expected", semi, 16_384, 1e-9, _dense_work(semi)),
        ("JAX, vmap of scan, window rolled", averaged, 512, 1e-9, peers.jax_scan(same)),
    ]  # fmt: skip
    for name, law, scenarios, allowed, work in plan:
        if work is None:
            continue
        batch, modes = on_grid(USUAL, max(64, scenarios // shrink))
        given = side_by_side(modes) if "side by side" in name else modes
        error = peer_error(law, work(given), batch, USUAL)
        assert error < allowed, (name, error)
        spent = median_of(lambda work=work, given=given: work(given), 3)
        note = f"off by {error:.0e}" if allowed == 1.0 else ""
        rows.append(Row(f"peer: {name}", modes.size / spent, 0.0, processors(), note))
    return rows


def _dense_work(law: dt.Law) -> Work:
    problem = peer_problem(law)
    return lambda modes: peers.dense(problem, modes)


def plain_error(horizon: float) -> float:
    """How far the plain recursion is off at a longer horizon."""
    setting, rng = Setting(100, round(100 * horizon)), np.random.default_rng(1)
    times = np.concatenate(([0.0], np.cumsum(np.rint(20 + rng.exponential(20, 200))))) * setting.step
    signal = dt.SwitchingSignal(times, np.arange(times.size) % 2)
    modes = signal(np.arange(setting.periods) * setting.step + 1e-9)[None].astype(np.int8)
    figures = peers.plain(peer_problem(LAWS["averaged"]), modes)
    return peer_error(LAWS["averaged"], figures, SignalBatch.of([signal]), setting)


def window_error(setting: Setting) -> float:
    """Inputs along one scenario against the dense row, summed exactly, relative to Σ|terms|."""
    import math

    law, batch = LAWS["averaged"], on_grid(setting, 8)[0]
    data = run(law, batch, setting, trajectories=True)
    x, u = data.x.values[0, 0], data.u.values[0, 0, 0]
    feedback = law.digital(setting.step)
    F, G, worst = feedback.state_gain[0, 0], feedback.input_gain[0, :, 0, 0], 0.0
    for k in np.linspace(setting.taps, setting.periods, 200).astype(int):
        # The products, too, without rounding: twice a double's digits.
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
    print("| what | scenario-steps/s | ratio | fraction of FMA bound | note |\n|---|---|---|---|---|")
    for row in rows:
        peak = machine.fma_one if row.threads == 1 else machine.fma_all
        bound = f"{2.0 * row.fmas * row.rate / peak:.2f}" if row.fmas else ""
        ratio = rows[0].rate / row.rate
        counted = f"{row.fmas:.0f} fmas" if row.fmas else ""
        note = "; ".join(part for part in (counted, row.note) if part)
        rate = f"{1e-6 * row.rate:,.3g} M" if row.rate < 1e8 else f"{1e-6 * row.rate:,.0f} M"
        print(f"| {row.what} | {rate} | {ratio:.2f} | {bound} | {note} |")


def main() -> None:
    machine = measured(QUICK)
    print(heading() + "\n")
    print(
        f"Fused multiply-adds: {1e-9 * machine.fma_one:.1f} GFlop/s on one core, "
        f"{1e-9 * machine.fma_all:.1f} on all. A chain of them that waits for itself says "
        f"{1e-9 * machine.clock:.2f} GHz, if one takes 4 cycles; so "
        f"{machine.fma_one / machine.clock:.1f} operations a cycle. Triad: "
        f"{1e-9 * machine.triad_one:.1f} GB/s on one core, {1e-9 * machine.triad_all:.1f} on all.\n"
    )
    rows = [*ours(QUICK), *jax_rows(QUICK), *peer_rows(QUICK)]
    table(rows, machine)
    rate = {row.what: row.rate for row in rows}
    first, dwell = rate["deadtime, averaged, N = 100"], "deadtime, averaged, dwell-aware, N = 100"
    semi = rate["deadtime, expected, semi-Markov, N = 100"] / rate["peer: dense, expected"]
    batch = on_grid(USUAL, len(rows) and (4096 if QUICK else 65_536))[0]
    again = len(batch) * 1000 / median_of(lambda: run(LAWS["averaged"], batch, USUAL), 5)
    print(
        f"\nAgainst the peer with the same rows: factorised {first / rate['peer: plain recursion']:.1f}"
        f" times the plain recursion's rate; dense "
        f"{rate[dwell] / rate['peer: dense, dwell-aware']:.1f} (dwell-aware) and {semi:.1f} "
        f"(expected) times the dense loop's. The plain recursion's figures are off by "
        f"{plain_error(10.0):.0e} of themselves at T = 10 s, {plain_error(20.0):.0e} at 20 s and "
        f"{plain_error(30.0):.0e} at 30 s. deadtime's inputs agree with the dense row, summed "
        f"exactly, to {window_error(USUAL):.0e} of Σ|terms| at N = 100 and "
        f"{window_error(LONGEST):.0e} at N = 10,000. "
        f"The first row, timed again at the end: {1e-6 * again:,.0f} M."
    )
    if not QUICK:
        command = [sys.executable, "-c", MILLION]
        seconds, kilobytes = map(float, subprocess.check_output(command, text=True).split())
        print(
            f"\n1,000,000 scenarios × 1,000 periods × 4 laws, signals drawn: {seconds:.1f} s "
            f"({4e3 / seconds:,.0f} M scenario-steps/s), peak memory {kilobytes / 2**20:.2f} GiB."
        )


if __name__ == "__main__":
    main()
