"""A camera for the robot program raiden that reads the pictures of `yamsim serve-robot --cameras`.

    camera = YamsimCamera("right_wrist_camera", "right")
    camera.open()
    camera.grab()
    frame = camera.get_frame()

raiden must be importable, since the class inherits from `raiden.cameras.base.Camera`.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from raiden.cameras.base import Camera, CameraFrame

from .camera_reader import CameraReader, Picture
from .core.errors import YamsimError

__all__ = ["YamsimCamera"]

# Mounted upside down on a real station, so raiden rotates its pictures. Source: TRI-ML/raiden 2353b10, server.py.
_UPSIDE_DOWN = ("right_wrist_camera",)
_GRAB_TIMEOUT_S = 5.0  # s, longest wait of `grab`


class YamsimCamera(Camera):
    """A simulated camera with the interface of raiden's real cameras: BGR pictures, no depth.

    Pictures of `right_wrist_camera` are rotated by 180 degrees like those of the real camera, since raiden rotates them
    back.

    Args:
        name: raiden's name, such as "left_wrist_camera".
        camera: as `serve-robot` prints it, such as "left".
        folder: value of `serve-robot --folder`.
    """

    def __init__(self, name: str, camera: str, folder: str | None = None) -> None:
        self._name, self._camera, self._folder = name, camera, folder
        self._reader: CameraReader | None = None
        self._picture: Picture | None = None
        self._file: BinaryIO | None = None

    @property
    def name(self) -> str:
        """Raiden's name of the camera."""
        return self._name

    @property
    def serial_number(self) -> str:
        """A serial number that contains the name of the camera at the server."""
        return f"yamsim-{self._camera}"

    @property
    def recording_extension(self) -> str:
        """The extension of the files that `start_recording` writes."""
        return "rgb"

    def open(self) -> None:
        """Connect to the server.

        Raises:
            RuntimeError: no server runs, or the server has no such camera.
        """
        try:
            self._reader = CameraReader(self._camera, self._folder)
        except YamsimError as error:
            raise RuntimeError(str(error)) from error

    def close(self) -> None:
        """Close the connection and the file of a recording."""
        self.stop_recording()
        if self._reader is not None:
            self._reader.close()
        self._reader = self._picture = None

    def start_recording(self, path: Path) -> None:
        """Write each grabbed picture to a file, as a line of JSON and the RGB bytes.

        raiden's converter cannot read this format, and no other part of raiden reads recorded files.
        """
        self._file = path.open("wb")

    def stop_recording(self) -> None:
        """Close the file of a recording."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def grab(self) -> bool:
        """Wait up to `_GRAB_TIMEOUT_S` for the next picture, and store it for `get_frame`; return whether it came."""
        if self._reader is None:
            return False
        try:
            self._picture = self._reader.read(-1 if self._picture is None else self._picture.number, _GRAB_TIMEOUT_S)
        except (TimeoutError, YamsimError):
            return False
        if self._file is not None:
            height, width, _ = self._picture.image.shape
            header = {"time_ns": self._picture.time_ns, "width": width, "height": height}
            self._file.write(json.dumps(header).encode() + b"\n" + self._turn_upright(self._picture.image).tobytes())
        return True

    def get_frame(self) -> CameraFrame:
        """Return the last grabbed picture.

        Raises:
            RuntimeError: no picture was grabbed.
        """
        if self._picture is None:
            raise RuntimeError(f"camera {self._name}: call grab first")
        image = self._turn_upright(self._picture.image)[..., ::-1]
        return CameraFrame(color=np.ascontiguousarray(image), depth=None, timestamp_ns=self._picture.time_ns)

    def get_current_timestamp_ns(self) -> int:
        """Return the present time on the clock of the frames, ns."""
        return time.time_ns()

    def get_intrinsics(self) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[int, int]]:
        """Return the intrinsics (3, 3), zero distortion (5,), and the size (width, height), px.

        Raises:
            RuntimeError: the camera is not open.
        """
        if self._reader is None:
            raise RuntimeError(f"camera {self._name}: call open first")
        form = self._reader.form
        K = form.K.copy()
        if self._name in _UPSIDE_DOWN:
            K[:2, 2] = form.width - 1 - K[0, 2], form.height - 1 - K[1, 2]
        return K, np.zeros(5), (form.width, form.height)

    def _turn_upright(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return image[::-1, ::-1] if self._name in _UPSIDE_DOWN else image
