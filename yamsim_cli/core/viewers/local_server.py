"""viser's server, limited to this machine's own pages and programs."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

import viser
import websockets.asyncio.server

from ..page_origin import refusal

# Held while viser's server starts, see `guarded`.
_STARTING = threading.Lock()


@contextlib.contextmanager
def guarded(host: str) -> Iterator[None]:
    """While this lasts, a WebSocket server that starts refuses requests from pages of other sites.

    viser makes its server by itself and has no hook for requests, so the function that it calls is wrapped meanwhile.
    """
    serve = websockets.asyncio.server.serve

    def with_check(*args: Any, process_request: Callable[..., Any] | None = None, **options: Any) -> Any:
        def check(connection: Any, request: Any) -> Any:
            headers = request.headers
            refused = refusal(headers.get_all("Host"), headers.get_all("Origin"), host)
            if refused is not None:
                return connection.respond(403, refused)
            return process_request(connection, request) if process_request is not None else None

        return serve(*args, process_request=check, **options)

    with _STARTING:
        websockets.asyncio.server.serve = with_check  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            websockets.asyncio.server.serve = serve  # type: ignore[misc]


class LocalServer(viser.ViserServer):
    """viser's server without its tunnel to a public address, for which any client could ask."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing: there is no tunnel."""
        return
