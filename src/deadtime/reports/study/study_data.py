"""The data of a study: runs with every axis of the maps, findings as JSON, a table of cells."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.base.json_records import plain, record
from deadtime.problems.law_registry import LEVELS
from deadtime.reports.study.findings import best, summary
from deadtime.reports.study.phrases import Answer
from deadtime.scenarios.sweeps import Cell, FileStudy, sweep
from deadtime.scenarios.sweeps.axes import ORACLE, knowledge_of, within
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
    data = data[[*READ, "diverged", "reason"]].load()
    given = {  # an axis that the grid leaves out has one value
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
    entries = []
    for index in np.argwhere(unbuilt):
        *where, law = (data[name].values[i] for name, i in zip(dims, index, strict=True))
        cell = Cell(tuple(index[:-1].tolist()), dict(zip(map(str, dims), where, strict=False)))
        reason = str(data.reason.values[tuple(index)])
        entries.append({"cell": str(cell), "law": str(law), "reason": reason})
    return entries


ENDS = ("", "_low", "_high")
FIGURES = (
    "ise",
    *(name + end for name in ("regret", "median_regret", "stabilised") for end in ENDS),
)
DUEL = tuple(name + end for name in ("ratio", "median_ratio", "share") for end in ENDS)


def write_cells(data: xr.Dataset, path: Path) -> None:
    """One row per cell and law: median ∫|x|², regret, signals stabilised, with intervals."""
    figures = summary(data)
    axes = [str(name) for name in figures.ise.dims]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*axes, *FIGURES])
        for index in np.ndindex(figures.ise.shape):
            place = [figures[name].values[i] for name, i in zip(axes, index, strict=True)]
            writer.writerow([*place, *(f"{figures[name].values[index]:.6g}" for name in FIGURES)])


def record_of(data: xr.Dataset, answers: Sequence[Answer]) -> dict[str, Any]:
    """The findings for JSON."""
    return {
        "title": data.attrs["title"],
        "version": data.attrs["version"],
        "seed": int(data.attrs["seed"]),
        "scenarios": int(data.attrs["scenarios"]),
        "answers": [record(answer, "question", "sentences", "tables") for answer in answers],
        "cells": list(_cells(data)),
        "failures": failures(data),
    }


def _cells(data: xr.Dataset) -> Iterator[dict[str, Any]]:
    """Every cell: where it is, what each law did there, and which was best for what is known."""
    figures = summary(data)
    laws = [str(law) for law in data.law.values]
    causal = [law for law in laws if law != ORACLE]
    ranked = {
        level: best(data, within(causal, level))
        for level in LEVELS[:-1]
        if any(knowledge_of(law) == level for law in causal)
    }
    axes = [str(name) for name in figures.ise.dims[:-1]]
    for index in np.ndindex(figures.ise.shape[:-1]):
        places = zip(axes, index, strict=True)
        cell: dict[str, Any] = {name: figures[name].values[i] for name, i in places}
        cell["laws"] = {
            law: {name: figures[name].values[(*index, row)] for name in FIGURES}
            for row, law in enumerate(laws)
        }
        cell["best"] = {
            level: {
                "winner": str(table.winner.values[index]),
                "runner_up": str(table.runner_up.values[index]),
                "tied": bool(table.verdict.values[index] != 1.0),
                **{name: table[name].values[index] for name in DUEL},
            }
            for level, table in ranked.items()
        }
        yield plain(cell)
