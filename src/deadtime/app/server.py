"""Serve the explorer: on this machine alone, unless told otherwise; sessions begin and end here.

A session costs memory for as long as it lives. One without a browser, as that of a plain GET, soon
ends; their number is limited; and an ended session releases its memory.
"""

from __future__ import annotations

import asyncio
import ctypes
import gc
import ipaddress
import logging
import re
import socket
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

import panel as pn
import panel_material_ui as pmui
from tornado.ioloop import IOLoop

from deadtime.app.documents import open_named
from deadtime.app.first_view import FirstView
from deadtime.app.page import Page
from deadtime.app.workers import Workers
from deadtime.base.errors import ArgumentError

MOST = 40  # sessions at once
LINGER = 15_000  # milliseconds for which a session waits for a browser that has not come, or left
CHECK = 2_000  # milliseconds between looks for those
_REST = 1.0  # seconds after the end of a session in which others may end too


class Sessions:
    """The sessions of one server: `make` makes the page of one, `most` there may be at once."""

    def __init__(self, make: Callable[[], Page], most: int = MOST) -> None:
        self._make, self._most = make, most
        self._sweeps = False

    def begin(self) -> pmui.Page:
        """The page for the visitor whose session begins now."""
        context = pn.state.curdoc.session_context if pn.state.curdoc else None
        if context is not None and len(context.server_context.sessions) >= self._most:
            text = (
                f"Too many pages are open: this explorer serves {self._most} at once. Close one of "
                "yours, or load this page again in a minute."
            )
            alert = pmui.Alert(object=text, severity="warning")
            view, close = pmui.Page(title="deadtime explorer", main=[alert]), lambda: None
        else:
            page = self._make()
            view, close = page.view(), page.close
        self._when_over(view, close)
        return view

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
        """Release the memory of all sessions that ended a moment ago."""
        self._sweeps = False
        gc.collect()
        with suppress(OSError, AttributeError):  # not glibc
            ctypes.CDLL(None).malloc_trim(0)  # glibc keeps freed memory until it is trimmed


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


PORT = 5006
_TRIED = 20  # ports, where none was asked for


def is_loopback(address: str) -> bool:
    """Whether only this machine can reach an address.

    Examples
    --------
    >>> is_loopback("127.0.0.1"), is_loopback("localhost"), is_loopback("0.0.0.0")
    (True, True, False)
    """
    if address == "localhost":
        return True
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def free_port(address: str, port: int | None) -> int:
    """The port asked for, or the first free one from 5006 on.

    Raises
    ------
    ArgumentError
        If it is taken, or the address is not this machine's.
    """
    if port is not None and not 0 < port < 65536:
        raise ArgumentError(f"port must be between 1 and 65535, got {port}.")
    for candidate in [port] if port is not None else range(PORT, PORT + _TRIED):
        family = socket.AF_INET6 if ":" in address else socket.AF_INET
        with socket.socket(family) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((address, candidate))
            except PermissionError:
                raise ArgumentError(
                    f"port {candidate} needs more rights: use one above 1023."
                ) from None
            except socket.gaierror:
                raise ArgumentError(f"address {address!r} is not known: use 127.0.0.1.") from None
            except OSError as error:
                if port is not None or "assign" in str(error):
                    raise ArgumentError(
                        f"{address}:{candidate} cannot be served: {error.strerror}: choose "
                        "another --port or --address."
                    ) from None
                continue
        return candidate
    raise ArgumentError(f"ports {PORT} to {PORT + _TRIED - 1} are taken: choose one by --port.")


def serve(
    problem: str = "paper",
    address: str = "127.0.0.1",
    port: int | None = None,
    show: bool = True,
    origins: tuple[str, ...] = (),
    workers: int = 1,
    sessions: int = MOST,
    started: Callable[[str], None] = lambda url: None,
    progress: Callable[[str], None] = lambda stage: None,
) -> None:
    """Serve pages until interrupted; every session has its own.

    Sessions begin with `problem`, a named one or a file; at most `sessions` are open at once.
    `show` opens a browser. `origins` are the names, host:port, by which browsers reach the server
    where these differ from the address. `workers` is the number of processes for long jobs.
    `progress` is called with each stage, `started` with the URL.

    Raises
    ------
    ArgumentError
        If the problem cannot be opened, the address cannot be served, or no session may be open.
    """
    if sessions < 1:
        raise ArgumentError(f"sessions must be at least 1, got {sessions}.")
    document = open_named(problem)
    port = free_port(address, port)
    team = Workers(workers)
    try:
        progress(f"running the laws of {problem}")
        first_view = FirstView.of(document)
        progress("building a page")
        Page(document, team, first_view)  # compiles what pages call
        host = f"[{address}]" if ":" in address else address
        known = {f"{host}:{port}", f"localhost:{port}", f"127.0.0.1:{port}", *origins}
        if not is_loopback(address):
            known |= {f"{socket.gethostname()}:{port}", f"{_own_address()}:{port}"}
        pn.extension(notifications=False)
        visitors = Sessions(lambda: Page(document, team, first_view), sessions)
        _quieten()
        asyncio.get_event_loop().set_exception_handler(_unless_closed)
        server: Any = pn.serve(
            {"/": visitors.begin},
            address=address, port=port, show=show, title="deadtime explorer", start=False,
            websocket_origin=sorted(known), verbose=False,
            websocket_max_message_size=40_000_000, index=None,
            unused_session_lifetime_milliseconds=LINGER, check_unused_sessions_milliseconds=CHECK,
        )  # fmt: skip
        started(f"http://{'localhost' if address in ('0.0.0.0', '::') else host}:{port}/")
        server.run_until_shutdown()
    finally:
        team.close()


def _quieten() -> None:
    """Log only errors, in terms of this command."""
    browsers = logging.getLogger("bokeh.server.views.ws")
    browsers.setLevel(logging.ERROR)
    browsers.addFilter(_in_our_words)
    logging.getLogger("tornado.access").setLevel(logging.ERROR)


def _in_our_words(record: logging.LogRecord) -> bool:
    """Name our option where Bokeh names its own."""
    match = re.search(r"connection from Origin '(?:https?://)?([^']*)'", record.getMessage())
    if match:
        record.msg = f"refused a page of {match[1]}: if it is yours, add --origin {match[1]}"
        record.args = ()
    return True


def _unless_closed(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Ignore browsers that leave while a message is on its way to them."""
    if type(context.get("exception")).__name__ not in ("WebSocketClosedError", "StreamClosedError"):
        loop.default_exception_handler(context)


def _own_address() -> str:
    """The address of this machine in its network, as far as it can be told."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # nothing is sent
            return probe.getsockname()[0]
        except OSError:
            return "127.0.0.1"
