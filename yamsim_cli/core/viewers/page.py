"""A browser page that shows a live rig and moves it, served on this machine's loopback address alone."""

from __future__ import annotations

import itertools
import logging
import math
import os
import socket
import time
from typing import Any

import viser

from ..errors import UsageError
from .live import Drive, LiveRig
from .shapes import add_bodies
from .viewpoint import FOV_DEG, Viewpoint

HOST = "127.0.0.1"

_STATUS_PERIOD = 1.0  # s

# Of a slider, rad or m.
_STEP = 0.001


class _LoopbackServer(viser.ViserServer):
    """viser's server without its way out: any client can ask it for a tunnel to a public address."""

    def request_share_url(self, verbose: bool = True) -> None:
        return None


class Page:
    """The page of one live rig; closing it frees its port.

    Args:
        port: to listen on; 0 takes a free one.

    Raises:
        UsageError: the port cannot be had.
    """

    def __init__(self, live: LiveRig, viewpoint: Viewpoint, port: int) -> None:
        # A browser drops connections as it pleases; without a handler, each one would be a traceback on stderr.
        logging.getLogger("websockets").addHandler(logging.NullHandler())
        self._live = live
        self._server = _serve(port, f"yamsim: {live.rig.name}")
        self.url = f"http://{HOST}:{self._server.get_port()}"
        self._frames = add_bodies(self._server.scene, live.model)
        self._place_camera(viewpoint)
        self._status = self._server.gui.add_markdown("")
        self._shown = (time.monotonic(), live.time)
        self._pause_button = self._server.gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
        self._pause_button.on_click(self._toggle_pause)
        home = self._server.gui.add_button("Home", icon=viser.Icon.HOME, hint="Arms back to rest, grippers shut")
        home.on_click(self._go_home)
        self.sliders = self._add_sliders()
        self.update()

    def update(self) -> None:
        """Send what has changed since the last call to whoever watches."""
        positions, quaternions = self._live.body_poses()
        with self._server.atomic():
            for body, frame in self._frames.items():
                # viser drops a pose that has not changed.
                frame.position, frame.wxyz = positions[body], quaternions[body]
        self._show_status()

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()

    def _place_camera(self, viewpoint: Viewpoint) -> None:
        camera = self._server.initial_camera
        camera.position, camera.look_at = viewpoint.position, viewpoint.look_at
        camera.fov, camera.near = math.radians(FOV_DEG), 0.01

    def _add_sliders(self) -> dict[tuple[str, str], viser.GuiSliderHandle[float]]:
        """One slider a drive: (arm, drive) -> slider."""
        sliders = {}
        for arm, drives in itertools.groupby(self._live.drives, key=lambda drive: drive.arm):
            with self._server.gui.add_folder(arm):
                for drive in drives:
                    sliders[arm, drive.name] = self._add_slider(drive)
        return sliders

    def _add_slider(self, drive: Drive) -> viser.GuiSliderHandle[float]:
        # A slider's values count up from its lower end: whole steps there give whole steps everywhere.
        low, high = math.ceil(drive.low / _STEP) * _STEP, math.floor(drive.high / _STEP) * _STEP
        slider = self._server.gui.add_slider(
            f"{drive.name} ({drive.unit})", round(low, 3), round(high, 3), step=_STEP, initial_value=drive.home
        )
        slider.on_update(lambda _: self._live.command(drive, slider.value))
        return slider

    def _go_home(self, _: Any) -> None:
        for drive in self._live.drives:
            # viser's setter takes more types than its getter gives, which mypy has no words for.
            self.sliders[drive.arm, drive.name].value = drive.home  # type: ignore[misc]
        self._live.reset()

    def _toggle_pause(self, _: Any) -> None:
        self._live.paused = paused = not self._live.paused
        self._pause_button.label = "Play" if paused else "Pause"
        self._pause_button.icon = viser.Icon.PLAYER_PLAY if paused else viser.Icon.PLAYER_PAUSE

    def _show_status(self) -> None:
        now, (then, simulated) = time.monotonic(), self._shown
        if now - then >= _STATUS_PERIOD:
            self._shown = now, self._live.time
            speed = max(0.0, self._live.time - simulated) / (now - then)
            state = "paused" if self._live.paused else f"{speed:.2f} × real time"
            self._status.content = f"{self._live.time:.0f} s, {state}"


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
