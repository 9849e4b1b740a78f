"""Tables beside the answers: comparisons of two laws by delay and dwell time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from deadtime.base.wording import amount
from deadtime.reports.study.phrases import AnswerTable, tally

if TYPE_CHECKING:
    import xarray as xr


def by_dwell_time(fight: xr.Dataset) -> Iterator[tuple[float, float, xr.Dataset]]:
    """(D, τ_d, the cells there), shortest first."""
    for delay in np.sort(fight.delay.values):
        for time in np.sort(fight.dwell_time.values):
            yield float(delay), float(time), fight.sel(delay=delay, dwell_time=time)


def table(caption: str, fight: xr.Dataset, outcomes: tuple[str, str]) -> AnswerTable:
    """A comparison of two laws: quotients over the other axes, and in how many cells each won."""
    rows = []
    for delay, time, cells in by_dwell_time(fight):
        ratio = cells.ratio.values[~np.isnan(cells.ratio.values)]
        if not ratio.size:
            continue
        first, second, neither, _ = tally(cells.verdict)
        figures = (float(np.median(ratio)), float(ratio.min()), float(ratio.max()))
        rows.append(
            (
                f"{delay:g}",
                f"{time:g}",
                f"{time / delay:.3g}",
                *map(amount, figures),
                str(first),
                str(second),
                str(neither),
            )
        )
    headings = ("D, s", "τ_d, s", "τ_d/D", "median", "least", "largest", *outcomes, "neither")
    return AnswerTable(caption, headings, tuple(rows))
