"""Compilation of kernels by Numba, with a cache on disk that is valid until a source changes.

A `deadtime.numerics.kernels.Kernel` imports this module when it needs Numba.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pickle
import threading
import time
from collections.abc import Callable, Iterator
from types import CodeType, FunctionType
from typing import Any

from numba import njit, types
from numba.core import event
from numba.core.caching import IndexDataCacheFile
from numba.extending import typeof_impl

from deadtime.base import notices
from deadtime.numerics.lanes.code import make_code
from deadtime.numerics.lanes.operators import make_operators  # registers operators of vectors

_LONG = 1.0  # seconds of compiling after which there is a notice


class _CacheFile(IndexDataCacheFile):
    """The files of a kernel on disk: one for each signature, named by a hash of it.

    Numba's index of a kernel's files is read, extended and written. With two processes compiling at
    the same time, one loses its entry, or gets the other's code for its own signature. Here the
    index only marks that a file exists.
    """

    def save(self, key: Any, data: Any) -> None:
        content = self._dump((key, data))
        self._save_data(self._file_of(key), (self._version, self._source_stamp, content))
        if not self._load_index():
            self._save_index({"any": True})

    def load(self, key: Any) -> Any:
        try:
            version, stamp, content = self._load_data(self._file_of(key))
            if (version, stamp) != (self._version, self._source_stamp):
                return None
            found, data = pickle.loads(content)
        except (OSError, AttributeError, ImportError):  # no file, or types that have been renamed
            return None
        return data if found == key else None

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except (AttributeError, ImportError):  # types that have been renamed
            return {}

    def _file_of(self, key: Any) -> str:
        digest = hashlib.sha256(repr(key).encode()).hexdigest()
        return self._data_name(int(digest[:12], 16))


def dispatcher_of(kernel: Any) -> Any:
    """A kernel's dispatcher, with a cache on disk if a folder is writable."""
    _register_type(type(kernel))
    # A wrapper for callers in C takes a tenth of the time to compile, and kernels have none.
    options: dict[str, Any] = {"no_cfunc_wrapper": True, **kernel.options}
    dispatcher: Any = njit(**options)(kernel.function)
    try:
        dispatcher.enable_caching()
    except RuntimeError:  # no writable folder: it is compiled in each process
        return dispatcher
    # Numba's own stamp is that of one file, so that changes of called functions have no effect.
    with contextlib.suppress(AttributeError):  # in a Numba with other names, its own stamp remains
        cache, own = dispatcher._cache, dispatcher._cache._cache_file
        files = _CacheFile(cache.cache_path, cache._impl.filename_base, _stamp(kernel))
        cache._cache_file = files if isinstance(own, IndexDataCacheFile) else own
    return dispatcher


def is_cached(dispatcher: Any) -> bool:
    """Whether this machine has it compiled for some arguments; False if that is unknown."""
    try:
        return bool(dispatcher._cache._cache_file._load_index())
    except AttributeError:  # no cache, or a Numba with other names
        return False


def is_kept(dispatcher: Any) -> bool:
    """Whether compiled code is cached for other processes."""
    return isinstance(getattr(dispatcher._cache, "_cache_file", None), _CacheFile)


class _Listener(event.Listener):
    """Calls a function with the dispatcher whenever compiling starts."""

    def __init__(self, do: Callable[[Any], None]) -> None:
        self._do = do

    def on_start(self, event: Any) -> None:
        self._do(event.data["dispatcher"])

    def on_end(self, event: Any) -> None:
        pass


@contextlib.contextmanager
def where_compiling_starts(do: Callable[[Any], None]) -> Iterator[None]:
    """Call do(dispatcher) whenever a function is compiled, but not when it is loaded from disk."""
    with event.install_listener("numba:compile", _Listener(do)):
        yield


def _stamp(kernel: Any) -> tuple[Any, ...]:
    """The stamp of a kernel and of all functions of the package that it calls, recursively.

    It is the name, time and size of their files, and the global numbers that they use.
    """
    reached, codes, numbers = [kernel.function, make_operators, make_code], [], []
    for function in reached:
        inner = [function.__code__]
        for code in inner:  # intrinsics contain the functions that generate their code
            inner += [part for part in code.co_consts if isinstance(part, CodeType)]
            for name in code.co_names:
                named = function.__globals__.get(name)
                called = _function_of(named, function)
                if called is not None and called not in reached:
                    reached.append(called)
                elif isinstance(named, int | float | tuple):
                    numbers.append((name, repr(named)))
        codes.append(function.__code__)
    files = sorted({code.co_filename for code in codes})
    found = [(name, os.stat(name)) for name in files if os.path.exists(name)]
    times = ((os.path.basename(name), at.st_mtime_ns, at.st_size) for name, at in found)
    return (*times, *numbers)


def _function_of(named: Any, caller: Any) -> Any:
    """The Python function of a callee, if it is a kernel or of the caller's package; else None."""
    function = named
    for attribute in ("function", "py_func", "_defn"):  # of a kernel, a dispatcher, an intrinsic
        function = getattr(named, attribute, function)
    if not isinstance(function, FunctionType):
        return None
    package = function.__module__.partition(".")[0]
    own = hasattr(named, "dispatcher") or package == caller.__module__.partition(".")[0]
    return function if own else None


@functools.cache
def _register_type(kind: Any) -> None:
    """Let kernels call kernels."""
    typeof_impl.register(kind)(lambda kernel, _: types.Dispatcher(kernel.dispatcher))


class _Notice(event.Listener):
    """Calls `notices.compiling` when compiling takes long, of kernels and `njit` functions."""

    def __init__(self) -> None:
        self._depth, self._began, self._spent = 0, 0.0, 0.0
        self._timer: threading.Timer | None = None

    def on_start(self, event: Any) -> None:
        self._depth += 1
        if self._depth == 1:
            self._began = time.perf_counter()
            left = max(0.0, _LONG - self._spent)
            self._timer = threading.Timer(left, lambda: notices.compiling())
            self._timer.daemon = True
            self._timer.start()

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0 and self._timer is not None:
            self._spent += time.perf_counter() - self._began
            self._timer.cancel()


event.register("numba:compile", _Notice())
