"""Sessions of the explorer: how many there may be, and that nothing of them stays."""

import asyncio
import gc
import json
import re
import signal
import subprocess
import sys
import weakref
from concurrent.futures import Future
from pathlib import Path

import panel as pn
import pytest
from tornado.httpclient import AsyncHTTPClient, HTTPRequest
from tornado.websocket import websocket_connect

from deadtime.app.documents import open_named
from deadtime.app.first_view import FirstView
from deadtime.app.jobs import look_at_log
from deadtime.app.page import Page
from deadtime.app.server import Sessions
from deadtime.cli.application import main

# Of widgets that set options of other widgets, and of messages that Bokeh had yet to send to a page
# that left; none of ours.
pytestmark = [
    pytest.mark.filterwarnings("ignore::PendingDeprecationWarning"),
    pytest.mark.filterwarnings("ignore:coroutine 'WSHandler:RuntimeWarning"),
    pytest.mark.filterwarnings(
        "ignore:Exception ignored in. .coroutine object WSHandler:"
        "pytest.PytestUnraisableExceptionWarning"
    ),
]

MEMORY = Path(__file__).parents[2] / "benchmarks" / "explorer_memory.py"


async def said(socket, word):
    """The next message with a word."""
    while word not in (message := str(await socket.read_message() or "")):
        assert message, "the server closed the websocket"
    return message


class Served:
    """Pages of the paper's problem, served in this process; which of them are still alive."""

    def __init__(self, most):
        document = open_named("paper")
        self.first_view = FirstView.of(document)
        self.made = 0
        self.alive = weakref.WeakSet()
        self.documents = weakref.WeakSet()
        self.sessions = Sessions(self.make, most)

    def make(self):
        page = Page(self.first_view.document, None, self.first_view)
        self.made += 1
        self.alive.add(page)
        self.documents.add(pn.state.curdoc)
        return page

    async def __aenter__(self):
        pn.extension(notifications=False)
        self.interrupt = signal.getsignal(signal.SIGINT)
        self.server = pn.serve(
            {"/": self.sessions.begin}, port=0, address="127.0.0.1", show=False, start=False,
            verbose=False, websocket_origin="*", index=None,
            unused_session_lifetime_milliseconds=3000, check_unused_sessions_milliseconds=100,
        )  # fmt: skip
        self.server.start()
        self.url = f"http://127.0.0.1:{self.server.port}/"
        return self

    async def __aexit__(self, *_):
        signal.signal(signal.SIGINT, self.interrupt)
        self.server.stop()

    async def get(self):
        answer = await AsyncHTTPClient().fetch(self.url, request_timeout=120.0)
        return answer.body.decode()

    async def connect(self):
        """A page as a browser has it: its websocket, and what it shows."""
        token = re.search(r'"token":"([^"]+)"', await self.get())[1]
        socket = await websocket_connect(
            HTTPRequest(f"ws{self.url[4:]}ws"), subprotocols=["bokeh", token]
        )
        await said(socket, "ACK")
        for part in (json.dumps({"msgid": "1", "msgtype": "PULL-DOC-REQ"}), "{}", "{}"):
            await socket.write_message(part)
        await said(socket, "PULL-DOC-REPLY")
        return socket, await said(socket, "roots")

    async def until_nothing_is_left(self):
        """Wait for the end of all sessions, and for the sweep after them."""
        async with asyncio.timeout(120.0):
            while self.server.get_sessions("/") or self.alive or self.documents:
                await asyncio.sleep(0.1)


@pytest.mark.long
def test_nothing_stays_of_sessions_that_are_over():
    async def visit():
        async with Served(most=10) as served:
            for _ in range(2):
                await served.get()
                socket, _ = await served.connect()
                socket.close()
            await served.until_nothing_is_left()
            return served.made

    gc.disable()  # the sweep after sessions is to find them
    try:
        assert asyncio.run(visit()) >= 4
    finally:
        gc.enable()


def test_a_visitor_too_many_is_asked_to_come_later_and_then_served():
    async def visit():
        async with Served(most=1) as served:
            first, shown = await served.connect()
            second, refused = await served.connect()
            first.close()
            second.close()
            await served.until_nothing_is_left()
            third, later = await served.connect()
            third.close()
            return shown, refused, later

    shown, refused, later = asyncio.run(visit())
    assert "this explorer serves 1 at once" in refused
    for one in (shown, later):
        assert "Worst signal" in one
        assert "Too many pages" not in one


class Busy:
    """Workers that look at a log at once, and are busy with all else for ever."""

    def submit(self, limit, job, *given, on_progress=None):
        future = Future()
        future.set_running_or_notify_cancel()
        if job is look_at_log:
            future.set_result(job(*given))
        return future

    def stop(self, future):
        pass


LOG = b"t,x1,u1\n" + b"".join(b"%d,%d,%d\n" % (i, i % 3, i % 2) for i in range(50))


def test_a_session_that_ends_in_the_middle_of_a_job_leaves_nothing(caplog):
    class Reloaded(Served):
        """Whose pages are given a log as they are made."""

        def make(self):
            page = super().make()
            page.workers = page._jobs._workers = page.log._jobs._workers = Busy()
            page.upload_log("log.csv", LOG)
            return page

    async def visit():
        async with Reloaded(most=10) as served:
            socket, _ = await served.connect()
            (page,) = served.alive
            async with asyncio.timeout(60.0):
                while not page.log.progress.text.visible:
                    await asyncio.sleep(0.05)
            del page
            socket.close()
            await served.until_nothing_is_left()

    asyncio.run(visit())
    assert [one.getMessage() for one in caplog.records if "failed" in one.getMessage()] == []


def test_each_step_of_closing_runs_whatever_the_others_do(monkeypatch):
    page = Page(open_named("paper"), None)
    done, ended = [], []

    def fail(*_):
        raise AttributeError("its document is gone")

    log = page.log
    monkeypatch.setattr(page._jobs, "stop", fail)
    monkeypatch.setattr(log, "drop", fail)
    monkeypatch.setattr(pn.state, "on_session_destroyed", ended.append)
    monkeypatch.setattr("deadtime.app.server._unwatch", lambda view: (done.append(view), fail()))
    sessions = Sessions(lambda: page)
    monkeypatch.setattr(sessions, "_sweep_soon", lambda: done.append("swept"))
    view = sessions.begin()
    (over,) = ended
    with pytest.raises(AttributeError, match="its document is gone"):
        over(None)
    assert done == [view, "swept"]
    assert not {"log", "figures", "outcome", "actions"} & vars(page).keys()


def test_pages_that_begin_with_one_problem_share_its_runs():
    first_view = FirstView.of(open_named("paper"))
    one, other = (Page(first_view.document, None, first_view) for _ in range(2))
    assert one.outcome is other.outcome
    one.controls.sliders["delay"].value = 0.5
    assert one.outcome is not other.outcome
    assert other.outcome is first_view.outcome


@pytest.mark.parametrize("count", ["0", "-3"])
def test_a_server_of_no_sessions_is_refused(count, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["app", "--sessions", count, "--no-browser"])
    assert ended.value.code == 2
    assert f"sessions must be at least 1, got {count}" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is read from /proc")
def test_visitors_leave_no_memory_behind():
    # Thirty after the first fifty, of both kinds in turn: each costs a second of building its page,
    # and the seven megabytes of a page that stays, of either kind, would be twice what may.
    # `python benchmarks/explorer_memory.py` has five hundred of each.
    command = [sys.executable, MEMORY, "--compared", "--visitors", "80"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
