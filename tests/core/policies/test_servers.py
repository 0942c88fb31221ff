"""The tests' own servers read requests whole, however the network cuts them."""

from __future__ import annotations

import socket
import threading

import pytest

from tests.core.policies.servers import read_request

_POST = b"POST / HTTP/1.1\r\nContent-Length: 4\r\n\r\nbody"
_GET = b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"


@pytest.mark.parametrize("cut", [3, len(_POST) - 4, len(_POST) - 2, len(_POST) + 5])
def test_a_request_is_read_whole_wherever_it_is_cut(cut: int) -> None:
    client, server = socket.socketpair()
    with client, server:
        server.settimeout(5)
        sent = _POST + _GET
        client.sendall(sent[:cut])
        later = threading.Timer(0.05, client.sendall, (sent[cut:],))
        later.start()
        assert read_request(server) == _POST
        assert read_request(server) == _GET
        later.join()


def test_a_request_that_ends_early_is_an_error() -> None:
    client, server = socket.socketpair()
    with client, server:
        client.sendall(_POST[:-1])
        client.shutdown(socket.SHUT_WR)
        with pytest.raises(ConnectionError, match="within a request"):
            read_request(server)
