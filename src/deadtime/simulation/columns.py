"""A run as columns, by python-control's names, and as CSV."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from os import PathLike

import numpy as np
from jaxtyping import Float

from deadtime.base.files import replacing
from deadtime.base.wording import one_line, subscript


def numbered_columns(
    signals: Mapping[str, Float[np.ndarray, "signal T"] | None],
) -> dict[str, Float[np.ndarray, " T"]]:
    """A column for each row of signals that are there, called by their letter and a number.

    Examples
    --------
    >>> list(numbered_columns({"x": np.zeros((2, 3)), "w": None}))
    ['x[0]', 'x[1]']
    """
    return {
        f"{letter}[{i}]": row
        for letter, rows in signals.items()
        if rows is not None
        for i, row in enumerate(rows)
    }


def write_csv(
    path: str | PathLike[str],
    columns: Mapping[str, np.ndarray],
    names: Mapping[str, Sequence[str]],
) -> None:
    """Columns as CSV, full precision, with the names of signals by their letter behind a colon.

    What is called as it would be without a name keeps its column.
    """
    told = {
        f"{letter}[{i}]": f"{letter}[{i}]: {one_line(name)}"
        for letter, given in names.items()
        for i, name in enumerate(given)
        if name not in (letter, f"{letter}{subscript(i + 1)}")
    }
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    with replacing(path) as place, place.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([told.get(name, name) for name in columns])
        writer.writerows(rows)
