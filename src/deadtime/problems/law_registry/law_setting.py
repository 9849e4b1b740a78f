"""What a law is made from, whether a problem file asks for it or a study."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.estimation import ModeFilter, OutputModeFilter
from deadtime.plant import SwitchedSystem, Weight
from deadtime.switching import Rule, SwitchingModel

Need = Literal["model", "rule", "signal", "mode_filter"]


@dataclass(frozen=True, eq=False)
class LawSetting:
    """The plant that a law believes in, gains, and what there is to know of the switching.

    Attributes
    ----------
    plant : SwitchedSystem
    gains : ndarray, shape (modes, m, n)
    mean_gain : callable
        The gain (m, n) of a plant of one mode, designed as the others were.
    period : float
        At which laws that are tuned are tuned, seconds.
    model : switching model or None
        A model of the switching, for laws that need one.
    rule : Rule or None
        By which the state decides the mode; None where a signal does.
    weight : Weight or None
        Of the cost, for laws that minimise it; None: the identity.
    mode_filter : callable or None
        What makes the filter of a law that believes in a plant, for laws that are not told the
        mode.
    allow_unstable : bool
        Whether gains may leave a mode unstable.
    """

    plant: SwitchedSystem
    gains: Float[np.ndarray, "mode m n"]
    mean_gain: Callable[[SwitchedSystem], Float[np.ndarray, "m n"]]
    period: float
    model: SwitchingModel | None = None
    rule: Rule | None = None
    weight: Weight | None = None
    mode_filter: Callable[[SwitchedSystem], ModeFilter | OutputModeFilter] | None = None
    allow_unstable: bool = False

    def has(self, need: Need) -> bool:
        """Whether something that a law may need is there."""
        if need == "signal":
            return self.rule is None
        return getattr(self, need) is not None

    def require(self, need: Need, kind: str) -> None:
        """Refuse a law of some kind that needs what is not there."""
        if not self.has(need):
            raise ArgumentError(NEEDS[need].format(kind=kind))


# What a law may need, and what a file is told that lacks it.
NEEDS: Mapping[Need, str] = {
    "model": "kind = '{kind}' needs a [switching] section: a model to rely on.",
    "mode_filter": (
        'kind = "{kind}" needs a [mode_filter] section, by which it tells the modes: '
        "disturbance and noise say what to expect of the states."
    ),
    "rule": (
        'kind = "{kind}" needs a [signal] of kind "half-space", "polyhedra" or "quadratic": that '
        "is the rule it runs forward."
    ),
    "signal": (
        'kind = "{kind}" needs a signal that is known in advance, but the state decides the '
        'mode: use kind = "state-dependent", which is exact there.'
    ),
}
