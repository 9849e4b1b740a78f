"""A study: a labelled grid, and the loops that run in its cells."""

from __future__ import annotations

import itertools
import json
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.base.version import __version__
from deadtime.feedback import Law
from deadtime.imperfections import Imperfection
from deadtime.plant import SwitchedSystem, Weight
from deadtime.scenarios.dataset import METRICS
from deadtime.scenarios.sweeps.axes import Axis, axis_of


@dataclass(frozen=True)
class Cell:
    """One point of the grid: its index along every axis, and its values by name."""

    index: tuple[int, ...]
    values: Mapping[str, Any]
    axes: Mapping[str, Axis] = field(default_factory=dict)

    def __str__(self) -> str:
        return ", ".join(
            self.axes.get(name, axis_of(name)).say(value) for name, value in self.values.items()
        )


@dataclass(frozen=True, eq=False)
class Loop:
    """The arguments of `monte_carlo` in a cell.

    Attributes
    ----------
    plant, laws, model, x0, horizon, step, imperfections, weight
        As `monte_carlo` takes them, laws by name.
    reasons : mapping
        From the names of laws that could not be built to the faults.
    """

    plant: SwitchedSystem
    laws: Mapping[str, Law]
    model: Any
    x0: Float[np.ndarray, " n"]
    horizon: float
    step: float
    imperfections: Sequence[Imperfection] = ()
    reasons: Mapping[str, str] = field(default_factory=dict)
    weight: Weight | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Study(ABC):
    """A grid of cells, in each of which every law runs on the same random signals (immutable).

    Attributes
    ----------
    grid : mapping
        From the names of axes to their values, in the order of the dataset's dimensions.
    laws : tuple of str
        Names of the laws, the same in every cell.
    scenarios, seed : int
        Signals per cell, and their seed; an axis ``seed`` has precedence.
    metrics : tuple of str
        Metrics of `monte_carlo` that are stored.
    title, source : str
        A heading, and the origin of the plant.
    text : str
        The content of its file.
    """

    grid: Mapping[str, tuple[Any, ...]]
    laws: tuple[str, ...]
    scenarios: int
    seed: int
    metrics: tuple[str, ...]
    title: str = ""
    source: str = ""
    text: str = ""

    @abstractmethod
    def loop(self, cell: Cell) -> Loop:
        """The loop of a cell: plant, laws, switching model and the other arguments.

        Raises
        ------
        DeadtimeError
            If no law can be built there; the message becomes the cell's reason.
        """

    @abstractmethod
    def particulars(self) -> dict[str, Any]:
        """Everything else on which results depend, for JSON."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        return tuple(len(values) for values in self.grid.values())

    @property
    def size(self) -> int:
        """Number of cells."""
        return int(np.prod(self.shape))

    def cells(self) -> Iterator[Cell]:
        """Every cell, the last axis fastest."""
        return map(self.cell, itertools.product(*map(range, self.shape)))

    def cell(self, index: tuple[int, ...]) -> Cell:
        """The cell at an index."""
        axes = zip(self.grid.items(), index, strict=True)
        values = {name: values[i] for (name, values), i in axes}
        return Cell(index, values, {name: self.axis(name) for name in values})

    def axis(self, name: str) -> Axis:
        """The label and unit of an axis."""
        return axis_of(name)

    def definition(self) -> dict[str, Any]:
        """Everything on which results depend: studies with equal definitions have equal results."""
        whole = {
            "version": __version__,
            "grid": {name: list(values) for name, values in self.grid.items()},
            "laws": list(self.laws),
            "scenarios": self.scenarios,
            "seed": self.seed,
            "metrics": list(self.metrics),
            **self.particulars(),
        }
        return json.loads(json.dumps(whole))


def differences(old: Any, new: Any, name: str = "") -> list[str]:
    """The differences between two definitions, a phrase per entry.

    Examples
    --------
    >>> differences({"seed": 0, "grid": {"delay": [1.0]}}, {"seed": 0, "grid": {"delay": [2.0]}})
    ['grid.delay was [1.0], is [2.0]']
    """
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return [] if old == new else [f"{name} was {_short(old)}, is {_short(new)}"]
    found = []
    for key in [*old, *(key for key in new if key not in old)]:
        inner = f"{name}.{key}" if name else str(key)
        if name == "files" and key in old and key in new and old[key] != new[key]:
            found.append(f"{key} has changed")
        elif key not in old:
            found.append(f"{inner} is new")
        elif key not in new:
            found.append(f"{inner} is gone")
        else:
            found += differences(old[key], new[key], inner)
    return found


def require_axis(name: str, taken: Sequence[str]) -> None:
    """Refuse names that an axis of a dataset in a store cannot have."""
    reserved = ("law", "scenario", "done", "reason", "diverged", "zarr.json", *METRICS)
    bad = not name or "/" in name or "\\" in name or name.startswith((".", "__"))
    if name in reserved or bad:
        raise ArgumentError(
            f"{name!r} cannot be the name of an axis: use letters, digits, dots and underscores, "
            f"and none of {', '.join(reserved)}."
        )
    if name in taken:
        raise ArgumentError(f"{name} is given twice: keep one of them.")


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}…"
