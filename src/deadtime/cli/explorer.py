"""`deadtime app`."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from deadtime.base.errors import ArgumentError
from deadtime.cli.application import START, AsJson, ProblemFile, app as commands, lines
from deadtime.cli.printing import print_json, stage_line


@commands.command(
    group=START,
    help_epilogue=lines(
        "deadtime app",
        "deadtime app problem.toml",
        "deadtime app follower --port 8000 --no-browser",
        "deadtime app --address 0.0.0.0   # for the whole network: there is no password",
    ),
)
def app(
    problem: ProblemFile = Path("paper"),
    *,
    port: int | None = None,
    address: str = "127.0.0.1",
    origin: tuple[str, ...] = (),
    browser: Annotated[bool, Parameter(negative="--no-browser")] = True,
    sessions: int = 40,
    json_output: AsJson = False,
) -> None:
    """Explore a problem on a page: move it, draw its signal, watch every law.

    Parameters
    ----------
    port
        Where to serve; the first free one from 5006 on by default.
    address
        127.0.0.1 is this machine alone; 0.0.0.0 lets the whole network in.
    origin
        A name, host:port, by which browsers reach the page behind a proxy.
    browser
        Open a browser.
    sessions
        Pages that may be open at once; who comes then is asked to come later.
    """
    if not json_output:
        print(f"Starting the explorer with {problem}: half a minute the first time.", flush=True)
    with ExitStack() as starting:
        say = starting.enter_context(stage_line(quiet=json_output))
        say("loading libraries")
        try:
            from deadtime.app.server import is_loopback, serve
        except ModuleNotFoundError as error:
            raise ArgumentError(
                f"the explorer needs {error.name}: pip install '.[app]' in a clone of deadtime."
            ) from None

        def on_started(url: str) -> None:
            starting.close()
            alone = is_loopback(address)
            if json_output:
                print_json({"url": url, "only_this_machine": alone})
                sys.stdout.flush()
                return
            print(f"Explorer: {url}")
            if alone:
                print("Only this machine can reach it (--address 0.0.0.0 lets the network in).")
            else:
                print("Everyone who can reach this machine can use it; there is no password.")
            print(f"It serves {sessions} pages at once (--sessions). Ctrl-C ends it.", flush=True)

        serve(
            str(problem), address, port, browser, origin,
            sessions=sessions, started=on_started, progress=say,
        )  # fmt: skip
