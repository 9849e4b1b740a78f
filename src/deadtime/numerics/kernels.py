"""Kernels: plain loops, run by Python until they have cost about what compiling them would.

To compile a kernel takes seconds, once per machine; a run of a thousand periods spends
milliseconds in it. So a kernel starts as the Python that it is, and goes over to Numba

- as soon as a process has spent `START` seconds in kernels, where this machine has it compiled,
- where not, once it has cost `PATIENCE` seconds itself,
- at once where its arguments are large, and where it says so (`@kernel(eager=True)`). What is large
  is what Python is likely to spend its patience on: a kernel whose time grows as its arguments do
  can say how many numbers those are (`@kernel(large=…)`).

At worst that is twice the time of the better choice, and a short run needs neither Numba nor a
compiler. Where NumPy does the same over all pieces at once, it is given as `plain`: that runs in
place of the Python, however large the arguments are. Both ways do the same floating-point
operations in the same order: no figure depends on which is taken. What is written for both keeps to
loops and scalars over arrays that its caller or its first lines make: array expressions cost
seconds of compiling each. A kernel that only compiled kernels call says `no_cpython_wrapper=True`:
unpacking its arguments from Python's may cost as much to compile as the kernel itself.

DEADTIME_COMPILE=always compiles everything at its first call; =never compiles nothing but what is
eager.
"""

from __future__ import annotations

import functools
import math
import os
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

START = 1.0  # seconds of all kernels of a process: about what loading Numba costs
PATIENCE = 2.0  # seconds of one kernel
LARGE = 50_000  # numbers in the arguments, or times that they say
WISH = os.environ.get("DEADTIME_COMPILE", "auto")


class _Here(threading.local):
    """Of each thread: whether it runs a kernel as Python."""

    within = False


_HERE = _Here()


class Kernel:
    """A function of plain loops that is compiled where that pays.

    Attributes
    ----------
    function : callable
        What was decorated, as Python.
    eager : bool
        Whether it is never run as Python.
    options : dict
        For `numba.njit`.
    plain : callable or None
        What runs in place of the function as Python.
    large : float
        How many numbers in the arguments are too many for Python.
    """

    spent = 0.0  # seconds of this process in the Python of kernels

    def __init__(
        self,
        function: Callable[..., Any],
        eager: bool,
        options: dict[str, Any],
        plain: Callable[..., Any] | None = None,
        large: float | None = None,
    ) -> None:
        functools.update_wrapper(self, function)
        self.function, self.eager, self.options, self.plain = function, eager, options, plain
        self.large = (LARGE if plain is None else math.inf) if large is None else large
        self._own, self._asked = 0.0, False
        self._ready: Callable[..., Any] | None = None

    def __reduce__(self) -> str:
        return self.function.__qualname__

    def __call__(self, *args: Any) -> Any:
        if self._ready is not None:
            return self._ready(*args)
        within = _HERE.within
        if self._pays(args, within):
            self._ready = self.dispatcher
            return self.dispatcher(*args)
        if not within:
            return self._interpret(args)
        began = time.perf_counter()
        try:
            return (self.plain or self.function)(*args)
        finally:
            self._own += time.perf_counter() - began

    @functools.cached_property
    def dispatcher(self) -> Any:
        """Numba's dispatcher of it."""
        from deadtime.numerics.compiling import dispatcher_of

        return dispatcher_of(self)

    def _pays(self, args: tuple[Any, ...], within: bool) -> bool:
        """Whether it is time to leave Python."""
        if self.eager or WISH == "never":
            return self.eager
        if WISH == "always" or self._own > PATIENCE:
            return True
        if not within and self.large < math.inf and _size(args) > self.large:
            return True
        if self._asked or Kernel.spent < START:
            return False
        from deadtime.numerics.compiling import is_cached

        self._asked = True
        return is_cached(self.dispatcher)

    def _interpret(self, args: tuple[Any, ...]) -> Any:
        # Of a processor, not of the clock: on a busy machine compiling takes longer, too.
        began, _HERE.within = time.thread_time(), True
        try:
            # Compiled code says nothing about overflow either.
            with np.errstate(all="ignore"):
                return _plain_numbers((self.plain or self.function)(*args))
        finally:
            _HERE.within, took = False, time.thread_time() - began
            self._own += took
            Kernel.spent += took


def kernel(
    function: Callable[..., Any] | None = None,
    *,
    eager: bool = False,
    plain: Callable[..., Any] | None = None,
    large: float | None = None,
    **options: Any,
) -> Any:
    """Make a function of plain loops a kernel; options are those of `numba.njit`.

    Examples
    --------
    >>> @kernel
    ... def total(a):
    ...     sum = 0.0
    ...     for i in range(a.size):
    ...         sum += a[i]
    ...     return sum
    >>> float(total(np.ones(3)))
    3.0
    """
    if function is None:
        return lambda inner: Kernel(inner, eager, options, plain, large)
    return Kernel(function, eager, options, plain, large)


def inner_kernel(function: Callable[..., Any]) -> Kernel:
    """A kernel that becomes a part of those that call it, and makes no arrays.

    For what is done again and again within a loop of a large kernel. A call that hands over arrays
    in tuples costs more than a few lines of vectors, and so does counting how often each array is
    in use, with every look into a tuple; who makes none need not count.
    """
    return Kernel(
        function,
        eager=True,
        options={"nogil": True, "no_cpython_wrapper": True, "forceinline": True, "_nrt": False},
    )


def expect_many_calls() -> None:
    """Say that kernels will run for long: what this machine has compiled is used from now on."""
    Kernel.spent = max(Kernel.spent, START)


def _plain_numbers(result: Any) -> Any:
    """A result with Python's numbers in place of NumPy's, as Numba returns it."""
    if isinstance(result, np.generic):
        return result.item()
    if isinstance(result, tuple):
        parts = [_plain_numbers(part) for part in result]
        return type(result)(*parts) if hasattr(result, "_fields") else tuple(parts)
    return result


def _size(args: tuple[Any, ...]) -> int:
    """How many numbers the arguments hold, and what counts among them count."""
    total = 0
    for arg in args:
        if isinstance(arg, np.ndarray):
            total += arg.size
        elif isinstance(arg, tuple):
            total += _size(arg)
        elif isinstance(arg, int):
            total += arg
    return total
