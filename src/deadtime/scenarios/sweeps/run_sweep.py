"""`sweep`: the cells of a study that a store lacks, computed on Dask and stored by its workers."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np

from deadtime.base.checks import count
from deadtime.base.errors import ArgumentError, WorkerError
from deadtime.scenarios.sweeps.blocks import costs_of, facts_of, layout_of
from deadtime.scenarios.sweeps.cell import run_cell
from deadtime.scenarios.sweeps.cluster import cluster
from deadtime.scenarios.sweeps.load import load_study
from deadtime.scenarios.sweeps.store import (
    Store,
    cached_store,
    create,
    exists,
    open_store,
    open_sweep,
    place_of,
)
from deadtime.scenarios.sweeps.study import Study

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

_AHEAD = 3  # blocks submitted per thread of the cluster, so that none waits for this process
_LARGEST = 2.0**30  # bytes of a variable in a cell
_LOOK = 2.0  # seconds between counts of the cluster's threads


@dataclass(frozen=True)
class Progress:
    """The progress of a sweep.

    Attributes
    ----------
    done, total : int
        Cells that are complete in the store, and all cells.
    computed : int
        Cells computed by this run.
    seconds : float
        Time since the first block was submitted.
    busy : float
        Time of workers on blocks, summed.
    threads : int
        Threads of the cluster.
    cost, whole_cost : float
        Estimated cost of the finished blocks of this run, and of all of them, seconds of one core.
    """

    done: int
    total: int
    computed: int
    seconds: float
    busy: float
    threads: int
    cost: float
    whole_cost: float


Report = Callable[[Progress], None]


def sweep(
    study: Study | str | PathLike[str],
    store: str | PathLike[str],
    scheduler: str | None = None,
    *,
    workers: int | None = None,
    progress: Report | None = None,
) -> xr.Dataset:
    """Run every cell of a study's grid by `monte_carlo`, into one Zarr store.

    Only cells that the store lacks are computed: after an interruption the same call continues. The
    store does not depend on the cluster, on the number of workers or on interruptions, to the last
    bit.

    Parameters
    ----------
    study : Study or path
        From `load_study` or `function_study`; or a study file.
    store : path
        A folder that all workers reach by this name, or a URL of fsspec.
    scheduler : str, optional
        Address of a Dask scheduler, such as "tcp://host:8786"; without it a cluster of processes on
        this machine. A script that calls this with several workers must do so under
        ``if __name__ == "__main__":``.
    workers : int, optional
        Processes on this machine; as many as there are processors by default. One worker is a
        thread of this process.
    progress : callable, optional
        Called with a `Progress` after each block of cells.

    Returns
    -------
    xarray.Dataset
        As `open_sweep` gives it: dimensions (axes of the grid, law, scenario), one variable per
        metric, `diverged`, `reason` (what went wrong with a law in a cell) and `done`.

    Raises
    ------
    ArgumentError
        If the store holds another study, or one of another version.
    StoreError
        If the store cannot be written; what it holds is kept.
    ClusterError
        If the scheduler cannot be reached, or has no workers of this version.
    WorkerError
        If some cells ended their workers repeatedly; all others are stored.

    Examples
    --------
    >>> import tempfile
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> def loop(delay):
    ...     plant = dt.SwitchedSystem(problem.plant.A, problem.plant.B, delay)
    ...     kinds = dt.AveragedPredictor, dt.ExactPredictor
    ...     laws = [kind(plant, problem.gains) for kind in kinds]
    ...     model = dt.Markov([[0, 2], [2, 0]])
    ...     return dict(plant=plant, laws=laws, model=model, x0=[1, 0], horizon=5, step=0.02)
    >>> study = dt.function_study(loop, {"delay": [0.5, 1.0]}, scenarios=20)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     data = dt.sweep(study, folder + "/mine.zarr", workers=1).load()
    >>> dict(data.sizes)
    {'delay': 2, 'law': 2, 'scenario': 20}
    >>> bool((data.ise.sel(delay=1.0) > data.ise.sel(delay=0.5)).mean() > 0.9)
    True
    """
    if not isinstance(study, Study):
        if not isinstance(study, (str, PathLike)):
            raise ArgumentError(f"study must be a Study or a file, got {type(study).__name__}.")
        study = load_study(study)
    workers = None if workers is None else count("workers", workers)
    if scheduler is not None and workers is not None:
        raise ArgumentError("workers are those of the scheduler: give one of the two.")
    url = place_of(store)
    # A new store is made only when a cluster is available.
    target = prepare(study, url) if exists(url) else None
    if target is None or target.missing():
        with cluster(scheduler, workers) as client:
            target = target or prepare(study, url)
            _compute(study, target, client, progress or (lambda _: None))
    return open_sweep(url)


def prepare(study: Study, url: str) -> Store:
    """The study's store, existing or new."""
    if exists(url):
        target = open_store(url)
        target.require(study)
        return target
    if 8.0 * len(study.laws) * study.scenarios > _LARGEST:
        raise ArgumentError(
            f"scenarios must be at most {int(_LARGEST / 8 / len(study.laws)):,} with "
            f"{len(study.laws)} laws, got {study.scenarios:,}: put seeds on the grid instead."
        )
    layout = layout_of(study, costs_of(study))
    target = create(url, study, layout, facts_of(study))
    target.require(study)  # another sweep may have made one at the same time
    return target


def run_block(study: Study, url: str, key: str, number: int) -> tuple[int, float]:
    """Compute a block's cells and store them, on a worker; the number of cells, and seconds."""
    began = time.perf_counter()
    store = cached_store(url, key)
    outcomes = [run_cell(study, study.cell(index)) for index in store.layout.cells(number)]
    store.write(number, outcomes)
    return len(outcomes), time.perf_counter() - began


def _compute(study: Study, target: Store, client: Client, report: Report) -> None:
    """Submit the missing blocks, most expensive first, a few per thread at a time.

    So the last blocks are short, and workers finish together.
    """
    from distributed import KilledWorker, as_completed

    missing, run = target.missing(), uuid4().hex
    layout, of_cells = target.layout, costs_of(study)
    costs = np.array([of_cells[layout.slices(number)].sum() for number in range(layout.size)])
    total, whole = study.size, float(costs[list(missing)].sum())
    waiting = [(-costs[number], number) for number in missing]
    heapq.heapify(waiting)
    done = total - sum(len(list(target.layout.cells(number))) for number in missing)
    computed, busy, spent, began = 0, 0.0, 0.0, time.monotonic()
    threads = Threads(client)
    futures = as_completed(loop=client.loop)
    numbers: dict[str, int] = {}
    try:
        while waiting or numbers:
            while waiting and len(numbers) < _AHEAD * threads.now():
                number = heapq.heappop(waiting)[1]
                key, what = f"block-{number}-{run}", (study, target.url, target.key, number)
                future = client.submit(run_block, *what, key=key, pure=False)
                numbers[key] = number
                futures.add(future)
            future = next(futures)
            number = numbers.pop(future.key)
            try:
                cells, took = future.result()
            except KilledWorker:
                continue  # it is reported below as missing
            computed, busy = computed + cells, busy + took
            spent += float(costs[number])
            now = done + computed, total, computed, time.monotonic() - began, busy
            report(Progress(*now, threads.now(), spent, whole))
    finally:
        client.cancel(list(futures.futures), force=True)
    lost = target.missing()
    if lost:
        cells = [str(study.cell(next(target.layout.cells(number)))) for number in lost[:3]]
        raise WorkerError(
            f"{len(lost)} blocks of cells made their workers die, so they are absent, such as the "
            f"one at {'; '.join(cells)}: give workers more memory and run the same again."
        )


class Threads:
    """The number of threads of the cluster, counted now and then: workers come and go."""

    def __init__(self, client: Client) -> None:
        self._client, self._known, self._asked = client, 1, -_LOOK

    def now(self) -> int:
        """At least 1, so that blocks are submitted before workers arrive."""
        if time.monotonic() - self._asked >= _LOOK:
            threads: Any = self._client.nthreads()
            self._known = max(1, sum(threads.values()))
            self._asked = time.monotonic()
        return self._known
