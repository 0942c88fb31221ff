"""A browser page that shows a live rig and moves it."""

from __future__ import annotations

import itertools
import math
import time
from typing import Any

import viser

from .address import PageAddress
from .bodies_page import BodiesPage
from .cameras_panel import CameraPictures, CamerasPanel
from .live import Drive, LiveRig
from .viewpoint import Viewpoint

_STATUS_PERIOD = 1.0  # s

# Step of a slider, rad or m.
_STEP = 0.001

# Smallest and largest distance between two arms that a person can try, m. Any closer, their bases would touch.
_MARGINS = (0.2, 1.2)


class RigPage(BodiesPage):
    """The page of a live rig: a slider for every drive, check boxes for what is shown, and its cameras.

    Args:
        boards: whether boards and mounts are shown at first, if the rig has them.
        pictures: renders what the rig's cameras see; None if nothing can be rendered.
    """

    def __init__(
        self,
        live: LiveRig,
        viewpoint: Viewpoint,
        address: PageAddress,
        *,
        boards: bool = True,
        pictures: CameraPictures | None = None,
    ) -> None:
        super().__init__(live, viewpoint, address)
        self._live = live
        self._measured = (time.monotonic(), live.time)
        home = self._server.gui.add_button("Home", icon=viser.Icon.HOME, hint="Arms back to rest, grippers shut")
        home.on_click(self._go_home)
        self.sliders = self._add_sliders()
        self.margin = self._add_margin()
        self._add_switches(boards=boards)
        self._cameras = CamerasPanel(self._server, live, pictures)
        self.update()

    def update(self) -> None:
        """Send what has changed since the last call to all clients."""
        super().update()
        self._cameras.update()
        self._show_status()

    def _add_sliders(self) -> dict[tuple[str, str], viser.GuiSliderHandle[float]]:
        """(arm, drive) -> its slider."""
        sliders = {}
        for arm, drives in itertools.groupby(self._live.drives, key=lambda drive: drive.arm):
            with self._server.gui.add_folder(arm):
                for drive in drives:
                    sliders[arm, drive.name] = self._add_slider(drive)
        return sliders

    def _add_slider(self, drive: Drive) -> viser.GuiSliderHandle[float]:
        # A slider counts its steps from its lower end. If that is a whole number of steps, so are all values.
        low, high = math.ceil(drive.low / _STEP) * _STEP, math.floor(drive.high / _STEP) * _STEP
        slider = self._server.gui.add_slider(
            f"{drive.name} ({drive.unit})", round(low, 3), round(high, 3), step=_STEP, initial_value=drive.home
        )
        slider.on_update(lambda _: self._live.command(drive, slider.value))
        return slider

    def _add_margin(self) -> viser.GuiSliderHandle[float] | None:
        """A slider for the distance between two arms; None for a lone arm."""
        rig = self._live.rig
        if len(rig.arms) < 2:
            return None
        low, high = min(_MARGINS[0], rig.margin), max(_MARGINS[1], rig.margin)
        slider = self._server.gui.add_slider("margin (m)", low, high, step=_STEP, initial_value=rig.margin)
        slider.on_update(lambda _: self._live.place(slider.value))
        return slider

    def _add_switches(self, *, boards: bool) -> None:
        """Add check boxes for what is shown."""
        gui, bodies = self._server.gui, self._bodies
        model = self._live.model
        mocap = [frame for body, frame in bodies.frames.items() if model.body_mocapid[body] >= 0]
        with gui.add_folder("Shown"):
            for label, nodes, shown in (
                ("boards", mocap, boards),
                ("looks", bodies.looks, True),
                ("collision primitives", bodies.colliders, False),
            ):
                if nodes:
                    self._add_switch(label, nodes, shown=shown)

    def _add_switch(self, label: str, nodes: Any, *, shown: bool) -> None:
        box = self._server.gui.add_checkbox(label, initial_value=shown)

        def show(_: Any = None) -> None:
            for node in nodes:
                node.visible = box.value

        box.on_update(show)
        show()

    def _go_home(self, _: Any) -> None:
        for drive in self._live.drives:
            # viser's setter takes more types than its getter returns, which mypy cannot express.
            self.sliders[drive.arm, drive.name].value = drive.home  # type: ignore[misc]
        self._live.reset()

    def _show_status(self) -> None:
        now, (then, simulated) = time.monotonic(), self._measured
        if now - then >= _STATUS_PERIOD:
            self._measured = now, self._live.time
            speed = max(0.0, self._live.time - simulated) / (now - then)
            state = "paused" if self._live.paused else f"{speed:.2f} × real time"
            self._status.content = f"{self._live.time:.0f} s, {state}"
