"""A study: what is run in every cell of its grid, and the grid."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.imperfections import Imperfection
from deadtime.plant import SwitchedSystem


@dataclass(frozen=True)
class Axis:
    """A parameter that may stand on the grid: its name in files and data, and for readers."""

    name: str
    label: str
    unit: str = ""

    def say(self, value: object) -> str:
        """The value with its name, for titles.

        Examples
        --------
        >>> AXES["delay"].say(0.5), AXES["sojourn"].say("uniform")
        ('delay 0.5 s', 'uniform sojourns')
        """
        if isinstance(value, str):
            return f"{value} {self.label}"
        return f"{self.label} {value:g} {self.unit}".rstrip()


# In the order of the dataset's dimensions: those that tell maps apart, then a map's y and x.
AXES: Mapping[str, Axis] = {
    axis.name: axis
    for axis in (
        Axis("sojourn", "sojourns"),
        Axis("delay", "delay", "s"),
        Axis("step", "sampling period", "s"),
        Axis("distance", "mode distance α"),
        Axis("dwell_time", "dwell time", "s"),
    )
}
OPTIONAL = ("step",)  # an axis of the dataset only where the grid lists it


@dataclass(frozen=True)
class Cell:
    """One point of the grid: its place along every axis, and the values there."""

    index: tuple[int, ...]
    sojourn: str
    delay: float
    step: float
    distance: float
    dwell_time: float

    def __str__(self) -> str:
        values = ((axis, getattr(self, name)) for name, axis in AXES.items())
        return ", ".join(axis.say(value) for axis, value in values)


@dataclass(frozen=True, eq=False)
class Study:
    """A complete study (immutable).

    Attributes
    ----------
    title : str
    source : str
        Where the plant comes from.
    plant : SwitchedSystem
        The plant at α = 1 and the problem's delay.
    poles : tuple of complex
        Where the gains of every cell's modes, and of their mean, are placed.
    laws : tuple of str
        Names of the laws, as in `deadtime.study.laws`; the oracle is the last.
    x0, horizon, step
        As `simulate` takes them; `step` where it is not on the grid.
    scenarios, seed : int
        Signals per cell, and their seed.
    grid : mapping
        From the names of `AXES`, in their order, to values.
    text : str
        The study file.
    imperfections : tuple of Imperfection
        Of every run, drawn with the scenario's seed.
    """

    title: str
    source: str
    plant: SwitchedSystem
    poles: tuple[complex, ...]
    laws: tuple[str, ...]
    x0: Float[np.ndarray, " n"]
    horizon: float
    step: float
    scenarios: int
    seed: int
    grid: Mapping[str, tuple[Any, ...]]
    text: str = ""
    imperfections: tuple[Imperfection, ...] = ()

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        return tuple(len(values) for values in self.grid.values())

    @property
    def size(self) -> int:
        """Number of cells."""
        return int(np.prod(self.shape))

    def cells(self) -> Iterator[Cell]:
        """Every cell, neighbours in dwell time after each other."""
        for index in itertools.product(*map(range, self.shape)):
            values: dict[str, Any] = {"step": self.step}
            for (name, axis), i in zip(self.grid.items(), index, strict=True):
                values[name] = axis[i]
            yield Cell(index, **values)
