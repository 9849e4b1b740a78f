"""Immutable objects: the arrays that a frozen dataclass holds cannot be written through.

A frozen dataclass refuses new values for its attributes, but not `run.states[:] = 0`. Arrays are
therefore made read-only at construction; and again whenever an object is rebuilt without its
constructor, by `pickle` or `copy`, where arrays forget that they were: what an object answers
may rest on tables made from them, and compiled functions are compiled anew for arrays that can be
written to.
"""

from __future__ import annotations

import copy
from typing import Any, Self

import numpy as np


class Frozen:
    """A base of frozen dataclasses that hold arrays, alone or in tuples.

    A class with its own ``__post_init__`` calls this one's at its end. Arrays that can be written
    to are copied: nobody else's become read-only, and nobody else can change them. To hand over an
    array without a copy, pass it through `checks.read_only`. A constructor of one's own
    (``init=False``) makes its arrays read-only itself.

    Examples
    --------
    >>> import copy
    >>> import deadtime as dt
    >>> plant = copy.deepcopy(dt.problems.paper().plant)
    >>> plant.A[:] = 0.0
    Traceback (most recent call last):
    ...
    ValueError: assignment destination is read-only
    """

    def __post_init__(self) -> None:
        own = vars(self)
        for name, value in own.items():
            own[name] = _freeze(value)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        _lock(state)


class Stateful:
    """A base of objects that change as they run: `copy.copy` gives one that goes on by itself.

    A copy has arrays of its own, but for those that cannot be written to.
    """

    def __copy__(self) -> Self:
        memo: dict[int, Any] = {}
        _share(vars(self), memo, set())
        return copy.deepcopy(self, memo)


def _share(value: Any, memo: dict[int, Any], seen: set[int]) -> None:
    """Note in `memo` what a copy may share: frozen objects, and arrays nobody can write to."""
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, Frozen) or (isinstance(value, np.ndarray) and not value.flags.writeable):
        memo[id(value)] = value
    elif isinstance(value, dict):
        for part in value.values():
            _share(part, memo, seen)
    elif isinstance(value, (tuple, list)):
        for part in value:
            _share(part, memo, seen)
    elif hasattr(value, "__dict__"):
        _share(vars(value), memo, seen)


def _freeze(value: Any) -> Any:
    """A value, of arrays and of those in tuples a copy that cannot be written to."""
    if isinstance(value, np.ndarray) and value.flags.writeable:
        value = value.copy(order="K")
        value.flags.writeable = False
    elif isinstance(value, tuple):
        parts = [_freeze(part) for part in value]
        if any(new is not old for new, old in zip(parts, value, strict=True)):
            value = type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value


def _lock(value: Any) -> None:
    """Make arrays that nobody else has, those in containers included, read-only in place."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, dict):
        for part in value.values():
            _lock(part)
    elif isinstance(value, (tuple, list)):
        for part in value:
            _lock(part)
