"""How many of the plants that an uncertain one may be a law keeps stable, each mode held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import instance, positive
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.base.wording import as_rate
from deadtime.feedback import Law
from deadtime.plant.plant_set import PlantUncertainty
from deadtime.spectrum import growth_rate

DRAWN = 100


@dataclass(frozen=True, eq=False)
class DrawnStability(Frozen):
    """How fast the loop grows on plants that were drawn (immutable).

    Attributes
    ----------
    growth : (plants, modes) array
        Growth rates with each mode held, 1/s.
    """

    growth: Float[np.ndarray, "plant mode"]

    @property
    def stable(self) -> int:
        """On how many plants every mode decays."""
        return int((self.growth < 0.0).all(axis=1).sum())

    @property
    def all_stable(self) -> bool:
        """Whether that is all of them."""
        return self.stable == len(self.growth)

    @property
    def sentence(self) -> str:
        """In words; it is a sample, and says nothing of switching."""
        many, worst = len(self.growth), float(self.growth.max())
        how = "decay" if worst < 0.0 else "grow"
        slowest = f"the slowest at {as_rate(worst)} /s" if how == "decay" else (
            f"the fastest grows at {as_rate(worst)} /s"
        )  # fmt: skip
        return (
            f"Of {many} plants drawn from what is known of A, B and delays, {self.stable} decay in "
            f"every mode held, {slowest}."
        )


def drawn_stability(
    known: PlantUncertainty, law: Law, step: float = 0.01, *, count: int = DRAWN, seed: int = 0
) -> DrawnStability:
    """Whether a law's loop decays on plants drawn from an uncertain one, with each mode held.

    The law, and the model in it, stay what they are. A sample, no proof: were a plant drawn bad
    with a probability above p, `count` draws would all be good with (1 − p)^count at most, so that
    of 100 good ones p is below 3 % at 95 %.

    Parameters
    ----------
    known : UncertainPlant
        Such as `Identification.uncertain`, or what a problem file says in [uncertainty].
    law : Law
        A law that is a table, or an `OutputFeedback` of one.
    step : float
        Sampling period, in seconds.
    count, seed : int
        How many plants, and of the random numbers.

    Raises
    ------
    ArgumentError
        If the law is no table, or not one for such a plant.

    Examples
    --------
    >>> import deadtime as dt, numpy as np
    >>> plant = dt.SwitchedSystem([[[0.5]]], [[[1.0]]], delay=0.3)
    >>> law = dt.AveragedPredictor(plant, [[[-1.5]]])
    >>> for error in (0.05, 0.5):
    ...     known = dt.UncertainPlant(plant, np.diag([error, error, 0.01]) ** 2)
    ...     drawn_stability(known, law, 0.1).stable
    100
    81
    """
    instance("known", known, PlantUncertainty)
    instance("law", law, Law)
    step = positive("step", step)
    if not has_rates(law):
        raise ArgumentError(
            f"law must be a table, whose loop has growth rates; a {type(law).__name__} has none: "
            "simulate it on known.draw(…)."
        )
    plants = known.draw(count, seed)
    modes = range(known.plant.modes)
    rates = [[growth_rate(one, law, mode, step) for mode in modes] for one in plants]
    return DrawnStability(np.array(rates))


def has_rates(law: Law) -> bool:
    """Whether a law's loop has growth rates at a period: whether it, or its inner law, is a table.

    Examples
    --------
    >>> import deadtime as dt
    >>> has_rates(dt.problems.paper().laws["averaged"])
    True
    """
    return law.is_linear
