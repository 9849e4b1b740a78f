"""Immutable objects: the arrays that a frozen dataclass holds cannot be written through.

A frozen dataclass refuses new values for its attributes, but not `run.states[:] = 0`. Arrays are
therefore made read-only at construction, and again by `pickle` and `copy`, which restore an object
without its constructor and with writable arrays: an object may cache tables computed from its
arrays, and Numba would compile every function again for writable ones.
"""

from __future__ import annotations

import copy
from typing import Any, Self

import numpy as np


class Frozen:
    """A base of frozen dataclasses that hold arrays, alone or in tuples.

    A class with its own ``__post_init__`` calls this one at its end. Writable arrays are copied, so
    that the caller's stay writable and changes of them have no effect; an array that passed
    `checks.read_only` is not. A class with its own constructor (``init=False``) makes its arrays
    read-only itself.

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
        # Through `vars`, because a frozen dataclass refuses assignment.
        own = vars(self)
        for name, value in own.items():
            own[name] = _freeze(value)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        _lock(state)


class Stateful:
    """A base of objects with a running state: `copy.copy` gives an independent one.

    The two share read-only arrays and frozen objects.
    """

    def __copy__(self) -> Self:
        memo: dict[int, Any] = {}
        _share(vars(self), memo, set())
        return copy.deepcopy(self, memo)


def _share(value: Any, memo: dict[int, Any], seen: set[int]) -> None:
    """Enter into deepcopy's `memo` the frozen objects and read-only arrays in a value."""
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
    """A value with its arrays, also those in tuples, as read-only copies."""
    if isinstance(value, np.ndarray) and value.flags.writeable:
        value = value.copy(order="K")
        value.flags.writeable = False
    elif isinstance(value, tuple):
        parts = [_freeze(part) for part in value]
        if any(new is not old for new, old in zip(parts, value, strict=True)):
            value = type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value


def _lock(value: Any) -> None:
    """Make arrays, also those in containers, read-only in place."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, dict):
        for part in value.values():
            _lock(part)
    elif isinstance(value, (tuple, list)):
        for part in value:
            _lock(part)
