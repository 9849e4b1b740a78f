"""Studies in Python: a function makes the plant, laws and model of every cell."""

from __future__ import annotations

import hashlib
import inspect
import marshal
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deadtime.checks import count, instance
from deadtime.errors import ArgumentError
from deadtime.monte_carlo.dataset import METRICS
from deadtime.monte_carlo.named import named_laws
from deadtime.sweeps.study import Cell, Loop, Study

_KEYS = ("plant", "laws", "model", "x0", "horizon", "step")


@dataclass(frozen=True, eq=False, kw_only=True)
class FunctionStudy(Study):
    """A study whose cells a function makes (immutable); see `function_study`."""

    function: Callable[..., Mapping[str, Any]]

    def particulars(self) -> dict[str, Any]:
        return {"function": _text(self.function)}

    def loop(self, cell: Cell) -> Loop:
        given = {name: value for name, value in cell.values.items() if name != "seed"}
        return _loop(self.function(**given))


def function_study(
    function: Callable[..., Mapping[str, Any]],
    grid: Mapping[str, Sequence[Any]],
    scenarios: int = 200,
    seed: int = 0,
    metrics: Sequence[str] = tuple(METRICS),
    title: str = "",
) -> FunctionStudy:
    """A study whose cells are made in Python: any plant, law, model or loop.

    Parameters
    ----------
    function : callable
        Called with a cell's values as keyword arguments (but for ``seed``); returns a mapping with
        ``plant``, ``laws`` (named alike in every cell), ``model``, ``x0``, ``horizon``, ``step``
        and perhaps ``imperfections``, as `monte_carlo` takes them. It runs on the workers; its
        source text is part of what tells studies apart, values that it reads from outside are not.
    grid : mapping
        From names to values, numbers or texts. ``seed`` stands for that of the signals.
    scenarios, seed : int
        Signals per cell, and their seed.
    metrics : sequence of str
        Those of `monte_carlo` to keep.
    title : str

    Raises
    ------
    ArgumentError
        If the grid is empty somewhere or holds a value twice, or the function does not make a loop
        of the grid's first cell.

    Examples
    --------
    >>> import deadtime as dt
    >>> def loop(delay, weight):
    ...     problem = dt.problems.paper()
    ...     plant = dt.SwitchedSystem(problem.plant.A, problem.plant.B, delay)
    ...     laws = {"mine": dt.AveragedPredictor(plant, problem.gains, [weight, 1 - weight])}
    ...     model = dt.Markov([[0, 2], [2, 0]])
    ...     return dict(plant=plant, laws=laws, model=model, x0=[1, 0], horizon=5, step=0.02)
    >>> study = function_study(loop, {"delay": [0.5, 1.0], "weight": [0.3, 0.5, 0.7]}, scenarios=50)
    >>> study.size, study.laws
    (6, ('mine',))
    """
    if not callable(function):
        raise ArgumentError(f"function must be callable, got {type(function).__name__}.")
    instance("grid", grid, Mapping)
    axes = {str(name): _axis(str(name), values) for name, values in grid.items()}
    for metric in metrics:
        if metric not in METRICS:
            raise ArgumentError(f"metrics must be some of {list(METRICS)}, got {metric!r}.")
    study = FunctionStudy(
        grid=axes,
        laws=(),
        scenarios=count("scenarios", scenarios),
        seed=count("seed", seed, 0),
        metrics=tuple(metrics),
        title=title or getattr(function, "__name__", ""),
        text=_text(function),
        function=function,
    )
    laws = tuple(study.loop(next(study.cells())).laws)
    return FunctionStudy(**{**vars(study), "laws": laws})


def _axis(name: str, values: Sequence[Any]) -> tuple[Any, ...]:
    """At least one number or text, and none twice."""
    if isinstance(values, (str, bytes)) or not np.iterable(values):
        raise ArgumentError(f"grid[{name!r}] must be a list of values, got {values!r}.")
    listed = [value.item() if isinstance(value, np.generic) else value for value in values]
    for value in listed:
        if not isinstance(value, (int, float, str)):
            raise ArgumentError(f"grid[{name!r}] must hold numbers or texts, got {value!r}.")
    if not listed or len(set(listed)) < len(listed):
        raise ArgumentError(
            f"grid[{name!r}] must hold at least one value and none twice, got {listed}."
        )
    return tuple(listed)


def _loop(made: Any) -> Loop:
    """What the function returned, by name."""
    allowed = (*_KEYS, "imperfections")
    if not isinstance(made, Mapping) or not set(_KEYS) <= set(made) <= set(allowed):
        got = sorted(made) if isinstance(made, Mapping) else type(made).__name__
        raise ArgumentError(
            f"function must return a mapping with {', '.join(_KEYS)} and perhaps imperfections, "
            f"got {got}."
        )
    parts = dict(made)
    parts["laws"] = named_laws(parts["laws"])
    parts["x0"] = np.asarray(parts["x0"], dtype=float)
    parts["horizon"], parts["step"] = float(parts["horizon"]), float(parts["step"])
    return Loop(**parts)


def _text(function: Callable[..., Any]) -> str:
    """The source text; of a function that has none, its name and a digest of what it does."""
    try:
        return textwrap.dedent(inspect.getsource(function))
    except (OSError, TypeError):
        name = getattr(function, "__qualname__", type(function).__name__)
        code = getattr(function, "__code__", None)
        digest = "" if code is None else hashlib.sha256(marshal.dumps(code)).hexdigest()
        return f"{name} {digest}".strip()
