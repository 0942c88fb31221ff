"""The photos to lay a rig over, from files, folders, or a recorded episode, with all that is known of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..config.rig import RigConfig
from ..dataset.layout import episode_directories
from ..dataset.lowdim import load_frame
from ..errors import DatasetError, ResourceError, UsageError, suggest
from ..geometry.camera import CameraModel
from ..geometry.se3 import Array, inverse
from ..images.image_files import read_image
from .joint_files import Stands, recorded_stands

SUFFIXES = (".png", ".jpg", ".jpeg")

# Endings of pictures that are written for photos. Files with such names are not photos.
OVERLAY_ENDING = "_overlay.png"
MASK_ENDING = "_mask.png"


@dataclass(frozen=True)
class Photo:
    """One photo and what is known of it.

    Attributes:
        path: its file.
        camera: the camera that took it; None if not known.
        stands: how every arm stands; None if not known, which counts as home.
        joints_source: where the joints come from: "home", "file" or "episode".
        T_base_in_cam: pose (4, 4) of the first arm's base in the camera's frame; None if it was not recorded.
        time: when it was taken, s; None if not known.
    """

    path: Path
    camera: CameraModel | None = None
    stands: Stands | None = None
    joints_source: str = "home"
    T_base_in_cam: Array | None = None
    time: float | None = None


def find_photos(paths: Sequence[Path]) -> list[Path]:
    """The photos that files and folders name, in order, each once; overlays and masks in a folder are left out.

    Raises:
        ResourceError: a path does not exist, is no PNG or JPEG, or a folder has none.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(item for item in path.iterdir() if _may_be_photo(item))
            if not inside:
                raise ResourceError(f"{path} holds no photo; valid: {', '.join(SUFFIXES)}")
            found += inside
        elif not path.exists():
            raise ResourceError(f"{path} does not exist; give a photo or a folder of photos")
        elif path.suffix.lower() not in SUFFIXES:
            raise ResourceError(f"{path} is no photo; valid: {', '.join(SUFFIXES)}")
        else:
            found.append(path)
    once: dict[Path, Path] = {}
    for path in found:
        once.setdefault(path.resolve(), path)
    return list(once.values())


def _may_be_photo(path: Path) -> bool:
    """Whether a file in a folder is a photo. Hidden files, and overlays and masks of earlier runs, are none."""
    ours = path.name.endswith((OVERLAY_ENDING, MASK_ENDING))
    return path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and not ours and path.is_file()


def mask_of(masks: Path, photo: Path) -> Path:
    """The mask of a photo: `masks` itself, or the file with the photo's name if `masks` is a folder.

    Raises:
        ResourceError: the folder has none.
    """
    if not masks.is_dir():
        return masks
    for name in (f"{photo.stem}{MASK_ENDING}", f"{photo.stem}.png", photo.name):
        if (masks / name).is_file() and (masks / name).resolve() != photo.resolve():
            return masks / name
    raise ResourceError(f"{masks} holds no mask for {photo.name}; valid: {photo.stem}{MASK_ENDING} or {photo.stem}.png")


def recorded_photos(recordings: Sequence[Path], camera: str | None, rig: RigConfig) -> list[Photo]:
    """The frames of episodes, and of all episodes of datasets, in order, see `episode_photos`."""
    episodes: list[Path] = []
    for path in recordings:
        within = [episode for _, episode in episode_directories(path)] if path.is_dir() else []
        episodes += within or [path]
    return [photo for episode in episodes for photo in episode_photos(episode, camera, rig)]


def episode_photos(episode: Path, camera: str | None, rig: RigConfig) -> list[Photo]:
    """A recorded episode's frames of one camera, with its own intrinsics, pose and joints.

    Args:
        camera: name of the camera; by default the first one that is no wrist camera.

    Raises:
        DatasetError: it is no episode, or a frame of it is damaged.
        UsageError: it has no such camera.
    """
    if (episode / "lowdim").is_dir() and not (episode / "rgb").is_dir():
        raise DatasetError(f"{episode} has no pictures: nobody recorded any")
    if not (episode / "rgb").is_dir() or not (episode / "lowdim").is_dir():
        raise DatasetError(f"{episode} is no episode: it needs rgb/ and lowdim/; give DATASET/ep_NNNNNN")
    cameras = sorted(path.name for path in (episode / "rgb").iterdir() if path.is_dir())
    if not cameras:
        raise DatasetError(f"{episode}/rgb holds no camera")
    if camera is None:
        camera = next((name for name in cameras if "wrist" not in name), cameras[0])
    if camera not in cameras:
        raise UsageError(f"{episode} has no camera {camera!r}; {suggest(camera, cameras)}")
    photos = []
    for path in sorted((episode / "rgb" / camera).iterdir()):
        if path.suffix.lower() not in SUFFIXES:
            continue
        lowdim = episode / "lowdim" / f"{path.stem}.pkl"
        try:
            frame = load_frame(lowdim.read_bytes())
            K = _matrix(frame["intrinsics"][camera], 3)
            T_cam_in_base = _matrix(frame["extrinsics"][camera], 4)
            if len(rig.arms) > 1:
                # It was recorded in the left arm's base, and is needed in that of the rig's first arm.
                T_left_in_world = rig.T_base_in_world(rig.recorded[0])
                T_cam_in_base = inverse(rig.T_base_in_world(0)) @ T_left_in_world @ T_cam_in_base
            time = float(frame["timestamp"]) if "timestamp" in frame else None
            stands = recorded_stands(np.asarray(frame["joints"], dtype=np.float64), rig, lowdim)
        except OSError as error:
            raise DatasetError(f"{lowdim}: cannot be read: {error.strerror or error}") from error
        except KeyError as error:
            raise DatasetError(
                f"{lowdim}: has no {error} of camera {camera}: without them, give its pictures with --img "
                f"{episode}/rgb/{camera}"
            ) from error
        except (TypeError, ValueError, DatasetError) as error:
            raise DatasetError(f"{lowdim}: cannot be used: {error}") from error
        height, width = read_image(path).shape[:2]
        photos.append(Photo(path, _pinhole(K, width, height), stands, "episode", inverse(T_cam_in_base), time))
    if not photos:
        raise DatasetError(f"{episode}/rgb/{camera} holds no frame")
    return photos


def _matrix(values: object, side: int) -> Array:
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.shape != (side, side) or not np.isfinite(matrix).all():
        raise ValueError(f"a camera's matrix has the shape {matrix.shape} or is not finite; valid: ({side}, {side})")
    return matrix


def _pinhole(K: Array, width: int, height: int) -> CameraModel:
    (a, b, c), (d, e, f), _ = K.tolist()
    return CameraModel(width, height, ((a, b, c), (d, e, f), (0.0, 0.0, 1.0)))
