"""The runs of a study, as its report reads them: a sweep's dataset with every axis of the maps."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.scenarios.sweeps import Cell, FileStudy, sweep
from deadtime.scenarios.sweeps.run_sweep import Report

if TYPE_CHECKING:
    import xarray as xr

# In the order of maps: what tells panels apart, then a panel's y and x.
ORDER = ("sojourn", "delay", "step", "distance", "dwell_time")


READ = ("ise", "final_norm")  # metrics that findings are made of


def run_study(
    study: FileStudy,
    store: str | PathLike[str],
    workers: int | None = None,
    progress: Report | None = None,
    scheduler: str | None = None,
) -> xr.Dataset:
    """Run what a study's store lacks, and load what its report is made of.

    Parameters
    ----------
    study : FileStudy
        From `load_study`, with poles and a grid of dwell_time and perhaps distance, delay, sojourn
        and step.
    store, workers, progress, scheduler
        As `sweep` takes them.

    Returns
    -------
    xarray.Dataset
        Dimensions sojourn, delay, perhaps step, distance, dwell_time, law, scenario. Variables
        ise, final_norm and diverged, NaN for a law that could not be built in a cell; and reason.

    Raises
    ------
    ArgumentError
        If the grid has other axes, which the report's maps do not show.
    DeadtimeError
        What `sweep` raises.
    """
    other = [name for name in study.grid if name not in ORDER]
    if study.poles is None or "dwell_time" not in study.grid or other:
        raise ArgumentError(
            "study must have poles, and a grid of dwell_time and perhaps distance, delay, sojourn "
            f"and step, for a report, got the grid {list(study.grid)}: use deadtime sweep and "
            "deadtime plot."
        )
    if not set(READ) <= set(study.metrics):
        raise ArgumentError(f"metrics must hold {' and '.join(READ)} for a report.")
    data = sweep(study, store, scheduler, workers=workers, progress=progress)
    return _complete(data[[*READ, "diverged", "reason"]].load(), study)


def _complete(data: xr.Dataset, study: FileStudy) -> xr.Dataset:
    """All axes of the maps, those that the grid leaves out with one value."""
    given = {
        "sojourn": "exponential",
        "delay": float(np.max(study.problem["plant"]["delay"])),  # as the axis has it
        "distance": 1.0,
    }
    fixed = {name: [value] for name, value in given.items() if name not in data.dims}
    axes = [name for name in ORDER if name in data.dims or name in fixed]
    return data.expand_dims(fixed).transpose(*axes, "law", "scenario", missing_dims="ignore")


def failures(data: xr.Dataset) -> list[dict[str, str]]:
    """The laws that could not be built somewhere: cell, law and why."""
    dims = data.reason.dims
    unbuilt = (data.reason != "").values & data.ise.isnull().all("scenario").values
    found = []
    for index in np.argwhere(unbuilt):
        *where, law = (data[name].values[i] for name, i in zip(dims, index, strict=True))
        cell = Cell(tuple(index[:-1].tolist()), dict(zip(map(str, dims), where, strict=False)))
        reason = str(data.reason.values[tuple(index)])
        found.append({"cell": str(cell), "law": str(law), "reason": reason})
    return found
