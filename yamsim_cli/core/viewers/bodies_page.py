"""The base of all browser pages: bodies that move, and a button to pause them."""

from __future__ import annotations

import logging
import math
import os
import socket
import time
from typing import Any

import numpy as np
import viser

from ..errors import ResourceError, UsageError
from .address import PageAddress
from .cloths import ClothNodes
from .local_server import LocalServer, guarded
from .shapes import add_bodies
from .shown import Shown
from .viewpoint import FOV_DEG, Viewpoint

# Decimals of positions (m) and quaternions that are sent.
_DECIMALS = 5

# How often a page is told that it is connected, and how long after the last time it says that it is not, s.
_BEAT_SECONDS = 1.0
_SILENCE_SECONDS = 5.0


class BodiesPage:
    """A page that shows the bodies of `shown` as they move. Closing it frees its port.

    Raises:
        UsageError: the page cannot listen on the address.
    """

    def __init__(self, shown: Shown, viewpoint: Viewpoint, address: PageAddress) -> None:
        # Browsers drop connections at any time. Without a handler, each would print a traceback on stderr.
        logging.getLogger("websockets").addHandler(logging.NullHandler())
        self._shown = shown
        self._server = _serve(address, f"yamsim: {shown.title}")
        self.url = f"http://{address.url_host}:{self._server.get_port()}"
        self._show_bodies()
        self._place_camera(viewpoint)
        self._heartbeat = self._server.gui.add_html("")
        self._beat, self._beat_due = 0, 0.0
        self._status = self._server.gui.add_markdown("")
        self._pause_button = self._server.gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
        self._pause_button.on_click(self._toggle_pause)

    def update(self) -> None:
        """Send what has changed since the last call to all clients."""
        # An arm at rest trembles by less than anyone can see. Rounding keeps that from being sent.
        if self._model is not self._shown.model:
            for node in self._bodies.frames.values():
                node.remove()
            self._cloths.remove()
            self._show_bodies()
        positions, quaternions = (np.round(poses, _DECIMALS) for poses in self._shown.body_poses())
        points = np.round(self._shown.cloth_points(), _DECIMALS)
        with self._server.atomic():
            if len(positions) != self._model.nbody or len(points) != self._model.nflexvert:
                return  # Another scene has come up in between, and is shown by the next call.
            for body, frame in self._bodies.frames.items():
                # viser does not send a pose that has not changed.
                frame.position, frame.wxyz = positions[body], quaternions[body]
            self._cloths.show(points)
        if self._pause_button.label != (label := "Play" if self._shown.paused else "Pause"):
            self._pause_button.label = label
            self._pause_button.icon = viser.Icon.PLAYER_PLAY if self._shown.paused else viser.Icon.PLAYER_PAUSE
        if (now := time.monotonic()) >= self._beat_due:
            self._beat, self._beat_due = self._beat + 1, now + _BEAT_SECONDS
            self._heartbeat.content = _disconnected(self._beat)

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()

    def _show_bodies(self) -> None:
        self._model = self._shown.model
        self._bodies = add_bodies(self._server.scene, self._model)
        self._cloths = ClothNodes(self._server.scene, self._model)

    def _place_camera(self, viewpoint: Viewpoint) -> None:
        camera = self._server.initial_camera
        camera.position, camera.look_at = viewpoint.position, viewpoint.look_at
        camera.fov, camera.near = math.radians(FOV_DEG), 0.01

    def _toggle_pause(self, _: Any) -> None:
        self._shown.paused = not self._shown.paused


def _disconnected(beat: int) -> str:
    """A notice that appears by itself, on the panel and across the page, unless another one replaces it in time.

    A page whose server is gone still shows the last state that it was sent, such as a recording that goes on. Nobody
    can tell it otherwise then, so that the notice has to be there before.
    """
    name = f"yamsim-gone-{beat}"
    hidden = "visibility: hidden; overflow: hidden; max-height: 0"
    looks = "background: rgb(150, 0, 0); color: white; font-weight: bold"
    shown = f"{hidden}; {looks}; animation: {name} 0s {_SILENCE_SECONDS}s forwards"
    across = "position: fixed; bottom: 0; left: 0; width: 100vw; z-index: 10000; font-size: 1.3em; text-align: center"
    return (
        f"<style>@keyframes {name} {{ to {{ visibility: visible; max-height: 8em; padding: 0.7em }} }}</style>"
        f'<div style="{shown}">Disconnected: nothing below is up to date.</div>'
        f'<div style="{shown}; {across}">Disconnected: the server is gone, and nothing is recorded.</div>'
    )


def _serve(address: PageAddress, title: str) -> viser.ViserServer:
    check_free(address)
    with guarded(address.host):
        server = LocalServer(host=address.host, port=address.port, label=title, verbose=False)
    if address.port and server.get_port() != address.port:
        # Another program took the port meanwhile. viser then takes the next free one, which nobody asked for.
        server.stop()
        raise _taken(address, "it is in use")
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.scene.world_axes.visible = False
    return server


def check_free(address: PageAddress) -> None:
    """Make sure that a page can listen on an address.

    Raises:
        UsageError: the host is no address of this machine.
        ResourceError: the port is taken, or may not be used.
    """
    try:
        family, kind, _, _, place = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM)[0]
    except socket.gaierror as error:
        reason = error.strerror or str(error)
        raise UsageError(f"--host {address.host} is not valid ({reason}): give an address of this machine") from error
    with socket.socket(family, kind) as probe:
        if os.name == "posix":
            # The server sets this, too: connections of an earlier page that are still closing are not in the way.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(place)
        except OSError as error:
            raise _taken(address, error.strerror or str(error)) from error


def _taken(address: PageAddress, reason: str) -> UsageError | ResourceError:
    if address.port == 0:
        return UsageError(f"--host {address.host} cannot be used ({reason}): give an address of this machine")
    return ResourceError(
        f"--port {address.port} cannot be used on {address.host} ({reason}): give another, or 0 for a free one"
    )
