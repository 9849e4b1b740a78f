"""How many sessions a server holds, and what is let go of when one ends.

A session costs memory for as long as it lives. One to which no browser came, as that of a plain
GET, soon ends; there are never more than so many; and what ended leaves nothing behind.
"""

from __future__ import annotations

import ctypes
import gc
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

import panel as pn
import panel_material_ui as pmui
from tornado.ioloop import IOLoop

from deadtime.app.page import Page

MOST = 40  # sessions at once
LINGER = 15_000  # milliseconds for which a session waits for a browser that has not come, or left
CHECK = 2_000  # milliseconds between looks for those
_REST = 1.0  # seconds after the end of a session in which others may end too


class Sessions:
    """The sessions of one server.

    Parameters
    ----------
    make : callable
        Makes the page of a session.
    most : int
        How many there may be at once.
    """

    def __init__(self, make: Callable[[], Page], most: int = MOST) -> None:
        self._make, self._most = make, most
        self._sweeps = False

    def begin(self) -> pmui.Page:
        """What the visitor sees whose session begins now."""
        if self._full():
            view, close = self._refusal(), lambda: None
        else:
            page = self._make()
            view, close = page.view(), page.close
        self._when_over(view, close)
        return view

    def _full(self) -> bool:
        """Whether the session that begins now is one too many."""
        context = pn.state.curdoc.session_context if pn.state.curdoc else None
        return context is not None and len(context.server_context.sessions) >= self._most

    def _refusal(self) -> pmui.Page:
        """For a visitor for whom there is no room."""
        text = (
            f"Too many pages are open: this explorer serves {self._most} at once. Close one of "
            "yours, or load this page again in a minute."
        )
        return pmui.Page(
            title="deadtime explorer", main=[pmui.Alert(object=text, severity="warning")]
        )

    def _when_over(self, view: pmui.Page, close: Callable[[], None]) -> None:
        """Call `close` when the session that begins now is over, then drop what shows its view."""

        def over(_: Any) -> None:
            with ExitStack() as steps:  # each of them runs, whatever becomes of the others
                steps.callback(self._sweep_soon)
                steps.callback(_unwatch, view)
                steps.callback(close)

        pn.state.on_session_destroyed(over)

    def _sweep_soon(self) -> None:
        if not self._sweeps:
            self._sweeps = True
            IOLoop.current().call_later(_REST, self._sweep)

    def _sweep(self) -> None:
        """Collect what all sessions left that ended a moment ago."""
        self._sweeps = False
        gc.collect()
        _return_memory()


def _unwatch(view: pmui.Page) -> None:
    """Take a view out of the watchers of Panel's state: it watches whether the server is busy."""
    watchers = [
        watcher
        for by_kind in pn.state.param.watchers.values()
        for watched in by_kind.values()
        for watcher in watched
    ]
    for watcher in watchers:
        if getattr(getattr(watcher.fn, "__self__", None), "self", None) is view:
            pn.state.param.unwatch(watcher)


def _return_memory() -> None:
    """Give free memory back to the system, where glibc would keep it for later."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
