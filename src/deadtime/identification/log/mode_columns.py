"""Which mode a log says was active: the numbers of modes, by what logs call them."""

from __future__ import annotations

from typing import Any

import numpy as np

from deadtime.base.checks import brief
from deadtime.base.errors import ArgumentError
from deadtime.identification.log.read_tables import LogTable


def mode_column(tables: list[LogTable], modes: str | None) -> str | None:
    """The column of the mode, which all tables have."""
    if modes is None:
        return None
    for table in tables:
        if modes not in table.frame.columns:
            raise ArgumentError(
                f"{table.name} must have the column {modes!r}, got "
                f"{brief(list(table.frame.columns))}: log the mode, name its column by modes=, say "
                "modes=None (--one-mode) for a plant of one mode, or modes=2 (--modes 2) for two "
                "that were not logged."
            )
    return modes


def labels_of(tables: list[LogTable], column: str | None) -> dict[str, int]:
    """The number of every mode, by what the logs call it."""
    if column is None:
        return {"mode 0": 0}
    seen: set[str] = set()
    for table in tables:
        missing = np.flatnonzero(table.frame[column].isna())
        if missing.size:
            raise ArgumentError(
                f"{table.place(int(missing[0]))}: {column} must be there in every row, got none: "
                "fill it with the mode that was active."
            )
        seen |= {label(value) for value in table.frame[column].unique()}
    if not all(name.isdecimal() for name in seen):
        return {name: i for i, name in enumerate(sorted(seen))}
    numbers = sorted(map(int, seen))
    if numbers[-1] - numbers[0] >= len(numbers):
        absent = next(i for i in range(numbers[0], numbers[-1]) if i not in numbers)
        raise ArgumentError(
            f"{column}: mode {absent} is never visited, modes {numbers} are: nothing is known of "
            "it. Log a stay in it, or number the modes without a gap."
        )
    return {str(i): place for place, i in enumerate(numbers)}


def absent_modes(
    tables: list[LogTable], column: str | None, labels: dict[str, int]
) -> tuple[str, ...]:
    """Modes that are categories of a column and not visited."""
    import pandas as pd

    kinds = [table.frame[column].dtype for table in tables if column is not None]
    declared = [kind.categories for kind in kinds if isinstance(kind, pd.CategoricalDtype)]
    names = [label(name) for categories in declared for name in categories]
    return tuple(dict.fromkeys(name for name in names if name not in labels))


def label(value: Any) -> str:
    """What a log calls a mode: whole numbers are the same however they are written."""
    if isinstance(value, float | np.floating) and float(value).is_integer():
        return str(int(value))
    if isinstance(value, bool | np.bool_):
        return str(int(value))
    return str(value).strip()
