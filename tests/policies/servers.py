"""Small servers for policy clients: correct ones, and ones with any answer."""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from yamsim_cli.policies.act import dump_json, load_json

Infer = Callable[[Mapping[str, Any]], Any]


@contextmanager
def act_server(infer: Infer) -> Iterator[str]:
    """An /act server; `infer` returns the answer, bytes unchanged. Returns its URL."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        disable_nagle_algorithm = True

        def do_POST(self) -> None:
            answer = infer(load_json(self.rfile.read(int(self.headers["Content-Length"]))))
            data = answer if isinstance(answer, bytes) else dump_json(answer)
            self.send_response(200 if self.path == "/act" else 404)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, format: str, *args: Any) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"act://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def openpi_server(answer: Callable[[bytes], bytes | str], metadata: bytes = b"\x80") -> Iterator[str]:
    """A WebSocket server of another library that answers bytes with bytes or a text. Returns its URL."""
    from websockets.sync.server import ServerConnection, serve

    def handle(connection: ServerConnection) -> None:
        connection.send(metadata)
        for message in connection:
            assert isinstance(message, bytes)
            connection.send(answer(message))

    with serve(handle, "127.0.0.1", 0, compression=None, max_size=None) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        finally:
            server.shutdown()
            thread.join()


def read_request(connection: socket.socket) -> bytes:
    """Read one whole HTTP request, and nothing after it.

    A client may send the head and the body in two segments, so one `recv` can return the head alone.

    Raises:
        ConnectionError: the client closed the connection before the end of the request.
    """

    def receive(size: int) -> bytes:
        data = connection.recv(size)
        if not data:
            raise ConnectionError("the client closed the connection within a request")
        return data

    request = b""
    while not request.endswith(b"\r\n\r\n"):
        request += receive(1)  # One byte at a time, since the bytes after the head may be the next request's.
    length = re.search(rb"\r\ncontent-length:\s*(\d+)", request, re.IGNORECASE)
    end = len(request) + (int(length[1]) if length else 0)
    while len(request) < end:
        request += receive(end - len(request))
    return request


@contextmanager
def raw_server(answer: Callable[[socket.socket], None]) -> Iterator[int]:
    """A port whose every connection is passed to `answer`, and closed afterwards.

    An `answer` that speaks HTTP reads each request with `read_request`.
    """
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def run() -> None:
            while True:
                try:
                    connection, _ = listener.accept()
                except OSError:
                    return
                with connection, suppress(OSError):
                    connection.settimeout(5)
                    answer(connection)
                    # Closing with unread data would discard the sent answer.
                    connection.shutdown(socket.SHUT_WR)
                    while connection.recv(65536):
                        pass

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        try:
            yield listener.getsockname()[1]
        finally:
            listener.shutdown(socket.SHUT_RDWR)
            thread.join(5)
