"""What does a sweep cost beside its cells, and how far does it scale?

    python benchmarks/sweep.py            some minutes
    python benchmarks/sweep.py --quick    a smoke run
    python benchmarks/sweep.py --tiny     the run of 100,000 tiny cells, too

Speed-up and overhead are measured on cells of about a second, which are blocks of their own.
Overhead is the time in which the worker had no block in hand. Rates and overhead are measured from
the fourth block that was finished to the last: starting a cluster is named apart. A null block
costs what a block costs the scheduler and the client: it is the bound on blocks per second of a
large cluster. Every store is held against one made without a cluster, bit for bit.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from machine import heading

import deadtime as dt
from deadtime.numerics import kernels
from deadtime.scenarios.sweeps import Progress
from deadtime.scenarios.sweeps.blocks import BlockLayout
from deadtime.scenarios.sweeps.cluster import cluster
from deadtime.scenarios.sweeps.run_sweep import run_block
from deadtime.scenarios.sweeps.store import create, open_store

SECOND = 180_000  # scenarios of a cell of about a second
WORKERS = (1, 2)
PROBLEM = dt.problems.paper()
WARM = 3  # blocks after which rates are measured


def loop(delay: float, share: float) -> dict:
    """The paper's plant under a weighted law."""
    plant = dt.SwitchedSystem(PROBLEM.plant.A, PROBLEM.plant.B, delay)
    law = dt.AveragedPredictor(plant, PROBLEM.gains, [share, 1.0 - share])
    model = dt.Markov([[0.0, 2.0], [2.0, 0.0]])
    return {
        "plant": plant,
        "laws": {"weighted": law},
        "model": model,
        "x0": [1.0, 0.0],
        "horizon": 10.0,
        "step": 0.02,
    }


def tiny_loop(delay: float, share: float) -> dict:
    """The same for a second only."""
    return loop(delay, share) | {"horizon": 1.0, "step": 0.05}


def nothing(number: int) -> int:
    """A block that costs nothing."""
    return number


def grid(cells: int, along: int) -> dict[str, list[float]]:
    """Cells of delays and weights."""
    return {
        "delay": np.linspace(0.2, 1.0, cells // along).round(6).tolist(),
        "share": np.linspace(0.2, 0.8, along).round(6).tolist(),
    }


def same(one: Path, other: Path) -> bool:
    """Whether two stores hold the same files."""
    trees = [
        {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}
        for root in (one, other)
    ]
    return trees[0] == trees[1]


def swept(study: dt.Study, store: Path, workers: int) -> tuple[list[Progress], float]:
    """What a sweep reported after each block, and all its seconds."""
    seen: list[Progress] = []
    began = time.perf_counter()
    create(str(store), study, BlockLayout(study.shape, (1,) * len(study.shape)), {})
    dt.sweep(study, store, workers=workers, progress=seen.append)
    return seen, time.perf_counter() - began


def speed_up(folder: Path, cells: int, scenarios: int) -> None:
    """One worker and two on the same cells."""
    study = dt.function_study(loop, grid(cells, 4), scenarios, metrics=["ise"])
    plain = create(str(folder / "plain.zarr"), study, BlockLayout(study.shape, (1, 1)), {})
    alone = [run_block(study, plain.url, plain.key, number)[1] for number in range(cells)]
    print(
        f"| one block after the other, no cluster | {sum(alone):.1f} s | | {cells} cells, median "
        f"{statistics.median(alone):.2f} s |"
    )
    rates = {}
    for workers in WORKERS:
        store = folder / f"{workers}.zarr"
        seen, whole = swept(study, store, workers)
        assert same(store, folder / "plain.zarr")
        warm, last = seen[WARM], seen[-1]
        rates[workers] = (cells - 1 - WARM) / (last.seconds - warm.seconds)
        note = f"start, first blocks and end {whole - last.seconds + warm.seconds:.1f} s"
        if workers == 1:
            idle = 1.0 - (last.busy - warm.busy) / (last.seconds - warm.seconds)
            note += f"; without a block {100.0 * idle:.2f} % of the time"
        print(
            f"| {workers} worker{'s' * (workers > 1)} | {1.0 / rates[workers]:.3f} s a cell | "
            f"{rates[workers] / rates[1]:.2f} | {note} |"
        )


def null_blocks(count: int) -> None:
    """What a block costs scheduler and client."""
    with cluster(None, 2) as client:
        client.gather(client.map(nothing, range(100), pure=False))
        began = time.perf_counter()
        client.gather(client.map(nothing, range(count), pure=False))
        spent = time.perf_counter() - began
    print(f"| {count:,} blocks of nothing | {spent:.1f} s | | {1e6 * spent / count:.0f} µs each |")


def tiny(folder: Path, cells: int, scenarios: int = 10) -> None:
    """Many small cells, put together into blocks."""
    study = dt.function_study(tiny_loop, grid(cells, 100), scenarios)
    store, seen = folder / "tiny.zarr", []
    began = time.perf_counter()
    data = dt.sweep(study, store, workers=2, progress=seen.append)
    spent = time.perf_counter() - began
    assert data.done.all()
    place = data.isel(delay=-1, share=-1)
    direct = dt.monte_carlo(
        **tiny_loop(float(place.delay), float(place.share)), scenarios=scenarios
    )
    assert (place.ise.values == direct.ise.values).all()
    files = [path for path in store.rglob("*") if path.is_file()]
    size = sum(path.stat().st_size for path in files)
    blocks = open_store(str(store)).layout.size
    print(f"| {cells:,} cells of {scenarios} scenarios | {spent:.0f} s | | {blocks:,} blocks, "
          f"{1e3 * seen[-1].busy / cells:.1f} ms of a worker a cell, {len(files):,} files, "
          f"{size / 1e6:.0f} MB |")  # fmt: skip


def main() -> None:
    kernels.WISH = "always"  # what is timed is warm
    quick = "--quick" in sys.argv
    print(f"{heading()}\n\n| what | time | speed-up | |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        speed_up(folder, 8 if quick else 40, SECOND // (100 if quick else 1))
        null_blocks(1_000 if quick else 20_000)
        tiny(folder, 200 if quick else 100_000 if "--tiny" in sys.argv else 5_000)


if __name__ == "__main__":
    main()
