"""The protocol /act of MolmoAct2's and GR00T's servers for YAM: an HTTP POST of JSON for each answer.

Arrays are written as the package json_numpy writes them: base64 of the bytes, the dtype's name and the shape.
"""

from __future__ import annotations

import base64
import binascii
import http.client
import json
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from .policy_client import (
    DamagedMessageError,
    RemoteError,
    array_from_bytes,
    check_json,
    no_answer_error,
    parse_address,
    read_body,
    request_context,
)

SCHEME = "act"
_PATH = "/act"
_ARRAY_KEY = "__numpy__"


class ActClient:
    """Asks a server over one connection, which is made again when it is lost.

    Args:
        url: `act://HOST:PORT`, or with a path other than `/act`.
        timeout: for a part of an answer, s.

    Raises:
        UsageError: the URL is not valid.
        ResourceError: no server listens there.
    """

    def __init__(self, url: str, timeout: float) -> None:
        parts = urlsplit(url)
        host, port = parse_address(url, SCHEME, 8202)
        self._url, self._path = url, parts.path.rstrip("/") or _PATH
        self._connection = http.client.HTTPConnection(host, port, timeout=timeout)
        try:
            self._connection.connect()
        except OSError as error:
            raise no_answer_error(url, error) from error

    def begin(self, seed: int) -> None:
        """Do nothing: the server keeps no state of a trial."""

    def infer(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        """The server's answer.

        Raises:
            RemoteError: the server is gone, or answers with an error or with no message.
            TimeoutError: the server did not answer in time.
        """
        with request_context(self._url, self._connection.close):
            data, status = self._post(dump_json(message))
        try:
            answer = load_json(data)
        except DamagedMessageError as error:
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
            # A server may close an idle connection, so the request is sent once more on a new one.
            self._connection.close()
            self._connection.request("POST", self._path, body, headers)
            response = self._connection.getresponse()
        return read_body(response), response.status


def dump_json(message: Any) -> bytes:
    """A message of plain containers, text, numbers and arrays."""
    return json.dumps(message, default=_encode).encode()


def load_json(data: bytes) -> Any:
    """The message in bytes; arrays in it are read-only.

    Raises:
        DamagedError: the bytes are no JSON, hold too many values, or an array is damaged.
    """
    try:
        check_json(data)
        return json.loads(data, object_hook=_decode)
    except (ValueError, RecursionError) as error:
        text = str(error) if isinstance(error, DamagedMessageError) else f"no JSON: {str(error)[:100]}"
        raise DamagedMessageError(text) from error


def _encode(value: object) -> dict[str, Any]:
    if isinstance(value, np.ndarray | np.generic):
        content = base64.b64encode(value.tobytes()).decode("ascii")
        return {_ARRAY_KEY: content, "dtype": value.dtype.str, "shape": list(value.shape)}
    raise TypeError(f"{type(value).__name__} cannot be sent")


def _decode(found: dict[str, Any]) -> Any:
    if _ARRAY_KEY not in found:
        return found
    try:
        content = base64.b64decode(found[_ARRAY_KEY], validate=True)
    except (TypeError, ValueError, binascii.Error) as error:
        raise DamagedMessageError("an array whose content is no base64") from error
    whole = array_from_bytes(content, found.get("dtype"), found.get("shape"))
    return whole if whole.ndim else whole[()]
