"""What Numba does for kernels: compiles them, and keeps them as long as their sources stand."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from types import FunctionType
from typing import Any

from numba import njit, types
from numba.core import event
from numba.core.caching import IndexDataCacheFile
from numba.extending import typeof_impl

from deadtime.numerics import kernels
from deadtime.numerics.kernels import Kernel

_LONG = 1.0  # seconds of one compilation after which it is said


@typeof_impl.register(Kernel)
def _typeof_kernel(kernel: Kernel, _: Any) -> types.Dispatcher:
    """Kernels that call kernels call what Numba makes of them."""
    return types.Dispatcher(kernel.dispatcher)


def dispatcher_of(kernel: Kernel) -> Any:
    """A kernel's dispatcher, which keeps what it compiles on disk where it can."""
    dispatcher = njit(**kernel.options)(kernel.function)
    try:
        dispatcher.enable_caching()
    except RuntimeError:  # no folder can be written: it is compiled anew in each process
        return dispatcher
    cache = dispatcher._cache
    # Numba's own stamp is that of one file, and calls into others would go unnoticed.
    cache._cache_file = IndexDataCacheFile(
        cache.cache_path, cache._impl.filename_base, _stamp(kernel.function)
    )
    return dispatcher


def is_cached(dispatcher: Any) -> bool:
    """Whether this machine has it compiled, for whatever arguments."""
    cache = getattr(dispatcher, "_cache", None)
    return hasattr(cache, "_cache_file") and bool(cache._cache_file._load_index())


def _stamp(function: FunctionType) -> tuple[Any, ...]:
    """Name, time and size of the files that a function and the kernels that it calls lie in."""
    files = sorted({each.__code__.co_filename for each in _reached(function, set())})
    found = [(name, os.stat(name)) for name in files if os.path.exists(name)]
    return tuple((os.path.basename(name), at.st_mtime_ns, at.st_size) for name, at in found)


def _reached(function: FunctionType, seen: set[FunctionType]) -> Iterator[FunctionType]:
    """A function and all kernels that it calls."""
    if function in seen:
        return
    seen.add(function)
    yield function
    for name in function.__code__.co_names:
        called = function.__globals__.get(name)
        if isinstance(called, Kernel):
            yield from _reached(called.function, seen)


class _Notice(event.Listener):
    """Calls `kernels.notice` once compiling takes a while."""

    def __init__(self) -> None:
        self._depth, self._timer = 0, threading.Timer(0.0, kernels.notice)

    def on_start(self, event: Any) -> None:
        self._depth += 1
        if self._depth == 1:
            self._timer = threading.Timer(_LONG, kernels.notice)
            self._timer.daemon = True
            self._timer.start()

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._timer.cancel()


event.register("numba:compile", _Notice())
