"""Answers in plain sentences, every one computed from a study's data.

Which law to use; the two open questions of arXiv 2503.08446: law (2), averaged, or law (80), mean,
and the gain from knowing the dwell time; and the gain from knowing the distribution of sojourns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from deadtime.base.wording import amount
from deadtime.problems.law_registry import LEVELS, the_law
from deadtime.reports.study import findings
from deadtime.reports.study.phrases import (
    Answer,
    AnswerTable,
    change,
    of_cells,
    percent,
    place_of,
    region,
    span,
    tally,
    times_the_oracle,
    words_of,
)
from deadtime.scenarios.sweeps.axes import AWARE, ORACLE, knowledge_of, within

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
    counts = (f"cells {outcome}" for outcome in (*outcomes, "undecided"))
    headings = ("D, s", "τ_d, s", "τ_d/D", "median", "least", "largest", *counts)
    return AnswerTable(caption, headings, tuple(rows))


AVERAGED, MEAN = "averaged", "mean"
MOST, FEW = 0.95, 0.05  # shares of the signals stabilised


def averaged_or_mean(data: xr.Dataset) -> Answer:
    """When the averaged law is better than the mean law."""
    fight = findings.duel(data, AVERAGED, MEAN)
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
        (table(caption, fight, ("won by averaged", "won by mean")),),
        ((AVERAGED, MEAN),),
    )


def _where_it_wins(
    data: xr.Dataset, law: str, ratio: xr.DataArray, cells: xr.DataArray
) -> list[str]:
    """Where on the grid a law is the better one, by how much, and whether it is of use there."""
    if not cells.any():
        return []
    where, count = region(cells), int(cells.sum())
    calm = findings.summary(data).stabilised.sel(law=law).values[cells.values]
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
    calm = findings.summary(data).stabilised
    dims = [dim for dim in calm.dims if dim not in ("law", "distance")]
    more, fewer, _, total = tally(findings.steadier(data, MEAN, AVERAGED))
    ends = []
    for alpha in (float(data.distance.min()), float(data.distance.max())):
        shares = calm.sel(distance=alpha).mean(dims)
        mean, averaged = (percent(float(shares.sel(law=law))) for law in (MEAN, AVERAGED))
        ends.append(f"{mean} against {averaged} of all signals at α = {alpha:g}")
    return (
        f"The mean law stabilises more signals than the averaged law in {of_cells(more, total)} "
        f"and fewer in {fewer}: {', '.join(ends)}."
    )


EXPECTED = "expected"
GAIN = 0.99  # a quotient below which a law gains something, beside being better


def gain_from_dwell_time(data: xr.Dataset, plain: Sequence[str]) -> Answer:
    """The gain of the dwell-aware laws over the same laws without the dwell time."""
    sentences, tables = [], []
    for law in plain:
        aware = law + AWARE
        fight = findings.duel(data, aware, law)
        better, worse, _, total = tally(fight.verdict)
        sentences.append(
            f"With the dwell time known, {the_law(law)} does better in {of_cells(better, total)} "
            f"and worse in {worse}. {_along_the_dwell_time(fight)}"
        )
        sentences += [_gain(fight), *_cost(fight), *_stability(data, aware, law)]
        tables.append(table(_caption(the_law(aware), the_law(law)), fight, ("better", "worse")))
    question = "What does it bring to know the dwell time?"
    duels = tuple((law + AWARE, law) for law in plain)
    return Answer(question, tuple(sentences), tuple(tables), duels)


def gain_from_distribution(data: xr.Dataset, rivals: Sequence[str]) -> Answer:
    """The gain of the expected law over the best law that knows the dwell time at most."""
    fight, rival = findings.against_best(data, EXPECTED, rivals), findings.favourite(data, rivals)
    better, worse, _, total = tally(fight.verdict)
    sentences = [
        "Against the best of the laws that know the dwell time at most, chosen anew in every "
        f"cell, the expected law does better in {of_cells(better, total)} and worse in {worse}. "
        f"{_along_the_dwell_time(fight)}",
        _gain(fight),
        *_cost(fight),
        *_stability(data, EXPECTED, rival),
    ]
    regret = findings.summary(data).regret.sel(law=EXPECTED).values
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
    """The change of ∫|x|² from the shortest dwell time to the longest, at each end of delays."""
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
    total, cells = int(fight.ratio.notnull().sum()), (fight.verdict == 1.0) & (fight.ratio < GAIN)
    text = f"It brings at least {percent(1.0 - GAIN)} in {of_cells(int(cells.sum()), total)}"
    if cells.any():
        text += f", most at {_extreme(fight.ratio.where(cells), np.nanargmin)}"
    useless: dict[float, list[str]] = {}
    for delay, time, here in by_dwell_time(fight):
        if _middle(here.ratio.values) >= GAIN:
            useless.setdefault(delay, []).append(f"{time:g}")
    if useless:
        places = " and ".join(
            f"τ_d = {', '.join(times)} s with D = {delay:g} s" for delay, times in useless.items()
        )
        text += f"; less than that in the median cell at {places}"
    return text + "."


def _cost(fight: xr.Dataset) -> list[str]:
    cells = (fight.verdict == -1.0) & (fight.ratio > 1.0 / GAIN)
    if not cells.any():
        return []
    total = int(fight.ratio.notnull().sum())
    return [
        f"It costs at least {percent(1.0 - GAIN)} in {of_cells(int(cells.sum()), total)}, most at "
        f"{_extreme(fight.ratio.where(cells), np.nanargmax)}."
    ]


def _stability(data: xr.Dataset, law: str, other: str) -> list[str]:
    """Whether a law stabilises more signals than another, and where by most."""
    more, fewer, _, total = tally(findings.steadier(data, law, other))
    if not (more or fewer):
        return []
    calm = findings.summary(data).stabilised
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


WORDS = {
    "nothing": "nothing of the switching",
    "the dwell time": "the dwell time",
    "the distribution": "the distribution of the sojourns",
}
CLOSE = 1.05  # quotient of two laws' regrets below which the choice hardly matters
CRUDE = ("delay ignored", "only")  # laws, by how their names end, that nobody would choose


def answers(data: xr.Dataset) -> list[Answer]:
    """Answers from the data: which law to use, and the paper's two open questions.

    A question is left out if the study does not run the laws that it is about.
    """
    laws = [str(law) for law in data.law.values]
    sections = [which_law(data)]
    if AVERAGED in laws and MEAN in laws:
        sections.append(averaged_or_mean(data))
    plain = [law for law in laws if law + AWARE in laws]
    if plain:
        sections.append(gain_from_dwell_time(data, plain))
    rivals = within(laws, "the dwell time")
    if EXPECTED in laws and rivals:
        sections.append(gain_from_distribution(data, rivals))
    return sections


def which_law(data: xr.Dataset) -> Answer:
    """For every level of knowledge the law of least typical regret."""
    laws = [str(law) for law in data.law.values if law != ORACLE]
    chosen: dict[str, str] = {}
    for level in LEVELS[:-1]:
        if any(knowledge_of(law) == level for law in laws):
            chosen[level] = findings.favourite(data, within(laws, level))
    sentences = [_advice(chosen)] if chosen else []
    sentences += [_record(data, level, law, within(laws, level)) for level, law in chosen.items()]
    return Answer("Which law to use?", (*sentences, *_where_any_will_do(data, laws)))


def _advice(chosen: dict[str, str]) -> str:
    """One sentence: the law for what is known; knowledge that changes nothing is left out."""
    kept: dict[str, str] = {}
    for level, law in chosen.items():
        if law not in kept.values():
            kept[level] = law
    best = list(kept.items())[::-1]
    parts = [f"{the_law(law)} if {WORDS[level]} is known" for level, law in best[:-1]]
    return f"Use {', otherwise '.join([*parts, the_law(best[-1][1])])}."


def _record(data: xr.Dataset, level: str, law: str, able: list[str]) -> str:
    """How a law fares, and how it fares among those that know as much."""
    figures, cells = (
        findings.summary(data).sel(law=law),
        int(findings.unbeaten(data, able).sel(law=law).sum()),
    )
    regret, calm = figures.regret.values, figures.stabilised.values
    typical, worst = float(findings.typical_regret(data).sel(law=law)), float(np.nanmax(regret))
    capped = int(np.sum(~(regret <= findings.LOST)))
    how = f", {of_cells(capped, regret.size)} counted as {findings.LOST:g} times" if capped else ""
    return (
        f"Knowing {WORDS[level]}: {the_law(law)}. Its ∫|x|² is {amount(typical)} times the "
        f"oracle’s, the geometric mean over the grid{how}, and {amount(worst)} times in "
        "the worst cell. "
        f"It stabilises more than {percent(MOST)} of the signals in "
        f"{of_cells(int(np.sum(calm > MOST)), regret.size)}, and no law that knows as much beats "
        f"it in {of_cells(cells, regret.size)}."
    )


def _where_any_will_do(data: xr.Dataset, laws: list[str]) -> list[str]:
    regret = findings.summary(data).regret.sel(law=[law for law in laws if not law.endswith(CRUDE)])
    if regret.sizes["law"] < 2:
        return []
    alike = regret.max("law", skipna=False) < CLOSE * regret.min("law", skipna=False)
    if not alike.any():
        return []
    where = region(alike)
    return [
        f"In {of_cells(int(alike.sum()), alike.size)} the choice hardly matters"
        + (f" (all at {where})" if where else "")
        + f": all predictors are within {percent(CLOSE - 1.0)} of each other."
    ]
