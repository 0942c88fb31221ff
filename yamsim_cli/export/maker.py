"""Export to the episodes of the maker's station program: arrays and an MP4 per camera in a folder per episode.

Source: i2rt-robotics/yam-abc-reproduce 7d9f9d1, `yam_abc_reproduce/data/schema.py`, `recorder.py`, `default_format.py`.
"""

from __future__ import annotations

import functools
import json
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli import __version__

from ..core.dataset.reader import RecordedEpisode, StoredEpisode, read_side_by_side_images
from ..core.images.video import BT601, VideoWriter, require_encoder
from ..core.progress import Progress
from .export_source import ActionSource, ExportSource, Frames, RealSource
from .output_directory import ExportResult, export_directory
from .station_episode import (
    StationEpisode,
    StationEpisodeWriter,
    StationReader,
    camera_roles,
    task_folder,
    write_station_episodes,
)

_SCHEMA_VERSION = 1
_COMPLETE_FLAG = "write_complete.flag"  # written last; the maker's programs ignore an episode without it
_METADATA = "metadata.json"
_MS_PER_S = 1000.0  # times of frames are in ms
# Datasets have no date. Counting seconds from here, the maker's list, newest first, has the episodes in reverse order.
_CREATED = datetime(1970, 1, 1)


def export_maker(
    source: ExportSource,
    out: Path,
    progress: Progress,
    *,
    actions: ActionSource = "recorded",
    top: str | None = None,
    workers: int = 1,
    overwrite: bool = False,
) -> ExportResult:
    """Write the episodes that the maker's station program would have recorded, as `<task>/ep_<number>/`.

    Args:
        actions: for real recordings: "recorded" for commands, or "measured" for joints one frame later.
        top: camera with the role `top`; None for the only camera that is not on a wrist.
        workers: processes that encode; 1 is this process.
    """
    reader = StationReader(source, camera_roles(source, top), actions)
    if reader.roles:
        require_encoder()
    frames, notes = 0, _rate_notes(source)
    with export_directory(out, overwrite=overwrite) as stage:
        factory = functools.partial(_MakerEpisodeWriter, reader, stage.path)
        for count, note in write_station_episodes(factory, source, workers, progress):
            frames += count
            notes += [] if note is None else [note]
    return ExportResult(out, len(source), frames, stage.moved_aside, tuple(notes))


def _rate_notes(source: ExportSource) -> list[str]:
    rate = 1 / source.frame_period
    if abs(rate - round(rate)) < 1e-3:
        return []
    remedy = "--fps gives evenly spaced frames" if isinstance(source, RealSource) else "`record --fps 30` records 30"
    return [f"the dataset has {rate:g} frames a second, which the maker's converters round to {round(rate)}; {remedy}"]


class _MakerEpisodeWriter(StationEpisodeWriter):
    def _write(self, episode: RecordedEpisode, number: int, values: StationEpisode) -> None:
        folder = self._root / task_folder(values.prompt) / episode.directory.name
        folder.mkdir(parents=True)
        self._write_arrays(folder, values)
        for camera, role in self._reader.roles.items():
            # The maker's converters decode by PyAV, which assumes BT.601.
            path = folder / f"{role}-images-rgb.mp4"
            with VideoWriter(path, self._reader.source.frame_period, matrix=BT601) as video:
                for image in read_side_by_side_images(episode, (camera,)):
                    video.write(image)
        text = json.dumps(self._metadata(episode, number, values), indent=2, allow_nan=False, ensure_ascii=False)
        (folder / _METADATA).write_text(text + "\n", encoding="utf-8")
        (folder / _COMPLETE_FLAG).touch()

    def _note(self, episode: RecordedEpisode, frames: Frames) -> str | None:
        source = self._reader.source
        return source.describe_uneven_times(episode, frames) if isinstance(source, RealSource) else None

    def _write_arrays(self, folder: Path, values: StationEpisode) -> None:
        for k, arm in enumerate(self._reader.sides):
            measured, commanded = values.measured[:, k], values.commanded[:, k]
            np.save(folder / f"{arm}-joint_pos.npy", measured[:, :-1])
            np.save(folder / f"{arm}-gripper_pos.npy", measured[:, -1:])
            np.save(folder / f"action-{arm}-joint.npy", commanded[:, :-1])
            np.save(folder / f"action-{arm}-gripper.npy", commanded[:, -1:])
        for role in self._reader.roles.values():
            np.save(folder / f"{role}-timestamp.npy", values.times * _MS_PER_S)

    def _metadata(self, episode: RecordedEpisode, number: int, values: StationEpisode) -> dict[str, Any]:
        rate = 1 / self._reader.source.frame_period
        is_simulated = isinstance(episode, StoredEpisode)
        origin: dict[str, Any] = {
            "dataset": episode.dataset_directory.name,
            "episode": episode.directory.name,
            "source": "simulated" if is_simulated else "real",
        }
        if isinstance(episode, StoredEpisode):
            origin |= {"seed": episode.record.seed, "attempt": episode.record.attempt}
        cameras = [
            {
                "name": role,
                "type": "simulated" if is_simulated else "unknown",
                "role": role,
                "mode": "mono",
                "image_keys": ["rgb"],
                # Width and height of a video are even.
                "width": width + width % 2,
                "height": height + height % 2,
                "fps": round(rate),
                "depth_scale": None,
            }
            for role, (width, height) in (
                (role, episode.record.cameras[camera]) for camera, role in self._reader.roles.items()
            )
        ]
        return {
            "yam_abc_reproduce_version": f"yamsim {__version__}",
            "schema_version": _SCHEMA_VERSION,
            "created_at": (_CREATED + timedelta(seconds=number)).isoformat(),
            "task_name": values.prompt,
            "arm_names": list(self._reader.sides),
            "num_arm_joints": self._reader.joints,
            "control_hz": round(rate, 6),
            "cameras": cameras,
            "num_frames": len(values.times),
            "git_commit": None,
            "extra": {"yamsim": origin},
        }
