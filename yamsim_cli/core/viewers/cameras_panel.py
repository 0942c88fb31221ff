"""The cameras of a live rig on its page: buttons to take their pictures, and to look through them."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
import viser
from numpy.typing import NDArray

from ..errors import ResourceError
from ..geometry.camera import opencv_from_mujoco
from ..geometry.se3 import quat_from_rotation
from .live import LiveRig


class CameraPictures(Protocol):
    """Renders what cameras see. Only one thread calls it."""

    def render(self, camera: str) -> NDArray[np.uint8]:
        """An RGB image (height, width, 3) of uint8.

        Raises:
            ResourceError: nothing can be rendered here.
        """
        ...


class CamerasPanel:
    """A folder of the page; there is none if the rig has no camera."""

    def __init__(self, server: viser.ViserServer, live: LiveRig, pictures: CameraPictures | None) -> None:
        self._gui = server.gui
        self._live = live
        self._pictures = pictures
        self._images: dict[str, viser.GuiImageHandle] = {}
        self._wanted = False
        self._cameras = tuple(live.model.cam(k).name for k in range(live.model.ncam))
        if not self._cameras:
            return
        self._folder = server.gui.add_folder("Cameras")
        with self._folder:
            if pictures is not None:
                self._button = server.gui.add_button("Take pictures", icon=viser.Icon.CAMERA)
                self._button.on_click(self._want)
            for camera in self._cameras:
                self._add_view(camera)

    def update(self) -> None:
        """Take the pictures that were asked for; to be called from the thread that owns OpenGL."""
        if not self._wanted or self._pictures is None:
            return
        self._wanted = False
        for camera in self._cameras:
            try:
                image = self._pictures.render(camera)
            except ResourceError as error:
                # It would fail again, so nobody can ask again.
                self._pictures, self._button.disabled = None, True
                with self._folder:
                    self._gui.add_markdown(f"No pictures: {error}")
                return
            if camera in self._images:
                self._images[camera].image = image
                continue
            with self._folder:
                self._images[camera] = self._gui.add_image(image, label=camera)

    def _want(self, _: Any) -> None:
        self._wanted = True

    def _add_view(self, camera: str) -> None:
        button = self._gui.add_button(f"Look through {camera}", icon=viser.Icon.EYE)

        def look(event: Any) -> None:
            with self._live.lock:
                seen = self._live.data.cam(camera)
                position, R = seen.xpos.copy(), opencv_from_mujoco(seen.xmat)
            view = event.client.camera
            with event.client.atomic():
                view.wxyz, view.position = quat_from_rotation(R), position
                view.fov = math.radians(float(self._live.model.cam(camera).fovy[0]))

        button.on_click(look)
