"""How a search for designs spends its budget."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deadtime.design.families import Family, Poles, Weights
from deadtime.design.search import Merit, Search, Tried

_SAMPLED = 0.35  # of the budget
_PARTS = (0.2, 0.25, 0.35, 0.5, 1.0)  # of the rest, one after the other
_SIZES = (0.25, 0.6, 0.25, 0.6, 0.15)  # of the simplex that each starts with
_FEWEST = 20  # trials that polishing is worth
_LONGER = (1, 2, 5, 10, 20, 50, 100)  # times the step: what is tried where longer ones are allowed


def pairs_of(
    search: Search, filtered: bool | None, step: float, longest_step: float | None
) -> list[tuple[Family, float]]:
    """What is varied: families of parameters and periods."""
    kinds = [False, True] if filtered is None else [filtered]
    family = Poles if search.plant.inputs == 1 else Weights
    families = [family(search.plant, kind) for kind in kinds]
    longest = step if longest_step is None else longest_step
    steps = [k * step for k in _LONGER if k * step <= longest * (1.0 + 1e-9)]
    return [(family, one) for one in steps for family in families]


def spend(
    search: Search,
    pairs: Sequence[tuple[Family, float]],
    gains: np.ndarray,
    asked: float,
    rng: np.random.Generator,
) -> None:
    """Samples, then polishing for cost, and for margin where that falls short."""
    share = max(4, int(_SAMPLED * search.budget / len(pairs)))
    for family, step in pairs:
        for parameters in family.starts(gains):
            search.evaluate(family, step, parameters)
        search.samples(family, step, share, rng)
    for part, size in zip(_PARTS, _SIZES, strict=True):
        short = not any(one.margin >= asked for one in search.stable)
        merits = [search.widest()] if short else [search.cheapest(asked)]
        if short and part < 0.3:
            merits.append(search.cheapest(asked))
        left = search.budget - search.spent
        per_mode = search.plant.modes > 1 and part >= 0.25
        for merit in merits:
            if left < _FEWEST:
                return
            for start in _distinct(search, merit, 1 if part == 1.0 else 2):
                search.polish(start, merit, per_mode, int(part * left / 3.0) + 10, size)


def _distinct(search: Search, merit: Merit, most: int) -> list[Tried]:
    """The best of each family and step, the best of all first."""
    best: list[Tried] = []
    for one in search.ranked(merit):
        if all((one.family, one.step) != (other.family, other.step) for other in best):
            best.append(one)
        if len(best) == most:
            break
    return best
