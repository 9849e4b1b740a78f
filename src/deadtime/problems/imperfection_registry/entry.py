"""An entry of the registry: the section of a problem file for an imperfection.

class BacklashSection(ImperfectionSection):
    "The description in editors."

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
    """An imperfection as an axis of sweeps, where 0 is none (immutable).

    Attributes
    ----------
    name : str
        Name in study files, data and on the command line.
    label, unit : str
        For readers.
    description : str
        The text in editors.
    keys : callable
        From a value to the keys of the section.
    values : type
        Type of its values.
    """

    name: str
    label: str
    unit: str
    description: str
    keys: Callable[[float], Mapping[str, Any]]
    values: Any = NotNegative


@dataclass(frozen=True)
class Slider:
    """The slider of an imperfection on the page (immutable).

    Attributes
    ----------
    label : str
    key : str
        The key of the section with its value.
    reach : float
        End of its range, times the largest |x_i(0)|.
    steps : int
        Number of steps.
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
