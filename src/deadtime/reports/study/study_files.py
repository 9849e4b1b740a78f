"""A study's findings as files: one JSON object, and a table with a row per cell and law."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deadtime.base.json_records import plain, record
from deadtime.problems.law_registry import LEVELS
from deadtime.reports.study.findings import best, summary
from deadtime.reports.study.phrases import Answer
from deadtime.reports.study.study_runs import failures
from deadtime.scenarios.sweeps.axes import ORACLE, knowledge_of, within

if TYPE_CHECKING:
    import xarray as xr

ENDS = ("", "_low", "_high")
FIGURES = (
    "ise",
    *(name + end for name in ("regret", "median_regret", "stabilised") for end in ENDS),
)
DUEL = tuple(name + end for name in ("ratio", "median_ratio", "share") for end in ENDS)


def write_cells(data: xr.Dataset, path: Path) -> None:
    """One row per cell and law: median ∫|x|², regret, signals stabilised, with intervals."""
    found = summary(data)
    axes = [str(name) for name in found.ise.dims]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*axes, *FIGURES])
        for index in np.ndindex(found.ise.shape):
            place = [found[name].values[i] for name, i in zip(axes, index, strict=True)]
            writer.writerow([*place, *(f"{found[name].values[index]:.6g}" for name in FIGURES)])


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
    found = summary(data)
    laws = [str(law) for law in data.law.values]
    causal = [law for law in laws if law != ORACLE]
    ranked = {
        level: best(data, within(causal, level))
        for level in LEVELS[:-1]
        if any(knowledge_of(law) == level for law in causal)
    }
    axes = [str(name) for name in found.ise.dims[:-1]]
    for index in np.ndindex(found.ise.shape[:-1]):
        places = zip(axes, index, strict=True)
        cell: dict[str, Any] = {name: found[name].values[i] for name, i in places}
        cell["laws"] = {
            law: {name: found[name].values[(*index, row)] for name in FIGURES}
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
