"""`sweep`: the cells of a study that a store lacks, computed on Dask and stored by its workers."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np

from deadtime.base.checks import count
from deadtime.base.errors import ArgumentError, WorkerError
from deadtime.scenarios.sweeps.blocks import BlockLayout, costs_of, facts_of, layout_of
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

_AHEAD = 3  # blocks that are handed over for every thread of the cluster
_LARGEST = 2.0**30  # bytes of a variable in a cell
_LOOK = 2.0  # seconds between looks at how many threads there are


@dataclass(frozen=True)
class Progress:
    """How far a sweep is.

    Attributes
    ----------
    done, total : int
        Cells that are whole in the store, and all there are.
    computed : int
        Cells of this run.
    seconds : float
        Since the first block was handed over.
    busy : float
        That workers spent on blocks, summed over them.
    threads : int
        That the cluster has.
    cost, whole_cost : float
        Estimated cost of what this run has done, and of all that it has to do, seconds of one core.
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

    Only cells that the store lacks are computed: after an interruption, whatever was its reason,
    the same call goes on. The store does not depend on the cluster, on the number of workers or on
    interruptions, to the last bit.

    Parameters
    ----------
    study : Study or path
        From `load_study` or `function_study`; or a study file.
    store : path
        A folder that all workers reach under this name, or a URL that fsspec knows.
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
        If some cells made their workers die, again and again; all others are stored.

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
    # A new store is made when there is something to compute it with.
    target = prepare(study, url) if exists(url) else None
    if target is None or target.missing():
        with cluster(scheduler, workers) as client:
            target = target or prepare(study, url)
            _compute(study, target, client, progress or (lambda _: None))
    return open_sweep(url)


def prepare(study: Study, url: str) -> Store:
    """The study's store: the one that is there, or a new one."""
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


def block_costs(study: Study, layout: BlockLayout) -> np.ndarray:
    """Estimated seconds of every block."""
    costs = costs_of(study)
    return np.array([costs[layout.slices(number)].sum() for number in range(layout.size)])


def run_block(study: Study, url: str, key: str, number: int) -> tuple[int, float]:
    """Compute a block's cells and store them: what a worker does. Its cells, and its seconds."""
    began = time.perf_counter()
    store = cached_store(url, key)
    outcomes = [run_cell(study, study.cell(index)) for index in store.layout.cells(number)]
    store.write(number, outcomes)
    return len(outcomes), time.perf_counter() - began


def _compute(study: Study, target: Store, client: Client, report: Report) -> None:
    """Hand over the missing blocks, dear ones first, a few for each thread at a time."""
    from distributed import KilledWorker, as_completed

    missing, run = target.missing(), uuid4().hex
    costs = block_costs(study, target.layout)
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
            for number in _next(waiting, _AHEAD * threads.now() - len(numbers)):
                key, what = f"block-{number}-{run}", (study, target.url, target.key, number)
                future = client.submit(run_block, *what, key=key, pure=False)
                numbers[key] = number
                futures.add(future)
            future = next(futures)
            number = numbers.pop(future.key)
            try:
                cells, took = future.result()
            except KilledWorker:
                continue  # it is missing at the end
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


def _next(waiting: list[tuple[float, int]], room: int) -> Iterator[int]:
    while waiting and room > 0:
        yield heapq.heappop(waiting)[1]
        room -= 1


class Threads:
    """How many threads the cluster has, asked for now and then: workers come and go."""

    def __init__(self, client: Client) -> None:
        self._client, self._known, self._asked = client, 1, -_LOOK

    def now(self) -> int:
        """At least 1: what is handed over waits for workers."""
        if time.monotonic() - self._asked >= _LOOK:
            self._known = max(1, _count(self._client.nthreads()))
            self._asked = time.monotonic()
        return self._known


def _count(threads: Any) -> int:
    return sum(threads.values())
