"""What a page has others do: jobs in other processes, whose results come in the page's own turn."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Any

import panel as pn

from deadtime.app.workers import Job, Told, Workers


class Errands:
    """Jobs that are out, of one part of a page.

    Parameters
    ----------
    workers : Workers
        Who does them.
    """

    def __init__(self, workers: Workers) -> None:
        self._workers = workers
        self._out: dict[object, Future[Any] | None] = {}

    def begin(
        self,
        limit: float,
        done: Callable[[Any], None],
        failed: Callable[[BaseException], None],
        job: Job,
        *given: Any,
        told: Told | None = None,
    ) -> None:
        """Run a job in another process, then go on here with its result or its error.

        Nothing comes of one that was stopped. `told` is called with what the job tells on its way.
        """
        browser, errand = pn.state.curdoc, object()

        def here(act: Callable[[], None]) -> None:
            """Do something in the page's turn, if the job is still wanted then."""

            def unless_stopped() -> None:
                if errand in self._out:
                    act()

            if browser is None:
                unless_stopped()
            elif errand in self._out and browser.session_context is not None:
                browser.add_next_tick_callback(unless_stopped)  # the session is not over

        def finish(future: Future[Any]) -> None:
            del self._out[errand]
            error = future.exception()
            failed(error) if error is not None else done(future.result())

        def on_finished(future: Future[Any]) -> None:
            if not future.cancelled():
                here(partial(finish, future))

        def on_told(said: Any) -> None:
            if told is not None:
                here(partial(told, said))

        self._out[errand] = None  # it may be heard of before it is known by its future
        more = {"told": on_told} if told else {}
        future = self._workers.submit(limit, job, *given, **more)
        if errand in self._out:
            self._out[errand] = future
        future.add_done_callback(on_finished)

    def stop(self) -> None:
        """End all that is out."""
        out, self._out = self._out, {}
        for future in out.values():
            if future is not None:
                self._workers.stop(future)
