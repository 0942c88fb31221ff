from __future__ import annotations

import time
from typing import Any

import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.cameras.configs import ColorMode
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from numpy.typing import NDArray

from ..camera_reader import CameraReader, Picture, served_cameras
from ..core.errors import ResourceError, YamsimError
from .config import YamsimCameraConfig

_READ_TIMEOUT_S = 5.0  # s, longest wait of `read`


class YamsimCamera(Camera):
    """Reads the pictures of one camera of a running `yamsim serve-robot --cameras`."""

    def __init__(self, config: YamsimCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self._reader: CameraReader | None = None
        self._last = -1  # number of the last read picture

    def __str__(self) -> str:
        return f"YamsimCamera({self.config.camera})"

    @property
    def is_connected(self) -> bool:
        """Whether the camera is connected."""
        return self._reader is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Return one entry per camera of the server in the default folder; empty without a server."""
        try:
            found = served_cameras()
        except ResourceError:
            return []
        return [
            {
                "name": name,
                "type": "yamsim",
                "id": name,
                "default_stream_profile": {"width": form.width, "height": form.height, "fps": form.fps},
            }
            for name, form in found.items()
        ]

    def connect(self, warmup: bool = True) -> None:
        """Connect to the server. With `warmup`, also wait for a picture.

        Raises:
            DeviceAlreadyConnectedError: the camera is connected.
            ConnectionError: no server runs, or the server has no such camera.
            ValueError: the served pictures differ from the config.
        """
        if self._reader is not None:
            raise DeviceAlreadyConnectedError(f"{self} is already connected")
        try:
            reader = CameraReader(self.config.camera, self.config.folder)
        except YamsimError as error:
            raise ConnectionError(str(error)) from error
        form = reader.form
        size = (self.config.width or form.width, self.config.height or form.height)
        if size != (form.width, form.height) or (self.config.fps or 0) > form.fps:
            raise ValueError(
                f"{self}: {size[0]}x{size[1]} at {self.config.fps or form.fps:g} frames per second are requested, but "
                f"{form.width}x{form.height} at {form.fps:g} is served: set serve-robot --size and --camera-fps"
            )
        self.width, self.height = size
        self.fps = self.config.fps or round(form.fps)
        self._reader, self._last = reader, -1
        if warmup:
            self.read()

    def read(self) -> NDArray[Any]:
        """Wait for a picture (height, width, 3) that was not read yet.

        Raises:
            DeviceNotConnectedError: the camera is not connected, or the server has ended.
            TimeoutError: no picture arrived in time.
        """
        return self._wait_for_new(_READ_TIMEOUT_S)

    def async_read(self, timeout_ms: float = 200) -> NDArray[Any]:
        """Wait up to `timeout_ms` for a picture (height, width, 3) that was not read yet."""
        return self._wait_for_new(timeout_ms / 1000)

    def read_latest(self, max_age_ms: int = 500) -> NDArray[Any]:
        """Return the newest picture (height, width, 3), even if read before. Raise TimeoutError if it is too old."""
        picture = self._picture_after(-1, _READ_TIMEOUT_S)
        age_ms = (time.time_ns() - picture.time_ns) / 1e6
        if age_ms > max_age_ms:
            raise TimeoutError(f"{self}: the newest picture is {age_ms:.0f} ms old, more than {max_age_ms} ms")
        return self._in_color_mode(picture)

    def disconnect(self) -> None:
        """Close the connection.

        Raises:
            DeviceNotConnectedError: the camera is not connected.
        """
        if self._reader is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        self._reader.close()
        self._reader = None

    def _wait_for_new(self, timeout: float) -> NDArray[Any]:
        picture = self._picture_after(self._last, timeout)
        self._last = picture.number
        return self._in_color_mode(picture)

    def _picture_after(self, after: int, timeout: float) -> Picture:
        if self._reader is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        try:
            return self._reader.read(after, timeout)
        except YamsimError as error:
            raise DeviceNotConnectedError(str(error)) from error

    def _in_color_mode(self, picture: Picture) -> NDArray[Any]:
        image = picture.image
        return image.copy() if self.config.color_mode == ColorMode.RGB else np.ascontiguousarray(image[..., ::-1])
