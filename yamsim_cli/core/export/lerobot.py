"""Export to LeRobotDataset v3.0, episode by episode and without torch; see `lerobot_schema`."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..dataset.reader import RecordedEpisode, recorded_images
from ..images.video import BT601, VideoWriter, require_encoder
from ..progress import Progress
from . import lerobot_schema as schema
from .lerobot_content import Content, RealContent, SimulatedContent
from .lerobot_options import RECORDED, WHOLE, LeRobotOptions, RealOptions
from .lerobot_schema import Place
from .lerobot_stats import PixelCounts, RunningStats, Stats, column_stats
from .lerobot_tables import TableSeries, episode_table, frames_table, require_parquet, write_tasks
from .real_source import RealSource
from .source import AnySource, Exported, Source
from .target import export_directory


def export_lerobot(
    source: Source,
    out: Path,
    progress: Progress,
    options: LeRobotOptions = WHOLE,
    *,
    overwrite: bool = False,
) -> Exported:
    """Write a dataset as LeRobotDataset v3.0: Parquet for numbers, H.264 for images, frame k at exactly k periods.

    Raises:
        DatasetError: a file is missing, altered or damaged, or episodes have things with other joints.
        ResourceError: pyarrow or PyAV is not installed.
        UsageError, PartialJobError, InterruptedJobError: see `export_directory`.
    """
    return _export(source, out, progress, SimulatedContent(source, options), overwrite)


def export_real_lerobot(
    source: RealSource,
    out: Path,
    progress: Progress,
    options: RealOptions = RECORDED,
    *,
    overwrite: bool = False,
) -> Exported:
    """Write real recordings as LeRobotDataset v3.0; what nobody recorded is not there.

    Raises:
        DatasetError: a file is missing, altered or damaged; nobody recorded the commands that are asked for; or other
            things were recorded of one episode than of the first.
        ResourceError: pyarrow or PyAV is not installed.
        UsageError, PartialJobError, InterruptedJobError: see `export_directory`.
    """
    return _export(source, out, progress, RealContent(source, options), overwrite)


def _export(source: AnySource, out: Path, progress: Progress, content: Content, overwrite: bool) -> Exported:
    require_parquet()
    if content.pictures and source.cameras:
        require_encoder()
    with export_directory(out, overwrite=overwrite) as stage:
        with _Writer(stage.path, source, content) as writer:
            for number, episode in enumerate(source.episodes()):
                writer.add(episode)
                progress(number + 1, len(source))
        writer.write_meta()
    return Exported(out, len(source), writer.frames, stage.moved_aside, tuple(content.notes))


@dataclass(frozen=True)
class _Filmed:
    """An episode's video of one camera: its place, its length (s), and its images' statistics."""

    place: Place
    end: float
    stats: Stats


def _film(root: Path, episode: RecordedEpisode, place: Place, camera: str, period: float) -> _Filmed:
    """The video of an episode's images of one camera, in a file of its own.

    lerobot's tools delete and split such episodes by copying files. Where several episodes share a file, the tools
    encode it anew at a whole number of frames a second (seen in 0.6.1), so that no frame is at its time any more.
    """
    path = root / place.path(schema.VIDEO, video_key=schema.image_key(camera))
    path.parent.mkdir(parents=True, exist_ok=True)
    counts = PixelCounts()
    # lerobot's decoder, which uses a PyAV older than 17, ignores the tag for the colours' encoding and assumes BT.601.
    with VideoWriter(path, period, key_frame_interval=schema.KEY_FRAME_INTERVAL, matrix=BT601) as video:
        for image in recorded_images(episode, (camera,)):
            video.write(image)
            counts.add(image)
    return _Filmed(place, video.frames * period, counts.stats())


class _Writer:
    """Writes a dataset's episodes into a directory; leaving it closes all files.

    Attributes:
        frames: how many were written.
    """

    def __init__(self, root: Path, source: AnySource, content: Content) -> None:
        self.frames = 0
        self._root, self._source, self._content = root, source, content
        self._cameras = source.cameras if content.pictures else {}
        self._columns = content.columns() | dict(schema.INDEX_FEATURES)
        self._tasks: dict[str, int] = {}
        self._total = RunningStats()
        self._provenance: list[dict[str, Any]] = []
        self._open = contextlib.ExitStack()

    def __enter__(self) -> _Writer:
        root = self._root
        self._data = self._open.enter_context(TableSeries(root, schema.DATA, schema.DATA_FILE_MB))
        self._episodes = self._open.enter_context(TableSeries(root, schema.EPISODES, schema.DATA_FILE_MB))
        # Decoding and encoding leave the interpreter free, so cameras are done in parallel.
        self._threads = self._open.enter_context(ThreadPoolExecutor(max(1, len(self._cameras))))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.__exit__(kind, error, trace)

    def add(self, episode: RecordedEpisode) -> None:
        """Write one episode.

        Raises:
            DatasetError: it holds other things than the first one.
        """
        number, period = len(self._provenance), self._source.frame_period
        filming = {
            camera: self._threads.submit(_film, self._root, episode, Place(number), camera, period)
            for camera in self._cameras
        }
        frames = episode.frames()
        task = frames[0].get("language_prompt", "")
        values = self._content.values(episode, frames)
        values |= self._places(len(frames), number, self._tasks.setdefault(task, len(self._tasks)))
        filmed = {camera: film.result() for camera, film in filming.items()}
        stats = {schema.image_key(camera): film.stats for camera, film in filmed.items()}
        stats |= {key: column_stats(value) for key, value in values.items()}
        place, rows_place = self._data.next_place(), self._episodes.next_place()
        row: dict[str, Any] = {
            "episode_index": number,
            "tasks": [task],
            "length": len(frames),
            "data/chunk_index": place.chunk,
            "data/file_index": place.file,
            "dataset_from_index": self.frames,
            "dataset_to_index": self.frames + len(frames),
            "meta/episodes/chunk_index": rows_place.chunk,
            "meta/episodes/file_index": rows_place.file,
        }
        for camera, film in filmed.items():
            prefix = f"videos/{schema.image_key(camera)}"
            row |= {f"{prefix}/chunk_index": film.place.chunk, f"{prefix}/file_index": film.place.file}
            row |= {f"{prefix}/from_timestamp": 0.0, f"{prefix}/to_timestamp": film.end}
        row |= {f"stats/{key}/{name}": value for key, found in stats.items() for name, value in _whole(found).items()}
        self._data.write(frames_table(self._columns, values))
        self._episodes.write(episode_table(row))
        self._total.add(stats)
        self.frames += len(frames)
        origin = {"episode": episode.directory.name, **self._content.origin(episode)}
        self._provenance.append({"episode_index": number} | origin)

    def _places(self, frames: int, number: int, task: int) -> dict[str, NDArray[Any]]:
        """Where an episode's frames are, in time and among all."""
        return {
            "timestamp": np.arange(frames) * self._source.frame_period,
            "frame_index": np.arange(frames),
            "episode_index": np.full(frames, number),
            "index": np.arange(self.frames, self.frames + frames),
            "task_index": np.full(frames, task),
        }

    def write_meta(self) -> None:
        """Write the files that describe the whole dataset, after all episodes."""
        source, root = self._source, self._root
        write_tasks(root, list(self._tasks))
        # A video's width and height are even.
        sizes = {camera: (w + w % 2, h + h % 2) for camera, (w, h) in self._cameras.items()}
        counts = {"episodes": len(self._provenance), "frames": self.frames, "tasks": len(self._tasks)}
        robots = [source.rig.arms[k].model.name for k in source.rig.recorded]
        _write_json(
            root / schema.INFO, schema.info(sizes, round(1 / source.frame_period, 6), robots, self._columns, **counts)
        )
        stats = {
            key: {name: value.tolist() for name, value in _whole(found).items()}
            for key, found in self._total.stats().items()
        }
        _write_json(root / schema.STATS, stats)
        _write_json(
            root / schema.PROVENANCE,
            {"dataset": source.path.absolute().name, **self._content.about(), "episodes": self._provenance},
        )


def _whole(stats: Stats) -> dict[str, NDArray[Any]]:
    """Statistics with their count as a whole number."""
    return {name: value.astype(np.int64) if name == "count" else value for name, value in stats.items()}


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")
