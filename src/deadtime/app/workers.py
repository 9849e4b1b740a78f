"""Processes for jobs that take longer than a moment, each with a limit of time.

A page stays responsive while they work. The process of a job that takes too long is ended, and
another takes its place. Jobs and results are plain data.
"""

from __future__ import annotations

import multiprocessing
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, NamedTuple
from weakref import WeakSet

from deadtime.base.errors import ArgumentError, DeadtimeError

Job = Callable[..., Any]
Progress = Callable[[Any], None]
_MEMORY = 8 * 2**30  # bytes of addresses, of which libraries alone take two
_TRIES = 3  # processes that may end before they begin a job


class TooLongError(ArgumentError):
    """A job took longer than it may."""


class StoppedError(ArgumentError):
    """A job was stopped, since its result is no longer needed."""


class _Job(NamedTuple):
    """A job as it was submitted."""

    limit: float
    job: Job
    given: tuple
    on_progress: Progress | None


class _NotBegunError(Exception):
    """A process ended before it began its job, of which the job knows nothing."""


class Workers:
    """A few processes, started at once, that run one job each at a time."""

    def __init__(self, count: int = 1) -> None:
        self._idle: queue.Queue[_Worker] = queue.Queue()
        self._threads = ThreadPoolExecutor(count, "deadtime-worker")
        self._closed = threading.Event()
        self._all: set[_Worker] = set()
        # A job that is stopped leaves this at once, with its arguments and all that awaits it.
        self._waiting: dict[Future[Any], _Job] = {}
        self._doing: dict[Future[Any], _Worker] = {}
        self._stopped: WeakSet[Future[Any]] = WeakSet()
        self._lock = threading.Lock()
        for _ in range(count):
            self._start()

    def _start(self) -> None:
        worker = _Worker()
        self._all.add(worker)
        self._idle.put(worker)

    def submit(
        self, limit: float, job: Job, *given: Any, on_progress: Progress | None = None
    ) -> Future[Any]:
        """Run a job, for `limit` seconds at most, when there is a process for it.

        The job is a function of a module, its arguments and its result plain data. With
        `on_progress` it gets a keyword ``tell=``; what it passes to `tell` (plain data) is given to
        `on_progress`, in a thread. The future fails with an `ArgumentError` if the job takes
        longer, its process dies, or it raises an error.
        """
        future: Future[Any] = Future()
        with self._lock:
            self._waiting[future] = _Job(limit, job, given, on_progress)
        self._threads.submit(self._run_next)
        return future

    def stop(self, future: Future[Any]) -> None:
        """End a job whose result is no longer needed, started or not."""
        with self._lock:
            self._waiting.pop(future, None)
            if future.cancel() or future.done():
                return
            self._stopped.add(future)
            if future in self._doing:
                self._doing[future].kill()

    def _run_next(self) -> None:
        """Run the job that waits longest, if there is one still."""
        with self._lock:
            if not self._waiting:
                return
            future = next(iter(self._waiting))
            request = self._waiting.pop(future)
            if not future.set_running_or_notify_cancel():
                return
        result, error = None, None
        try:
            result = self._done_somewhere(future, request)
        except Exception as raised:
            error = raised
        with self._lock:  # from here on it is too late to stop it
            stopped = future in self._stopped
            self._stopped.discard(future)
        if stopped:
            future.set_exception(StoppedError("that was stopped."))
        elif error is not None:
            future.set_exception(error)
        else:
            future.set_result(result)

    def _done_somewhere(self, future: Future[Any], request: _Job) -> Any:
        """The result of a job; an idle process may have died, and is no reason to fail."""
        for _ in range(_TRIES):
            if self._closed.is_set():  # nobody puts back an idle process any more
                raise StoppedError("that was stopped.")
            worker = self._idle.get()
            try:
                with self._lock:
                    if future in self._stopped:
                        raise StoppedError("that was stopped.")
                    self._doing[future] = worker
                return worker.do(request)
            except _NotBegunError:
                continue
            finally:
                with self._lock:
                    self._doing.pop(future, None)
                self._put_back(worker)
        raise ArgumentError(
            f"no process begins that: {_TRIES} ended before they did, perhaps for want of memory. "
            "Close other programs, or restart `deadtime app`."
        )

    def _put_back(self, worker: _Worker) -> None:
        """Make a process idle again, or start another where it has ended."""
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

    @property
    def alive(self) -> bool:
        return self._process.is_alive()

    def do(self, request: _Job) -> Any:
        """Run a job here; the process does not outlive one that takes too long.

        Raises
        ------
        _NotBegunError
            If the process ends, or has ended, before it begins the job.
        """
        try:
            self._pipe.send((request.job, request.given, request.on_progress is not None))
            self._pipe.recv()  # begun: what it imports before that is not the job's fault
        except (EOFError, OSError):
            self.end()
            raise _NotBegunError from None
        end = time.monotonic() + request.limit
        try:
            while True:
                if not self._pipe.poll(max(end - time.monotonic(), 0.0)):
                    self.end()
                    raise TooLongError(
                        f"that takes longer than {request.limit:g} s, and was stopped: make the "
                        "problem smaller, or use the command line, which has no limit."
                    )
                kind, answer = self._pipe.recv()
                if kind != "progress":
                    break
                if request.on_progress is not None:
                    request.on_progress(answer)
        except (EOFError, OSError):
            self.end()
            raise ArgumentError(
                "that ended its process, perhaps for want of memory: make the problem smaller."
            ) from None
        if kind == "failed":
            raise answer
        return answer

    def kill(self) -> None:
        self._process.kill()
        self._process.join()

    def end(self) -> None:
        self.kill()
        self._pipe.close()


def _serve(pipe: Connection) -> None:
    import deadtime.app.jobs  # noqa: F401  what jobs need is loaded before the first comes

    with suppress(ImportError):  # not on Windows
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    try:
        while True:
            job, given, tells = pipe.recv()
            pipe.send(("begun", None))
            more = {"tell": lambda message: pipe.send(("progress", message))} if tells else {}
            try:
                answer = ("done", job(*given, **more))
            except DeadtimeError as error:
                answer = ("failed", ArgumentError(str(error)))
            except Exception as error:  # a fault of ours ends the job, not the process
                answer = ("failed", ArgumentError(f"{type(error).__name__}: {error}"))
            pipe.send(answer)
    except (EOFError, OSError, KeyboardInterrupt):
        pass
