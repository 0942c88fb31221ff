"""Export to the two layouts of ABC: its release of one MCAP file per episode, and the one that its trainer reads.

Source: amazon-far/abc e5e1fbc, `export_mcap.py`, `abc_minimal/train_loop.py`.
"""

from __future__ import annotations

import functools
import json
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.extras import require_library

from ..core.dataset.reader import RecordedEpisode, read_side_by_side_images
from ..core.errors import DatasetError, UsageError
from ..core.geometry.se3 import Array
from ..core.images.image import Image
from ..core.images.resize import resize_image
from ..core.images.video import BT601, VideoWriter, encode_packets, require_encoder
from ..core.progress import Progress
from .abc_messages import (
    COMPRESSED_VIDEO,
    GRIPPER_STATE,
    INSTRUCTIONS,
    ROBOT_STATE,
    message_classes,
    stamped_message,
)
from .export_source import ActionSource, ExportSource
from .output_directory import ExportResult, export_directory
from .station_episode import (
    SIDES,
    TOP,
    StationEpisode,
    StationEpisodeWriter,
    StationReader,
    camera_roles,
    task_folder,
    write_station_episodes,
)

AbcLayout = Literal["release", "training"]

JOINTS = 6  # joints per arm in both layouts
TICK_NS = 33_333_333  # ns between rows of the training layout, which rounds 1/30 s down
_FPS = 30  # rows and video frames per second of the training layout
PICTURE_SIZE = (224, 224)  # px, of each camera's square in the training layout's video
_GOP = 30  # frames between key frames, where the trainer expects them
_CAMERAS = (TOP, *SIDES)  # in the order of the video, from the top
_ARM_WIDTH = JOINTS + 1

# Role -> topic and `frame_id`.
_TOPICS = {
    "top": ("/top-camera", "top_camera-images-rgb"),
    "left": ("/left-wrist-camera", "left_camera-images-rgb"),
    "right": ("/right-wrist-camera", "right_camera-images-rgb"),
}
_SAME_PERIOD = 1e-6  # relative difference from 1/30 s, below which frames are exactly TICK_NS apart
_ROUNDING_NS = 1e-3  # ns; without it, rounding could lower a whole number
_SAME_TIME_S = 1e-6  # s, deviation from even times, below which times are even


def export_abc(
    source: ExportSource,
    out: Path,
    progress: Progress,
    *,
    layout: AbcLayout = "release",
    actions: ActionSource = "recorded",
    top: str | None = None,
    workers: int = 1,
    overwrite: bool = False,
) -> ExportResult:
    """Write a dataset as ABC's: `release` with `<task>/episode_<uuid>/episode.mcap`, or `training`.

    A single arm is the left one. The training layout has a row every 1/30 s, with the last frame before it.

    Args:
        actions: for real recordings: "recorded" for commands, or "measured" for joints one frame later.
        top: camera above the arms; None for the only camera that is not on a wrist.
        workers: processes that encode; 1 is this process.
    """
    reader = StationReader(source, camera_roles(source, top, single_wrist="left"), actions)
    if reader.joints != JOINTS:
        raise UsageError(
            f"ABC's layouts are for arms with {JOINTS} joints, and rig {source.rig.name!r} has arms with "
            f"{reader.joints}: export it as lerobot"
        )
    if TOP not in reader.roles.values():
        raise DatasetError(
            f"{source.path} has no camera above the arms, which ABC's layouts need; its cameras are "
            f"{', '.join(source.camera_sizes) or 'none'}: name one with --top"
        )
    require_encoder()
    if layout == "release":
        require_library("an MCAP file", "mcap_protobuf", "mcap")
    frames = 0
    with export_directory(out, overwrite=overwrite) as stage:
        writer = ReleaseWriter if layout == "release" else TrainingWriter
        factory = functools.partial(writer, reader, stage.path)
        for count, _ in write_station_episodes(factory, source, workers, progress):
            frames += count
    return ExportResult(out, len(source), frames, stage.moved_aside, _missing_notes(reader))


def _missing_notes(reader: StationReader) -> tuple[str, ...]:
    missing = [f"a {role} camera" for role in _CAMERAS if role not in reader.roles.values()]
    missing += ["a right arm"] if len(reader.sides) == 1 else []
    return (f"ABC's own models need {', '.join(missing)}, which the dataset does not have",) if missing else ()


def frame_stamps(times: Array) -> NDArray[np.int64]:
    """Return the times (n,), s, in ns from one row of the training layout on.

    Frames at 30 a second are exactly `TICK_NS` apart, so that each falls on one row.
    """
    since = times - times[0]
    period = since[-1] / max(len(since) - 1, 1)
    if np.abs(since - period * np.arange(len(since))).max() > _SAME_TIME_S:
        return np.asarray(TICK_NS + np.round(since * 1e9), np.int64)
    step = TICK_NS if abs(period * _FPS - 1) < _SAME_PERIOD else int(period * 1e9 + _ROUNDING_NS)
    return TICK_NS + step * np.arange(len(since), dtype=np.int64)


def latest_frames(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the last frame at or before each row of the training layout, for frames at `stamps` (n,), ns."""
    ticks = np.arange(stamps[0], stamps[-1] + 1, TICK_NS, dtype=np.int64)
    latest: NDArray[np.int64] = np.searchsorted(stamps, ticks, side="right").astype(np.int64) - 1
    return latest


def episode_uuid(episode: RecordedEpisode) -> str:
    """Return the UUID of an episode, a function of its name and content."""
    return str(uuid.uuid5(uuid.NAMESPACE_OID, f"{episode.directory.name} {episode.record.content_sha256}"))


class ReleaseWriter(StationEpisodeWriter):
    """Writes `<task>/episode_<uuid>/episode.mcap` with joints, grippers, the instruction and H.264 of each camera."""

    def _write(self, episode: RecordedEpisode, number: int, values: StationEpisode) -> None:
        from mcap.writer import Writer
        from mcap_protobuf.schema import register_schema

        name = episode_uuid(episode)
        folder = self._root / task_folder(values.prompt) / f"episode_{name}"
        folder.mkdir(parents=True)
        films = {
            role: encode_packets(read_side_by_side_images(episode, (camera,)), self._reader.source.frame_period)
            for camera, role in self._reader.roles.items()
        }
        with (folder / "episode.mcap").open("wb") as file:
            writer: Any = Writer(file)
            writer.start()
            writer.add_metadata("session-metadata", {"session-uuid": name})
            schemas = {kind: register_schema(writer, made) for kind, made in message_classes().items()}
            channels: dict[str, int] = {}
            for topic, kind, stamp, fields in self._messages(values, films):
                if topic not in channels:
                    channels[topic] = writer.register_channel(topic, "protobuf", schemas[kind])
                data = stamped_message(kind, stamp, **fields).SerializeToString()
                writer.add_message(channels[topic], log_time=stamp, data=data, publish_time=stamp)
            writer.finish()

    def _messages(
        self, values: StationEpisode, films: dict[str, list[bytes]]
    ) -> Iterator[tuple[str, str, int, dict[str, Any]]]:
        """Yield topic, message name, time (ns) and fields, in order of time."""
        stamps = frame_stamps(values.times).tolist()
        yield "/instruction", INSTRUCTIONS, stamps[0], {"data": values.prompt}
        for k, stamp in enumerate(stamps):
            for arm, side in enumerate(self._reader.sides):
                for what, rows in (("state", values.measured), ("action", values.commanded)):
                    row = rows[k, arm].tolist()
                    yield f"/{side}-arm-{what}", ROBOT_STATE, stamp, {"position": row[:JOINTS]}
                    yield f"/{side}-ee-{what}", GRIPPER_STATE, stamp, {"position": row[JOINTS:]}
            for role, packets in films.items():
                topic, frame_id = _TOPICS.get(role, (f"/{role}-camera", f"{role}_camera-images-rgb"))
                fields = {"frame_id": frame_id, "data": packets[k], "format": "h264"}
                yield topic, COMPRESSED_VIDEO, stamp, fields


class TrainingWriter(StationEpisodeWriter):
    """Writes `episode_<uuid>/` with the rows, the video and the metadata that ABC's trainer reads."""

    def _write(self, episode: RecordedEpisode, number: int, values: StationEpisode) -> None:
        folder = self._root / f"episode_{episode_uuid(episode)}"
        folder.mkdir(parents=True)
        chosen = latest_frames(frame_stamps(values.times))
        rows = np.hstack([self._arm_columns(rows) for rows in (values.measured, values.commanded)])
        rows[chosen].astype(np.float64).tofile(folder / "states_actions.bin")
        cameras = {role: camera for camera, role in self._reader.roles.items()}
        shown = [role for role in _CAMERAS if role in cameras]
        # ABC's loader makes the times of frames and the key frames up, so the encoder may add no key frame.
        path = folder / "combined_camera-images-rgb.mp4"
        with VideoWriter(path, 1 / _FPS, key_frame_interval=_GOP, matrix=BT601, scene_cuts=False) as video:
            for image in _repeated(self._stacked_images(episode, [cameras[role] for role in shown]), chosen.tolist()):
                video.write(image)
        metadata = {
            "task_name": task_folder(values.prompt),
            "cameras": shown,
            "camera_resolutions": {role: list(PICTURE_SIZE) for role in shown},
            "alignment": "fixed_clock_30hz_causal",
            "t0_ns": 0,
            "tick_ns": TICK_NS,
            "num_steps": len(chosen),
            "yamsim": {"dataset": episode.dataset_directory.name, "episode": episode.directory.name},
        }
        text = json.dumps(metadata, indent=2, allow_nan=False, ensure_ascii=False)
        (folder / "episode_metadata.json").write_text(text + "\n", encoding="utf-8")

    def _arm_columns(self, rows: Array) -> Array:
        columns = np.zeros((len(rows), len(SIDES) * _ARM_WIDTH))
        flat = rows.reshape(len(rows), -1)
        columns[:, : flat.shape[1]] = flat
        return columns

    def _stacked_images(self, episode: RecordedEpisode, cameras: Sequence[str]) -> Iterator[Image]:
        for images in zip(*(read_side_by_side_images(episode, (camera,)) for camera in cameras), strict=True):
            yield np.concatenate([resize_image(image, PICTURE_SIZE, pad=True) for image in images])


def _repeated(images: Iterator[Image], chosen: Sequence[int]) -> Iterator[Image]:
    number, image = 0, next(images)
    for wanted in chosen:
        while number < wanted:
            number, image = number + 1, next(images)
        yield image
