"""Run a study: every cell by itself, here or in worker processes, into one labelled dataset."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING

import numpy as np

from deadtime.checks import count
from deadtime.errors import WorkerError
from deadtime.study.cell import VARIABLES, Outcome, run_cell
from deadtime.study.study import AXES, Study
from deadtime.version import __version__

if TYPE_CHECKING:
    import xarray as xr

Progress = Callable[[str], None]


def run_study(
    study: Study, workers: int | None = None, progress: Progress = lambda _: None
) -> xr.Dataset:
    """Run every law of a study in every cell of its grid.

    Cells are computed independently of each other, so the result does not depend on the number
    of workers. In all cells scenario i is drawn with the same seed: cells that differ in the
    plant only share their signals, and those of another dwell time are the same, stretched.

    Parameters
    ----------
    study : Study
        From `load_study`.
    workers : int, optional
        Processes, ≥ 1; as many as there are processors by default. With more than one a script
        must call this under ``if __name__ == "__main__":``.
    progress : callable
        Called with a few words after each cell.

    Returns
    -------
    xarray.Dataset
        Dimensions: the axes of the grid, then (law, scenario). Variables ise, energy, peak,
        final_norm and diverged; NaN for a law that could not be built in a cell, and
        ``attrs["failures"]`` lists these with their reasons, as JSON.

    Raises
    ------
    WorkerError
        If a worker process dies.
    """
    workers = count("workers", (os.cpu_count() or 1) if workers is None else workers)
    shape = (*study.shape, len(study.laws), study.scenarios)
    values = {name: np.full(shape, np.nan) for name in VARIABLES}
    diverged = np.zeros(shape, dtype=bool)
    failures: dict[tuple[int, ...], list[dict[str, str]]] = {}
    for outcome in _outcomes(study, min(workers, study.size)):
        cell = outcome.cell
        for name, array in outcome.values.items():
            values[name][cell.index] = array
        diverged[cell.index] = outcome.diverged
        failures[cell.index] = [
            {"cell": str(cell), "law": law, "reason": reason}
            for law, reason in outcome.reasons.items()
        ]
        progress(str(cell))
    failed = [failure for index in sorted(failures) for failure in failures[index]]
    return _dataset(study, values, diverged, failed)


def _outcomes(study: Study, workers: int) -> Iterator[Outcome]:
    """The outcome of every cell, in any order."""
    if workers == 1:
        yield from (run_cell(study, cell) for cell in study.cells())
        return
    from multiprocessing import get_context

    pool = ProcessPoolExecutor(workers, get_context("spawn"), _ignore_interrupts)
    try:
        for done in as_completed([pool.submit(run_cell, study, cell) for cell in study.cells()]):
            yield done.result()
    except BrokenProcessPool:
        raise WorkerError(
            "a worker process died: run with fewer workers if memory ran out; a script that "
            'calls run_study must do so under if __name__ == "__main__":.'
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _ignore_interrupts() -> None:
    """Leave Ctrl-C to the parent, which then stops the workers."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _dataset(
    study: Study,
    values: Mapping[str, np.ndarray],
    diverged: np.ndarray,
    failures: Sequence[Mapping[str, str]],
) -> xr.Dataset:
    import xarray as xr

    dims = (*study.grid, "law", "scenario")
    variables = {
        name: (dims, values[name], {"units": unit, "long_name": long})
        for name, (unit, long) in VARIABLES.items()
    }
    variables["diverged"] = (dims, diverged, {"long_name": "|x| left 1e100"})
    coordinates = {
        name: (name, list(axis), {"long_name": AXES[name].label, "units": AXES[name].unit})
        for name, axis in study.grid.items()
    }
    coordinates |= {"law": ("law", list(study.laws)), "scenario": np.arange(study.scenarios)}
    attributes = {
        "title": study.title,
        "source": study.source,
        "seed": study.seed,
        "scenarios": study.scenarios,
        "horizon": study.horizon,
        "step": study.step,
        "x0": study.x0.tolist(),
        "start": float(np.linalg.norm(study.x0)),
        "study": study.text,
        "failures": json.dumps(failures, ensure_ascii=False),
        "version": __version__,
    }
    return xr.Dataset(variables, coordinates, attributes)
