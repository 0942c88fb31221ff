"""The LeRobot config of a simulated camera."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig, ColorMode


@CameraConfig.register_subclass("yamsim")
@dataclass(kw_only=True)
class YamsimCameraConfig(CameraConfig):
    """Config of a camera of `yamsim serve-robot --cameras`.

    Attributes:
        camera: as `serve-robot` prints it, such as "top".
        folder: value of `serve-robot --folder`.
        fps, width, height: expected, Hz and px; by default the server's values.
    """

    camera: str
    folder: str | None = None
    color_mode: ColorMode = ColorMode.RGB

    def __post_init__(self) -> None:
        self.color_mode = ColorMode(self.color_mode)
