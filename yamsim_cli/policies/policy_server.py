"""Serve a policy to `yamsim eval --policy http://HOST:PORT` from any process that can import yamsim.

    from yamsim_cli.policies.policy_server import PolicyServer

    with PolicyServer(MyPolicy, port=8080) as server:
        print(server.url)
        server.serve_forever()

The server needs numpy and msgpack only. It calls the given function to make a policy for each client, and calls the
policies of all clients one at a time. It listens on 127.0.0.1 by default, without a password.
"""

from __future__ import annotations

import secrets
import sys
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from yamsim_cli.core.extras import require_library

from ..core.errors import ResourceError
from ..core.workers.job_server import kill_forks_at_exit
from ..http_origin import refusal_reason
from .policy_faults import describe_fault
from .policy_loading import check_policy, reset_policy, wanted_images, wanted_state
from .remote_policy import PROTOCOL, MessageError, UnsendableError, pack_message, require_sendable, unpack_message

LOOPBACK = "127.0.0.1"

_MAX_BYTES = 64_000_000  # of a message; two images of 1920 x 1080 take a fifth
_MAX_SESSIONS = 256  # a further client replaces the oldest


class PolicyServer(ThreadingHTTPServer):
    """HTTP server that answers clients until `shutdown`. As a context manager, it closes its port at the end.

    Args:
        make_policy: makes a policy for each client, as `policies.policy_protocol.Policy`.
        host: with an address other than 127.0.0.1, other machines can use the policy.
        port: 0 selects a free port.

    Raises:
        ResourceError: msgpack is not installed, or the server cannot listen on the port.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, make_policy: Callable[[], Any], host: str = LOOPBACK, port: int = 8080) -> None:
        require_library("a policy in another process", "msgpack", "remote")
        self._make, self.host = make_policy, host
        self._sessions: dict[str, Any] = {}
        # Most models do not support simultaneous calls from two threads.
        self._one_at_a_time = threading.Lock()
        try:
            super().__init__((host, port), _Handler)
        except OSError as error:
            raise ResourceError(f"cannot listen on {host}:{port}: {error.strerror}; try another --port") from error

    @property
    def url(self) -> str:
        """Address for clients."""
        host, port = self.server_address[:2]
        return f"http://{host if isinstance(host, str) else host.decode()}:{port}"

    def answer_message(self, what: str, message: Any) -> bytes:
        """Return the encoded answer to a message that was posted to `/<what>`. An error becomes an answer too."""
        with self._one_at_a_time:
            try:
                # Otherwise, a process that the policy forks would answer the client again.
                with kill_forks_at_exit():
                    return pack_message(self._handle_message(what, message))
            # A policy may raise any exception, and its client needs an answer.
            except Exception as error:  # noqa: BLE001
                return _fault_answer(error)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore lost connections, such as those of terminated workers."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    def _handle_message(self, what: str, message: Any) -> dict[str, Any]:
        if what == "session":
            if message["protocol"] != PROTOCOL:
                raise MessageError(f"this server speaks version {PROTOCOL} of the protocol, not {message['protocol']}")
            if len(self._sessions) >= _MAX_SESSIONS:
                self._sessions.pop(next(iter(self._sessions)))
            policy = check_policy(self._make(), "of the server")
            session = secrets.token_hex(8)
            self._sessions[session] = policy
            requests = {"images": list(wanted_images(policy)), "wants": list(wanted_state(policy))}
            return {"session": session, **requests, "ticks": getattr(policy, "ticks", 1)}
        policy = self._sessions[message["session"]]
        if what == "reset":
            reset_policy(policy, message["seed"])
            return {}
        if what == "act":
            return {"action": require_sendable(policy(message["observation"]))}
        if what == "close":
            del self._sessions[message["session"]]
            return {}
        raise MessageError(f"there is no /{what}")


def _fault_answer(error: Exception) -> bytes:
    if isinstance(error, MessageError):
        report: dict[str, Any] = {"error": str(error), "invalid": isinstance(error, UnsendableError)}
    else:
        fault = describe_fault(error, Path.cwd())
        report = {"error": fault.text, "traceback": fault.traceback}
        # File names may contain bytes that are no valid text.
        report = {key: text.encode(errors="backslashreplace").decode() for key, text in report.items()}
    return pack_message(report)


class _Handler(BaseHTTPRequestHandler):
    server: PolicyServer
    # HTTP/1.1 keeps the connection open: a new connection for each action takes longer than the action.
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True

    def do_POST(self) -> None:
        """Answer one message. Requests from web pages of other sites are refused."""
        hosts, origins = (self.headers.get_all(name, []) for name in ("Host", "Origin"))
        if refusal_reason(hosts, origins, self.server.host) is not None:
            self.send_error(403)
            self.close_connection = True
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > _MAX_BYTES:
            self.send_error(413)
            return
        try:
            data = self.server.answer_message(self.path.strip("/"), unpack_message(self.rfile.read(int(length))))
        except MessageError as error:
            data = _fault_answer(error)
        self.send_response(200)
        self.send_header("Content-Type", "application/msgpack")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: clients send about thirty requests per second."""
