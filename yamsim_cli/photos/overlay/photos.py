"""Find photos in files, folders or recorded episodes, with recorded cameras and joints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.dataset_paths import episode_directories
from yamsim_cli.core.dataset.lowdim import load_frame
from yamsim_cli.core.errors import DatasetError, ResourceError, UsageError, suggest_similar
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, invert_pose
from yamsim_cli.core.images.image_files import read_image

from .joint_files import ArmPostures, recorded_postures

PHOTO_SUFFIXES = (".png", ".jpg", ".jpeg")

# Suffixes of pictures that yamsim writes beside photos.
OVERLAY_SUFFIX = "_overlay.png"
MASK_SUFFIX = "_mask.png"


@dataclass(frozen=True)
class PlacedCamera:
    """A calibrated camera and the arms that it sees, by `yamsim calibrate`.

    Attributes:
        T_bases_in_cam: pose (4, 4) of each arm's base in the camera frame, in the rig's order.
        offsets: of each arm's joints (dof,), rad: measured minus true.
        delay: s; photos show the arms as they were this much before their time stamps.
    """

    camera: CameraModel
    T_bases_in_cam: tuple[Array, ...]
    offsets: tuple[Array, ...]
    delay: float

    def true_postures(self, measured: ArmPostures) -> ArmPostures:
        """Return postures without the joints' offsets."""
        pairs = zip(measured, self.offsets, strict=True)
        return tuple(replace(one, joints=one.joints - offsets) for one, offsets in pairs)


@dataclass(frozen=True)
class Photo:
    """A photo, with what is known of camera, joints and pose.

    Attributes:
        postures: of a rig's arms; None shows the home joints.
        joints_source: "home", "file" or "episode".
        T_base_in_cam: pose (4, 4) of the first arm's base in the camera frame.
        time: s.
        placed: the calibration of its camera and arms, which replaces boards and recorded poses.
    """

    path: Path
    camera: CameraModel | None = None
    postures: ArmPostures | None = None
    joints_source: str = "home"
    T_base_in_cam: Array | None = None
    time: float | None = None
    placed: PlacedCamera | None = None


def find_photos(paths: Sequence[Path]) -> list[Path]:
    """Return photos in order and once each, without earlier outputs in folders.

    Raises:
        ResourceError: a path does not exist, is no PNG or JPEG, or a folder has none.
    """
    found: dict[Path, Path] = {}
    for path in paths:
        if path.is_dir():
            photos = sorted(item for item in path.iterdir() if _may_be_photo(item))
            if not photos:
                raise ResourceError(f"{path} contains no photo; valid: {', '.join(PHOTO_SUFFIXES)}")
        elif not path.exists():
            raise ResourceError(f"{path} does not exist; give a photo or a folder of photos")
        elif path.suffix.lower() not in PHOTO_SUFFIXES:
            raise ResourceError(f"{path} is not a photo; valid: {', '.join(PHOTO_SUFFIXES)}")
        else:
            photos = [path]
        for photo in photos:
            found.setdefault(photo.resolve(), photo)
    return list(found.values())


def _may_be_photo(path: Path) -> bool:
    written = path.name.endswith((OVERLAY_SUFFIX, MASK_SUFFIX))
    return path.suffix.lower() in PHOTO_SUFFIXES and not path.name.startswith(".") and not written and path.is_file()


def find_mask(masks: Path, photo: Path) -> Path:
    """Return `masks`, or in a folder the file named as the photo.

    Raises:
        ResourceError: the folder has no mask for the photo.
    """
    if not masks.is_dir():
        return masks
    for name in (f"{photo.stem}{MASK_SUFFIX}", f"{photo.stem}.png", photo.name):
        if (masks / name).is_file() and (masks / name).resolve() != photo.resolve():
            return masks / name
    raise ResourceError(
        f"{masks} contains no mask for {photo.name}; valid: {photo.stem}{MASK_SUFFIX} or {photo.stem}.png"
    )


def recorded_photos(
    recordings: Sequence[Path], camera: str | None, rig: RigConfig, placed: PlacedCamera | None = None
) -> list[Photo]:
    """Return one camera's photos in episodes or datasets. Raises as `episode_photos`."""
    episodes: list[Path] = []
    for path in recordings:
        within = [episode for _, episode in episode_directories(path)] if path.is_dir() else []
        episodes += within or [path]
    return [photo for episode in episodes for photo in episode_photos(episode, camera, rig, placed)]


def choose_camera(cameras: Sequence[str], camera: str | None) -> str:
    """Return `camera` or, if None, the first name without "wrist", else the first."""
    return camera or next((name for name in cameras if "wrist" not in name), cameras[0])


def episode_photos(
    episode: Path, camera: str | None, rig: RigConfig, placed: PlacedCamera | None = None
) -> list[Photo]:
    """Return an episode's photos from one camera, by default the first that is no wrist camera.

    With `placed`, the camera and the arms have its poses, and the frames need neither intrinsics nor extrinsics.

    Raises:
        DatasetError: the directory is no episode or has no pictures, or a frame is damaged.
        UsageError: the episode has no such camera.
    """
    if (episode / "lowdim").is_dir() and not (episode / "rgb").is_dir():
        raise DatasetError(f"{episode} has no images: it was recorded without them")
    if not (episode / "rgb").is_dir() or not (episode / "lowdim").is_dir():
        raise DatasetError(f"{episode} is not an episode: it needs rgb/ and lowdim/; give DATASET/ep_NNNNNN")
    cameras = sorted(path.name for path in (episode / "rgb").iterdir() if path.is_dir())
    if not cameras:
        raise DatasetError(f"{episode}/rgb contains no folder of a camera")
    camera = choose_camera(cameras, camera)
    if camera not in cameras:
        raise UsageError(f"{episode} has no camera {camera!r}; {suggest_similar(camera, cameras)}")
    files = sorted((episode / "rgb" / camera).iterdir())
    files = [path for path in files if path.suffix.lower() in PHOTO_SUFFIXES]
    if not files:
        raise DatasetError(f"{episode}/rgb/{camera} contains no image")
    if placed is not None:
        return _placed_photos(episode, files, rig, placed)
    return [_frame_photo(episode, camera, path, rig) for path in files]


@contextmanager
def frame_errors(lowdim: Path, missing_key_remedy: str = "") -> Iterator[None]:
    """Raise DatasetError with the file `lowdim` for what is wrong with a recorded frame."""
    try:
        yield
    except OSError as error:
        raise DatasetError(f"{lowdim}: cannot be read: {error.strerror or error}") from error
    except KeyError as error:
        raise DatasetError(f"{lowdim}: has no {error}{missing_key_remedy}") from error
    except (TypeError, ValueError, DatasetError) as error:
        raise DatasetError(f"{lowdim}: cannot be used: {error}") from error


def _placed_photos(episode: Path, files: Sequence[Path], rig: RigConfig, placed: PlacedCamera) -> list[Photo]:
    rows, times = [], []
    for path in files:
        lowdim = episode / "lowdim" / f"{path.stem}.pkl"
        with frame_errors(lowdim):
            frame = load_frame(lowdim.read_bytes())
            rows.append(np.asarray(frame["joints"], dtype=np.float64))
            times.append(float(frame["timestamp"]))
    if len({row.shape for row in rows}) > 1:
        raise DatasetError(f"{episode}: frames have different numbers of joints; record it again")
    seen = np.array(times) - placed.delay
    shown = np.stack([np.interp(seen, times, column) for column in np.stack(rows).T], axis=1)
    photos = []
    for path, row, time in zip(files, shown, times, strict=True):
        measured = recorded_postures(row, rig, episode / "lowdim")
        photos.append(Photo(path, placed.camera, placed.true_postures(measured), "episode", time=time, placed=placed))
    return photos


def _frame_photo(episode: Path, camera: str, path: Path, rig: RigConfig) -> Photo:
    lowdim = episode / "lowdim" / f"{path.stem}.pkl"
    with frame_errors(lowdim, f" of camera {camera}; to use the images alone, give --img {episode}/rgb/{camera}"):
        frame = load_frame(lowdim.read_bytes())
        K = camera_matrix(frame, "intrinsics", camera)
        T_cam_in_base = camera_matrix(frame, "extrinsics", camera)
        time = float(frame["timestamp"]) if "timestamp" in frame else None
        frame_postures = recorded_postures(np.asarray(frame["joints"], dtype=np.float64), rig, lowdim)
    if len(rig.arms) > 1:
        # Recorded extrinsics are relative to the left arm's base, `Photo` to the first arm's.
        T_left_in_world = rig.T_base_in_world(rig.recording_order[0])
        T_cam_in_base = invert_pose(rig.T_base_in_world(0)) @ T_left_in_world @ T_cam_in_base
    height, width = read_image(path).shape[:2]
    return Photo(path, pinhole_camera(K, width, height), frame_postures, "episode", invert_pose(T_cam_in_base), time)


def camera_matrix(frame: Mapping[str, Any], key: str, camera: str) -> Array:
    """Return a camera's "intrinsics" (3, 3) or "extrinsics" (4, 4: pose in an arm's base).

    Raises KeyError without a matrix, and ValueError for a wrong shape or infinite values.
    """
    side = {"intrinsics": 3, "extrinsics": 4}[key]
    matrix = np.asarray(frame[key][camera], dtype=np.float64)
    if matrix.shape != (side, side) or not np.isfinite(matrix).all():
        raise ValueError(f"{key} of {camera} has the shape {matrix.shape} or is not finite; valid: ({side}, {side})")
    return matrix


def pinhole_camera(K: Array, width: int, height: int) -> CameraModel:
    """Return an undistorted camera from its matrix (3, 3) and size, px."""
    (a, b, c), (d, e, f), _ = K.tolist()
    return CameraModel(width, height, ((a, b, c), (d, e, f), (0.0, 0.0, 1.0)))
