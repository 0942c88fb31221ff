"""The LeRobot config of a simulated camera."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig, ColorMode


@CameraConfig.register_subclass("yamsim")
@dataclass(kw_only=True)
class YamsimCameraConfig(CameraConfig):
    """A camera of `yamsim serve-robot --cameras`.

    Attributes:
        camera: a name that `serve-robot` prints, such as "top".
        folder: the value of `serve-robot --folder`, with the same default.
        color_mode: order of the colour channels, RGB or BGR.
        fps, width, height: expected values, Hz and px; by default the values of the server.
    """

    camera: str
    folder: str | None = None
    color_mode: ColorMode = ColorMode.RGB

    def __post_init__(self) -> None:
        self.color_mode = ColorMode(self.color_mode)
