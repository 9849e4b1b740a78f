"""The section of a problem file for a law, and the setting that the law is built from.

class CurrentModeLaw(LawSection):
    "The description in editors."

    names = (Named("current mode", knows="nothing"),)
    kind: Literal["current-mode"]

    def law(self, setting: LawSetting) -> Law:
        return CurrentModePredictor(setting.plant, setting.gains)
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.feedback.belief import BeliefFilter
from deadtime.plant import SwitchedSystem, Weight
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import Matrices, Matrix, Section, Vector
from deadtime.switching import Rule, SwitchingModel

Need = Literal["model", "rule", "signal", "mode_filter"]


@dataclass(frozen=True, eq=False)
class LawSetting:
    """A law's model of the plant, gains, and information on the switching.

    Attributes
    ----------
    plant : SwitchedSystem
    gains : ndarray, shape (modes, m, n)
    mean_gain : callable
        The gain (m, n) of a plant of one mode, designed as the others were.
    period : float
        Sampling period for laws that are tuned, seconds.
    model : switching model or None
        A model of the switching, for laws that need one.
    rule : Rule or None
        The rule by which the state decides the mode; None where a signal does.
    weight : Weight or None
        Weights of the cost, for laws that minimise it; None: the identity.
    mode_filter : callable or None
        From a law's plant to its mode filter, for laws on a mode belief.
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
    mode_filter: Callable[[SwitchedSystem], BeliefFilter] | None = None
    allow_unstable: bool = False

    def has(self, need: Need) -> bool:
        """Whether a need of a law is met."""
        if need == "signal":
            return self.rule is None
        return getattr(self, need) is not None

    def require(self, need: Need, kind: str) -> None:
        """Refuse a law of some kind if its need is not met."""
        if not self.has(need):
            raise ArgumentError(NEEDS[need].format(kind=kind))


# Needs of laws, with the message for a file that lacks one.
NEEDS: Mapping[Need, str] = {
    "model": "kind = '{kind}' needs a [switching] section: a model of the switching.",
    "mode_filter": (
        'kind = "{kind}" needs a [mode_filter] section, which estimates the mode: give '
        "its disturbance and noise."
    ),
    "rule": (
        'kind = "{kind}" needs a [signal] of kind "half-space", "polyhedra" or "quadratic": the '
        "rule of its prediction."
    ),
    "signal": (
        'kind = "{kind}" needs a signal that is known in advance, but the state decides the '
        'mode: use kind = "state-dependent", which is exact there.'
    ),
}


SQUARE = [[0.0, 1.0], [-1.0, -0.5]]
COLUMN = [[0.0], [1.0]]
UNIT = [[1.0, 0.0], [0.0, 1.0]]

# Lists of numbers: their shape, and an example.
Plants = Annotated[Matrices, Shape("(modes, n, n)", [SQUARE, SQUARE])]
InputMatrices = Annotated[Matrices, Shape("(modes, n, m)", [COLUMN, COLUMN])]
Square = Annotated[Matrix, Shape("(n, n)", UNIT)]
InputWeight = Annotated[Matrix, Shape("(m, m)", [[1.0]])]

# Information on the switching that a law uses; each level includes those before it.
LEVELS = ("nothing", "the dwell time", "the distribution", "the future")


@dataclass(frozen=True, kw_only=True)
class Named:
    """The name of a law in studies, on the page, in figures and sentences (immutable).

    Attributes
    ----------
    name : str
        Unique; with ``{mode}`` in it there is one law for each mode. The first of an entry is the
        `label` of the law that its kind alone makes.
    keys : mapping
        Keys of the section that make it, beside the kind, the mode and the dwell time.
    knows : str
        Information on the switching that it uses, one of `LEVELS`; the key `dwell_time` gives the
        dwell time.
    colour : str
        As "#rrggbb", the same everywhere; empty: an unused one.
    noun : str
        The noun after "the" in a sentence; empty: its name in quotation marks.
    several : bool
        Whether it is useful for several modes only.
    in_files, in_studies : bool
        Whether it runs where a file, or a study, names no laws.
    on_page : bool
        Whether the page offers it for every problem.
    """

    name: str
    keys: Mapping[str, Any] = field(default_factory=dict)
    knows: str
    colour: str = ""
    noun: str = ""
    several: bool = False
    in_files: bool = False
    in_studies: bool = False
    on_page: bool = True


# One for all, one per input, or a row of them per mode.
Delays = Annotated[
    float | Vector | Matrix, Shape("a number, (m,), (modes, 1) or (modes, m)", [0.5, 0.2])
]


class ModelSection(Section):
    """A plant that differs from [plant] in the keys given: the true one, or a law's own model."""

    delay: Delays | None = None
    A: Plants | None = None
    B: InputMatrices | None = None


class LawSection(Section):
    """The base of entries. Each adds its `kind`, its keys, its `names` and `law`."""

    names: ClassVar[tuple[Named, ...]] = ()
    needs: ClassVar[tuple[Need, ...]] = ()
    # Longest delay, in periods, for which its table takes a moment; None: any.
    quick: ClassVar[int | None] = None
    # Whether it may be the law of a servo, whose extended plant has constant states.
    follows: ClassVar[bool] = True

    name: str | None = Field(None, description="Name in tables and figures.")
    low_pass: Annotated[float | Matrix | None, Shape("a number or (m, m)", [[0.1]])] = Field(
        None,
        description="Time constant of a low-pass filter on the law's input, seconds; a number, or "
        "m × m.",
    )
    model: ModelSection = Field(default_factory=ModelSection)

    @abstractmethod
    def law(self, setting: LawSetting) -> Law:
        """The law of the section; the entry's `needs` are met."""
