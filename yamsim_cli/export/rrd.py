"""Export for the rerun viewer: one `.rrd` per episode with images, joints, poses and camera frusta."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core.dataset.dataset_paths import depth_path
from ..core.dataset.imported_records import RealEpisodeRecord
from ..core.dataset.lowdim import RIGHT_IN_LEFT_BASE_KEY
from ..core.dataset.reader import RecordedEpisode, StoredEpisode
from ..core.extras import require_library
from ..core.geometry.se3 import Array
from ..core.progress import Progress
from .export_source import ExportSource, depth_cameras
from .output_directory import ExportResult, export_directory

_IMAGE_DISTANCE = 0.15  # m, of an image in front of its camera
_AXIS_LENGTH = 0.05  # m, of the axes that show a pose
_AXIS_COLOURS = ((220, 50, 50), (50, 160, 50), (50, 80, 220))


def export_rerun(source: ExportSource, out: Path, progress: Progress, *, overwrite: bool = False) -> ExportResult:
    """Write `ep_NNNNNN.rrd` files. Poses are in the base of the only or left arm.

    Real recordings are shown at their recorded times, without data that was not recorded.
    """
    require_library("an .rrd file", "rerun", "rerun")
    frames = 0
    with export_directory(out, overwrite=overwrite) as stage:
        for number, episode in enumerate(source.open_episodes()):
            frames += _write(stage.path / f"{episode.directory.name}.rrd", source, episode)
            progress(number + 1, len(source))
    return ExportResult(out, len(source), frames, stage.moved_aside)


def _write(path: Path, source: ExportSource, episode: RecordedEpisode) -> int:
    import rerun

    dataset = source.path.absolute().name
    # Without properties, which contain the time of day.
    stream = rerun.RecordingStream("yamsim", recording_id=f"{dataset}-{episode.directory.name}", send_properties=False)
    stream.save(path)
    stream.send_recording_name(f"{dataset}/{episode.directory.name}")
    frames = episode.frames()
    things = episode.record.objects if isinstance(episode, StoredEpisode) else ()
    _log_static(stream, source, episode, frames, things)
    with_depth = depth_cameras(episode) if isinstance(episode, StoredEpisode) else ()
    for k, frame in enumerate(frames):
        stream.set_time("frame", sequence=k)
        stream.set_time("time", duration=frame["timestamp"])
        for camera in source.camera_sizes:
            place = _log_camera(stream, source, camera, frame)
            picture = rerun.EncodedImage(contents=episode.image(camera, k), media_type="image/jpeg")
            stream.log(f"{place}/rgb", picture)
            if camera in with_depth:
                with np.load(
                    io.BytesIO(episode.read_verified(depth_path(camera, episode.first_frame + k))), allow_pickle=False
                ) as archive:
                    stream.log(f"{place}/depth", rerun.DepthImage(archive["depth"], meter=1000.0))
        for hand, T in _hand_poses(source, frame).items():
            stream.log(f"base/{hand}", _rerun_transform(T))
        for item in things:
            stream.log(f"base/{item}", _rerun_transform(frame[f"{item}_pose"]))
        _log_numbers(stream, source, frame)
    stream.disconnect()
    return len(frames)


def _log_camera(stream: Any, source: ExportSource, camera: str, frame: Mapping[str, Any]) -> str:
    """Log a camera. Return its rerun entity path: below `base` if K and pose are known, else below `cameras`."""
    import rerun

    if not all(camera in frame.get(key, ()) for key in ("intrinsics", "extrinsics")):
        return f"cameras/{camera}"
    place = f"base/{camera}"
    width, height = source.camera_sizes[camera]
    stream.log(place, _rerun_transform(frame["extrinsics"][camera]))
    pinhole = rerun.Pinhole(
        image_from_camera=frame["intrinsics"][camera],
        resolution=[width, height],
        image_plane_distance=_IMAGE_DISTANCE,
    )
    stream.log(place, pinhole)
    return place


def _log_static(
    stream: Any, source: ExportSource, episode: RecordedEpisode, frames: list[dict[str, Any]], things: Iterable[str]
) -> None:
    import rerun

    stream.log("base", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    axes = rerun.Arrows3D(vectors=np.eye(3) * _AXIS_LENGTH, colors=_AXIS_COLOURS)
    hands = [_hand_poses(source, frame) for frame in frames]
    for item in (*hands[0], *things):
        stream.log(f"base/{item}/axes", axes, static=True)
    for hand in hands[0]:
        path = np.array([each[hand][:3, 3] for each in hands])
        stream.log(f"base/{hand}_path", rerun.LineStrips3D([path], colors=[[90, 90, 90]], radii=0.001), static=True)
    if RIGHT_IN_LEFT_BASE_KEY in frames[0]:
        stream.log("base/right_base", _rerun_transform(frames[0][RIGHT_IN_LEFT_BASE_KEY]), static=True)
        stream.log("base/right_base/axes", axes, static=True)
    record, name = episode.record, f"{source.path.absolute().name}/{episode.directory.name}"
    lines = [name, str(frames[0].get("language_prompt", ""))]
    if isinstance(record, RealEpisodeRecord):
        lines += [f"real, from {record.imported.name}", *record.problems]
    else:
        lines += [f"seed {record.seed}, attempt {record.attempt}", f"success: {record.outcome.success}"]
    stream.log("episode", rerun.TextDocument("\n".join(lines)), static=True)


def _hand_poses(source: ExportSource, frame: Mapping[str, Any]) -> dict[str, Array]:
    """Return name -> pose (4, 4) of each hand; empty if poses were not recorded."""
    if "ee_pose" not in frame:
        return {}
    poses = np.reshape(frame["ee_pose"], (-1, 4, 4))
    return {f"{prefix}hand": T for prefix, T in zip(source.arm_prefixes, poses, strict=True)}


def _log_numbers(stream: Any, source: ExportSource, frame: Mapping[str, Any]) -> None:
    import rerun

    for key in ("joints", "ctrl"):
        for name, value in zip(source.drive_names, frame[key], strict=True) if key in frame else ():
            stream.log(f"{key}/{name}", rerun.Scalars(float(value)))
    if "magnet" in frame:
        for prefix, holds in zip(source.arm_prefixes, np.atleast_1d(frame["magnet"]), strict=True):
            stream.log(f"{prefix}weld", rerun.Scalars(float(holds)))


def _rerun_transform(T: Array) -> Any:
    import rerun

    return rerun.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])
