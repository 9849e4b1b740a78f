"""Answers in plain sentences, every one computed from a study's data."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from deadtime.base.wording import amount
from deadtime.problems.law_registry import LEVELS, the_law
from deadtime.reports.study.findings import LOST, favourite, summary, typical_regret, unbeaten
from deadtime.reports.study.knowledge_answer import (
    EXPECTED,
    worth_of_distribution,
    worth_of_dwell_time,
)
from deadtime.reports.study.mean_answer import AVERAGED, MEAN, MOST, averaged_or_mean
from deadtime.reports.study.phrases import Answer, of_cells, percent, region
from deadtime.scenarios.sweeps.axes import AWARE, ORACLE, knowledge_of, within

if TYPE_CHECKING:
    import xarray as xr

WORDS = {
    "nothing": "nothing of the switching",
    "the dwell time": "the dwell time",
    "the distribution": "the distribution of the sojourns",
}
CLOSE = 1.05  # quotient of two laws' regrets below which the choice hardly matters
CRUDE = ("delay ignored", "only")  # laws, by how their names end, that nobody would choose


def answers(data: xr.Dataset) -> list[Answer]:
    """What the data say: which law to use, and the paper's two open questions.

    A question is left out if the study does not run the laws that it is about.
    """
    laws = [str(law) for law in data.law.values]
    found = [which_law(data)]
    if AVERAGED in laws and MEAN in laws:
        found.append(averaged_or_mean(data))
    plain = [law for law in laws if law + AWARE in laws]
    if plain:
        found.append(worth_of_dwell_time(data, plain))
    rivals = within(laws, "the dwell time")
    if EXPECTED in laws and rivals:
        found.append(worth_of_distribution(data, rivals))
    return found


def which_law(data: xr.Dataset) -> Answer:
    """For every level of knowledge the law of least typical regret."""
    laws = [str(law) for law in data.law.values if law != ORACLE]
    chosen: dict[str, str] = {}
    for level in LEVELS[:-1]:
        if any(knowledge_of(law) == level for law in laws):
            chosen[level] = favourite(data, within(laws, level))
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
    figures, cells = summary(data).sel(law=law), int(unbeaten(data, able).sel(law=law).sum())
    regret, calm = figures.regret.values, figures.stabilised.values
    typical, worst = float(typical_regret(data).sel(law=law)), float(np.nanmax(regret))
    capped = int(np.sum(~(regret <= LOST)))
    how = f", {of_cells(capped, regret.size)} counted as {LOST:g} times" if capped else ""
    return (
        f"Knowing {WORDS[level]}: {the_law(law)}. Its ∫|x|² is {amount(typical)} times the "
        f"oracle’s, the geometric mean over the grid{how}, and {amount(worst)} times in "
        "the worst cell. "
        f"It stabilises more than {percent(MOST)} of the signals in "
        f"{of_cells(int(np.sum(calm > MOST)), regret.size)}, and no law that knows as much beats "
        f"it in {of_cells(cells, regret.size)}."
    )


def _where_any_will_do(data: xr.Dataset, laws: list[str]) -> list[str]:
    """Where the laws hardly differ."""
    regret = summary(data).regret.sel(law=[law for law in laws if not law.endswith(CRUDE)])
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
