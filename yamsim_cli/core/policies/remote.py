"""A policy that runs in another process, on this machine or another, and is asked over HTTP."""

from __future__ import annotations

import contextlib
import http.client
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

from ..errors import ResourceError, UsageError
from .base import InvalidActionError, Observation
from .bounds import LONGEST_TEXT, plain_numbers
from .peer import RemoteError, answering, content_of
from .wire import PROTOCOL, WireError, pack, require_msgpack, unpack


class RemotePolicy:
    """Asks a server, see `yamsim_cli.policy_server`, for every action.

    It has a session of its own on the server. One connection serves all calls.

    Attributes:
        images, wants, ticks: those of the server's policy.

    Args:
        url: the server's URL, such as `http://127.0.0.1:8080`.
        timeout: seconds to wait for an answer.

    Raises:
        UsageError: the URL is not valid.
        ResourceError: nobody answers there, or only in another protocol.
    """

    def __init__(self, url: str, timeout: float) -> None:
        require_msgpack()
        parts = urlsplit(url)
        if parts.scheme != "http" or not parts.hostname or parts.path.strip("/"):
            raise UsageError(f"--policy {url} is not valid: give http://HOST:PORT")
        self._url = url
        self._connection = http.client.HTTPConnection(parts.hostname, parts.port or 80, timeout=timeout)
        try:
            session = self._ask("session", {"protocol": PROTOCOL})
            self.images, self.ticks = tuple(session["images"]), int(session["ticks"])
            # Older servers do not send this.
            self.wants = tuple(session.get("wants", ()))
            self._session = session["session"]
        except (OSError, RemoteError, KeyError, TypeError, ValueError) as error:
            raise ResourceError(
                f"--policy {url}: no policy answers there: {error}; start one with yamsim serve-policy"
            ) from error

    def reset(self, seed: int) -> None:
        """Tell the server's policy to forget the previous trial."""
        self._ask("reset", {"session": self._session, "seed": seed})

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        """The answer of the server's policy.

        Raises:
            RemoteError: the policy raised something, or the server is gone.
            InvalidActionError: its answer cannot be sent.
            TimeoutError: it did not answer in time.
        """
        answer = self._ask("act", {"session": self._session, "observation": dict(observation)})
        action = answer.get("action")
        if not isinstance(action, dict):
            raise RemoteError(f"{self._url} answers with no action")
        for key, value in action.items():
            if value is not None:
                plain_numbers(value, str(key)[:40])
        return action

    def close(self) -> None:
        """End the session, and close the connection."""
        with contextlib.suppress(OSError, RemoteError, AttributeError):
            self._ask("close", {"session": self._session})
        self._connection.close()

    def _ask(self, what: str, message: Mapping[str, Any]) -> dict[str, Any]:
        with answering(self._url, self._connection.close):
            self._connection.request("POST", f"/{what}", pack(message), {"Content-Type": "application/msgpack"})
            response = self._connection.getresponse()
            data = content_of(response)
        try:
            answer = unpack(data)
        except WireError as error:
            raise RemoteError(f"{self._url} answers {response.status} and no message of this protocol") from error
        if not isinstance(answer, dict):
            raise RemoteError(f"{self._url} answers with {type(answer).__name__}")
        if answer.get("invalid"):
            raise InvalidActionError(str(answer.get("error"))[:LONGEST_TEXT])
        if "error" in answer:
            raise RemoteError(str(answer["error"]), str(answer.get("traceback", "")))
        return answer
