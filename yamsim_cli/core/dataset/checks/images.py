"""Checks that images decode, have the right size, and show something that moves when the arm does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...geometry.se3 import Array
from ...images.image import ImageHeader, ImageLook
from .problem import Problems

# Images with more pixels are not decoded: a header can announce gigabytes. No camera here comes near.
_MOST_PIXELS = 2**26

# An image with less contrast is uniform, and with less brightness black, of 255. They are measured on a smaller copy of
# the picture, so that neither noise nor a few bad pixels count.
_UNIFORM_CONTRAST = 2.0
_BLACK_BRIGHTNESS = 16.0

# A camera counts as frozen if so many images in a row are equal while a joint moves by so much, rad. 0.02 rad move the
# hand, half a metre away, by 10 mm, which are 5 pixels in the task's camera. Images of a slower arm may be equal.
_FROZEN_RUN = 3
_FROZEN_MOTION = 0.02


class ImageReader(Protocol):
    """Decodes images. It is passed in, since this package does not know OpenCV."""

    def header(self, data: bytes) -> ImageHeader | None:
        """Size and channels; None when it is no image, or ends before its end."""
        ...

    def look(self, data: bytes) -> ImageLook | None:
        """What the decoded image looks like; None when it cannot be decoded."""
        ...

    def labels(self, data: bytes) -> NDArray[np.uint8] | None:
        """A decoded segmentation image (height, width); None when it is none, or not whole."""
        ...


class CameraChecks:
    """Checks one camera's images, one after the other.

    Args:
        size: width and height that images should have; None for those of the first image.
    """

    def __init__(self, camera: str, size: tuple[int, int] | None, reader: ImageReader, problems: Problems) -> None:
        self._camera = camera
        self._stated = size
        self._reader = reader
        self._problems = problems
        self.size = size
        self.fingerprints: dict[int, int] = {}

    def check(self, number: int, name: str, data: bytes) -> bool:
        """Whether an image could be decoded; its faults are noted."""
        header = self._reader.header(data)
        if header is None:
            self._problems.add("image.decode", name, f"{len(data)} bytes")
            return False
        size = (header.width, header.height)
        if header.width * header.height > _MOST_PIXELS:
            self._add("image.size", name, _by(size), f"at most {_MOST_PIXELS} pixels")
            return True
        if self.size is None:
            self.size = size
        if size != self.size:
            self._add("image.size", name, _by(size), _by(self.size) + ("" if self._stated else ", as the first one"))
        if header.channels != 3:
            self._add("image.colour", name, f"{header.channels} channel", "3 channels")
        look = self._reader.look(data)
        if look is None or look.complaint:
            self._problems.add("image.decode", name, look.complaint if look else f"{len(data)} bytes")
            return False
        if look.contrast < _UNIFORM_CONTRAST:
            code = "image.black" if look.brightness < _BLACK_BRIGHTNESS else "image.uniform"
            self._add(code, name, f"brightness {look.brightness:.0f} of 255, contrast {look.contrast:.1f}")
        self.fingerprints[number] = look.fingerprint
        return True

    def _add(self, code: str, name: str, value: str, valid: str = "") -> None:
        self._problems.add(code, name, value, valid, about=self._camera)


def check_frozen(
    fingerprints: Mapping[int, int], names: Mapping[int, str], joints: Mapping[int, Array], problems: Problems
) -> None:
    """Note runs of equal images during which the arm moves.

    Args:
        fingerprints: frame -> its image's fingerprint.
        joints: frame -> joint angles, rad.
    """
    for run in _equal_runs(fingerprints):
        known = [joints[k] for k in run if k in joints]
        if len(run) < _FROZEN_RUN or len(known) < 2:
            continue
        motion = float(np.max(np.ptp(np.array(known), axis=0)))
        if motion > _FROZEN_MOTION:
            value = f"frames {run[0]} to {run[-1]} are the same image while a joint moves {motion:.2f} rad"
            problems.add("image.frozen", names[run[0]], value)


def _equal_runs(fingerprints: Mapping[int, int]) -> list[Sequence[int]]:
    runs: list[list[int]] = []
    for number in sorted(fingerprints):
        last = runs[-1][-1] if runs else None
        if last == number - 1 and fingerprints[number] == fingerprints[last]:
            runs[-1].append(number)
        else:
            runs.append([number])
    return list(runs)


def _by(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"
