"""Browser page that plays a recorded episode."""

from __future__ import annotations

from typing import Any

import viser

from ..core.dataset.reader import RecordedImages
from ..core.errors import DatasetError
from .page_address import PageAddress
from .scene_page import ScenePage
from .viewed_scene import EpisodePlayer
from .viewpoint import Viewpoint


class EpisodePage(ScenePage):
    """Plays an episode, with the images of the shown frame and a slider to choose the frame."""

    def __init__(
        self, player: EpisodePlayer, viewpoint: Viewpoint, address: PageAddress, images: RecordedImages
    ) -> None:
        super().__init__(player, viewpoint, address)
        self._player = player
        self._images = images
        self._shown_frame: int | None = None
        self._slider_frame = 0
        self.slider = self._server.gui.add_slider("frame", 0, player.frame_count - 1, step=1, initial_value=0)
        self.slider.on_update(self.seek)
        self.pictures: dict[str, viser.GuiImageHandle] = {}
        self.update()

    def update(self) -> None:
        """Send changes of scene, slider and images to all browsers."""
        super().update()
        with self._player.lock:
            frame = self._player.frame_number
            if frame != self._slider_frame:
                # Move the slider only if playback reached another frame, so that a move by the user is not undone.
                # mypy cannot express that viser's setter takes more types than its getter returns.
                self.slider.value = self._slider_frame = frame  # type: ignore[misc]
        state = ", paused" if self._player.paused else ""
        self._status.content = f"{frame * self._player.frame_period:.2f} s{state}"
        # Read images at the start, and later only while a client is connected.
        if frame != self._shown_frame and (self._server.get_clients() or self._shown_frame is None):
            self._shown_frame = frame
            self._show_pictures(frame)

    def _show_pictures(self, frame: int) -> None:
        for camera in self._images.cameras:
            try:
                image = self._images.read_image(camera, frame)
            except DatasetError as error:
                # Playback continues without images.
                self._status.content += f"  \n{error}"
                continue
            if camera in self.pictures:
                self.pictures[camera].image = image
            else:
                self.pictures[camera] = self._server.gui.add_image(image, label=camera, format="jpeg", jpeg_quality=80)

    async def seek(self, event: Any) -> None:
        """Show the frame that a user has chosen with the slider."""
        # viser runs a coroutine immediately, but a thread often only after the player has moved the slider.
        # An event without a client comes from `update`, not from a user.
        if event.client is not None:
            with self._player.lock:
                self._slider_frame = self.slider.value
                self._player.seek(self._slider_frame)
