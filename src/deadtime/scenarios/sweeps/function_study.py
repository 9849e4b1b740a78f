"""Studies in Python: a function makes the plant, laws and model of every cell."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deadtime.base.checks import count, instance, positive, real_array, require_shape
from deadtime.base.errors import ArgumentError, DeadtimeError
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import weight_of
from deadtime.scenarios.dataset import METRICS
from deadtime.scenarios.named_laws import named_laws
from deadtime.scenarios.source import SignalSampler
from deadtime.scenarios.sweeps.axes import Axis, no_write
from deadtime.scenarios.sweeps.content import source_of, values_of
from deadtime.scenarios.sweeps.study import Cell, Loop, Study, require_axis

_KEYS = ("plant", "laws", "model", "x0", "horizon", "step")


@dataclass(frozen=True, eq=False, kw_only=True)
class FunctionStudy(Study):
    """A study whose cells a function makes (immutable); see `function_study`.

    Attributes
    ----------
    function : callable
        From a cell's values to a mapping of what `monte_carlo` takes.
    values : mapping
        All that the function reads beside them, as `deadtime.scenarios.sweeps.content` puts it.
    """

    function: Callable[..., Mapping[str, Any]]
    values: Mapping[str, Any]

    def particulars(self) -> dict[str, Any]:
        return {"function": self.text, "values": dict(self.values)}

    def loop(self, cell: Cell) -> Loop:
        given = {name: value for name, value in cell.values.items() if name != "seed"}
        try:
            made = self.function(**given)
        except DeadtimeError:
            raise
        except Exception as error:
            raise ArgumentError(f"function failed: {type(error).__name__}: {error}.") from None
        return _loop(made)

    def axis(self, name: str) -> Axis:
        return Axis(name, name, "", no_write)


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
        and perhaps ``imperfections`` and ``weight``, as `monte_carlo` takes them. It
        runs on the workers. Its source text, its defaults, the values around it and the globals
        that it reads tell studies apart: arrays, plants, laws, helpers and nested mappings by what
        they hold, libraries by name.
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
        If the grid is empty somewhere or holds a value twice, the function does not make a loop
        of the grid's first cell, or it reads something that cannot be compared with what another
        run reads, such as an open file or a random generator.

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
    if not inspect.isfunction(function):
        raise ArgumentError(
            f"function must be a function, got {type(function).__name__}: write one by def."
        )
    instance("grid", grid, Mapping)
    axes: dict[str, tuple[Any, ...]] = {}
    for name, values in grid.items():
        require_axis(str(name), list(axes))
        axes[str(name)] = _axis(str(name), values)
    for metric in metrics:
        if metric not in METRICS or list(metrics).count(metric) > 1:
            raise ArgumentError(
                f"metrics must be some of {list(METRICS)}, each once, got {metric!r}."
            )
    study = FunctionStudy(
        grid=axes,
        laws=(),
        scenarios=count("scenarios", scenarios),
        seed=count("seed", seed, 0),
        metrics=tuple(metrics),
        title=title or getattr(function, "__name__", ""),
        text=source_of(function),
        function=function,
        values=values_of(function),
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
    allowed = (*_KEYS, "imperfections", "weight")
    if not isinstance(made, Mapping) or not set(_KEYS) <= set(made) <= set(allowed):
        got = sorted(made) if isinstance(made, Mapping) else type(made).__name__
        raise ArgumentError(
            f"function must return a mapping with {', '.join(_KEYS)} and perhaps imperfections "
            f"and weight, got {got}."
        )
    parts = dict(made)
    instance("plant", parts["plant"], SwitchedSystem)
    if not isinstance(parts["model"], SignalSampler):
        raise ArgumentError(
            "model must have a method sample(horizon, seed), such as Markov and SemiMarkov, got "
            f"{type(parts['model']).__name__}."
        )
    parts["laws"] = named_laws(parts["laws"])
    parts["x0"] = real_array("x0", parts["x0"], "(n,)", 1)
    require_shape("x0", parts["x0"], (parts["plant"].states,), "(n,)")
    parts["horizon"] = positive("horizon", parts["horizon"])
    parts["step"] = positive("step", parts["step"])
    parts["weight"] = weight_of(parts.get("weight"), parts["plant"])
    return Loop(**parts)
