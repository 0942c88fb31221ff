"""A recording as others made it: its motion, and what its cameras saw."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..config.real import GripperUnit
from ..config.rig import RigConfig
from ..documents.base import NAME_PATTERN
from ..errors import DatasetError
from ..geometry.se3 import Array
from ..motion import Motion

# Numbers of samples, or of ns.
Samples = NDArray[np.int64]


@dataclass(frozen=True)
class Pictures:
    """What a camera saw, as JPEG.

    Attributes:
        samples: numbers (k,) of the motion's samples at which it did, increasing.
        read: gives a picture for each of them, in order.
    """

    samples: Samples
    read: Callable[[], Iterator[bytes]]


@dataclass(frozen=True)
class Recording:
    """A recording.

    Attributes:
        motion: joints in rad; openings in whatever unit `gripper` says.
        gripper: in which unit the openings are.
        pictures: camera -> what it saw.
        prompt: the task in words; empty where nobody said.
        intrinsics: camera -> K (3, 3), where it is known.
        extrinsics: camera -> its poses (n, 4, 4) in the base, where they are known.
        problems: what the recording itself says is wrong with it, for a person.

    Raises:
        DatasetError: a camera has a name that cannot be a folder's.
    """

    motion: Motion
    gripper: GripperUnit
    pictures: Mapping[str, Pictures] = field(default_factory=dict)
    prompt: str = ""
    intrinsics: Mapping[str, Array] = field(default_factory=dict)
    extrinsics: Mapping[str, Array] = field(default_factory=dict)
    problems: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for camera in self.pictures:
            if not re.fullmatch(NAME_PATTERN, camera):
                raise DatasetError(
                    f"{self.motion.name}: camera {camera[:80]!r} is not valid; valid: a letter, then letters, digits "
                    "and _; rename it in the recording"
                )

    def in_metres(self, rig: RigConfig) -> Motion:
        """The motion with openings of one finger, m."""
        if self.gripper == "metres":
            return self.motion
        arms = []
        for arm, k in zip(self.motion.arms, rig.recorded, strict=True):
            fingers = rig.arms[k].robot.fingers
            full = fingers.full_opening if fingers else 0.0
            arms.append(
                replace(
                    arm,
                    openings=self._opened(arm.openings, full),
                    commanded_openings=self._opened(arm.commanded_openings, full),
                )
            )
        return replace(self.motion, arms=tuple(arms))

    def _opened(self, values: Array | None, full: float) -> Array | None:
        if values is None:
            return None
        return full * (1 - values if self.gripper == "closed_share" else values)
