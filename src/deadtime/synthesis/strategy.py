"""How a search for designs spends its budget."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deadtime.synthesis.design_search import DesignSearch, Merit, Spent, Tried
from deadtime.synthesis.gain_families import ChoiceFamily, Poles, Weights

_ROUND = 50  # trials in the first round
_SAMPLED = 0.2  # of a round
_PARTS = (0.2, 0.25, 0.35, 0.5, 1.0)  # of the rest, one after the other
_SIZES = (0.25, 0.6, 0.25, 0.6, 0.15)  # of the simplex that each starts with
_FEWEST = 20  # trials that polishing is worth
_LONGER = (1, 2, 5, 10, 20, 50, 100)  # times the step: what is tried where longer ones are allowed


def pairs_of(
    search: DesignSearch, filtered: bool | None, step: float, longest_step: float | None
) -> list[tuple[ChoiceFamily, float]]:
    """What is varied: families of parameters and periods."""
    kinds = [False, True] if filtered is None else [filtered]
    family = Poles if search.plant.inputs == 1 else Weights
    families = [family(search.plant, kind) for kind in kinds]
    longest = step if longest_step is None else longest_step
    steps = [k * step for k in _LONGER if k * step <= longest * (1.0 + 1e-9)]
    return [(family, one) for one in steps for family in families]


def spend(
    search: DesignSearch,
    pairs: Sequence[tuple[ChoiceFamily, float]],
    gains: np.ndarray,
    rng: np.random.Generator,
) -> None:
    """Rounds of samples and polishing, each twice as long as the one before.

    The budget only says where they end, so a larger one tries all that a smaller one does.
    """
    try:
        for family, step in pairs:
            for parameters in family.starts(gains):
                search.evaluate(family, step, parameters)
        size = _ROUND
        while True:
            _round(search, pairs, search.spent + size, size, rng)
            size *= 2
    except Spent:
        return


def _round(
    search: DesignSearch,
    pairs: Sequence[tuple[ChoiceFamily, float]],
    end: int,
    size: int,
    rng: np.random.Generator,
) -> None:
    """Samples, then polishing for cost, and for the request where that falls short."""
    share = max(4, int(_SAMPLED * size / len(pairs)))
    for family, step in pairs:
        search.samples(family, step, share, rng)
    for part, simplex in zip(_PARTS, _SIZES, strict=True):
        short = not any(search.shortfall(one) == 0.0 for one in search.stable)
        merits = [search.nearest()] if short else [search.cheapest()]
        if short and part < 0.3:
            merits.append(search.cheapest())
        per_mode = search.plant.modes > 1 and part >= 0.25
        left = end - search.spent
        for merit in merits:
            if search.budget - search.spent < _FEWEST:
                raise Spent
            if left < _FEWEST:
                return
            for start in _distinct(search, merit, 1 if part == 1.0 else 2):
                search.polish(start, merit, per_mode, int(part * left / 3.0) + 10, simplex)


def _distinct(search: DesignSearch, merit: Merit, most: int) -> list[Tried]:
    """The best of each family and step, the best of all first."""
    best: list[Tried] = []
    for one in search.ranking(merit):
        if all((one.family, one.step) != (other.family, other.step) for other in best):
            best.append(one)
        if len(best) == most:
            break
    return best
