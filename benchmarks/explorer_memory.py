"""Does the explorer's memory stay bounded over many visitors?

A visitor gets the page, opens its websocket, pulls the document as a browser does, and leaves.
A plain GET, as of a robot, gets the page only. Memory is that of the server's process alone, in
MB, as the system counts it (VmRSS, Linux only); the first visitors warm it up. Asserted: it grows
by at most `MOST` MB from visitor `WARM` to the last.

    python benchmarks/explorer_memory.py [--visitors 500] [--compared]

With --compared both kinds of visitor come in turn to one server, and memory is read where the
assertion compares it alone: each reading takes a rest.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import re
import signal
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

from machine import heading
from tornado.httpclient import AsyncHTTPClient, HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

Visit = Callable[[str], Awaitable[object]]  # of a page's address
WARM, MOST = 50, 50.0  # visitors; MB
REST = 20.0  # seconds after which the server has let go of who left


class Server:
    """`deadtime app`, as a process of its own."""

    def __init__(self) -> None:
        command = [str(Path(sys.executable).with_name("deadtime")), "app", "--no-browser"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        said = iter(self.process.stdout.readline, "")
        self.url = next(found[0] for line in said if (found := re.search(r"http://\S+", line)))

    def memory(self) -> float:
        """Resident memory, MB."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        found = re.search(r"VmRSS:\s+(\d+) kB", status)
        assert found
        return int(found[1]) / 1024.0

    def stop(self) -> None:
        self.process.send_signal(signal.SIGINT)
        self.process.wait(30)


async def get(url: str) -> str:
    """A plain GET: the page without its websocket."""
    answer = await AsyncHTTPClient().fetch(url, request_timeout=120.0)
    return answer.body.decode()


async def said(socket: WebSocketClientConnection, word: str) -> None:
    """Wait for a message."""
    while word not in (message := str(await socket.read_message() or "")):
        assert message, "the server closed the websocket"


async def visit(url: str) -> None:
    """What a browser does: the page, its websocket, the document; then it leaves."""
    found = re.search(r'"token":"([^"]+)"', await get(url))
    assert found, "the page was refused"
    request = HTTPRequest(f"ws{url[4:]}ws", headers={"Origin": url.rstrip("/")})
    socket = await websocket_connect(
        request, subprotocols=["bokeh", found[1]], max_message_size=10**8
    )
    await said(socket, "ACK")
    for part in (json.dumps({"msgid": "1", "msgtype": "PULL-DOC-REQ"}), "{}", "{}"):
        await socket.write_message(part)
    await said(socket, "PULL-DOC-REPLY")
    socket.close()


def in_turn() -> Visit:
    """One visitor of either kind after the other."""
    kinds = itertools.cycle((visit, get))

    async def either(url: str) -> None:
        await next(kinds)(url)

    return either


def marks_of(visitors: int, compared: bool) -> list[int]:
    """After how many visitors memory is read."""
    between = () if compared else (min(10, visitors), *range(100, visitors + 1, 100))
    return sorted({min(WARM, visitors), *between, visitors})


async def measured(server: Server, marks: list[int], how: Visit) -> list[tuple[int, float]]:
    """Memory after so many visitors, MB, once the server has rested."""
    rows = []
    for count in range(1, marks[-1] + 1):
        await how(server.url)
        if count in marks:
            await asyncio.sleep(REST)
            rows.append((count, server.memory()))
            print(f"{how.__name__} {count}: {rows[-1][1]:.0f} MB", file=sys.stderr)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--visitors", type=int, default=500)
    parser.add_argument("--compared", action="store_true")
    asked = parser.parse_args()
    visitors, marks = asked.visitors, marks_of(asked.visitors, asked.compared)
    print(heading(), "\n\n| visitors | how | memory, MB | since the first mark, MB |", sep="")
    print("|---|---|---|---|")
    kinds = ((visit, "websocket"), (get, "plain GET"))
    for how, name in ((in_turn(), "in turn"),) if asked.compared else kinds:
        server = Server()
        try:
            before = server.memory()
            print(f"| 0 | {name} | {before:.0f} | |")
            rows = asyncio.run(measured(server, marks, how))
        finally:
            server.stop()
        for count, memory in rows:
            print(f"| {count} | {name} | {memory:.0f} | {memory - rows[0][1]:+.0f} |")
        grown = rows[-1][1] - next(memory for count, memory in rows if count >= min(WARM, visitors))
        assert grown < MOST, f"{name}: {grown:.0f} MB more after {visitors} visitors"


if __name__ == "__main__":
    main()
