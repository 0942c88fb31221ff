"""The protocol of /act: one HTTP POST an answer, JSON with arrays. MolmoAct2's and GR00T's servers for YAM speak it."""

from __future__ import annotations

import http.client
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

from .bounds import DamagedError
from .json_arrays import dump_json, load_json
from .peer import RemoteError, address_of, answering, content_of, nobody

SCHEME = "act"
_PATH = "/act"


class ActClient:
    """Asks a server over a connection that it keeps; one that is gone is made again for the next question.

    Args:
        url: `act://HOST:PORT`, or with a path other than `/act`.
        timeout: seconds to wait for a part of an answer.

    Raises:
        UsageError: the URL is not valid.
        ResourceError: nobody listens there.
    """

    def __init__(self, url: str, timeout: float) -> None:
        parts = urlsplit(url)
        host, port = address_of(url, SCHEME, 8202)
        self._url, self._path = url, parts.path.rstrip("/") or _PATH
        self._connection = http.client.HTTPConnection(host, port, timeout=timeout)
        try:
            self._connection.connect()
        except OSError as error:
            raise nobody(url, error) from error

    def begin(self, seed: int) -> None:
        """Nothing to do: the server remembers no trial."""

    def ask(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        """The server's answer.

        Raises:
            RemoteError: it is gone, or answers with an error or something else than a message.
            TimeoutError: there is none in time.
        """
        with answering(self._url, self._connection.close):
            data, status = self._post(dump_json(message))
        try:
            answer = load_json(data)
        except DamagedError as error:
            raise RemoteError(f"{self._url} answers {status} and no message: {error}") from error
        if status != http.client.OK or not isinstance(answer, dict):
            raise RemoteError(f"{self._url} answers {status}: {str(answer)[:300]}")
        return answer

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def _post(self, body: bytes) -> tuple[bytes, int]:
        headers = {"Content-Type": "application/json"}
        try:
            self._connection.request("POST", self._path, body, headers)
            response = self._connection.getresponse()
        except (ConnectionError, http.client.BadStatusLine):
            # A server may end a connection that was idle meanwhile; a new one tells whether it is there.
            self._connection.close()
            self._connection.request("POST", self._path, body, headers)
            response = self._connection.getresponse()
        return content_of(response), response.status
