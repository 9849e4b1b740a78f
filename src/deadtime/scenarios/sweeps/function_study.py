"""Studies in Python: a function makes the plant, laws and model of every cell.

A store describes its study, the function and the values that it reads, as JSON: equal descriptions
have equal results. Values are described by content: numbers and texts, arrays by their entries,
other objects by the state that `pickle` would store, without `functools.cached_property`. A
function is its source, its defaults and all that its code reads by name: the values around it, the
globals of its module, and attributes of other modules. Functions, classes and modules of the
standard library and of installed packages are identified by their names.
"""

from __future__ import annotations

import copyreg
import dis
import functools
import hashlib
import inspect
import json
import math
import sys
import sysconfig
import textwrap
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from deadtime.base.checks import count, instance, positive, real_array, require_shape
from deadtime.base.errors import ArgumentError, DeadtimeError
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import weight_of
from deadtime.scenarios.dataset import METRICS, named_laws
from deadtime.scenarios.source import SignalSampler
from deadtime.scenarios.sweeps.axes import Axis, no_write
from deadtime.scenarios.sweeps.study import Cell, Loop, Study, require_axis

_LISTED = 64  # entries of an array that are listed; larger arrays have a digest
_DRAWS = ("Generator", "RandomState", "Random", "SystemRandom")
# Methods that `dataclass` generates from the body of a class.
_GENERATED = ("init", "repr", "eq", "lt", "le", "gt", "ge", "hash", "setattr", "delattr", "replace")
_GENERATED = tuple(f"__{name}__" for name in _GENERATED)
# Beside cached properties: the random state of a distribution, tables that laws cache.
_MADE = ("_random_state", "_table", "_kept")
_LOADS = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF", "LOAD_CLASSDEREF")
_HERE = "make it in the function, from numbers, texts and arrays"


def source_of(function: Callable[..., Any]) -> str:
    """The source text; for a function without one, its name and a digest of its code.

    Lambdas have the digest, too, as several may share a line of source.
    """
    code = function.__code__
    try:
        text = textwrap.dedent(inspect.getsource(code))
    except (OSError, TypeError):
        return f"{function.__qualname__} {_digest_of(code)}"
    return f"{text}{_digest_of(code)}" if code.co_name == "<lambda>" else text


def values_of(function: types.FunctionType) -> dict[str, Any]:
    """The defaults of a function, and all that its code reads by name, as JSON.

    Raises
    ------
    ArgumentError
        If one of these cannot be compared.
    """
    return _Description().values(function, "")


class _Description:
    """Describes values, each once; a value within itself is described by its level there."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[Any, Any]] = {}
        self._within: list[int] = []

    def of(self, value: Any, path: str) -> Any:
        """A value as JSON; `path` is what a message calls it."""
        if value is None or isinstance(value, (str, bool)) or type(value) is int:
            return value
        if type(value) is float:
            return value if math.isfinite(value) else {"number": repr(value)}
        if id(value) in self._known:
            return self._known[id(value)][1]
        if id(value) in self._within:
            return {"again": len(self._within) - self._within.index(id(value))}
        self._within.append(id(value))
        try:
            found = self._inside(value, path)
        finally:
            self._within.pop()
        self._known[id(value)] = value, found
        return found

    def values(self, function: types.FunctionType, path: str) -> dict[str, Any]:
        """Defaults, closure and globals of a function, by name."""
        parameters = inspect.signature(function, follow_wrapped=False).parameters.items()
        found = {name: one.default for name, one in parameters if one.default is not one.empty}
        around = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
        for name, cell in around:
            try:
                found[name] = cell.cell_contents
            except ValueError:  # nothing has been written into it so far
                continue
        for name in _globals_read(function.__code__):
            if name in function.__globals__:
                found.setdefault(name, function.__globals__[name])
        for name, value in list(found.items()):
            if _is_own(value):
                del found[name]
                found |= dict(_reads_of(function.__code__, name, value))
        _require_no_imports(function, path)
        return {name: self.of(value, _join(path, name)) for name, value in found.items()}

    def _inside(self, value: Any, path: str) -> Any:
        if isinstance(value, np.ndarray):
            return self._array(value, path)
        if isinstance(value, np.generic):
            return self._array(np.asarray(value), path)["entries"]
        if type(value) in (list, tuple):
            return [self.of(one, f"{path}[{i}]") for i, one in enumerate(value)]
        if type(value) in (dict, types.MappingProxyType):
            named = {
                key if isinstance(key, str) else f"({self.of(key, path)})": part
                for key, part in value.items()
            }
            return {name: self.of(part, _join(path, name)) for name, part in named.items()}
        if type(value) in (set, frozenset):
            return {"set": sorted((self.of(one, path) for one in value), key=json.dumps)}
        if type(value) in (bytes, bytearray):
            return {"bytes": hashlib.sha256(value).hexdigest()}
        if isinstance(value, types.ModuleType):
            if _is_own(value):
                _refuse(value, path, "read what it holds by name, as in settings.delay")
            return {"module": value.__name__}
        if isinstance(value, types.FunctionType):
            return self._function(value, path)
        if isinstance(value, type):
            return self._class(value, path)
        return self._object(value, path)

    def _array(self, value: np.ndarray, path: str) -> dict[str, Any]:
        kind = f"{value.dtype} {value.shape}"
        if value.dtype.hasobject or (value.size <= _LISTED and value.dtype.char not in "gG"):
            return {"array": kind, "entries": self.of(value.tolist(), path)}
        return {"array": kind, "entries": hashlib.sha256(value.tobytes()).hexdigest()}

    def _function(self, function: types.FunctionType, path: str) -> Any:
        if _is_library(function.__module__):
            return {"(function)": f"{function.__module__}.{function.__qualname__}"}
        return {"(function)": source_of(function), **self.values(function, path)}

    def _class(self, own: type, path: str) -> Any:
        """A class: by name, or by its bases and all definitions of its body."""
        found: dict[str, Any] = {"(class)": f"{own.__module__}.{own.__qualname__}"}
        if _is_library(own.__module__):
            return found
        found["(bases)"] = self.of(list(own.__bases__), path)
        for name, part in vars(own).items():
            inner = getattr(part, "fget", None) or getattr(part, "func", None)
            inner = inner or getattr(part, "__func__", None) or part
            if isinstance(inner, types.FunctionType):
                if not (name in _GENERATED and "__dataclass_fields__" in vars(own)):
                    found[name] = self.of(inner, _join(path, name))
            elif not name.startswith("__") and name != "_abc_impl" and not _is_slot(inner):
                found[name] = self.of(inner, _join(path, name))
        return found

    def _object(self, value: Any, path: str) -> Any:
        """Any other object, by the parts from which `pickle` would make it again."""
        module = getattr(value, "__module__", None) or type(value).__module__
        if type(value).__name__ in _DRAWS:
            _refuse(value, path, "make it in the function, from a seed")
        wrapped = getattr(value, "__wrapped__", None) or getattr(value, "py_func", None)
        if isinstance(wrapped, types.FunctionType) and _is_library(type(value).__module__):
            # functools.lru_cache, numba.njit
            return {"(type)": type(value).__name__, "(of)": self.of(wrapped, path)}
        try:
            reduce = copyreg.dispatch_table.get(type(value))
            parts = value.__reduce_ex__(2) if reduce is None else reduce(value)
        except Exception:  # an object that cannot be copied may raise anything
            _refuse(value, path, _HERE)
        if isinstance(parts, str):
            if not _is_library(module):
                _refuse(value, path, _HERE)
            return {"name": f"{module}.{parts}"}
        made_by, arguments = parts[:2]
        state, items, pairs = (*parts[2:5], None, None, None)[:3]
        found: dict[str, Any] = {"(type)": self.of(type(value), path)}
        if made_by.__name__ != "__newobj__" or arguments != (type(value),):
            found["(of)"] = self.of([made_by, *arguments], path)
        if items is not None:
            found["(items)"] = self.of(list(items), path)
        if isinstance(state, tuple) and len(state) == 2:  # __dict__, and what is in __slots__
            state = {**(state[0] or {}), **(state[1] or {})}
        if isinstance(state, dict):
            state = {name: part for name, part in state.items() if not _is_made(value, name)}
            found |= {name: self.of(part, _join(path, name)) for name, part in state.items()}
        elif state is not None:
            found["(state)"] = self.of(state, path)
        if pairs is not None:
            found["(pairs)"] = self.of([list(pair) for pair in pairs], path)
        return found


def _globals_read(code: types.CodeType) -> Iterator[str]:
    """Names that code and the functions within it look up in its module."""
    for one in _with_inner(code):
        for step in dis.get_instructions(one):
            if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
                yield step.argval


def _with_inner(code: types.CodeType) -> Iterator[types.CodeType]:
    """Code, and that of all functions within it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _with_inner(constant)


def _reads_of(
    code: types.CodeType, name: str, module: types.ModuleType
) -> Iterator[tuple[str, Any]]:
    """The attributes of a module that code, and functions within it, read under the module's name.

    For a module within the module these are the attributes read of the inner one.
    """
    for one in _with_inner(code):
        steps = list(dis.get_instructions(one))
        for place, step in enumerate(steps):
            if step.opname not in _LOADS or step.argval != name:
                continue
            path, value = name, module
            for after in steps[place + 1 :]:
                if not _is_own(value) or after.opname not in ("LOAD_ATTR", "LOAD_METHOD"):
                    break
                path, value = f"{path}.{after.argval}", getattr(value, after.argval, None)
            yield path, value


def _require_no_imports(function: types.FunctionType, path: str) -> None:
    """Refuse a function that imports modules which are neither Python's nor installed."""
    for code in _with_inner(function.__code__):
        steps = list(dis.get_instructions(code))
        for place, step in enumerate(steps):
            if step.opname != "IMPORT_NAME":
                continue
            relative = steps[place - 2].argval > 0  # the level, then the names, are loaded before
            if relative or not _is_library(step.argval):
                name = step.argval or "of its package"
                raise ArgumentError(
                    f"function{f' {path}' if path else ''} imports {name} within itself, which "
                    "cannot be compared with that of another run of the study: import it at the "
                    "top of the file."
                )


def _digest_of(code: types.CodeType) -> str:
    """A digest of code that does not depend on its file and line."""

    def parts(one: types.CodeType) -> list[Any]:
        inner = [parts(c) if isinstance(c, types.CodeType) else repr(c) for c in one.co_consts]
        names = [*one.co_names, *one.co_varnames, *one.co_freevars, *one.co_cellvars]
        return [one.co_code.hex(), inner, names]

    return hashlib.sha256(json.dumps(parts(code)).encode()).hexdigest()


@functools.cache
def _is_library(name: str | None) -> bool:
    """Whether a module is of Python, of this package or of an installed one."""
    top = (name or "").split(".")[0]
    if top in sys.stdlib_module_names or top == __name__.split(".")[0]:
        return top != "__main__"
    file = getattr(sys.modules.get(top), "__file__", None)
    folders = {sysconfig.get_path(kind) for kind in ("purelib", "platlib")}
    return file is not None and any(Path(file).is_relative_to(folder) for folder in folders)


def _is_own(value: Any) -> bool:
    """Whether a value is a module that is neither Python's nor installed."""
    return isinstance(value, types.ModuleType) and not _is_library(value.__name__)


def _is_made(value: Any, name: str) -> bool:
    """Whether an entry of an object's state follows from the others, or is documentation."""
    kept = inspect.getattr_static(type(value), name, None)
    ours = any(_is_library(base.__module__) for base in type(value).__mro__ if base is not object)
    return (
        isinstance(kept, functools.cached_property) or name == "__doc__" or (ours and name in _MADE)
    )


def _is_slot(part: Any) -> bool:
    return isinstance(part, (types.MemberDescriptorType, types.GetSetDescriptorType))


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _refuse(value: Any, path: str, advice: str) -> NoReturn:
    raise ArgumentError(
        f"function reads {path}, a {type(value).__name__}, which cannot be compared with that of "
        f"another run of the study: {advice}."
    )


_KEYS = ("plant", "laws", "model", "x0", "horizon", "step")


@dataclass(frozen=True, eq=False, kw_only=True)
class FunctionStudy(Study):
    """A study whose cells a function makes (immutable); see `function_study`.

    Attributes
    ----------
    function : callable
        From a cell's values to a mapping of arguments of `monte_carlo`.
    values : mapping
        Everything else that the function reads.
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
        that it reads identify the study: arrays, plants, laws, helpers and nested mappings by
        content, libraries by name.
    grid : mapping
        From names to values, numbers or texts. ``seed`` is the seed of the signals.
    scenarios, seed : int
        Signals per cell, and their seed.
    metrics : sequence of str
        Metrics of `monte_carlo` to store.
    title : str

    Raises
    ------
    ArgumentError
        If an axis is empty or holds a value twice, the function does not make a loop of the grid's
        first cell, or it reads a value that cannot be compared between runs, such as an open file
        or a random generator.

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
    """A `Loop` of the mapping that the function returned, checked."""
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
