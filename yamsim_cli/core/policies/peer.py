"""What clients of policies elsewhere share: where a server is, that it answers no more, and how much of it is read."""

from __future__ import annotations

import http.client
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit

from ..errors import ResourceError, UsageError
from .bounds import LARGEST, LONGEST_TEXT, LONGEST_TRACEBACK
from .policy_faults import Fault


class RemoteError(RuntimeError):
    """The server's policy raised something, or the server is gone.

    Attributes:
        fault: the description of what went wrong.
    """

    def __init__(self, text: str, traceback: str = "") -> None:
        text = text[:LONGEST_TEXT]
        super().__init__(text)
        self.fault = Fault(text, traceback[-LONGEST_TRACEBACK:])


def address_of(url: str, scheme: str, port: int) -> tuple[str, int]:
    """Host and port of a URL.

    Raises:
        UsageError: it is not of this scheme, or has no host.
    """
    try:
        parts = urlsplit(url)
        given = parts.port
    except ValueError:
        parts, given = urlsplit(""), None
    if parts.scheme != scheme or not parts.hostname or parts.query or parts.fragment or parts.username:
        raise UsageError(f"--policy {url} is not valid: give {scheme}://HOST:PORT")
    return parts.hostname, given or port


def nobody(url: str, error: object) -> ResourceError:
    """That nobody answers at a URL, for the user."""
    return ResourceError(f"--policy {url}: no policy answers there: {error}; start its server first")


@contextmanager
def answering(url: str, hang_up: Callable[[], None]) -> Iterator[None]:
    """While a question is asked and answered. Whatever ends it early, the connection is hung up: what comes later on it
    would be taken for another question's answer.

    Raises:
        RemoteError: the server is gone.
        TimeoutError: it did not answer in time.
    """
    try:
        yield
    except BaseException as error:
        hang_up()
        if isinstance(error, OSError | http.client.HTTPException) and not isinstance(error, TimeoutError):
            raise RemoteError(f"{url} is gone: {str(error) or type(error).__name__}") from error
        raise


def content_of(response: http.client.HTTPResponse) -> bytes:
    """The whole of an HTTP answer.

    Raises:
        http.client.HTTPException: it is longer than is read.
    """
    data = response.read(LARGEST + 1)
    if len(data) > LARGEST:
        raise http.client.HTTPException(f"its answer is longer than {LARGEST} bytes")
    return data
