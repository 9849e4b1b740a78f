"""Kernels: plain loops, interpreted by Python until compiling them pays.

Compiling a kernel takes seconds, once per machine; a run of a thousand periods takes milliseconds
in it. So a kernel is interpreted first, and compiled by Numba

- when the process has spent `START` seconds in kernels, if this machine has it compiled already,
- otherwise when the kernel has taken `PATIENCE` seconds itself,
- at once for large arguments (`@kernel(large=…)` sets their size), and with `@kernel(eager=True)`.

That takes at most twice the time of the better choice, and a short run needs neither Numba nor a
compiler. An equivalent function of NumPy on all pieces, `plain`, replaces the interpreted loops for
arguments of any size. All ways do the same floating-point operations in the same order, so that
results do not depend on the choice. Kernels consist of loops and scalars over arrays that exist
before the loops: each array expression takes seconds to compile. A kernel that only compiled
kernels call has `no_cpython_wrapper=True`: converting its arguments from Python may take as long to
compile as the kernel itself.

DEADTIME_COMPILE=always compiles everything at its first call; =never compiles eager kernels only.
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

START = 1.0  # seconds of all kernels of a process: about the time to load Numba
PATIENCE = 2.0  # seconds of one kernel
LARGE = 50_000  # numbers in array arguments, and values of integer ones, together
WISH = os.environ.get("DEADTIME_COMPILE", "auto")


class _Thread(threading.local):
    interpreting = False  # whether the thread is within an interpreted kernel


_THREAD = _Thread()


class Kernel:
    """A function of plain loops that is compiled where that pays.

    Attributes
    ----------
    function : callable
        The decorated function.
    eager : bool
        Whether it is compiled at its first call.
    options : dict
        For `numba.njit`.
    plain : callable or None
        A function of NumPy in place of the interpreted one.
    large : float
        Size of the arguments from which it is compiled at once.
    """

    spent = 0.0  # seconds of this process in interpreted kernels

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
        within = _THREAD.interpreting
        if self._pays(args, within):
            self._ready = self.dispatcher
            return self.dispatcher(*args)
        if not within:
            return self._interpret(args)
        # The outermost kernel counts towards `spent`, and converts numbers at the end.
        began = time.perf_counter()
        try:
            return (self.plain or self.function)(*args)
        finally:
            self._own += time.perf_counter() - began

    @functools.cached_property
    def dispatcher(self) -> Any:
        """Numba's dispatcher."""
        from deadtime.numerics.compiling import dispatcher_of

        return dispatcher_of(self)

    def _pays(self, args: tuple[Any, ...], within: bool) -> bool:
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
        # Processor time, not wall time: on a busy machine compiling takes longer, too.
        began, _THREAD.interpreting = time.thread_time(), True
        try:
            # Compiled code does not warn about overflow either.
            with np.errstate(all="ignore"):
                return _plain_numbers((self.plain or self.function)(*args))
        finally:
            _THREAD.interpreting, took = False, time.thread_time() - began
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
    """A kernel that is inlined into its callers and allocates no arrays.

    For functions within the loop of a large kernel: a call with arrays in tuples takes longer than
    a few lines of vector arithmetic, and so does reference counting of arrays, which a function
    without allocations does not need (`_nrt=False`).
    """
    return Kernel(
        function,
        eager=True,
        options={"nogil": True, "no_cpython_wrapper": True, "forceinline": True, "_nrt": False},
    )


def expect_many_calls() -> None:
    """Announce long work in kernels: those that this machine has compiled are used at once."""
    Kernel.spent = max(Kernel.spent, START)


def _plain_numbers(result: Any) -> Any:
    """A result with Python's numbers in place of NumPy's, as a compiled function returns it."""
    if isinstance(result, np.generic):
        return result.item()
    if isinstance(result, tuple):
        parts = [_plain_numbers(part) for part in result]
        return type(result)(*parts) if hasattr(result, "_fields") else tuple(parts)
    return result


def _size(args: tuple[Any, ...]) -> int:
    """The number of numbers in the arguments, plus the values of integers, which are counts."""
    total = 0
    for arg in args:
        if isinstance(arg, np.ndarray):
            total += arg.size
        elif isinstance(arg, tuple):
            total += _size(arg)
        elif isinstance(arg, int):
            total += arg
    return total
