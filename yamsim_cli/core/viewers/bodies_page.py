"""What every browser page has: bodies that move, a button to stop them, and this machine's loopback address alone."""

from __future__ import annotations

import logging
import math
import os
import socket
from typing import Any

import viser

from ..errors import UsageError
from .shapes import add_bodies
from .shown import Shown
from .viewpoint import FOV_DEG, Viewpoint

HOST = "127.0.0.1"


class _LoopbackServer(viser.ViserServer):
    """viser's server without its way out: any client can ask it for a tunnel to a public address."""

    def request_share_url(self, verbose: bool = True) -> None:
        return None


class BodiesPage:
    """A page on which the bodies of `shown` stand where they are; closing it frees its port.

    Args:
        port: to listen on; 0 takes a free one.

    Raises:
        UsageError: the port cannot be had.
    """

    def __init__(self, shown: Shown, viewpoint: Viewpoint, port: int) -> None:
        # A browser drops connections as it pleases; without a handler, each one would be a traceback on stderr.
        logging.getLogger("websockets").addHandler(logging.NullHandler())
        self._shown = shown
        self._server = _serve(port, f"yamsim: {shown.title}")
        self.url = f"http://{HOST}:{self._server.get_port()}"
        self._frames = add_bodies(self._server.scene, shown.model)
        self._place_camera(viewpoint)
        self._status = self._server.gui.add_markdown("")
        self._pause_button = self._server.gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
        self._pause_button.on_click(self._toggle_pause)

    def update(self) -> None:
        """Send what has changed since the last call to whoever watches."""
        positions, quaternions = self._shown.body_poses()
        with self._server.atomic():
            for body, frame in self._frames.items():
                # viser drops a pose that has not changed.
                frame.position, frame.wxyz = positions[body], quaternions[body]

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()

    def _place_camera(self, viewpoint: Viewpoint) -> None:
        camera = self._server.initial_camera
        camera.position, camera.look_at = viewpoint.position, viewpoint.look_at
        camera.fov, camera.near = math.radians(FOV_DEG), 0.01

    def _toggle_pause(self, _: Any) -> None:
        self._shown.paused = paused = not self._shown.paused
        self._pause_button.label = "Play" if paused else "Pause"
        self._pause_button.icon = viser.Icon.PLAYER_PLAY if paused else viser.Icon.PLAYER_PAUSE


def _serve(port: int, title: str) -> viser.ViserServer:
    _check_free(port)
    server = _LoopbackServer(host=HOST, port=port, label=title, verbose=False)
    if port and server.get_port() != port:
        # Somebody was faster; viser then takes the next free port, which is not what was asked for.
        server.stop()
        raise _taken(port, "it is in use")
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.scene.world_axes.visible = False
    return server


def _check_free(port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        if os.name == "posix":
            # As the server does: connections of an earlier page that are still winding down are not in the way.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise _taken(port, error.strerror or str(error)) from error


def _taken(port: int, reason: str) -> UsageError:
    return UsageError(f"--port {port} cannot be used on {HOST} ({reason}): give another, or 0 for a free one")
