"""`deadtime app`."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from deadtime.cli.entry import app
from deadtime.errors import ArgumentError


@app.command(name="app")
def explore(
    problem: str = "paper",
    *,
    port: int | None = None,
    address: str = "127.0.0.1",
    origin: tuple[str, ...] = (),
    browser: Annotated[bool, Parameter(negative="--no-browser")] = True,
) -> None:
    """Explore a problem on a page: move it, draw its signal, watch every law.

    Examples: `deadtime app`, `deadtime app problem.toml`, `deadtime app --port 8000 --no-browser`.

    Parameters
    ----------
    problem
        paper, three-mode, follower, or a problem file.
    port
        Where to serve; the first free one from 5006 on by default.
    address
        127.0.0.1 is this machine alone; 0.0.0.0 lets the whole network in.
    origin
        A name, host:port, by which browsers reach the page, behind a proxy.
    browser
        Open a browser.
    """
    try:
        from deadtime.app.server import is_loopback, serve
    except ModuleNotFoundError as error:
        raise ArgumentError(
            f"the explorer needs {error.name}: pip install 'deadtime[app]'."
        ) from None

    def started(url: str) -> None:
        print(f"Explorer: {url}")
        if is_loopback(address):
            print("Only this machine can reach it (--address 0.0.0.0 lets the network in).")
        else:
            print("Everyone who can reach this machine can use it; there is no password.")
        print("Ctrl-C ends it.", flush=True)

    serve(problem, address, port, browser, origin, started=started)
