"""Serve the explorer: on this machine alone, unless told otherwise."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import re
import socket
from collections.abc import Callable
from typing import Any

import panel as pn

from deadtime.app.documents import open_named
from deadtime.app.opening import Opening
from deadtime.app.page import Page
from deadtime.app.sessions import CHECK, LINGER, MOST, Sessions
from deadtime.app.workers import Workers
from deadtime.base.errors import ArgumentError

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

    Parameters
    ----------
    problem : str
        What sessions begin with: paper, three-mode, follower or a problem file.
    address, port : str, int
        Where; 127.0.0.1 is this machine alone.
    show : bool
        Open a browser.
    origins : tuple of str
        Names, host:port, by which browsers reach it, where that is not the address.
    workers : int
        Processes for what takes longer than a moment.
    sessions : int
        Pages that may be open at once; who comes then is asked to come later.
    started : callable
        Called with the page's URL once it is there.
    progress : callable
        Called before that with what is being done.

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
        opening = Opening.of(document)
        progress("building a page")
        Page(document, team, opening)  # compiles what pages call
        host = f"[{address}]" if ":" in address else address
        known = {f"{host}:{port}", f"localhost:{port}", f"127.0.0.1:{port}", *origins}
        if not is_loopback(address):
            known |= {f"{socket.gethostname()}:{port}", f"{_own_address()}:{port}"}
        pn.extension(notifications=False)
        visitors = Sessions(lambda: Page(document, team, opening), sessions)
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
    """Only what is worth a line, in terms of this command."""
    browsers = logging.getLogger("bokeh.server.views.ws")
    browsers.setLevel(logging.ERROR)
    browsers.addFilter(_in_our_words)
    logging.getLogger("tornado.access").setLevel(logging.ERROR)


def _in_our_words(record: logging.LogRecord) -> bool:
    """Name our option where Bokeh names its own."""
    found = re.search(r"connection from Origin '(?:https?://)?([^']*)'", record.getMessage())
    if found:
        record.msg = f"refused a page of {found[1]}: if it is yours, add --origin {found[1]}"
        record.args = ()
    return True


def _unless_closed(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Say nothing of browsers that leave while something is on its way to them."""
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
