"""All servers refuse requests from web pages of other sites in the same way."""

from __future__ import annotations

import http.client
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from yamsim_cli.http_origin import refusal_reason
from yamsim_cli.policies.policy_server import PolicyServer
from yamsim_cli.policies.remote_policy import pack_message
from yamsim_cli.viewers.page_address import PageAddress
from yamsim_cli.viewers.scene_page import serve_page

_WEBSOCKET = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
    "Sec-WebSocket-Version": "13",
}


@pytest.mark.parametrize(
    ("host", "origin", "bound"),
    [
        ("localhost:8080", None, "127.0.0.1"),
        ("127.0.0.1:8080", "http://127.0.0.1:8080", "127.0.0.1"),
        ("LOCALHOST:8080", "http://localhost:8080", "127.0.0.1"),
        ("[::1]:8080", "http://[::1]:8080", "::1"),
        ("localhost:9000", "http://localhost:9000", "127.0.0.1"),  # Another port: through an SSH tunnel.
        ("robot.lab:8080", "http://robot.lab:8080", "robot.lab"),
        ("192.168.1.7:8080", "https://192.168.1.7:8080", "0.0.0.0"),
        (f"{socket.gethostname()}:8080", None, "0.0.0.0"),
        (None, None, "127.0.0.1"),
    ],
)
def test_own_pages_and_programs_are_accepted(host: str | None, origin: str | None, bound: str) -> None:
    assert refusal_reason([host] if host else [], [origin] if origin else [], bound) is None


@pytest.mark.parametrize(
    ("hosts", "origins", "bound"),
    [
        (["evil.example:8080"], [], "127.0.0.1"),
        (["evil.example:8080"], [], "0.0.0.0"),
        (["evil.example"], ["http://evil.example"], "127.0.0.1"),
        (["localhost:8080"], ["http://evil.example"], "127.0.0.1"),
        (["localhost:8080"], ["http://localhost:8081"], "127.0.0.1"),
        (["localhost:8080"], ["null"], "127.0.0.1"),
        (["localhost:8080"], [""], "127.0.0.1"),
        (["localhost:8080"], ["file://localhost:8080"], "127.0.0.1"),
        (["localhost:8080", "evil.example"], [], "127.0.0.1"),
        (["localhost:8080"], ["http://localhost:8080", "http://evil.example"], "127.0.0.1"),
        (["localhost@evil.example"], [], "127.0.0.1"),
        (["localhost:8080/x"], [], "127.0.0.1"),
        (["localhost.evil.example"], [], "127.0.0.1"),
        (["10.0.0.9:8080"], [], "192.168.1.7"),
        ([""], [], "127.0.0.1"),
        (["[::1"], [], "127.0.0.1"),
        ([], ["http://evil.example"], "127.0.0.1"),
    ],
)
def test_other_sites_are_refused(hosts: list[str], origins: list[str], bound: str) -> None:
    assert refusal_reason(hosts, origins, bound) is not None


def _asked(port: int, method: str, path: str, body: bytes | None = None, **headers: str) -> int:
    """Return the status of the answer to a request with these headers."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    try:
        connection.putrequest(method, path, skip_host="Host" in headers)
        for name, value in headers.items():
            connection.putheader(name, value)
        if body is not None:
            connection.putheader("Content-Length", str(len(body)))
        connection.endheaders(body)
        return connection.getresponse().status
    finally:
        connection.close()


@contextmanager
def _page() -> Iterator[int]:
    server = serve_page(PageAddress(), "test")
    try:
        yield server.get_port()
    finally:
        server.stop()


def test_a_page_of_bodies_answers_its_own_page_alone() -> None:
    with _page() as port:
        own = f"http://127.0.0.1:{port}"
        assert _asked(port, "GET", "/") == 200
        assert _asked(port, "GET", "/", **_WEBSOCKET) == 101
        assert _asked(port, "GET", "/", Origin=own, **_WEBSOCKET) == 101
        for foreign in ({"Origin": "http://evil.example"}, {"Host": f"evil.example:{port}"}, {"Origin": "null"}):
            assert _asked(port, "GET", "/", **_WEBSOCKET, **foreign) == 403
            assert _asked(port, "GET", "/", **foreign) == 403


def test_a_policy_server_answers_no_page() -> None:
    made: list[Any] = []
    with PolicyServer(lambda: made.append(1), port=0) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        port, body = server.server_address[1], pack_message({"protocol": 1})
        try:
            for foreign in ({"Origin": "http://evil.example"}, {"Host": f"evil.example:{port}"}, {"Origin": "null"}):
                assert _asked(port, "POST", "/session", body, **foreign) == 403
            assert not made
            assert _asked(port, "POST", "/session", body) == 200
            assert made
        finally:
            server.shutdown()
            thread.join()
