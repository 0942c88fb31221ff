"""The photos of recordings whose gap is known, and how the arms stand in each, measured and simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..config.rig import RigConfig
from ..dataset.layout import image_name, lowdim_name
from ..dataset.lowdim import load_frame
from ..errors import DatasetError, UsageError, suggest
from ..gap.figures import Gap
from ..geometry.se3 import inverse
from ..images.image import Image
from ..motion import Motion
from ..overlay.joint_files import Stands
from ..overlay.photos import Photo, camera_matrix, chosen_camera, pinhole_camera
from ..types import Stand


@dataclass(frozen=True)
class Taken:
    """A photo that was taken during a recording.

    Attributes:
        gap: the recording's gap.
        frame: number of the measured sample, from 0.
        sample: row of that sample in the motion.
    """

    gap: Gap
    frame: int
    sample: int
    path: Path


def taken_photos(gaps: Sequence[Gap], camera: str | None) -> tuple[str, list[Taken]]:
    """The name of one camera, and its photos in the compared parts of recordings.

    Args:
        camera: name of the camera, see `chosen_camera`.

    Raises:
        UsageError: no recording has photos, or none by that camera.
    """
    folders = {gap.name: Path(gap.name) for gap in gaps if (Path(gap.name) / "rgb").is_dir()}
    cameras = sorted({path.name for folder in folders.values() for path in (folder / "rgb").iterdir() if path.is_dir()})
    if not cameras:
        raise UsageError("--pictures: no recording has photos; leave it out, or give episodes with rgb/")
    camera = chosen_camera(cameras, camera)
    if camera not in cameras:
        raise UsageError(f"--episode-camera {camera!r}: no recording has it; {suggest(camera, cameras)}")
    taken = []
    for gap in gaps:
        known = np.logical_and.reduce([np.isfinite(arm.joints).all(axis=1) for arm in gap.motion.arms])
        for frame, sample in enumerate(np.flatnonzero(known).tolist()):
            if gap.name in folders and gap.counted[sample]:
                path = folders[gap.name] / image_name(camera, frame)
                if path.is_file():
                    taken.append(Taken(gap, frame, sample, path))
    if not taken:
        raise UsageError(
            f"--pictures: camera {camera!r} has no photo of what was compared; choose another --from, --to"
        )
    return camera, taken


def chosen_photos(taken: Sequence[Taken], most: int) -> list[Taken]:
    """At most `most` of the photos, evenly chosen. The photo with the largest joint error is among them."""
    if len(taken) <= most:
        return list(taken)
    worst = max(range(len(taken)), key=lambda k: _error(taken[k]))
    even = np.linspace(0, len(taken) - 1, most - 1).round().astype(int).tolist() if most > 1 else []
    return [taken[k] for k in sorted({worst, *even})]


def _error(photo: Taken) -> float:
    both = zip(photo.gap.motion.arms, photo.gap.simulated.arms, strict=True)
    return max(float(np.abs(real.joints[photo.sample] - made.joints[photo.sample]).max()) for real, made in both)


def stands_at(motion: Motion, sample: int, rig: RigConfig) -> Stands:
    """How a rig's arms stand at a sample of a motion, in the rig's order."""
    stands = {}
    for arm, number in zip(motion.arms, rig.recorded, strict=True):
        config, opening = rig.arms[number], 0.0 if arm.openings is None else float(np.nan_to_num(arm.openings[sample]))
        dynamics, names = config.dynamics, config.robot.joint_names
        # An encoder's offset is in the recorded joints.
        off = [0.0 if dynamics is None else dynamics.joint(name).offset_rad for name in names]
        stands[number] = Stand(arm.joints[sample] - off, opening)
    return tuple(stands[number] for number in range(len(rig.arms)))


def photo_of(taken: Taken, camera: str, rig: RigConfig, image: Image) -> Photo:
    """A photo with its recorded camera and that camera's pose, as far as they were recorded.

    Raises:
        DatasetError: the frame cannot be read, or is damaged.
    """
    file = Path(taken.gap.name) / lowdim_name(taken.frame)
    try:
        frame = load_frame(file.read_bytes())
        K, T_cam_in_base = (
            None if (frame.get(key) or {}).get(camera) is None else camera_matrix(frame, key, camera)
            for key in ("intrinsics", "extrinsics")
        )
    except OSError as error:
        raise DatasetError(f"{file} cannot be read: {error.strerror or error}") from error
    except (TypeError, ValueError, DatasetError) as error:
        raise DatasetError(f"{file}: cannot be used: {error}") from error
    height, width = image.shape[:2]
    T_base_in_cam = None
    if T_cam_in_base is not None:
        # Extrinsics are recorded in the base of the only arm, or of the left one.
        T_cam_in_world = rig.T_base_in_world(rig.recorded[0]) @ T_cam_in_base
        T_base_in_cam = inverse(T_cam_in_world) @ rig.T_base_in_world(0)
    model = None if K is None else pinhole_camera(K, width, height)
    return Photo(taken.path, model, stands_at(taken.gap.simulated, taken.sample, rig), "episode", T_base_in_cam)
