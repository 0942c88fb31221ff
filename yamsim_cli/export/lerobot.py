"""Export to LeRobotDataset v3.0, without torch. `lerobot_schema` defines the format."""

from __future__ import annotations

import contextlib
import json
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.extras import require_library

from ..core.closable import Closable
from ..core.dataset.environment_state import joints_key, make_state_row, object_pose_keys, state_names
from ..core.dataset.lowdim import ACTION, RIGHT_IN_LEFT_BASE_KEY, STATE
from ..core.dataset.reader import RecordedEpisode, StoredEpisode, read_side_by_side_images
from ..core.errors import DatasetError, UsageError
from ..core.images.video import BT601, VideoWriter, require_encoder
from ..core.progress import Progress
from ..recorded_settings import describe_recorded_settings
from . import lerobot_schema as schema
from .export_source import ActionSource, ExportSource, Frames, RealEpisode, RealSource, SimulatedSource
from .lerobot_schema import LeRobotFeature, SeriesFile, TableSeries, episode_table, frames_table, write_tasks
from .lerobot_stats import PixelCounts, RunningStats, Stats, column_stats
from .output_directory import ExportResult, export_directory

FeatureValues = dict[str, NDArray[Any]]  # feature -> values (frames, ...) of one episode

_DIFFERS_FROM_FIRST_TEXT = "unlike the first episode: export them separately with --episodes"


def export_lerobot(
    source: SimulatedSource | RealSource,
    out: Path,
    progress: Progress,
    *,
    pictures: bool = True,
    environment_state: bool = False,
    actions: ActionSource = "recorded",
    overwrite: bool = False,
) -> ExportResult:
    """Write a dataset as LeRobotDataset v3.0, without features that were not recorded.

    The time of frame k is exactly k frame periods.

    Args:
        environment_state: of a simulated dataset: also write object poses as `observation.environment_state`.
        actions: of real recordings: "recorded" for commands, "measured" for joints one frame later, "none" for no
            actions.

    Raises:
        UsageError: `environment_state` is given for a real recording, or `actions` for a simulated dataset.
    """
    if environment_state and isinstance(source, RealSource):
        raise UsageError(f"--environment-state: {source.path} is real, and the poses of its objects were not recorded")
    if actions != "recorded" and isinstance(source, SimulatedSource):
        raise UsageError(f"--actions: {source.path} is simulated, and has recorded actions only")
    content = (
        _RealContent(source, pictures, actions)
        if isinstance(source, RealSource)
        else _SimulatedContent(source, pictures, environment_state)
    )
    require_library("a LeRobot dataset", "pyarrow", "lerobot")
    if content.pictures and source.camera_sizes:
        require_encoder()
    with export_directory(out, overwrite=overwrite) as stage:
        with _LeRobotWriter(stage.path, source, content) as writer:
            for number, episode in enumerate(source.open_episodes()):
                writer.add_episode(episode)
                progress(number + 1, len(source))
        writer.write_meta()
    return ExportResult(out, len(source), writer.frames, stage.moved_aside, tuple(content.notes))


class _FeatureSource(ABC):
    """Supplies the features of an export, except images and those that every dataset of the format has.

    After the last episode, `about` has entries for the provenance file, and `notes` has lines for the user.
    """

    def __init__(self, pictures: bool, about: dict[str, Any]) -> None:
        self.pictures = pictures
        self.about = about
        self.notes: list[str] = []

    @abstractmethod
    def column_features(self) -> dict[str, LeRobotFeature]:
        """Return the features in the Parquet files."""

    @abstractmethod
    def feature_values(self, episode: Any, frames: Frames) -> FeatureValues:
        """Return the values of an episode by feature."""

    @abstractmethod
    def provenance_entry(self, episode: Any) -> dict[str, Any]:
        """Return the entry of an episode in the provenance file `meta/yamsim.json`."""


class _SimulatedContent(_FeatureSource):
    def __init__(self, source: SimulatedSource, pictures: bool, environment_state: bool) -> None:
        super().__init__(pictures, {"recorded": describe_recorded_settings(source.config)})
        self._source = source
        self._cameras = tuple(source.camera_sizes) if pictures else ()
        self._things = tuple(object_pose_keys(source.config)) if environment_state else ()

    def column_features(self) -> dict[str, LeRobotFeature]:
        source = self._source
        features = {
            schema.STATE_KEY: schema.row_feature(source.drive_names),
            schema.ACTION_KEY: schema.row_feature((*source.drive_names, *source.weld_names)),
        }
        if self._things:
            names = state_names(self._things, source.first.record.joints)
            features[schema.ENVIRONMENT_STATE_KEY] = schema.row_feature(names)
        return features | schema.matrix_features(self._cameras, self._cameras)

    def feature_values(self, episode: StoredEpisode, frames: Frames) -> FeatureValues:
        joints, first = episode.record.joints, self._source.first
        if self._things and joints != first.record.joints:
            raise DatasetError(
                f"{episode.directory} has objects with other joints than {first.directory.name} ({joints}, not "
                f"{first.record.joints}): export them separately with --episodes, or without --environment-state"
            )
        if RIGHT_IN_LEFT_BASE_KEY in frames[0]:
            self.about[RIGHT_IN_LEFT_BASE_KEY] = frames[0][RIGHT_IN_LEFT_BASE_KEY].tolist()
        states, actions = zip(*(_state_and_action(frame) for frame in frames), strict=True)
        values = {schema.STATE_KEY: np.array(states), schema.ACTION_KEY: np.array(actions)}
        if self._things:
            values[schema.ENVIRONMENT_STATE_KEY] = np.array(
                [
                    make_state_row(
                        [(frame[f"{thing}_pose"], frame.get(joints_key(thing), ())) for thing in self._things]
                    )
                    for frame in frames
                ]
            )
        return values | _flatten_matrices(self._cameras, self._cameras, frames)

    def provenance_entry(self, episode: StoredEpisode) -> dict[str, Any]:
        return {"seed": episode.record.seed, "attempt": episode.record.attempt}


class _RealContent(_FeatureSource):
    """Features of real recordings. Grippers are shares of their opening, as in public datasets of real stations."""

    def __init__(self, source: RealSource, pictures: bool, actions: ActionSource) -> None:
        super().__init__(pictures, {"source": "real", "actions": actions, "gripper": "share"})
        self._source, self._actions = source, actions
        frame = source.first.frames()[0]
        self._velocities = "joint_velocities" in frame
        self._intrinsics = tuple(frame.get("intrinsics", ())) if pictures else ()
        self._extrinsics = tuple(frame.get("extrinsics", ())) if pictures else ()

    def column_features(self) -> dict[str, LeRobotFeature]:
        source = self._source
        features = {schema.STATE_KEY: schema.row_feature(source.drive_names)}
        if self._actions != "none":
            features[schema.ACTION_KEY] = schema.row_feature(source.drive_names)
        features[schema.RECORDED_TIME_KEY] = LeRobotFeature("float64", (1,))
        if self._velocities:
            named = zip(source.arm_prefixes, source.rig.recording_order, strict=True)
            joints = [prefix + name for prefix, k in named for name in source.rig.arms[k].robot.joint_drives]
            features[schema.VELOCITIES_KEY] = schema.row_feature(joints)
        return features | schema.matrix_features(self._intrinsics, self._extrinsics)

    def feature_values(self, episode: RealEpisode, frames: Frames) -> FeatureValues:
        source, n = self._source, len(frames)
        values: FeatureValues = {
            schema.STATE_KEY: source.with_gripper_shares([frame["joints"] for frame in frames]).reshape(n, -1)
        }
        if self._actions != "none":
            values[schema.ACTION_KEY] = source.actions(episode, frames, self._actions).reshape(n, -1)
        values[schema.RECORDED_TIME_KEY] = np.array([frame["timestamp"] for frame in frames])
        if self._velocities:
            values[schema.VELOCITIES_KEY] = np.reshape(_column_values(episode, frames, "joint_velocities"), (n, -1))
        for key, cameras in (("intrinsics", self._intrinsics), ("extrinsics", self._extrinsics)):
            for camera in cameras:
                if not all(camera in matrices for matrices in _column_values(episode, frames, key)):
                    raise DatasetError(f"{episode.directory} has no {key} of {camera}, {_DIFFERS_FROM_FIRST_TEXT}")
        values |= _flatten_matrices(self._intrinsics, self._extrinsics, frames)
        if (note := source.describe_uneven_times(episode, frames)) is not None:
            self.notes.append(f"{note}, and {schema.RECORDED_TIME_KEY} the recorded times")
        return values

    def provenance_entry(self, episode: RealEpisode) -> dict[str, Any]:
        return {"imported": episode.record.imported.model_dump()}


def _state_and_action(frame: Mapping[str, Any]) -> tuple[Any, Any]:
    if ACTION in frame:
        return frame[STATE], frame[ACTION]
    return frame["joints"], np.append(frame["ctrl"], np.asarray(frame["magnet"], np.float32))


def _flatten_matrices(intrinsics: Iterable[str], extrinsics: Iterable[str], frames: Frames) -> FeatureValues:
    """Return feature -> camera matrices of all frames, flattened in row-major order."""
    found = {
        schema.intrinsics_key(camera): np.array([np.ravel(frame["intrinsics"][camera]) for frame in frames])
        for camera in intrinsics
    }
    return found | {
        schema.extrinsics_key(camera): np.array([np.ravel(frame["extrinsics"][camera]) for frame in frames])
        for camera in extrinsics
    }


def _column_values(episode: RecordedEpisode, frames: Frames, key: str) -> list[Any]:
    if not all(key in frame for frame in frames):
        raise DatasetError(f"{episode.directory} has no {key}, {_DIFFERS_FROM_FIRST_TEXT}")
    return [frame[key] for frame in frames]


def _write_video(path: Path, episode: RecordedEpisode, camera: str, period: float) -> tuple[float, Stats]:
    """Write the images of one episode and camera to a file. Return its duration (s) and the statistics.

    With one file per episode, lerobot's tools delete and split episodes by copying. They encode a shared file again at
    an integer frame rate (seen in 0.6.1), which shifts all frames in time.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    counts = PixelCounts()
    # lerobot's decoder uses a PyAV older than 17, which ignores the tag for the colour matrix and assumes BT.601.
    with VideoWriter(path, period, key_frame_interval=schema.KEY_FRAME_INTERVAL, matrix=BT601) as video:
        for image in read_side_by_side_images(episode, (camera,)):
            video.write(image)
            counts.add(image)
    return video.frame_count * period, counts.stats()


class _LeRobotWriter(Closable):
    def __init__(self, root: Path, source: ExportSource, content: _FeatureSource) -> None:
        self.frames = 0
        self._root, self._source, self._content = root, source, content
        self._cameras = source.camera_sizes if content.pictures else {}
        self._columns = content.column_features() | dict(schema.INDEX_FEATURES)
        self._tasks: dict[str, int] = {}
        self._total = RunningStats()
        self._provenance: list[dict[str, Any]] = []
        self._open = contextlib.ExitStack()
        self._data = self._open.enter_context(TableSeries(root, schema.DATA_FILE_PATTERN, schema.DATA_FILE_MB))
        self._episodes = self._open.enter_context(TableSeries(root, schema.EPISODES_FILE_PATTERN, schema.DATA_FILE_MB))
        # Threads run in parallel, since decoding and encoding release the GIL.
        self._threads = self._open.enter_context(ThreadPoolExecutor(max(1, len(self._cameras))))

    def close(self) -> None:
        self._open.close()

    def add_episode(self, episode: RecordedEpisode) -> None:
        number, period = len(self._provenance), self._source.frame_period
        video_place, encoding = SeriesFile(number), {}
        for camera in self._cameras:
            path = self._root / video_place.path(schema.VIDEO_FILE_PATTERN, video_key=schema.image_key(camera))
            encoding[camera] = self._threads.submit(_write_video, path, episode, camera, period)
        frames = episode.frames()
        task = frames[0].get("language_prompt", "")
        values = self._content.feature_values(episode, frames)
        values |= self._index_values(len(frames), number, self._tasks.setdefault(task, len(self._tasks)))
        videos = {schema.image_key(camera): video.result() for camera, video in encoding.items()}
        stats = {key: found for key, (_, found) in videos.items()}
        stats |= {key: column_stats(value) for key, value in values.items()}
        place, rows_place = self._data.file_for_next_table(), self._episodes.file_for_next_table()
        row: dict[str, Any] = {
            "episode_index": number,
            "tasks": [task],
            "length": len(frames),
            "data/chunk_index": place.chunk_number,
            "data/file_index": place.number_in_chunk,
            "dataset_from_index": self.frames,
            "dataset_to_index": self.frames + len(frames),
            "meta/episodes/chunk_index": rows_place.chunk_number,
            "meta/episodes/file_index": rows_place.number_in_chunk,
        }
        for key, (end, _) in videos.items():
            row |= {
                f"videos/{key}/chunk_index": video_place.chunk_number,
                f"videos/{key}/file_index": video_place.number_in_chunk,
            }
            row |= {f"videos/{key}/from_timestamp": 0.0, f"videos/{key}/to_timestamp": end}
        row |= {
            f"stats/{key}/{name}": value for key, found in stats.items() for name, value in _plain_stats(found).items()
        }
        self._data.write(frames_table(self._columns, values))
        self._episodes.write(episode_table(row))
        self._total.add(stats)
        self.frames += len(frames)
        origin = {"episode": episode.directory.name, **self._content.provenance_entry(episode)}
        self._provenance.append({"episode_index": number} | origin)

    def _index_values(self, frames: int, number: int, task: int) -> FeatureValues:
        return {
            "timestamp": np.arange(frames) * self._source.frame_period,
            "frame_index": np.arange(frames),
            "episode_index": np.full(frames, number),
            "index": np.arange(self.frames, self.frames + frames),
            "task_index": np.full(frames, task),
        }

    def write_meta(self) -> None:
        """Write the files that describe the whole dataset, after all episodes are added."""
        source = self._source
        write_tasks(self._root, list(self._tasks))
        # Width and height of a video are even.
        sizes = {camera: (w + w % 2, h + h % 2) for camera, (w, h) in self._cameras.items()}
        counts = {"episodes": len(self._provenance), "frames": self.frames, "tasks": len(self._tasks)}
        robots = [source.rig.arms[k].model.name for k in source.rig.recording_order]
        stats = self._total.stats().items()
        contents: dict[str, dict[str, Any]] = {
            schema.INFO_FILE: schema.info_json(
                sizes, round(1 / source.frame_period, 6), robots, self._columns, **counts
            ),
            schema.STATS_FILE: {
                key: {name: value.tolist() for name, value in _plain_stats(found).items()} for key, found in stats
            },
            schema.PROVENANCE_FILE: {
                "dataset": source.path.absolute().name,
                **self._content.about,
                **({"selection": source.selection.report()} if source.selection else {}),
                "episodes": self._provenance,
            },
        }
        for name, content in contents.items():
            text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False)
            (self._root / name).write_text(text + "\n", encoding="utf-8")


def _plain_stats(stats: Stats) -> dict[str, NDArray[Any]]:
    return {name: value.astype(np.int64) if name == "count" else value for name, value in stats.items()}
