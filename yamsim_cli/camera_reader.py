"""Pictures of the arms that `yamsim serve-robot --cameras` simulates, for any program. It needs numpy alone.

    from yamsim_cli.camera_reader import CameraReader

    with CameraReader("top") as camera:
        picture = camera.read()
        picture.image  # RGB (height, width, 3)

`yamsim_cli.lerobot_camera` and `yamsim_cli.raiden_camera` are cameras of LeRobot's and raiden's that read by it.
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

from .core.closing import Closing
from .core.errors import ResourceError, UsageError, suggest
from .core.serve.sockets import CAMERA_SOCKET, default_folder

__all__ = ["CameraForm", "CameraReader", "Picture", "served_cameras"]

# Of an answer's description, and of a picture, bytes.
_LARGEST_HEAD, _LARGEST_PICTURE = 65_536, 3 * 4096**2


@dataclass(frozen=True)
class CameraForm:
    """What a camera's pictures are: width and height in px, at most so many a second, and intrinsics (3, 3)."""

    width: int
    height: int
    fps: float
    K: NDArray[np.float64]


@dataclass(frozen=True)
class Picture:
    """What a camera saw.

    Attributes:
        image: RGB (height, width, 3).
        number: of the picture; a later one has a larger number.
        time_ns: when, by the machine's clock, ns since 1970.
        sim_time: when, in the simulation, s.
        T_cam_in_base: the camera's pose (4, 4) in the left arm's base, in OpenCV's convention.
    """

    image: NDArray[np.uint8]
    number: int
    time_ns: int
    sim_time: float
    T_cam_in_base: NDArray[np.float64]


class CameraReader(Closing):
    """Reads one camera; close it, or use it in a `with`. It belongs to one thread at a time.

    Attributes:
        camera: its name.
        form: what its pictures are.

    Args:
        camera: as `serve-robot` prints it, such as "top".
        folder: that `serve-robot` was given with `--folder`; its default unless given.
        timeout: how long to wait for an answer, s.

    Raises:
        ResourceError: nothing is served there, or what answers is no `serve-robot`.
        UsageError: there is no such camera.
    """

    def __init__(self, camera: str, folder: str | Path | None = None, timeout: float = 5.0) -> None:
        self._folder, self._timeout = folder, timeout
        self._line: _Line | None = None
        forms = served_cameras(folder, timeout)
        if camera not in forms:
            raise UsageError(f"there is no camera {camera!r}; {suggest(camera, forms)}")
        self.camera, self.form = camera, forms[camera]

    def read(self, after: int = -1, timeout: float | None = None) -> Picture:
        """The newest picture whose number is larger than `after`; waits for one.

        Args:
            timeout: how long to wait, s; the reader's unless given.

        Raises:
            TimeoutError: there was none in time.
            ResourceError: `serve-robot` has ended, or what answers is none.
        """
        deadline = time.monotonic() + (self._timeout if timeout is None else timeout)
        if self._line is None:
            self._line = _Line(self._folder)
        try:
            told, data = self._line.ask({"ask": "picture", "camera": self.camera, "after": after}, deadline)
        except BaseException:
            # Its answer may still come, and would be taken for the next one's.
            self.close()
            raise
        height, width = self.form.height, self.form.width
        if (told.get("width"), told.get("height"), len(data)) != (width, height, 3 * height * width):
            self.close()
            raise ResourceError(f"camera {self.camera!r}: its pictures have another size now; open it again")
        try:
            return Picture(
                image=np.frombuffer(data, np.uint8).reshape(height, width, 3),
                number=int(told["number"]),
                time_ns=int(told["time_ns"]),
                sim_time=float(told["sim_time"]),
                T_cam_in_base=np.array(told["T_cam_in_base"], np.float64).reshape(4, 4),
            )
        except (KeyError, TypeError, ValueError) as error:
            self.close()
            raise _not_ours(self._folder) from error

    def close(self) -> None:
        """Hang up; a later `read` connects again."""
        if self._line is not None:
            self._line.close()
            self._line = None


def served_cameras(folder: str | Path | None = None, timeout: float = 5.0) -> dict[str, CameraForm]:
    """The cameras that a `serve-robot` hands out, by name.

    Args:
        folder, timeout: see `CameraReader`.

    Raises:
        ResourceError: nothing is served there, or what answers is no `serve-robot`.
    """
    line = _Line(folder)
    try:
        told, _ = line.ask({"ask": "cameras"}, time.monotonic() + timeout)
        return {
            str(name): CameraForm(
                int(one["width"]), int(one["height"]), float(one["fps"]), np.array(one["K"], np.float64).reshape(3, 3)
            )
            for name, one in told["cameras"].items()
        }
    except TimeoutError as error:
        raise ResourceError(f"{line.path}: serve-robot did not answer within {timeout:g} s") from error
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise _not_ours(folder) from error
    finally:
        line.close()


def _path(folder: str | Path | None) -> Path:
    return (default_folder(os.environ) if folder is None else Path(folder)) / CAMERA_SOCKET


def _not_ours(folder: str | Path | None) -> ResourceError:
    return ResourceError(f"{_path(folder)}: what answers there is no serve-robot of this version")


class _Line:
    """A connection; see `core.serve.cameras` for what is said on it."""

    def __init__(self, folder: str | Path | None) -> None:
        self.path = _path(folder)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.connect(str(self.path))
        except OSError as error:
            self._socket.close()
            raise ResourceError(
                f"{self.path}: no cameras are served there ({error.strerror or error}); start "
                "`yamsim serve-robot --cameras`, with the same --folder if it has one"
            ) from error

    def ask(self, message: dict[str, Any], deadline: float) -> tuple[dict[str, Any], bytes]:
        """What is answered, and the bytes that follow.

        Raises:
            TimeoutError: it did not come in time.
            ResourceError: the connection has ended, or brings no answer of ours.
        """
        asked = json.dumps(message).encode()
        try:
            self._wait(deadline)
            self._socket.sendall(len(asked).to_bytes(4, "little") + asked)
            length = int.from_bytes(self._take(4, deadline), "little")
            if length > _LARGEST_HEAD:
                raise ResourceError(f"{self.path}: what answers there is no serve-robot")
            told = json.loads(self._take(length, deadline))
            size = told.get("bytes") if isinstance(told, dict) else None
            if type(size) is not int or not 0 <= size <= _LARGEST_PICTURE:
                raise ResourceError(f"{self.path}: what answers there is no serve-robot")
            data = self._take(size, deadline)
        except TimeoutError:
            raise
        except (OSError, ValueError, RecursionError) as error:
            raise ResourceError(f"{self.path}: serve-robot has ended, or does not answer as it should") from error
        if "error" in told:
            raise ResourceError(f"{self.path}: {told['error']}")
        return told, data

    def close(self) -> None:
        """Hang up."""
        self._socket.close()

    def _take(self, count: int, deadline: float) -> bytes:
        data = bytearray(count)
        view, at = memoryview(data), 0
        while at < count:
            self._wait(deadline)
            got = self._socket.recv_into(view[at:])
            if not got:
                raise ConnectionError("closed")
            at += got
        return bytes(data)

    def _wait(self, deadline: float) -> None:
        left = deadline - time.monotonic()
        if left <= 0:
            raise TimeoutError(f"{self.path}: no new picture in time")
        self._socket.settimeout(left)
