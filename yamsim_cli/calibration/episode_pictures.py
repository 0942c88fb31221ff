"""Read pictures and measured joints of episodes in any format that `import` reads."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..core.attempt_data import ArmPosture
from ..core.config.rig import RigConfig
from ..core.dataset.dataset_paths import EPISODE_FILE
from ..core.dataset.imported_records import is_yamsim_data
from ..core.dataset.reader import RecordedEpisode, open_all_episodes, open_recorded_episode
from ..core.errors import DatasetError, UsageError, suggest_similar
from ..core.files.resources import Locations
from ..core.geometry.camera import CameraModel
from ..core.geometry.se3 import Array
from ..core.images.image import Image
from ..core.images.image_files import decode_image
from ..core.recorded_motion import RecordedMotion
from ..photos.overlay.joint_files import ArmPostures
from ..real.recordings.motion_faults import MotionFault, find_faults, require_units
from ..real.recordings.motion_reading import detect_format, format_reader, read_episode
from ..real.recordings.recording import Recording


@dataclass(frozen=True)
class TimedPictures:
    """One camera's pictures of an episode.

    Attributes:
        times: at which each picture was taken (k,), s.
        read: returns the pictures (height, width, 3) with the given increasing indices.
        K: recorded camera matrix (3, 3), px.
    """

    times: Array
    read: Callable[[Sequence[int]], list[Image]]
    K: Array | None


@dataclass(frozen=True)
class EpisodePictures:
    """Joints and pictures of an episode.

    Attributes:
        times: of the samples (n,), s.
        joints: by arm, in the rig's order, (n, dof), rad, without the rig's encoder offsets.
        openings: of one finger by arm (n,), m.
        cameras: name -> pictures.
        rig: name of the rig that an episode of yamsim was recorded or imported with; None for other recordings.
    """

    name: str
    times: Array
    joints: tuple[Array, ...]
    openings: tuple[Array, ...]
    cameras: Mapping[str, TimedPictures]
    rig: str | None = None

    def postures_at(self, time: float, offsets: Sequence[Array] | None = None) -> ArmPostures:
        """Return the arms' postures at a time, s; `offsets` (dof,) by arm are subtracted.

        Joints are interpolated by cubics, since straight lines between ten samples a second are off by 0.1 degrees.
        """
        last = len(self.times) - 1
        k = int(np.clip(np.searchsorted(self.times, time) - 1, 0, max(last - 1, 0)))
        span = self.times[k + 1] - self.times[k]
        share = float(np.clip((time - self.times[k]) / span, 0, 1))
        bend = share * (1 - share) * span
        postures = []
        for arm, (joints, opening) in enumerate(zip(self.joints, self.openings, strict=True)):
            slope = (joints[k + 1] - joints[k]) / span
            before, after = self.velocities[arm][k] - slope, self.velocities[arm][k + 1] - slope
            at = (1 - share) * joints[k] + share * joints[k + 1] + bend * ((1 - share) * before - share * after)
            wide = (1 - share) * opening[k] + share * opening[k + 1]
            postures.append(ArmPosture(at if offsets is None else at - offsets[arm], float(wide)))
        return tuple(postures)

    def read_pictures(self, name: str, wanted: Sequence[int], camera: CameraModel) -> list[Image]:
        """Return pictures (height, width, 3) of a camera with the given increasing indices.

        Raises:
            DatasetError: a picture is damaged, or has another size than the camera's calibration.
        """
        images = self.cameras[name].read(wanted)
        for k, image in zip(wanted, images, strict=True):
            height, width = image.shape[:2]
            if (width, height) != (camera.width, camera.height):
                raise DatasetError(
                    f"{self.name}: {name}, picture {k} has {width} x {height} pixels, and the camera is calibrated for "
                    f"{camera.width} x {camera.height}; give the camera file of this size"
                )
        return images

    @functools.cached_property
    def velocities(self) -> tuple[Array, ...]:
        """Joint velocities by arm (n, dof), rad/s, from central differences."""
        return tuple(np.gradient(joints, self.times, axis=0) for joints in self.joints)

    def velocities_at(self, time: float) -> list[Array]:
        """Return the joint velocities (dof,) of each arm at the sample nearest to a time."""
        k = int(np.abs(self.times - time).argmin())
        return [rows[k] for rows in self.velocities]


def read_episode_pictures(
    paths: Sequence[Path], rig: RigConfig, locations: Locations, mapping: str | None = None
) -> list[EpisodePictures]:
    """Return all episodes of recordings and datasets.

    Raises:
        DatasetError: a recording is unreadable, does not fit the rig, or has joints in degrees.
        UsageError: no episode has pictures.
    """
    found: list[EpisodePictures] = []
    for path in paths:
        if is_yamsim_data(path):
            stored = [open_recorded_episode(path)] if (path / EPISODE_FILE).exists() else open_all_episodes(path)
            found += [_from_stored(episode, rig) for episode in stored]
        else:
            read = format_reader(detect_format(path))
            found += [_from_recording(recording, rig) for recording in read(path, rig, mapping, locations)]
    with_pictures = [one for one in found if one.cameras]
    if not with_pictures:
        raise UsageError("no episode has pictures; give episodes with the pictures of a camera")
    return with_pictures


def _from_stored(episode: RecordedEpisode, rig: RigConfig) -> EpisodePictures:
    frames = episode.frames()
    matrices = frames[0].get("intrinsics") or {}
    times = np.array([frame["timestamp"] for frame in frames], dtype=np.float64)
    cameras = {}
    for name in episode.record.cameras:
        K = None if matrices.get(name) is None else np.asarray(matrices[name], dtype=np.float64)
        cameras[name] = TimedPictures(times - times[0], functools.partial(_read_stored, episode, name), K)
    return replace(_episode_pictures(read_episode(episode, rig), rig, cameras), rig=episode.record.rig)


def _read_stored(episode: RecordedEpisode, camera: str, indices: Sequence[int]) -> list[Image]:
    return [_decode(episode.image(camera, k), f"{episode.directory}: {camera}, frame {k}") for k in indices]


def _from_recording(recording: Recording, rig: RigConfig) -> EpisodePictures:
    cameras = {
        name: TimedPictures(
            recording.motion.times[images.samples],
            functools.partial(_read_recording, recording, name),
            recording.intrinsics.get(name),
        )
        for name, images in recording.pictures.items()
    }
    return _episode_pictures(recording.motion_in_metres(rig), rig, cameras)


def _read_recording(recording: Recording, camera: str, indices: Sequence[int]) -> list[Image]:
    wanted, images = set(indices), []
    for k, data in enumerate(recording.pictures[camera].read()):
        if k in wanted:
            images.append(_decode(data, f"{recording.motion.name}: {camera}, picture {k}"))
        if len(images) == len(wanted):
            break
    return images


def _decode(data: bytes, where: str) -> Image:
    image = decode_image(data)
    if image is None:
        raise DatasetError(f"{where} is not a valid picture; copy the recording again")
    return image


def _episode_pictures(motion: RecordedMotion, rig: RigConfig, cameras: Mapping[str, TimedPictures]) -> EpisodePictures:
    faults = find_faults(motion, rig)
    for fault in faults:
        if fault.fault is MotionFault.DEGREES:
            remedy = "If so, import it with --degrees, and calibrate the dataset"
            raise DatasetError(f"{motion.name}: {fault.text} {remedy}")
    require_units(motion.name, faults)
    known = np.logical_and.reduce([np.isfinite(arm.joints).all(axis=1) for arm in motion.arms])
    joints: dict[int, Array] = {}
    openings: dict[int, Array] = {}
    for arm, number in zip(motion.arms, rig.recording_order, strict=True):
        config = rig.arms[number]
        # Recorded joints include the encoder offsets, and the model's joints do not.
        off = [
            0.0 if config.dynamics is None else config.dynamics.joint(j).offset_rad for j in config.robot.joint_names
        ]
        joints[number] = arm.joints[known] - off
        openings[number] = np.zeros(int(known.sum())) if arm.openings is None else np.nan_to_num(arm.openings[known])
    if known.sum() < 2:
        raise DatasetError(f"{motion.name}: has {int(known.sum())} samples with joints; at least two are needed")
    order = range(len(rig.arms))
    return EpisodePictures(
        motion.name,
        motion.times[known],
        tuple(joints[k] for k in order),
        tuple(openings[k] for k in order),
        cameras,
    )


def other_rigs(episodes: Sequence[EpisodePictures], rig: str) -> str | None:
    """Return a line about episodes of yamsim that name another rig than `rig`; None if there are none."""
    others = [one for one in episodes if one.rig not in (None, rig)]
    if not others:
        return None
    names = ", ".join(sorted({repr(one.rig) for one in others}))
    return (
        f"{len(others)} of {len(episodes)} episodes, such as {others[0].name}, were recorded with rig {names}, and "
        f"--rig is {rig!r}: if its arms or grippers differ, the result is wrong; give the rig of the pictures"
    )


def camera_names(episodes: Sequence[EpisodePictures]) -> list[str]:
    """Return the names of all cameras, sorted."""
    return sorted({name for episode in episodes for name in episode.cameras})


def require_cameras(names: Sequence[str], episodes: Sequence[EpisodePictures]) -> None:
    """Raise UsageError if no episode has pictures of one of the named cameras."""
    known = camera_names(episodes)
    for name in names:
        if name not in known:
            raise UsageError(f"camera {name!r}: no episode has its pictures; {suggest_similar(name, known)}")
