"""The cluster that a sweep runs on: one on this machine, or one at a scheduler's address."""

from __future__ import annotations

import asyncio
import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from deadtime.base.errors import ArgumentError, ClusterError, DeadtimeError
from deadtime.base.threads import processors
from deadtime.base.version import __version__

if TYPE_CHECKING:
    from distributed import Client

# Of workers here, instead of Dask's: its MALLOC_TRIM_THRESHOLD_ returns memory to the system at
# once, which doubles the time of cells that allocate some megabytes again and again.
_ENVIRONMENT = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
_SETTINGS = {
    "distributed.nanny.pre-spawn-environ": _ENVIRONMENT,
    "distributed.worker.profile.enabled": False,  # it looks at every thread 100 times a second
}
_PATIENCE = 20.0  # seconds to wait for a scheduler, or for the first worker


@contextmanager
def cluster(scheduler: str | None, workers: int | None) -> Iterator[Client]:
    """A client of the scheduler at an address; without one, of a cluster on this machine."""
    try:
        import dask.config as settings
        import distributed
    except ImportError:
        raise ArgumentError(
            "a sweep runs on Dask, which is not installed: "
            'pip install ".[sweep]" in a clone of deadtime.'
        ) from None
    if scheduler is not None:
        with _unlogged(), _remote(scheduler) as client, _reachable(client, scheduler):
            yield client
        return
    count = processors() if workers is None else workers
    try:
        with settings.set(_SETTINGS):
            local = distributed.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=count > 1,
                host="127.0.0.1",
                protocol="tcp",
                dashboard_address="127.0.0.1:0",
                memory_limit=0,
                silence_logs=logging.CRITICAL,
            )
    except RuntimeError as error:
        raise ClusterError(
            f"workers cannot be started ({error}): a script must call sweep under "
            'if __name__ == "__main__":, or with workers=1.'
        ) from None
    with local, _hushed(distributed.Client(local, set_as_default=False)) as client:
        if count > 1:
            client.run(_prepare_worker)
        with _reachable(client, local.scheduler_address):
            yield client


@contextmanager
def _remote(scheduler: str) -> Iterator[Client]:
    """A client of an existing cluster, with workers of this version."""
    import distributed

    try:
        client = distributed.Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ClusterError(
            f"scheduler {scheduler!r} cannot be reached ({error or type(error).__name__}): start "
            "one with `dask scheduler`, or leave the scheduler out to run here."
        ) from None
    with _hushed(client):
        try:
            client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError:
            raise ClusterError(
                f"scheduler {scheduler!r} has no workers: start some with `dask worker "
                f"{scheduler}`."
            ) from None
        found = set(client.run(_version).values())  # pyright: ignore[reportAttributeAccessIssue]
        if found != {__version__}:
            raise ClusterError(
                f"the workers of {scheduler!r} run deadtime {', '.join(sorted(map(str, found)))}, "
                f"and this is {__version__}: install the same everywhere."
            )
        yield client


@contextmanager
def _reachable(client: Client, scheduler: str) -> Iterator[None]:
    """Turn failures that a lost scheduler causes into an error that says so."""
    try:
        yield
    except DeadtimeError:
        raise
    except Exception:
        if client.status == "running":
            raise
        raise ClusterError(
            f"scheduler {scheduler!r} was lost: what is stored is kept; start a "
            "scheduler and workers again, and run the same command again."
        ) from None


@contextmanager
def _unlogged() -> Iterator[None]:
    """Without Dask's own report of a lost scheduler, which an error reports already."""
    log = logging.getLogger("distributed.client")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)


def _version() -> str:
    return __version__


def _prepare_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all: the first process ends them
    asyncio.get_running_loop().set_exception_handler(_report)


def _hushed(client: Client) -> Client:
    async def hush() -> None:
        asyncio.get_running_loop().set_exception_handler(_report)

    client.sync(hush)
    return client


def _report(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Print errors of Dask's event loop, except time-outs of its own waits.

    A connection waits a few milliseconds at a time for data to send. If that wait ends in the
    loop's last turn, nothing awaits it, and asyncio would print a TimeoutError.
    """
    if not isinstance(context.get("exception"), TimeoutError):
        loop.default_exception_handler(context)
