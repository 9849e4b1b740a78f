"""What takes longer than a moment runs in processes of its own, each with a limit of time.

A page stays as quick as it is while they work, and a problem that never ends hurts nobody: its
process is ended, and another takes its place. Jobs go in and out as plain data.
"""

from __future__ import annotations

import multiprocessing
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from deadtime.base.errors import ArgumentError, DeadtimeError

Job = Callable[..., Any]
_MEMORY = 8 * 2**30  # bytes of addresses, of which libraries alone take two


class Workers:
    """A few processes, started at once, that run one job each at a time.

    Parameters
    ----------
    count : int
        How many.
    """

    def __init__(self, count: int = 1) -> None:
        self._idle: queue.Queue[_Worker] = queue.Queue()
        self._threads = ThreadPoolExecutor(count, "deadtime-worker")
        self._closed = threading.Event()
        self._all: set[_Worker] = set()
        for _ in range(count):
            self._start()

    def _start(self) -> None:
        worker = _Worker()
        self._all.add(worker)
        self._idle.put(worker)

    def submit(self, limit: float, job: Job, *given: Any) -> Future[Any]:
        """Run a job when there is a process for it.

        Parameters
        ----------
        limit : float
            Seconds that the job may take once it has begun.
        job : callable
            A function of a module, its arguments and its result plain data.

        Returns
        -------
        Future
            Of its result; of an `ArgumentError` if it takes longer, its process dies, or it
            raises an error.
        """
        return self._threads.submit(self._run, limit, job, given)

    def _run(self, limit: float, job: Job, given: tuple) -> Any:
        worker = self._idle.get()
        try:
            return worker.do(job, given, limit)
        finally:
            if worker.alive and not self._closed.is_set():
                self._idle.put(worker)
            else:
                worker.end()
                self._all.discard(worker)
                if not self._closed.is_set():
                    self._start()

    def close(self) -> None:
        """End all processes; what was still to be done is not."""
        self._closed.set()
        self._threads.shutdown(wait=False, cancel_futures=True)
        for worker in list(self._all):
            worker.kill()  # whoever waits for it then closes its pipe


class _Worker:
    """A process and the pipe to it."""

    def __init__(self) -> None:
        # Forked from a server with threads, a process may never get going.
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()
        self._ready = False

    @property
    def alive(self) -> bool:
        return self._process.is_alive()

    def do(self, job: Job, given: tuple, limit: float) -> Any:
        """Run a job here; the process does not outlive one that takes too long."""
        try:
            if not self._ready:  # it may still be importing, which is not the job's fault
                self._pipe.recv()
                self._ready = True
            self._pipe.send((job, given))
            if not self._pipe.poll(limit):
                self.end()
                raise ArgumentError(
                    f"that takes longer than {limit:g} s, and was stopped: make the problem "
                    "smaller, or use the command line, which has no limit."
                )
            worked, result = self._pipe.recv()
        except (EOFError, OSError):
            self.end()
            raise ArgumentError(
                "that ended its process, perhaps for want of memory: make the problem smaller."
            ) from None
        if not worked:
            raise result
        return result

    def kill(self) -> None:
        self._process.kill()
        self._process.join()

    def end(self) -> None:
        self.kill()
        self._pipe.close()


def _serve(pipe: Connection) -> None:
    """Do what comes through the pipe, until it closes."""
    import deadtime.app.jobs  # noqa: F401  what jobs need is loaded before the first comes

    with suppress(ImportError):  # not on Windows
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    try:
        pipe.send(True)
        while True:
            job, given = pipe.recv()
            try:
                answer = (True, job(*given))
            except DeadtimeError as error:
                answer = (False, ArgumentError(str(error)))
            except Exception as error:  # a fault of ours ends the job, not the process
                answer = (False, ArgumentError(f"{type(error).__name__}: {error}"))
            pipe.send(answer)
    except (EOFError, OSError, KeyboardInterrupt):
        pass
