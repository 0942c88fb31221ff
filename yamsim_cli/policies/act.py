"""Client of policy servers that answer HTTP POSTs of JSON to /act, such as MolmoAct2's and GR00T's for YAM arms.

Arrays are in json_numpy's format: base64 of the bytes, name of the dtype, and shape.
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
_URL_PATH = "/act"
_ARRAY_MARKER_KEY = "__numpy__"  # marks a JSON object as an array


class ActClient:
    """Client of an /act server, which connects again when the connection is lost.

    The URL is `act://HOST:PORT`, with a path if that is not `/act`. `timeout` is for each part of an answer, s.
    """

    def __init__(self, url: str, timeout: float) -> None:
        parts = urlsplit(url)
        host, port = parse_address(url, SCHEME, 8202)
        self._url, self._path = url, parts.path.rstrip("/") or _URL_PATH
        self._connection = http.client.HTTPConnection(host, port, timeout=timeout)
        try:
            self._connection.connect()
        except OSError as error:
            raise no_answer_error(url, error) from error

    def begin_trial(self, seed: int) -> None:
        """Do nothing: the server keeps no state of a trial."""

    def infer(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the server's answer to an observation's message. Raise RemoteError or TimeoutError without a valid
        answer.
        """
        with request_context(self._url, self._connection.close):
            data, status = self._post(dump_json(message))
        try:
            answer = load_json(data)
        except DamagedMessageError as error:
            raise RemoteError(f"{self._url} answers {status} without a valid message: {error}") from error
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
            # A server may close an idle connection: send again on a new one.
            self._connection.close()
            self._connection.request("POST", self._path, body, headers)
            response = self._connection.getresponse()
        return read_body(response), response.status


def dump_json(message: Any) -> bytes:
    """Encode a message as JSON, with arrays in json_numpy's format."""
    return json.dumps(message, default=_encode).encode()


def load_json(data: bytes) -> Any:
    """Decode a JSON message with arrays in json_numpy's format, which become read-only."""
    try:
        check_json(data)
        return json.loads(data, object_hook=_decode)
    except (ValueError, RecursionError) as error:
        text = str(error) if isinstance(error, DamagedMessageError) else f"not JSON: {str(error)[:100]}"
        raise DamagedMessageError(text) from error


def _encode(value: object) -> dict[str, Any]:
    if isinstance(value, np.ndarray | np.generic):
        content = base64.b64encode(value.tobytes()).decode("ascii")
        return {_ARRAY_MARKER_KEY: content, "dtype": value.dtype.str, "shape": list(value.shape)}
    raise TypeError(f"{type(value).__name__} cannot be sent")


def _decode(found: dict[str, Any]) -> Any:
    if _ARRAY_MARKER_KEY not in found:
        return found
    try:
        content = base64.b64decode(found[_ARRAY_MARKER_KEY], validate=True)
    except (TypeError, ValueError, binascii.Error) as error:
        raise DamagedMessageError("the content of an array is not base64") from error
    whole = array_from_bytes(content, found.get("dtype"), found.get("shape"))
    return whole if whole.ndim else whole[()]
