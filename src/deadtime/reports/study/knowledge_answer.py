"""The second open question of arXiv 2503.08446: what does it bring to know the dwell time?

And a third that follows: what does it bring to know how sojourns are distributed?
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from deadtime.problems.law_registry import the_law
from deadtime.reports.study.findings import against_best, duel, favourite, steadier, summary
from deadtime.reports.study.phrases import (
    Answer,
    change,
    of_cells,
    percent,
    place_of,
    tally,
    times_the_oracle,
    words_of,
)
from deadtime.reports.study.tables import by_dwell_time, table
from deadtime.scenarios.sweeps.axes import AWARE

if TYPE_CHECKING:
    import xarray as xr

EXPECTED = "expected"
WORTH = 0.99  # a quotient below which a law brings something, beside being better


def worth_of_dwell_time(data: xr.Dataset, plain: Sequence[str]) -> Answer:
    """What the dwell-aware laws gain over the same laws without."""
    sentences, tables = [], []
    for law in plain:
        aware = law + AWARE
        fight = duel(data, aware, law)
        better, worse, _, total = tally(fight.verdict)
        sentences.append(
            f"Told the dwell time, {the_law(law)} does better in {of_cells(better, total)} and "
            f"worse in {worse}. {_along_the_dwell_time(fight)}"
        )
        sentences += [_gain(fight), *_cost(fight), *_stability(data, aware, law)]
        tables.append(table(_caption(the_law(aware), the_law(law)), fight, ("better", "worse")))
    question = "What does it bring to know the dwell time?"
    duels = tuple((law + AWARE, law) for law in plain)
    return Answer(question, tuple(sentences), tuple(tables), duels)


def worth_of_distribution(data: xr.Dataset, rivals: Sequence[str]) -> Answer:
    """What the expected law gains over the best law that knows the dwell time at most."""
    fight, rival = against_best(data, EXPECTED, rivals), favourite(data, rivals)
    better, worse, _, total = tally(fight.verdict)
    sentences = [
        "Against the best of the laws that know the dwell time at most, chosen anew in every "
        f"cell, the expected law does better in {of_cells(better, total)} and worse in {worse}. "
        f"{_along_the_dwell_time(fight)}",
        _gain(fight),
        *_cost(fight),
        *_stability(data, EXPECTED, rival),
    ]
    regret = summary(data).regret.sel(law=EXPECTED).values
    sentences.append(
        "Beside the oracle, which has the same gains and knows the future as well: its ∫|x|² is "
        f"{times_the_oracle(regret)}."
    )
    return Answer(
        "What does it bring to know the distribution of the sojourns?",
        tuple(sentences),
        (table(_caption(the_law(EXPECTED), "the best without"), fight, ("better", "worse")),),
        ((EXPECTED, rival),),
    )


def _caption(law: str, other: str) -> str:
    return f"∫|x|² under {law} over that under {other}, by delay and dwell time"


def _along_the_dwell_time(fight: xr.Dataset) -> str:
    """What becomes of ∫|x|² from the shortest dwell time to the longest, at each end of delays."""
    delays, times = (np.sort(fight[name].values) for name in ("delay", "dwell_time"))
    parts = []
    for delay in dict.fromkeys((delays[-1], delays[0])):
        ends = []
        for time in dict.fromkeys((times[0], times[-1])):
            ratio = fight.ratio.sel(delay=delay, dwell_time=time).values
            ends.append(f"{change(_middle(ratio))} at τ_d/D = {time / delay:.2g}")
        parts.append(" and ".join(ends) + f" (D = {delay:g} s)")
    return f"In the median cell its ∫|x|² is {'; '.join(parts)}."


def _middle(values: np.ndarray) -> float:
    """Median of the numbers among some values, NaN if there is none."""
    values = values[~np.isnan(values)]
    return float(np.median(values)) if values.size else float("nan")


def _gain(fight: xr.Dataset) -> str:
    """Where knowledge brings something, and where it brings nothing."""
    total, cells = int(fight.ratio.notnull().sum()), (fight.verdict == 1.0) & (fight.ratio < WORTH)
    text = f"It brings at least {percent(1.0 - WORTH)} in {of_cells(int(cells.sum()), total)}"
    if cells.any():
        text += f", most at {_extreme(fight.ratio.where(cells), np.nanargmin)}"
    useless: dict[float, list[str]] = {}
    for delay, time, here in by_dwell_time(fight):
        if _middle(here.ratio.values) >= WORTH:
            useless.setdefault(delay, []).append(f"{time:g}")
    if useless:
        places = " and ".join(
            f"τ_d = {', '.join(times)} s with D = {delay:g} s" for delay, times in useless.items()
        )
        text += f"; less than that in the median cell at {places}"
    return text + "."


def _cost(fight: xr.Dataset) -> list[str]:
    """Where knowledge costs something."""
    cells = (fight.verdict == -1.0) & (fight.ratio > 1.0 / WORTH)
    if not cells.any():
        return []
    total = int(fight.ratio.notnull().sum())
    return [
        f"It costs at least {percent(1.0 - WORTH)} in {of_cells(int(cells.sum()), total)}, most at "
        f"{_extreme(fight.ratio.where(cells), np.nanargmax)}."
    ]


def _stability(data: xr.Dataset, law: str, other: str) -> list[str]:
    """Whether a law stabilises more signals than another, and where by most."""
    more, fewer, _, total = tally(steadier(data, law, other))
    if not (more or fewer):
        return []
    calm = summary(data).stabilised
    rise = calm.sel(law=law) - calm.sel(law=other)
    place = place_of(rise, int(np.nanargmax(rise.values)))
    after, before = (percent(float(calm.sel(law=name, **place))) for name in (law, other))
    return [
        f"{the_law(law).capitalize()} stabilises more signals than {the_law(other)} in "
        f"{of_cells(more, total)} and fewer in {fewer}; by most at {words_of(place)}: {after} "
        f"instead of {before} of them."
    ]


def _extreme(ratio: xr.DataArray, which: Callable[[np.ndarray], np.intp]) -> str:
    """The cell where a quotient is extreme, and what it is there."""
    place = place_of(ratio, int(which(ratio.values)))
    return f"{words_of(place)} ({change(float(ratio.sel(**place)))})"
