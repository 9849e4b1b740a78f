"""A second process that compiles the loop for some of the laws, where there are processors for two.

Numba compiles one function at a time in a process. The helper has the same plant and laws and the
same folder for compiled code: it compiles its share (`Engine.compile`) and ends, and the first
process, which samples signals and compiles for the other laws, finds the files. The two share
nothing else: if the helper fails, the first process does its work.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import Any

from deadtime.base.threads import processors
from deadtime.imperfections import Limiting
from deadtime.numerics.compiling import is_cached, is_kept, where_compiling_starts
from deadtime.scenarios.engine import ModelAhead
from deadtime.scenarios.lane_loop import run_scenarios
from deadtime.scenarios.prepare import BatchRequest, Runnable, prepare

_CHECK = 0.02  # seconds between looks at it
_LONGEST = 120.0  # seconds after which it is given up: several times its usual time


class Helper:
    """Compiles for some laws as soon as there is something to compile.

    Attributes
    ----------
    laws : set of str
        Its laws; none where no helper would be of use.
    """

    def __init__(self, request: BatchRequest, tables: Mapping[str, Runnable]) -> None:
        self.laws = share_of(tables) if tables and _is_of_use(request) else frozenset[str]()
        self._request, self._asked, self._given_up = request, False, 0.0
        self._process: subprocess.Popen[bytes] | None = None

    @contextlib.contextmanager
    def at_hand(self) -> Iterator[None]:
        """Start it when something has to be compiled within; it does not outlast that."""
        if not self.laws:
            yield
            return
        try:
            with where_compiling_starts(self._start):
                yield
        finally:
            if self._process is not None:
                self._process.kill()
                self._process.communicate()

    def wait(self, stopped: Callable[[], bool]) -> None:
        """Wait until its laws are compiled, or it has failed; after that it does not start."""
        self._asked = True
        while self._process is not None and self._process.poll() is None and not stopped():
            if time.monotonic() > self._given_up:
                return
            time.sleep(_CHECK)

    def _start(self, dispatcher: Any) -> None:
        ours = dispatcher.py_func.__module__.startswith(__package__)
        if self._asked or (is_cached(run_scenarios.dispatcher) and not ours):
            return
        self._asked = True
        # The run does not need it: laws of the user that cannot be pickled are compiled here.
        with contextlib.suppress(Exception):
            data = pickle.dumps((self._request, self.laws))
            # Its modules are those of this process, not those in the current folder.
            path = os.pathsep.join(filter(None, sys.path))
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__],
                env={**os.environ, "PYTHONPATH": path},
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            self._given_up = time.monotonic() + _LONGEST
            assert self._process.stdin is not None
            self._process.stdin.write(data)
            self._process.stdin.flush()


def _is_of_use(request: BatchRequest) -> bool:
    """Whether two processes can compile at once, sharing files, all that the run needs."""
    if processors() < 2 or not sys.executable or hasattr(sys, "frozen"):
        return False
    receives_all = all(isinstance(one, Limiting) for one in request.imperfections)
    return receives_all and is_kept(run_scenarios.dispatcher)


def share_of(tables: Mapping[str, Runnable]) -> frozenset[str]:
    """The laws to compile elsewhere: those of at least half of the work, the most costly first.

    Laws that share a compiled loop are together. A law that knows the signal counts twice.
    """
    laws: dict[tuple[Hashable, ...], list[str]] = {}
    for name, table in tables.items():
        laws.setdefault(_kind(table), []).append(name)
    costs = {kind: 2 if ModelAhead in kind else 1 for kind in laws}
    share, left = list[str](), sum(costs.values())
    for kind in sorted(laws, key=costs.__getitem__, reverse=True):
        if left <= sum(costs.values()) - left:
            break
        share += laws[kind]
        left -= costs[kind]
    return frozenset(share)


def _kind(table: Runnable) -> tuple[Hashable, ...]:
    """The key of a compiled loop, the same for laws that share one."""
    if isinstance(table, ModelAhead):
        return ModelAhead, table.loop.acting.lags.size
    return table.shape, table.dense is None, table.memory is None


def _end_with_parent() -> None:
    os.read(0, 1)  # returns when the parent closes its end: nothing more is written
    os._exit(1)


def main() -> None:
    """Compile the request from stdin, as long as that is open."""
    request, laws = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    prepared = prepare(request)
    for name, table in prepared.tables.items():
        if name in laws:
            prepared.engine.compile(table)


if __name__ == "__main__":
    main()
