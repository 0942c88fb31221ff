"""A client for the pictures that `yamsim serve-robot --cameras` serves. Its only third-party dependency is numpy.

    from yamsim_cli.camera_reader import CameraReader

    with CameraReader("top") as camera:
        picture = camera.read()
        picture.image  # RGB (height, width, 3)

`yamsim_cli.lerobot_camera` and `yamsim_cli.raiden_camera` wrap this reader as cameras of LeRobot and raiden.
"""

from __future__ import annotations

import json
import os
import socket
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .core.closable import Closable
from .core.errors import ResourceError, UsageError, suggest_similar
from .real.serve.socket_servers import CAMERA_SOCKET, default_socket_folder

__all__ = ["CameraForm", "CameraReader", "Picture", "served_cameras"]

_MAX_HEADER_BYTES, _MAX_PICTURE_BYTES = 65_536, 3 * 4096**2  # bytes, limits of an answer


@dataclass(frozen=True)
class CameraForm:
    """Format of a camera's pictures: size, px, maximum rate, Hz, and intrinsics `K` (3, 3), px."""

    width: int
    height: int
    fps: float
    K: NDArray[np.float64]


@dataclass(frozen=True)
class Picture:
    """A picture of a simulated camera, with its time and pose.

    Attributes:
        image: RGB (height, width, 3).
        time_ns: on the system clock, ns since 1970.
        sim_time: simulated time, s.
        T_cam_in_base: pose (4, 4) of the camera in the base frame of the left arm, in OpenCV's convention.
    """

    image: NDArray[np.uint8]
    number: int
    time_ns: int
    sim_time: float
    T_cam_in_base: NDArray[np.float64]


class CameraReader(Closable):
    """Reads the pictures of one camera. Close the reader, or use it as a context manager. It is not thread-safe.

    Args:
        camera: a name that `serve-robot` prints, such as "top".
        folder: value of `serve-robot --folder`.
        timeout: longest wait for an answer, s.

    Raises:
        ResourceError: no server runs there, or the server is not `serve-robot`.
        UsageError: the server has no such camera.
    """

    def __init__(self, camera: str, folder: str | Path | None = None, timeout: float = 5.0) -> None:
        self._folder, self._timeout = folder, timeout
        self._connection: _CameraConnection | None = None
        forms = served_cameras(folder, timeout)
        if camera not in forms:
            raise UsageError(f"there is no camera {camera!r}; {suggest_similar(camera, forms)}")
        self.camera, self.form = camera, forms[camera]

    def read(self, after: int = -1, timeout: float | None = None) -> Picture:
        """Wait for a picture with a number above `after`, and return the newest.

        Args:
            timeout: longest wait, s; by default the timeout of the reader.

        Raises:
            TimeoutError: no such picture arrived in time.
            ResourceError: `serve-robot` has ended, or the server is not `serve-robot`.
        """
        deadline = time.monotonic() + (self._timeout if timeout is None else timeout)
        if self._connection is None:
            self._connection = _CameraConnection(self._folder)
        try:
            request = {"ask": "picture", "camera": self.camera, "after": after}
            header, data = self._connection.request(request, deadline)
        except BaseException:
            # A late answer must not be mistaken for the answer to the next request.
            self.close()
            raise
        height, width = self.form.height, self.form.width
        if (header.get("width"), header.get("height"), len(data)) != (width, height, 3 * height * width):
            self.close()
            raise ResourceError(f"camera {self.camera!r}: the size of its pictures has changed; open it again")
        try:
            return Picture(
                image=np.frombuffer(data, np.uint8).reshape(height, width, 3),
                number=int(header["number"]),
                time_ns=int(header["time_ns"]),
                sim_time=float(header["sim_time"]),
                T_cam_in_base=np.array(header["T_cam_in_base"], np.float64).reshape(4, 4),
            )
        except (KeyError, TypeError, ValueError) as error:
            self.close()
            raise _invalid_answer(self._folder) from error

    def close(self) -> None:
        """Close the connection. A later `read` connects again."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None


def served_cameras(folder: str | Path | None = None, timeout: float = 5.0) -> dict[str, CameraForm]:
    """Return name -> picture format of all cameras of a running `serve-robot`.

    Args:
        folder: value of `serve-robot --folder`.
        timeout: longest wait for the answer, s.

    Raises:
        ResourceError: no server runs there, or the server is not `serve-robot`.
    """
    connection = _CameraConnection(folder)
    try:
        answer, _ = connection.request({"ask": "cameras"}, time.monotonic() + timeout)
        return {
            str(name): CameraForm(
                int(one["width"]), int(one["height"]), float(one["fps"]), np.array(one["K"], np.float64).reshape(3, 3)
            )
            for name, one in answer["cameras"].items()
        }
    except TimeoutError as error:
        raise ResourceError(f"{connection.path}: serve-robot did not answer within {timeout:g} s") from error
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise _invalid_answer(folder) from error
    finally:
        connection.close()


def _camera_socket_path(folder: str | Path | None) -> Path:
    return (default_socket_folder(os.environ) if folder is None else Path(folder)) / CAMERA_SOCKET


def _invalid_answer(folder: str | Path | None) -> ResourceError:
    return ResourceError(
        f"{_camera_socket_path(folder)}: this server is not `yamsim serve-robot`, or is another version of it"
    )


class _CameraConnection:
    """Socket connection to the camera server; see `real.serve.cameras` for the protocol."""

    def __init__(self, folder: str | Path | None) -> None:
        self.path = _camera_socket_path(folder)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.connect(str(self.path))
        except OSError as error:
            self._socket.close()
            raise ResourceError(
                f"{self.path}: no cameras are served there ({error.strerror or error}); start "
                "`yamsim serve-robot --cameras`, with the same --folder if it has one"
            ) from error

    def request(self, message: dict[str, Any], deadline: float) -> tuple[dict[str, Any], bytes]:
        """Return the answer to a message, and the bytes after it. `deadline` is a time of `time.monotonic`, s.

        Raises:
            TimeoutError: the answer did not arrive in time.
            ResourceError: the connection has ended, or the answer is not valid.
        """
        request = json.dumps(message).encode()
        try:
            self._set_timeout(deadline)
            self._socket.sendall(len(request).to_bytes(4, "little") + request)
            length = int.from_bytes(self._receive(4, deadline), "little")
            if length > _MAX_HEADER_BYTES:
                raise ResourceError(f"{self.path}: this server is not `yamsim serve-robot`")
            answer = json.loads(self._receive(length, deadline))
            size = answer.get("bytes") if isinstance(answer, dict) else None
            if type(size) is not int or not 0 <= size <= _MAX_PICTURE_BYTES:
                raise ResourceError(f"{self.path}: this server is not `yamsim serve-robot`")
            data = self._receive(size, deadline)
        except TimeoutError:
            raise
        except (OSError, ValueError, RecursionError) as error:
            raise ResourceError(f"{self.path}: serve-robot has ended, or its answer is not valid") from error
        if "error" in answer:
            raise ResourceError(f"{self.path}: {answer['error']}")
        return answer, data

    def close(self) -> None:
        self._socket.close()

    def _receive(self, count: int, deadline: float) -> bytes:
        data = bytearray(count)
        view, at = memoryview(data), 0
        while at < count:
            self._set_timeout(deadline)
            got = self._socket.recv_into(view[at:])
            if not got:
                raise ConnectionError("closed")
            at += got
        return bytes(data)

    def _set_timeout(self, deadline: float) -> None:
        left = deadline - time.monotonic()
        if left <= 0:
            raise TimeoutError(f"{self.path}: no new picture within the timeout")
        self._socket.settimeout(left)
