"""A browser page that shows a live rig and moves it."""

from __future__ import annotations

import itertools
import math
import time
from typing import Any

import viser

from .bodies_page import BodiesPage
from .live import Drive, LiveRig
from .viewpoint import Viewpoint

_STATUS_PERIOD = 1.0  # s

# Of a slider, rad or m.
_STEP = 0.001


class Page(BodiesPage):
    """The page of one live rig, with a slider for every drive."""

    def __init__(self, live: LiveRig, viewpoint: Viewpoint, port: int) -> None:
        super().__init__(live, viewpoint, port)
        self._live = live
        self._measured = (time.monotonic(), live.time)
        home = self._server.gui.add_button("Home", icon=viser.Icon.HOME, hint="Arms back to rest, grippers shut")
        home.on_click(self._go_home)
        self.sliders = self._add_sliders()
        self.update()

    def update(self) -> None:
        """Send what has changed since the last call to whoever watches."""
        super().update()
        self._show_status()

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

    def _show_status(self) -> None:
        now, (then, simulated) = time.monotonic(), self._measured
        if now - then >= _STATUS_PERIOD:
            self._measured = now, self._live.time
            speed = max(0.0, self._live.time - simulated) / (now - then)
            state = "paused" if self._live.paused else f"{speed:.2f} × real time"
            self._status.content = f"{self._live.time:.0f} s, {state}"
