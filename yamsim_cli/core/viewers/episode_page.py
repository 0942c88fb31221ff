"""A browser page that plays a recorded episode."""

from __future__ import annotations

from typing import Any

from .bodies_page import BodiesPage
from .player import EpisodePlayer
from .viewpoint import Viewpoint


class EpisodePage(BodiesPage):
    """The page of one player; its slider says which frame is shown, and takes it there."""

    def __init__(self, player: EpisodePlayer, viewpoint: Viewpoint, port: int) -> None:
        super().__init__(player, viewpoint, port)
        self._player = player
        self.slider = self._server.gui.add_slider("frame", 0, player.frames - 1, step=1, initial_value=0)
        self.slider.on_update(self._seek)
        self.update()

    def update(self) -> None:
        """Send what has changed since the last call to whoever watches."""
        super().update()
        frame = self._player.frame
        # viser's setter takes more types than its getter gives, which mypy has no words for.
        self.slider.value = frame  # type: ignore[misc]
        state = ", paused" if self._player.paused else ""
        self._status.content = f"{frame * self._player.frame_period:.2f} s{state}"

    def _seek(self, event: Any) -> None:
        # Moved by nobody's hand, the slider only says what is shown.
        if event.client is not None:
            self._player.seek(self.slider.value)
