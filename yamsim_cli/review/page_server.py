"""The server of the review page, on this machine only.

`GET /` is the page. `GET` of `/api/...`, `/strip/...` and `/picture/...` reads the dataset. `POST` of `/api/...`
changes decisions. Only one open page may decide. It names itself by a token, which it claims when it opens and renews
while it is open.
"""

from __future__ import annotations

import contextlib
import functools
import json
import re
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from ..core.config.rig import RigConfig
from ..core.dataset.reader import open_recorded_episode
from ..core.errors import DatasetError, ResourceError, UsageError, YamsimError
from ..http_origin import refusal_reason
from ..selection import EpisodeDecision
from .decisions import DecisionFile
from .episode_detail import film_strip, read_picture, timeline
from .episode_index import COLUMN_NAMES
from .scene_player import ScenePlayer

LOOPBACK = "127.0.0.1"
CLAIM_SECONDS = 6.0  # s after which a page that no longer renews its claim counts as closed; it renews every 2 s

_MAX_BODY = 100_000  # bytes of a request; a decision with the longest note has 2,000
_STRIPS = 2000  # film strips in memory, 8 kB each
_PAGE = Path(__file__).with_name("page")
_STYLE = Path(__file__).parents[1] / "core" / "report.css"
_FILES = {
    "/": (_PAGE / "index.html", "text/html; charset=utf-8"),
    "/report.css": (_STYLE, "text/css; charset=utf-8"),
    **{f"/{name}.js": (_PAGE / f"{name}.js", "text/javascript; charset=utf-8") for name in
       ("review", "grid", "plot", "episode", "server")},
    "/review.css": (_PAGE / "review.css", "text/css; charset=utf-8"),
}  # fmt: skip
_EPISODE = re.compile(r"^/api/episode/(\d{1,9})$")
_STRIP = re.compile(r"^/strip/(\d{1,9})\.jpg$")
_PICTURE = re.compile(r"^/picture/(\d{1,9})/([A-Za-z0-9_-]{1,100})/(\d{1,9})\.jpg$")
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}
_STATUS: dict[type[YamsimError], int] = {
    UsageError: 400,
    DatasetError: 422,
    ResourceError: 507,
}  # HTTP status of an error


class PageClaim:
    """Which open page may decide. Any thread may call the methods."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._token = ""
        self._seen = -CLAIM_SECONDS

    def claim(self, token: str, *, take_over: bool) -> str | None:
        """Return the token of the page that may decide now: `token`, or a new one; None if another page is open."""
        with self._lock:
            held = self._token and self._clock() - self._seen < CLAIM_SECONDS
            if held and not take_over and not self._is_holder(token):
                return None
            if not (held and self._is_holder(token)):
                self._token = secrets.token_hex(8)
            self._seen = self._clock()
            return self._token

    def _is_holder(self, token: str) -> bool:
        return secrets.compare_digest(token.encode(errors="replace"), self._token.encode())

    def release(self, token: str) -> None:
        """Let another page decide, after this page was closed."""
        with self._lock:
            if self._is_holder(token):
                self._token = ""

    def holds(self, token: str) -> bool:
        """Return whether the page with this token may decide."""
        with self._lock:
            return bool(self._token) and self._is_holder(token)


class ReviewServer(ThreadingHTTPServer):
    """HTTP server of one review.

    Args:
        dataset: the dataset's directory.
        directories: episode number -> directory.
        rows: rows of the overview, see `episode_index.read_rows`.
        decisions: the selection file.
        reviewer: name in the lines of new decisions.
        rig: for the names of the drives; None if unknown.
        port: 0 selects a free port.

    Raises:
        ResourceError: the server cannot listen on the port.
    """

    # `server_close` joins threads that are no daemons. The process aborts if it exits while a thread runs OpenCV.
    daemon_threads = False
    allow_reuse_address = True

    def __init__(
        self,
        dataset: Path,
        directories: Mapping[int, Path],
        rows: list[dict[str, Any]],
        decisions: DecisionFile,
        reviewer: str,
        rig: RigConfig | None,
        port: int,
    ) -> None:
        self.dataset, self.directories, self.reviewer, self.rig = dataset, directories, reviewer, rig
        self.claim = PageClaim()
        self._decisions = decisions
        self._write_lock = threading.Lock()
        self._session = secrets.token_hex(4)  # in the addresses of pictures, so that no browser shows older ones
        self._rows = json.dumps(rows, separators=(",", ":"), ensure_ascii=False)
        self.scenes = ScenePlayer()
        self._connections = set[Any]()
        self.strip = functools.lru_cache(_STRIPS)(self._make_strip)
        self.opened = functools.lru_cache(16)(open_recorded_episode)
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except OSError as error:
            raise ResourceError(f"cannot listen on {LOOPBACK}:{port}: {error.strerror}; try another --port") from error

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{LOOPBACK}:{self.server_address[1]}/"

    def directory(self, number: int) -> Path:
        """Return the directory of an episode. Raise DatasetError if there is none."""
        if number not in self.directories:
            raise DatasetError(f"there is no episode {number}")
        return self.directories[number]

    def _make_strip(self, number: int) -> bytes:
        return film_strip(self.directory(number), self.dataset)

    def overview(self) -> bytes:
        """Return the rows and decisions of all episodes as JSON."""
        decisions = {number: _decision_data(each) for number, each in self._decisions.decisions.items()}
        head = {
            "dataset": self.dataset.absolute().name,
            "selection": str(self._decisions.path),
            "undecided": self._decisions.undecided,
            "reviewer": self.reviewer,
            "stale": self._decisions.stale,
            "session": self._session,
            "decisions": decisions,
            "names": COLUMN_NAMES,
        }
        return f'{json.dumps(head, ensure_ascii=False)[:-1]},"episodes":{self._rows}}}'.encode()

    def decide(self, body: Mapping[str, Any]) -> dict[str, Any]:
        """Store a decision of the page. Raises as `DecisionFile.decide`."""
        number = _episode_number(body)
        with self._write_lock:
            made = self._decisions.decide(number, body, self.reviewer)
        return {"episode": number, "decision": made and _decision_data(made)}

    def play_scene(self, body: Mapping[str, Any]) -> dict[str, Any]:
        """Return the address of the 3D scene of an episode. Raises as `ScenePlayer.play`."""
        return {"url": self.scenes.play(self.directory(_episode_number(body)))}

    def get_request(self) -> tuple[Any, Any]:
        """Return the next connection and its address."""
        connection, address = super().get_request()
        self._connections.add(connection)
        return connection, address

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        self._connections.discard(request)
        super().shutdown_request(request)

    def server_close(self) -> None:
        """Stop listening, answer what was requested, and end the player of the 3D scene."""
        for connection in tuple(self._connections):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RD)  # ends threads that wait for another request
        super().server_close()
        self.scenes.close()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore lost connections, such as those of pictures that were scrolled away."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


def _episode_number(body: Mapping[str, Any]) -> int:
    number = body.get("episode")
    if not isinstance(number, int):
        raise UsageError("episode: it must be a number")
    return number


def _decision_data(decision: EpisodeDecision) -> dict[str, Any]:
    return decision.model_dump(mode="json", exclude={"episode", "sha256"})


class _Handler(BaseHTTPRequestHandler):
    server: ReviewServer
    protocol_version = "HTTP/1.1"
    timeout = 60  # s for the rest of a request

    def do_GET(self) -> None:
        if self._is_refused():
            return
        path = self.path.partition("?")[0]
        try:
            if path in _FILES:
                file, kind = _FILES[path]
                self._send(200, file.read_bytes(), kind)
            elif path == "/api/episodes":
                self._send(200, self.server.overview())
            elif match := _EPISODE.match(path):
                found = timeline(self.server.directory(int(match[1])), self.server.rig, self.server.dataset)
                self._send_json(200, found)
            elif match := _STRIP.match(path):
                self._send(200, self.server.strip(int(match[1])), "image/jpeg", lasting=True)
            elif match := _PICTURE.match(path):
                episode = self.server.opened(self.server.directory(int(match[1])))
                data = read_picture(episode, match[2], int(match[3]), self.server.dataset)
                self._send(200, data, "image/jpeg", lasting=True)
            else:
                self._send_json(404, {"error": "there is no such page"})
        except YamsimError as error:
            self._send_error(error)

    def do_POST(self) -> None:
        if self._is_refused():
            return
        try:
            body = self._read_body()
            token = str(body.get("token", ""))
            if self.path == "/api/claim":
                held = self.server.claim.claim(token, take_over=bool(body.get("take_over")))
                self._send_json(200 if held else 409, {"token": held})
            elif self.path == "/api/release":
                self.server.claim.release(token)
                self._send_json(200, {})
            elif self.path in ("/api/decide", "/api/scene"):
                if not self.server.claim.holds(token):
                    self._send_json(409, {"error": "another page is open, and only one page can decide"})
                elif self.path == "/api/decide":
                    self._send_json(200, self.server.decide(body))
                else:
                    self._send_json(200, self.server.play_scene(body))
            else:
                self._send_json(404, {"error": "there is no such page"})
        except YamsimError as error:
            self._send_error(error)

    def _is_refused(self) -> bool:
        hosts, origins = self.headers.get_all("Host", []), self.headers.get_all("Origin", [])
        reason = refusal_reason(hosts, origins, LOOPBACK)
        # A browser names the site of a request for a picture or a script only here.
        if reason is None and self.headers.get("Sec-Fetch-Site", "none") not in ("same-origin", "none"):
            reason = "the request comes from another site"
        if reason is not None:
            self.close_connection = True
            self._send_json(403, {"error": f"refused: {reason}"})
        return reason is not None

    def _read_body(self) -> dict[str, Any]:
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > _MAX_BODY:
            self.close_connection = True
            raise UsageError(f"a request must have at most {_MAX_BODY} bytes")
        try:
            body = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            body = None
        if not isinstance(body, dict):
            raise UsageError("the request is no JSON object")
        return body

    def _send_error(self, error: YamsimError) -> None:
        status = next((code for kind, code in _STATUS.items() if isinstance(error, kind)), 422)
        self._send_json(status, {"error": str(error)})

    def _send_json(self, status: int, data: Mapping[str, Any]) -> None:
        self._send(status, json.dumps(data, ensure_ascii=False, allow_nan=False).encode())

    def _send(self, status: int, data: bytes, kind: str = "application/json", *, lasting: bool = False) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Cache-Control", "private, max-age=600" if lasting else "no-store")
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing."""
