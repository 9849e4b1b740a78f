"""The first open question of arXiv 2503.08446: law (2), averaged, or law (80), mean?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from deadtime.problems.law_registry import the_law
from deadtime.reports.study.findings import duel, steadier, summary
from deadtime.reports.study.phrases import Answer, of_cells, percent, region, span, tally
from deadtime.reports.study.tables import table

if TYPE_CHECKING:
    import xarray as xr

AVERAGED, MEAN = "averaged", "mean"
MOST, FEW = 0.95, 0.05  # shares of the signals stabilised


def averaged_or_mean(data: xr.Dataset) -> Answer:
    """When the averaged law is better than the mean law."""
    fight = duel(data, AVERAGED, MEAN)
    first, second, neither, total = tally(fight.verdict)
    sentences = [
        f"The averaged law (2) is better in {of_cells(first, total)}, the mean law (80) in "
        f"{second}; in {neither} the signals do not decide. Counted by signals, the averaged law "
        f"has the smaller ∫|x|² on most of them in {int((fight.share_low > 0.5).sum())} cells, the "
        f"mean law in {int((fight.share_high < 0.5).sum())}."
    ]
    sentences += _where_it_wins(data, AVERAGED, fight.ratio, fight.verdict == 1.0)
    sentences += _where_it_wins(data, MEAN, 1.0 / fight.ratio, fight.verdict == -1.0)
    if fight.sizes["dwell_time"] > 1:
        sentences.append(_trend_in_dwell_time(fight))
    if fight.sizes["distance"] > 1:
        sentences.append(_trend_in_distance(data))
    caption = "∫|x|² under the averaged law over that under the mean law, by delay and dwell time"
    return Answer(
        "When is the averaged law better than the mean law?",
        tuple(sentences),
        (table(caption, fight, ("averaged better", "mean better")),),
        ((AVERAGED, MEAN),),
    )


def _where_it_wins(
    data: xr.Dataset, law: str, ratio: xr.DataArray, cells: xr.DataArray
) -> list[str]:
    """Where on the grid a law is the better one, by how much, and whether it is of use there."""
    if not cells.any():
        return []
    where, count = region(cells), int(cells.sum())
    calm = summary(data).stabilised.sel(law=law).values[cells.values]
    place = f"Where {the_law(law)} wins" + (f", at {where}," if where else "")
    return [
        f"{place} its ∫|x|² is {span(ratio.values[cells.values])}; there it stabilises more than "
        f"{percent(MOST)} of the signals in {of_cells(int(np.sum(calm > MOST)), count)} and fewer "
        f"than {percent(FEW)} in {int(np.sum(calm < FEW))}."
    ]


def _trend_in_dwell_time(fight: xr.Dataset) -> str:
    """Whether shorter dwell times favour the averaged law, as the paper's text has it."""
    times = fight.dwell_time.values
    short, long = (fight.sel(dwell_time=time) for time in (times.min(), times.max()))
    averaged = int((short.ratio_high < long.ratio_low).sum())
    mean = int((short.ratio_low > long.ratio_high).sum())
    lines = int(short.ratio.notnull().sum())
    favoured = AVERAGED if averaged > mean else MEAN
    said = f"favour {the_law(favoured)}" if averaged != mean else "favour neither law"
    return (
        f"Shorter dwell times {said}: from τ_d = {times.max():g} s down to {times.min():g} s, "
        f"the quotient of ∫|x|², averaged over mean, falls on {averaged} and rises on {mean} of "
        f"the {lines} lines of the grid along the dwell time (95 % intervals apart)."
    )


def _trend_in_distance(data: xr.Dataset) -> str:
    """Whether the mean law bears modes that are farther apart."""
    calm = summary(data).stabilised
    dims = [dim for dim in calm.dims if dim not in ("law", "distance")]
    more, fewer, _, total = tally(steadier(data, MEAN, AVERAGED))
    ends = []
    for alpha in (float(data.distance.min()), float(data.distance.max())):
        shares = calm.sel(distance=alpha).mean(dims)
        mean, averaged = (percent(float(shares.sel(law=law))) for law in (MEAN, AVERAGED))
        ends.append(f"{mean} against {averaged} of all signals at α = {alpha:g}")
    return (
        f"The mean law stabilises more signals than the averaged law in {of_cells(more, total)} "
        f"and fewer in {fewer}: {', '.join(ends)}."
    )
