"""Background jobs of a page in other processes, and their progress bar."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from html import escape
from typing import Any

import panel as pn
import panel_material_ui as pmui

from deadtime.app.workers import Job, Progress, Workers


class BackgroundJobs:
    """The running jobs of one part of a page."""

    def __init__(self, workers: Workers) -> None:
        self._workers = workers
        self._running: dict[object, Future[Any] | None] = {}

    def begin(
        self,
        limit: float,
        done: Callable[[Any], None],
        failed: Callable[[BaseException], None],
        job: Job,
        *arguments: Any,
        on_progress: Progress | None = None,
    ) -> None:
        """Run a job in another process, then go on here with its result or its error.

        A stopped job calls neither. `on_progress` is called with each report of the job.
        """
        browser, ticket = pn.state.curdoc, object()

        def here(act: Callable[[], None]) -> None:
            """Act in the page's event loop, unless the job is stopped by then."""

            def unless_stopped() -> None:
                if ticket in self._running:
                    act()

            if browser is None:
                unless_stopped()
            elif ticket in self._running and browser.session_context is not None:
                browser.add_next_tick_callback(unless_stopped)  # the session is not over

        def finish(future: Future[Any]) -> None:
            del self._running[ticket]
            error = future.exception()
            failed(error) if error is not None else done(future.result())

        def on_finished(future: Future[Any]) -> None:
            if not future.cancelled():
                here(partial(finish, future))

        def pass_on(message: Any) -> None:
            if on_progress is not None:
                here(partial(on_progress, message))

        self._running[ticket] = None  # progress may arrive before `submit` returns the future
        more = {"on_progress": pass_on} if on_progress else {}
        future = self._workers.submit(limit, job, *arguments, **more)
        if ticket in self._running:
            self._running[ticket] = future
        future.add_done_callback(on_finished)

    def stop(self) -> None:
        """Stop all running jobs."""
        running, self._running = self._running, {}
        for future in running.values():
            if future is not None:
                self._workers.stop(future)


_TICK = 1000  # milliseconds between looks at the clock


class ProgressBar:
    """A bar, and a line with the stage, the seconds elapsed and the limit."""

    def __init__(self, limit: float) -> None:
        self._limit, self._stage, self._began = limit, "", 0.0
        self._clock: Any = None
        self._bar = pmui.LinearProgress(sizing_mode="stretch_width", margin=(4, 10), visible=False)
        self.text = pn.pane.HTML("", sizing_mode="stretch_width", margin=(0, 10), visible=False)
        self.view = [self._bar, self.text]

    def show(self, stage: str) -> None:
        """Show a stage; the first starts the clock."""
        self._stage, begins = stage, not self.text.visible
        if begins:
            self._began = time.monotonic()
            self._bar.visible = self.text.visible = True
            if pn.state.curdoc is not None:
                browser = pn.state.curdoc
                self._clock = browser, browser.add_periodic_callback(self._tick, _TICK)
        self._tick()

    def hide(self) -> None:
        """Hide the bar and stop the clock."""
        self._bar.visible = self.text.visible = False
        if self._clock is not None:
            browser, tick = self._clock
            browser.remove_periodic_callback(tick)
            self._clock = None

    def _tick(self) -> None:
        seconds = time.monotonic() - self._began
        message = f"{escape(self._stage)} … {seconds:.0f} s of at most {self._limit:.0f} s"
        self.text.object = f"<div class='progress'>{message}</div>"
