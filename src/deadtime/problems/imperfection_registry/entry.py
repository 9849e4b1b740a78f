"""An entry of the registry: the section of a problem file that asks for an imperfection.

class BacklashSection(ImperfectionSection):
    "What editors show beside the kind."

    made: ClassVar = Backlash

    kind: Literal["backlash"]
    width: PerSignal = Field(description="Units of the input.")
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from deadtime.imperfections import Imperfection
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import NotNegative, Section, Vector

PerSignal = Annotated[float | Vector, Shape("a number, or one for each", [0.1, 0.2])]


@dataclass(frozen=True, kw_only=True)
class ImperfectionAxis:
    """An imperfection as an axis of sweeps, none of it for the value 0 (immutable).

    Attributes
    ----------
    name : str
        In study files, data and on the command line.
    label, unit : str
        For readers.
    description : str
        What editors show.
    keys : callable
        From a value to the keys of the section.
    values : type
        What its values may be.
    """

    name: str
    label: str
    unit: str
    description: str
    keys: Callable[[float], Mapping[str, Any]]
    values: Any = NotNegative


@dataclass(frozen=True)
class Slider:
    """How the page moves an imperfection along its axis (immutable).

    Attributes
    ----------
    label : str
    key : str
        The key of the section that holds the value where the file has one.
    reach : float
        How far it goes, times the largest |x_i(0)|.
    steps : int
        In how many steps.
    """

    label: str
    key: str
    reach: float
    steps: int


class ImperfectionSection(Section):
    """The base of entries. Each adds its `kind`, and a key for each field of the class it makes."""

    made: ClassVar[type[Imperfection] | None] = None
    axis: ClassVar[ImperfectionAxis | None] = None
    slider: ClassVar[Slider | None] = None
