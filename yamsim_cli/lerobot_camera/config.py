"""The LeRobot config of a simulated camera."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig, ColorMode


@CameraConfig.register_subclass("yamsim")
@dataclass(kw_only=True)
class YamsimCameraConfig(CameraConfig):
    """Config of a camera that reads the pictures of `yamsim serve-robot --cameras`.

    Attributes:
        camera: name of the camera, as `serve-robot` prints it, such as "top".
        folder: the value of `serve-robot --folder`, with the same default.
        color_mode: order of the colour channels, RGB or BGR.
        fps, width, height: expected rate and size of pictures, Hz and px; by default those of the server.
    """

    camera: str
    folder: str | None = None
    color_mode: ColorMode = ColorMode.RGB

    def __post_init__(self) -> None:
        self.color_mode = ColorMode(self.color_mode)
