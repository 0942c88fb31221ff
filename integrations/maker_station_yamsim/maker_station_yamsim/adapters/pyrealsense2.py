"""The part of `pyrealsense2` that reads colour images, on the cameras of `yamsim serve-robot --cameras`.

A camera's serial number is its name in the rig, such as `top`. Errors are those of librealsense: a RuntimeError with
its message. There is no depth. Only programs that `yamsim-maker` starts import this module.
"""

import os
import sys
from enum import Enum

# yamsim's camera reader needs only numpy, and the program's own packages come first.
sys.path.append(os.environ["YAMSIM_PACKAGES"])
try:
    from yamsim_cli import YamsimError
    from yamsim_cli.camera_reader import CameraReader, served_cameras
finally:
    sys.path.remove(os.environ["YAMSIM_PACKAGES"])

_FOLDER = os.environ["YAMSIM_CAN_FOLDER"]
_PRODUCT = "Intel RealSense D405 (simulated)"
_FRAME_TIMEOUT_MS = 5000  # ms, librealsense's default wait for frames


class stream(Enum):  # noqa: N801
    """Streams of a camera; only `color` can be enabled."""

    color = "color"
    depth = "depth"


class format(Enum):  # noqa: N801
    """Formats of an image; `rgb8` and `bgr8` can be enabled."""

    rgb8 = "rgb8"
    bgr8 = "bgr8"
    z16 = "z16"


class camera_info(Enum):  # noqa: N801
    """Properties of a device."""

    name = "name"
    serial_number = "serial_number"


class device:  # noqa: N801
    """A served camera."""

    def __init__(self, serial):
        self._serial = serial

    def get_info(self, info):
        """Return the name of the product or the serial number."""
        return self._serial if info is camera_info.serial_number else _PRODUCT

    def hardware_reset(self):
        """Do nothing: a simulated camera does not hang."""


class context:  # noqa: N801
    """The cameras of the machine."""

    def query_devices(self):
        """Return all served cameras."""
        return [device(name) for name in _served_forms()]


class config:  # noqa: N801
    """What a pipeline is to open."""

    def __init__(self):
        self.serial = ""
        self.streams = []

    def enable_device(self, serial):
        """Select a camera by its serial number."""
        self.serial = serial

    def enable_stream(self, kind, width, height, form, fps):
        """Request a stream."""
        self.streams.append((kind, width, height, form, fps))


class video_frame:  # noqa: N801
    """An image (height, width, 3)."""

    def __init__(self, image):
        self._image = image

    def get_data(self):
        """Return the image as an array."""
        return self._image


class composite_frame:  # noqa: N801
    """The images of one time."""

    def __init__(self, image):
        self._image = image

    def get_color_frame(self):
        """Return the colour image."""
        return video_frame(self._image)


class pipeline:  # noqa: N801
    """A camera's stream of images."""

    def __init__(self):
        self._reader = None
        self._number = -1
        self._bgr = False

    def start(self, wanted):
        """Open the camera.

        Raises:
            RuntimeError: the camera is not served, or has no such stream.
        """
        forms = _served_forms()
        serial = wanted.serial or next(iter(forms), "")
        if serial not in forms:
            raise RuntimeError(f"No device connected (serial {serial!r}; yamsim serves {', '.join(forms) or 'none'})")
        for kind, width, height, form, _fps in wanted.streams:
            served = forms[serial].width, forms[serial].height
            if kind is not stream.color or form is format.z16 or (width, height) != served:
                raise RuntimeError(
                    f"Couldn't resolve requests ({kind.value} {form.value} {width}x{height}; yamsim serves color rgb8 "
                    f"{served[0]}x{served[1]}, see `serve-robot --size`)"
                )
            self._bgr = form is format.bgr8
        self._reader = CameraReader(serial, _FOLDER)

    def wait_for_frames(self, timeout_ms=_FRAME_TIMEOUT_MS):
        """Return the next image.

        Raises:
            RuntimeError: no image arrived in time, or the server has ended.
        """
        if self._reader is None:
            raise RuntimeError("wait_for_frames cannot be called before start()")
        try:
            picture = self._reader.read(self._number, timeout_ms / 1000)
        except (TimeoutError, YamsimError) as error:
            raise RuntimeError(f"Frame didn't arrive within {timeout_ms} ({error})") from error
        self._number = picture.number
        return composite_frame(picture.image[..., ::-1] if self._bgr else picture.image)

    def stop(self):
        """Close the camera."""
        if self._reader is None:
            raise RuntimeError("stop() cannot be called before start()")
        self._reader.close()
        self._reader = None


def _served_forms():
    try:
        return served_cameras(_FOLDER)
    except YamsimError:
        return {}
