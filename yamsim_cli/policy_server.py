"""Serve a policy to `yamsim eval --policy http://HOST:PORT`, from any process that can import yamsim.

    from yamsim_cli.policy_server import PolicyServer

    with PolicyServer(MyPolicy, port=8080) as server:
        print(server.url)
        server.serve_forever()

Needs only numpy and msgpack. Every client gets a policy of its own, made by the function that is given. Calls are made
one at a time, for all clients together. It listens on 127.0.0.1 unless told otherwise, and asks for no password.
"""

from __future__ import annotations

import secrets
import sys
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from .core.errors import ResourceError
from .core.page_origin import refusal
from .core.policies.loading import check_policy, reset_policy, wanted_images, wanted_state
from .core.policies.policy_faults import fault_of
from .core.policies.wire import PROTOCOL, UnsendableError, WireError, pack, require_msgpack, sendable, unpack
from .core.workers.serving import forks_end_here

LOOPBACK = "127.0.0.1"

# Bytes of the largest message that is read. Two pictures of 1920 x 1080 take a fifth of it.
_LARGEST = 64_000_000
_MOST_SESSIONS = 256


class PolicyServer(ThreadingHTTPServer):
    """Answers clients until `shutdown`; leaving it as a context manager closes the port.

    Args:
        make_policy: makes a policy, see `core.policies.base.Policy`; called for every client.
        host: address to listen on; beyond 127.0.0.1, anybody who reaches it can use it.
        port: 0 takes a free one.

    Raises:
        ResourceError: msgpack is not installed, or the port cannot be had.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, make_policy: Callable[[], Any], host: str = LOOPBACK, port: int = 8080) -> None:
        require_msgpack()
        self._make, self.host = make_policy, host
        self._sessions: dict[str, Any] = {}
        # Most models must not be called from two threads at once, and a GPU would not be faster by it.
        self._one_at_a_time = threading.Lock()
        try:
            super().__init__((host, port), _Handler)
        except OSError as error:
            raise ResourceError(f"{host}:{port} cannot be listened on: {error.strerror}; try another --port") from error

    @property
    def url(self) -> str:
        """The address that clients connect to."""
        host, port = self.server_address[:2]
        return f"http://{host if isinstance(host, str) else host.decode()}:{port}"

    def answer(self, what: str, message: Any) -> bytes:
        """The answer to a message, as bytes; an error is an answer too."""
        with self._one_at_a_time:
            try:
                # A fork that the policy makes would answer the client a second time.
                with forks_end_here():
                    return pack(self._answer(what, message))
            # The policy may raise anything; the client is told, and the server goes on.
            except Exception as error:  # noqa: BLE001
                return _fault(error)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that vanish, as workers do that are ended: nothing is lost with them."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    def _answer(self, what: str, message: Any) -> dict[str, Any]:
        if what == "session":
            if message["protocol"] != PROTOCOL:
                raise WireError(f"this server speaks version {PROTOCOL}, and not {message['protocol']}")
            if len(self._sessions) >= _MOST_SESSIONS:
                self._sessions.pop(next(iter(self._sessions)))
            policy = check_policy(self._make(), "of the server")
            session = secrets.token_hex(8)
            self._sessions[session] = policy
            asks = {"images": list(wanted_images(policy)), "wants": list(wanted_state(policy))}
            return {"session": session, **asks, "ticks": getattr(policy, "ticks", 1)}
        policy = self._sessions[message["session"]]
        if what == "reset":
            reset_policy(policy, message["seed"])
            return {}
        if what == "act":
            return {"action": sendable(policy(message["observation"]))}
        if what == "close":
            del self._sessions[message["session"]]
            return {}
        raise WireError(f"there is no /{what}")


def _fault(error: Exception) -> bytes:
    """What went wrong, as an answer."""
    if isinstance(error, WireError):
        told: dict[str, Any] = {"error": str(error), "invalid": isinstance(error, UnsendableError)}
    else:
        fault = fault_of(error, Path.cwd())
        told = {"error": fault.text, "traceback": fault.traceback}
        # Names of files may hold bytes that are no valid text.
        told = {key: text.encode(errors="backslashreplace").decode() for key, text in told.items()}
    return pack(told)


class _Handler(BaseHTTPRequestHandler):
    server: PolicyServer
    # Keeps the connection open: a new one for every action would take longer than the action itself.
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True

    def do_POST(self) -> None:
        """One message, and its answer; a web page of another site is refused."""
        hosts, origins = (self.headers.get_all(name, []) for name in ("Host", "Origin"))
        if refusal(hosts, origins, self.server.host) is not None:
            self.send_error(403)
            self.close_connection = True
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > _LARGEST:
            self.send_error(413)
            return
        try:
            data = self.server.answer(self.path.strip("/"), unpack(self.rfile.read(int(length))))
        except WireError as error:
            data = _fault(error)
        self.send_response(200)
        self.send_header("Content-Type", "application/msgpack")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: there are thirty requests a second."""
