from __future__ import annotations

import itertools
import math
import time
from typing import Any, Protocol

import numpy as np
import viser
from numpy.typing import NDArray

from ..core.errors import ResourceError
from ..core.geometry.camera import opencv_from_mujoco
from ..core.geometry.se3 import quat_from_rotation
from .page_address import PageAddress
from .scene_page import ScenePage
from .viewed_scene import DriveControl, LiveRig
from .viewpoint import Viewpoint

_STATUS_PERIOD = 1.0  # s, between updates
_STEP = 0.001  # rad or m, of the sliders
_MARGIN_SLIDER_RANGE = (0.2, 1.2)  # m, range of the slider for the distance between two bases, which touch below 0.2


class CameraPictures(Protocol):
    """Renders images of the rig's cameras. All calls come from one thread."""

    def render(self, camera: str) -> NDArray[np.uint8]:
        """Return an RGB image (height, width, 3). Raise ResourceError if nothing can be rendered here."""


class RigPage(ScenePage):
    """Page of a simulated rig: a slider for each drive, check boxes for visibility, and a camera panel.

    `boards` are visible at first or not. Without `pictures`, nothing is rendered.
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
        self._measured = (time.monotonic(), live.simulated_seconds)
        home = self._server.gui.add_button(
            "Home", icon=viser.Icon.HOME, hint="Move the arms home, and close the grippers"
        )
        home.on_click(self._go_home)
        self.sliders = self._add_sliders()
        self.margin = self._add_margin()
        self._add_switches(boards=boards)
        self.cameras = CamerasPanel(self._server, live, pictures)
        self.update()

    def update(self) -> None:
        """Send scene, status and requested camera images to all browsers."""
        super().update()
        self.cameras.update()
        self._show_status()

    def _add_sliders(self) -> dict[tuple[str, str], viser.GuiSliderHandle[float]]:
        sliders = {}
        for arm, drives in itertools.groupby(self._live.drives, key=lambda drive: drive.arm):
            with self._server.gui.add_folder(arm):
                for drive in drives:
                    sliders[arm, drive.name] = self._add_slider(drive)
        return sliders

    def _add_slider(self, drive: DriveControl) -> viser.GuiSliderHandle[float]:
        # A slider counts steps from its lower end. Round both ends so that all values are multiples of the step.
        low, high = math.ceil(drive.low / _STEP) * _STEP, math.floor(drive.high / _STEP) * _STEP
        slider = self._server.gui.add_slider(
            f"{drive.name} ({drive.unit})", round(low, 3), round(high, 3), step=_STEP, initial_value=drive.home
        )
        slider.on_update(lambda _: self._live.set_command(drive, slider.value))
        return slider

    def _add_margin(self) -> viser.GuiSliderHandle[float] | None:
        rig = self._live.rig
        if len(rig.arms) < 2:
            return None
        low, high = min(_MARGIN_SLIDER_RANGE[0], rig.margin), max(_MARGIN_SLIDER_RANGE[1], rig.margin)
        slider = self._server.gui.add_slider("margin (m)", low, high, step=_STEP, initial_value=rig.margin)
        slider.on_update(lambda _: self._live.set_margin(slider.value))
        return slider

    def _add_switches(self, *, boards: bool) -> None:
        gui, bodies = self._server.gui, self.bodies
        model = self._live.model
        mocap = [frame for body, frame in bodies.frames.items() if model.body_mocapid[body] >= 0]
        with gui.add_folder("Shown"):
            for label, nodes, shown in (
                ("boards", mocap, boards),
                ("visual meshes", bodies.visuals, True),
                ("collision primitives", bodies.colliders, False),
            ):
                if nodes:
                    self._add_switch(label, nodes, shown=shown)

    def _add_switch(self, label: str, nodes: Any, *, shown: bool) -> None:
        box = self._server.gui.add_checkbox(label, initial_value=shown)

        def show_nodes(_: Any = None) -> None:
            for node in nodes:
                node.visible = box.value

        box.on_update(show_nodes)
        show_nodes()

    def _go_home(self, _: Any) -> None:
        for drive in self._live.drives:
            # mypy cannot express that viser's setter takes more types than its getter returns.
            self.sliders[drive.arm, drive.name].value = drive.home  # type: ignore[misc]
        self._live.reset()

    def _show_status(self) -> None:
        now, (then, simulated) = time.monotonic(), self._measured
        if now - then >= _STATUS_PERIOD:
            self._measured = now, self._live.simulated_seconds
            speed = max(0.0, self._live.simulated_seconds - simulated) / (now - then)
            state = "paused" if self._live.paused else f"{speed:.2f} × real time"
            self._status.content = f"{self._live.simulated_seconds:.0f} s, {state}"


class CamerasPanel:
    """Group of buttons that render camera images and move the view to a camera. The group is absent without cameras.

    Attributes:
        images: camera -> its image on the page, once rendered.
    """

    def __init__(self, server: viser.ViserServer, live: LiveRig, pictures: CameraPictures | None) -> None:
        self._gui = server.gui
        self._live = live
        self._pictures = pictures
        self.images: dict[str, viser.GuiImageHandle] = {}
        self._requested = False
        self._cameras = tuple(live.model.cam(k).name for k in range(live.model.ncam))
        if not self._cameras:
            return
        self._folder = server.gui.add_folder("Cameras")
        with self._folder:
            if pictures is not None:
                self._button = server.gui.add_button("Take pictures", icon=viser.Icon.CAMERA)
                self._button.on_click(self.request)
            for camera in self._cameras:
                self._add_view(camera)

    def update(self) -> None:
        """Render the requested images. Call from the thread that owns the OpenGL context."""
        if not self._requested or self._pictures is None:
            return
        self._requested = False
        for camera in self._cameras:
            try:
                image = self._pictures.render(camera)
            except ResourceError as error:
                # Disable the button, since every further rendering would fail too.
                self._pictures, self._button.disabled = None, True
                with self._folder:
                    self._gui.add_markdown(f"No pictures: {error}")
                return
            if camera in self.images:
                self.images[camera].image = image
                continue
            with self._folder:
                self.images[camera] = self._gui.add_image(image, label=camera)

    def request(self, _: Any = None) -> None:
        """Request an image of each camera, which the next `update` renders."""
        self._requested = True

    def _add_view(self, camera: str) -> None:
        button = self._gui.add_button(f"Look through {camera}", icon=viser.Icon.EYE)

        def look_from_camera(event: Any) -> None:
            with self._live.lock:
                seen = self._live.data.cam(camera)
                position, R = seen.xpos.copy(), opencv_from_mujoco(seen.xmat)
            view = event.client.camera
            with event.client.atomic():
                view.wxyz, view.position = quat_from_rotation(R), position
                view.fov = math.radians(float(self._live.model.cam(camera).fovy[0]))

        button.on_click(look_from_camera)
