"""Base class of all browser pages: a server of the library viser, moving bodies, and a pause button."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import viser
import websockets.asyncio.server

from ..core.errors import ResourceError, UsageError
from ..http_origin import refusal_reason
from .page_address import PageAddress
from .scene_nodes import ClothNodes, add_bodies
from .viewed_scene import ViewedScene
from .viewpoint import FOV_DEG, Viewpoint

_DECIMALS = 5  # of sent positions (m) and quaternions; an arm at rest moves by less, so nothing is sent
_HEARTBEAT_PERIOD = 1.0  # s
_HEARTBEAT_TIMEOUT = 5.0  # s, after which a page shows that it is disconnected

# Held while a server starts, since `_refuse_pages_of_other_sites` then replaces a function of `websockets`.
_START_LOCK = threading.Lock()


class ScenePage:
    """A page that shows the moving bodies and cloths of a scene. Closing the page frees its port.

    Attributes:
        bodies, cloths: nodes of the bodies and the cloths.

    Raises:
        UsageError: the page cannot listen on the address.
    """

    def __init__(self, shown: ViewedScene, viewpoint: Viewpoint, address: PageAddress) -> None:
        # Browsers drop connections at any time. Without a handler, each drop prints a traceback on stderr.
        logging.getLogger("websockets").addHandler(logging.NullHandler())
        self._shown = shown
        self._server = serve_page(address, f"yamsim: {shown.title}")
        self.url = f"http://{address.url_host}:{self._server.get_port()}"
        self._show_bodies()
        camera = self._server.initial_camera
        camera.position, camera.look_at = viewpoint.position, viewpoint.look_at
        camera.fov, camera.near = math.radians(FOV_DEG), 0.01
        self._heartbeat = self._server.gui.add_html("")
        self._beat, self._beat_due = 0, 0.0
        self._status = self._server.gui.add_markdown("")
        self._pause_button = self._server.gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
        self._pause_button.on_click(self._toggle_pause)

    def update(self) -> None:
        """Send changes of the scene to all browsers."""
        if self._model is not self._shown.model:
            for node in self.bodies.frames.values():
                node.remove()
            self.cloths.remove()
            self._show_bodies()
        positions, quaternions = (np.round(poses, _DECIMALS) for poses in self._shown.body_poses())
        points = np.round(self._shown.cloth_points(), _DECIMALS)
        with self._server.atomic():
            if len(positions) != self._model.nbody or len(points) != self._model.nflexvert:
                return  # The model was replaced meanwhile; the next call shows the new model.
            for body, frame in self.bodies.frames.items():
                # viser sends changed poses only.
                frame.position, frame.wxyz = positions[body], quaternions[body]
            self.cloths.set_points(points)
        if self._pause_button.label != (label := "Play" if self._shown.paused else "Pause"):
            self._pause_button.label = label
            self._pause_button.icon = viser.Icon.PLAYER_PLAY if self._shown.paused else viser.Icon.PLAYER_PAUSE
        if (now := time.monotonic()) >= self._beat_due:
            self._beat, self._beat_due = self._beat + 1, now + _HEARTBEAT_PERIOD
            self._heartbeat.content = _disconnection_notice(self._beat)

    def close(self) -> None:
        """Stop the server, and free its port."""
        self._server.stop()

    def _show_bodies(self) -> None:
        self._model = self._shown.model
        self.bodies = add_bodies(self._server.scene, self._model)
        self.cloths = ClothNodes(self._server.scene, self._model)

    def _toggle_pause(self, _: Any) -> None:
        self._shown.paused = not self._shown.paused


def _disconnection_notice(beat: int) -> str:
    """Return HTML that shows a notice on the page, unless the next heartbeat replaces it in time.

    A server that is gone cannot send a notice, so each heartbeat contains it in advance.
    """
    name = f"yamsim-gone-{beat}"
    hidden = "visibility: hidden; overflow: hidden; max-height: 0"
    style = "background: rgb(150, 0, 0); color: white; font-weight: bold"
    shown = f"{hidden}; {style}; animation: {name} 0s {_HEARTBEAT_TIMEOUT}s forwards"
    across = "position: fixed; bottom: 0; left: 0; width: 100vw; z-index: 10000; font-size: 1.3em; text-align: center"
    return (
        f"<style>@keyframes {name} {{ to {{ visibility: visible; max-height: 8em; padding: 0.7em }} }}</style>"
        f'<div style="{shown}">Disconnected: this page is no longer updated.</div>'
        f'<div style="{shown}; {across}">Disconnected: the server has ended, and nothing is recorded.</div>'
    )


class _LocalServer(viser.ViserServer):
    """A viser server without public tunnels, which any browser could request."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing, instead of opening a tunnel to a public address."""
        return


def serve_page(address: PageAddress, title: str) -> viser.ViserServer:
    """Serve an empty page that refuses requests of other sites."""
    require_free_address(address)
    with _refuse_pages_of_other_sites(address.host):
        server = _LocalServer(host=address.host, port=address.port, label=title, verbose=False)
    if address.port and server.get_port() != address.port:
        # Another program took the port meanwhile, so viser chose the next free port.
        server.stop()
        raise _port_error(address, "it is in use")
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.scene.world_axes.visible = False
    return server


@contextlib.contextmanager
def _refuse_pages_of_other_sites(host: str) -> Iterator[None]:
    """Make a WebSocket server that starts inside this block refuse requests from pages of other sites.

    viser has no hook for requests, so the block wraps the function that viser calls.
    """
    serve = websockets.asyncio.server.serve

    def with_origin_check(*args: Any, process_request: Callable[..., Any] | None = None, **options: Any) -> Any:
        def check(connection: Any, request: Any) -> Any:
            headers = request.headers
            refused = refusal_reason(headers.get_all("Host"), headers.get_all("Origin"), host)
            if refused is not None:
                return connection.respond(403, refused)
            return process_request(connection, request) if process_request is not None else None

        return serve(*args, process_request=check, **options)

    with _START_LOCK:
        websockets.asyncio.server.serve = with_origin_check  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            websockets.asyncio.server.serve = serve  # type: ignore[misc]


def require_free_address(address: PageAddress) -> None:
    """Raise UsageError or ResourceError unless a page can listen on an address."""
    try:
        family, kind, _, _, place = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM)[0]
    except socket.gaierror as error:
        reason = error.strerror or str(error)
        raise UsageError(f"--host {address.host} is not valid ({reason}): give an address of this machine") from error
    with socket.socket(family, kind) as probe:
        if os.name == "posix":
            # The server also sets this option, so that closing connections of an earlier page do not block the port.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(place)
        except OSError as error:
            raise _port_error(address, error.strerror or str(error)) from error


def _port_error(address: PageAddress, reason: str) -> UsageError | ResourceError:
    if address.port == 0:
        return UsageError(f"--host {address.host} cannot be used ({reason}): give an address of this machine")
    return ResourceError(
        f"--port {address.port} cannot be used on {address.host} ({reason}): give another, or 0 for a free one"
    )
