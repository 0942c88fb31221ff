"""Export for the rerun viewer: a `.rrd` an episode, with images, joints, poses and camera frusta. Alone knows rerun."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...dataset.layout import depth_name
from ...dataset.reader import StoredEpisode
from ...errors import ResourceError
from ...geometry.se3 import Array
from ...scene.robot import JOINTS
from ..episode import require_one_arm
from .source import Exported, Progress, Source, depth_cameras
from .target import export_directory

# How far in front of a camera its picture is shown, and how long the axes of a pose are, m.
_PICTURE_DISTANCE = 0.15
_AXIS = 0.05
_AXIS_COLOURS = ((220, 50, 50), (50, 160, 50), (50, 80, 220))


def export_rerun(source: Source, out: Path, progress: Progress, *, overwrite: bool = False) -> Exported:
    """Write `ep_NNNNNN.rrd` files into a directory; everything is in the robot's base frame.

    Raises:
        ConfigError: the rig has more than one arm.
        DatasetError: a file is missing, altered or damaged.
        ResourceError: rerun is not installed.
        UsageError, PartialJobError, InterruptedJobError: see `export_directory`.
    """
    require_one_arm(source.config)
    _require_rerun()
    frames = 0
    with export_directory(out, overwrite=overwrite) as stage:
        for number, episode in enumerate(source.episodes()):
            frames += _write(stage.path / f"{episode.directory.name}.rrd", source, episode)
            progress(number + 1, len(source))
    return Exported(out, len(source), frames, stage.moved_aside)


def _require_rerun() -> None:
    try:
        import rerun  # noqa: F401
    except ModuleNotFoundError as error:
        if error.name != "rerun":
            raise
        raise ResourceError("an .rrd file needs rerun, which is not here: pip install 'yamsim[rerun]'") from error


def _write(path: Path, source: Source, episode: StoredEpisode) -> int:
    import rerun

    name = f"{source.path.absolute().name}/{episode.directory.name}"
    # Without properties: they hold the time of day.
    stream = rerun.RecordingStream("yamsim", recording_id=name, send_properties=False)
    stream.save(path)
    frames = episode.frames()
    _log_static(stream, source, episode, frames)
    with_depth = depth_cameras(episode)
    for k, frame in enumerate(frames):
        stream.set_time("frame", sequence=k)
        stream.set_time("time", duration=frame["timestamp"])
        for camera in source.cameras:
            place = f"base/{camera}"
            width, height = source.cameras[camera]
            stream.log(place, _transform(frame["extrinsics"][camera]))
            pinhole = rerun.Pinhole(
                image_from_camera=frame["intrinsics"][camera],
                resolution=[width, height],
                image_plane_distance=_PICTURE_DISTANCE,
            )
            stream.log(place, pinhole)
            picture = rerun.EncodedImage(contents=episode.image(camera, k), media_type="image/jpeg")
            stream.log(f"{place}/rgb", picture)
            if camera in with_depth:
                with np.load(io.BytesIO(episode.whole(depth_name(camera, k))), allow_pickle=False) as archive:
                    stream.log(f"{place}/depth", rerun.DepthImage(archive["depth"], meter=1000.0))
        stream.log("base/hand", _transform(frame["ee_pose"]))
        for item in episode.record.objects:
            stream.log(f"base/{item}", _transform(frame[f"{item}_pose"]))
        _log_numbers(stream, frame)
    stream.disconnect()
    return len(frames)


def _log_static(stream: Any, source: Source, episode: StoredEpisode, frames: list[dict[str, Any]]) -> None:
    import rerun

    stream.log("base", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    axes = rerun.Arrows3D(vectors=np.eye(3) * _AXIS, colors=_AXIS_COLOURS)
    for item in ("hand", *episode.record.objects):
        stream.log(f"base/{item}/axes", axes, static=True)
    path = np.array([frame["ee_pose"][:3, 3] for frame in frames])
    stream.log("base/hand_path", rerun.LineStrips3D([path], colors=[[90, 90, 90]], radii=0.001), static=True)
    record = episode.record
    lines = [
        f"{source.path.absolute().name}/{episode.directory.name}",
        str(frames[0]["language_prompt"]),
        f"seed {record.seed}, attempt {record.attempt}",
        f"success: {record.outcome.success}",
    ]
    stream.log("episode", rerun.TextDocument("\n".join(lines)), static=True)


def _log_numbers(stream: Any, frame: Mapping[str, Any]) -> None:
    import rerun

    for key in ("joints", "ctrl"):
        for name, value in zip((*JOINTS, "gripper"), frame[key], strict=True):
            stream.log(f"{key}/{name}", rerun.Scalars(float(value)))
    stream.log("weld", rerun.Scalars(float(frame["magnet"])))


def _transform(T: Array) -> Any:
    import rerun

    return rerun.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])
