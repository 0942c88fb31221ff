"""A browser page that plays a recorded episode."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import viser
from numpy.typing import NDArray

from ..core.errors import DatasetError
from .page_address import PageAddress
from .scene_page import ScenePage
from .viewed_scene import EpisodePlayer
from .viewpoint import Viewpoint


class Images(Protocol):
    """The images of an episode's frames."""

    cameras: tuple[str, ...]

    def read(self, camera: str, frame: int) -> NDArray[np.uint8]:
        """An RGB image (height, width, 3) of uint8.

        Raises:
            DatasetError: the image is missing or damaged.
        """
        ...


class EpisodePage(ScenePage):
    """The page of one player, with its frames' pictures and a slider that shows and sets the frame."""

    def __init__(self, player: EpisodePlayer, viewpoint: Viewpoint, address: PageAddress, images: Images) -> None:
        super().__init__(player, viewpoint, address)
        self._player = player
        self._images = images
        self._pictured: int | None = None
        self._slid = 0
        self.slider = self._server.gui.add_slider("frame", 0, player.frames - 1, step=1, initial_value=0)
        self.slider.on_update(self._seek)
        self.pictures: dict[str, viser.GuiImageHandle] = {}
        self.update()

    def update(self) -> None:
        """Send what has changed since the last call to all clients."""
        super().update()
        with self._player.lock:
            frame = self._player.frame
            if frame != self._slid:
                # Set only if playing moved the frame, so that a user's move of the slider is not undone.
                # viser's setter takes more types than its getter returns, which mypy cannot express.
                self.slider.value = self._slid = frame  # type: ignore[misc]
        state = ", paused" if self._player.paused else ""
        self._status.content = f"{frame * self._player.frame_period:.2f} s{state}"
        # Images are read at the start, and then only while a client is connected.
        if frame != self._pictured and (self._server.get_clients() or self._pictured is None):
            self._pictured = frame
            self._show_pictures(frame)

    def _show_pictures(self, frame: int) -> None:
        for camera in self._images.cameras:
            try:
                image = self._images.read(camera, frame)
            except DatasetError as error:
                # The scene can be played without pictures.
                self._status.content += f"  \n{error}"
                continue
            if camera in self.pictures:
                self.pictures[camera].image = image
            else:
                self.pictures[camera] = self._server.gui.add_image(image, label=camera, format="jpeg", jpeg_quality=80)

    async def _seek(self, event: Any) -> None:
        # A coroutine runs at once. A thread would often run after playing moved the slider on.
        # Without a client, the page itself moved the slider.
        if event.client is not None:
            with self._player.lock:
                self._slid = self.slider.value
                self._player.seek(self._slid)
