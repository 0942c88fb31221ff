"""What LeRobot is told of a simulated camera."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig, ColorMode


@CameraConfig.register_subclass("yamsim")
@dataclass(kw_only=True)
class YamsimCameraConfig(CameraConfig):
    """A camera of `yamsim serve-robot --cameras`.

    Attributes:
        camera: its name there, such as "top".
        folder: that `serve-robot` was given with `--folder`; its default unless given.
        color_mode: of pictures.
        fps, width, height: what is expected of them; what is served unless given.
    """

    camera: str
    folder: str | None = None
    color_mode: ColorMode = ColorMode.RGB

    def __post_init__(self) -> None:
        self.color_mode = ColorMode(self.color_mode)
