"""The explorer as it is served: who reaches it, what it says, how it ends."""

import http.client
import socket
import urllib.request
from urllib.parse import urlsplit

import pytest

import deadtime as dt
from deadtime.app.server import free_port, is_loopback
from deadtime.cli.application import main
from explorer import Explorer


def handshake(url, origin):
    """The status with which the server answers a browser on a page of this origin."""
    place = urlsplit(url)
    connection = http.client.HTTPConnection(place.hostname, place.port, timeout=10)
    connection.request(
        "GET",
        "/ws",
        headers={
            "Upgrade": "websocket",
            "Connection": "Upgrade",
            "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
            "Sec-WebSocket-Version": "13",
            "Origin": origin,
        },
    )
    status = connection.getresponse().status
    connection.close()
    return status


@pytest.mark.long
def test_the_page_is_this_machines_alone_and_ends_quietly():
    explorer = Explorer("follower")
    try:
        assert any("Only this machine can reach it" in line for line in explorer.said)
        with urllib.request.urlopen(explorer.url) as answer:
            assert b"deadtime explorer" in answer.read()
        assert handshake(explorer.url, "http://example.org") == 403
        port = urlsplit(explorer.url).port
        others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None)}
        for address in others - {"127.0.0.1", "::1"}:
            with pytest.raises(OSError, match=r"refused|unreachable|timed out"):
                socket.create_connection((address, port), timeout=2).close()
        with pytest.raises(dt.ArgumentError, match=f"127.0.0.1:{port} cannot be served"):
            free_port("127.0.0.1", port)
    finally:
        errors = explorer.stop()
    (complaint,) = errors.splitlines()
    assert complaint.endswith(
        "refused a page of example.org: if it is yours, add --origin example.org"
    )
    assert explorer.process.returncode == 0


def test_addresses_and_problems_that_cannot_be_served_are_refused(capsys):
    for address in ("127.0.0.1", "localhost", "::1"):
        assert is_loopback(address)
    for address in ("0.0.0.0", "::", "192.0.2.1", "example.org"):
        assert not is_loopback(address)
    for arguments, message in (
        (["app", "--address", "192.0.2.1", "--no-browser"], "192.0.2.1:5006 cannot be served"),
        (["app", "--address", "no such name"], "address 'no such name' is not known"),
        (["app", "--port", "70000"], "port must be"),
        (["app", "nothing"], "problem must be one of paper"),
        (["app", "nothing.toml"], "nothing.toml cannot be read"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 2
        assert message in capsys.readouterr().err
