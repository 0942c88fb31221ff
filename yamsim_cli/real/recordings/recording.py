"""Recordings of other programs: arms' motion and cameras' images."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yamsim_cli.core.config.real_recordings import GripperUnit
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files.documents.config_base import NAME_PATTERN
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.jpeg import encode_jpeg
from yamsim_cli.core.images.video import read_video_frames
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion

SampleIndices = NDArray[np.int64]  # sample numbers, or times in ns

JPEG_QUALITY = 95  # hardly any loss


@dataclass(frozen=True)
class CameraImages:
    """JPEG images of one camera: `read` yields one for each of the increasing `samples` (k,)."""

    samples: SampleIndices
    read: Callable[[], Iterator[bytes]]


@dataclass(frozen=True)
class Recording:
    """A recording of another program.

    Attributes:
        motion: joints in rad, openings in the unit `gripper`.
        gripper: m of one finger, share that is open, or share that is closed.
        prompt: the task's instruction, or empty.
        intrinsics: camera -> K (3, 3), where known.
        extrinsics: camera -> pose (n, 4, 4) in the base at each sample, where known.
        problems: faults that the recording itself reports.

    Raises:
        DatasetError: a camera's name is invalid as a folder.
    """

    motion: RecordedMotion
    gripper: GripperUnit
    pictures: Mapping[str, CameraImages] = field(default_factory=dict)
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

    def motion_in_metres(self, rig: RigConfig) -> RecordedMotion:
        """Return the motion with openings in m of one finger."""
        if self.gripper == "metres":
            return self.motion
        arms = []
        for arm, k in zip(self.motion.arms, rig.recording_order, strict=True):
            fingers = rig.arms[k].robot.fingers
            full = fingers.full_opening if fingers else 0.0
            measured, commanded = (
                self._openings_in_metres(values, full) for values in (arm.openings, arm.commanded_openings)
            )
            arms.append(replace(arm, openings=measured, commanded_openings=commanded))
        return replace(self.motion, arms=tuple(arms))

    def _openings_in_metres(self, values: Array | None, full: float) -> Array | None:
        if values is None:
            return None
        return full * (1 - values if self.gripper == "closed_share" else values)


def motion_sides(rig: RigConfig) -> tuple[str, ...]:
    """Return `left` and `right`, or one empty text for a single arm."""
    return tuple(rig.arms[k].side for k in rig.recording_order) if len(rig.arms) > 1 else ("",)


def split_arms(
    joints: Array, commands: Array | None, rig: RigConfig, velocities: Array | None = None
) -> tuple[ArmMotion, ...]:
    """Split arrays (n, arms, drives), gripper last, into a motion per arm; openings keep their unit."""
    motions = []
    for k, (side, number) in enumerate(zip(motion_sides(rig), rig.recording_order, strict=True)):
        robot = rig.arms[number].robot
        dof, has_gripper = robot.dof, robot.fingers is not None and joints.shape[2] > robot.dof
        motions.append(
            ArmMotion(
                side,
                joints[:, k, :dof],
                None if commands is None else commands[:, k, :dof],
                joints[:, k, dof] if has_gripper else None,
                commands[:, k, dof] if has_gripper and commands is not None else None,
                None if velocities is None else velocities[:, k, :dof],
            )
        )
    return tuple(motions)


def read_json_object(file: Path) -> dict[str, Any]:
    """Return the content of a JSON file of another program. Raise DatasetError if it is no readable JSON object."""
    try:
        content = json.loads(file.read_bytes())
    except OSError as error:
        raise DatasetError(f"{file} cannot be read: {error.strerror or error}; copy it again") from error
    except ValueError as error:
        raise DatasetError(f"{file} is not valid JSON: {error}; copy it again") from error
    if not isinstance(content, dict):
        raise DatasetError(f"{file}: is {str(content)[:60]!r}; valid: a JSON object")
    return content


def video_jpegs(film: Path, count: int, part: int = 0, parts: int = 1) -> Iterator[bytes]:
    """Yield the `count` images of a video as JPEGs, or of each the part number `part` of `parts` above each other.

    Raises:
        DatasetError: the video cannot be read, or has another number of images or of rows of pixels.
    """
    found = 0
    for image in read_video_frames(film, 0.0, count + 1, 0.0):
        height, rest = divmod(image.shape[0], parts)
        if rest:
            raise DatasetError(f"{film}: is {image.shape[0]} px high; valid: a multiple of {parts} cameras")
        found += 1
        if found > count:
            break
        yield encode_jpeg(np.ascontiguousarray(image[part * height : (part + 1) * height]), JPEG_QUALITY)
    if found != count:
        more = "more than " if found > count else ""
        raise DatasetError(f"{film}: has {more}{min(found, count)} images for {count} samples; copy it again")


def times_from_nanoseconds(stamps: ArrayLike, source: str) -> Array:
    """Convert time stamps (n,), ns, to times (n,), s, from 0.

    Raises:
        DatasetError: they are not integers (n,); or as `times_from_seconds`.
    """
    values = np.asarray(stamps)
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise DatasetError(f"{source}: timestamps are {values.dtype} {values.shape}; valid: whole numbers (n,), ns")
    # A float does not hold the 19 digits of a time stamp.
    return times_from_seconds((values - values[:1]).astype(np.float64) * 1e-9, source)


def times_from_seconds(times: Array, source: str) -> Array:
    """Shift times (n,), s, to start at 0.

    Raises:
        DatasetError: there are fewer than two times, or they do not increase.
    """
    if len(times) < 2:
        raise DatasetError(f"{source}: has {len(times)} samples; a motion needs at least two")
    back = np.flatnonzero(~(np.diff(times) > 0))
    if len(back):
        k = int(back[0])
        raise DatasetError(
            f"{source}: sample {k + 1} is at {times[k + 1]:.4f} s, and the sample before at {times[k]:.4f} s: times "
            "increase; remove duplicate samples"
        )
    since: Array = times - times[0]
    return since
