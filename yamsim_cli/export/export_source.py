"""Source dataset of an export, read episode by episode: simulated, or recorded by real arms."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..core.config.real_recordings import RealConfig
from ..core.config.recording import RecordConfig
from ..core.config.rig import RigConfig
from ..core.dataset.dataset_paths import depth_path, image_path, lowdim_path
from ..core.dataset.imported_records import RealEpisodeRecord, read_imported_config
from ..core.dataset.reader import (
    RecordedEpisode,
    StoredEpisode,
    open_episode,
    open_recorded_episode,
    read_recording_config,
    select_episode_directories,
)
from ..core.dataset.row_format import arm_prefixes, drive_names, weld_names
from ..core.errors import DatasetError, UsageError
from ..core.files.resources import Locations
from ..core.geometry.se3 import Array
from ..selection import AppliedSelection

# Exported actions: recorded commands, joints measured one frame later, or none.
ActionSource = Literal["recorded", "measured", "none"]
Frames = Sequence[Mapping[str, Any]]  # low-dimensional data of an episode

_FPS_TOLERANCE = 0.01  # relative distance from an integer, below which a frame rate is rounded
_MAX_UNEVENNESS = 0.1  # deviation of the time between frames as a share of the period; above, times are uneven
ROUNDING_S = 1e-9  # s; without this tolerance, rounding could drop the last frame


@dataclass(frozen=True)
class ExportSource(ABC):
    """Selected episodes of one dataset, all with the same cameras.

    `selection` holds the decisions of a person that chose the episodes, and the frames that are cut off.
    """

    path: Path
    directories: tuple[Path, ...]
    first: RecordedEpisode
    config: RecordConfig | RealConfig
    selection: AppliedSelection | None = field(default=None, kw_only=True)

    def __len__(self) -> int:
        return len(self.directories)

    @abstractmethod
    def open_episodes(self) -> Iterator[RecordedEpisode]:
        """Open and yield the episodes one by one."""

    @property
    def rig(self) -> RigConfig:
        """Rig that recorded the dataset."""
        return self.config.rig

    @property
    def camera_sizes(self) -> dict[str, tuple[int, int]]:
        """Camera -> (width, height) of its images, px."""
        return self.first.record.cameras

    @property
    def arm_prefixes(self) -> tuple[str, ...]:
        """Name prefix of each arm, in recording order; "" for a single arm."""
        return arm_prefixes(self.rig)

    @property
    def drive_names(self) -> tuple[str, ...]:
        """Names of the drives in `joints`, in recording order."""
        return drive_names(self.rig)

    @property
    def frame_period(self) -> float:
        """Time from one frame to the next, s."""
        return self.first.record.frame_period_s


@dataclass(frozen=True)
class SimulatedSource(ExportSource):
    """Selected simulated episodes, all with the same cameras, frame period, objects and arms."""

    first: StoredEpisode
    config: RecordConfig

    @property
    def weld_names(self) -> tuple[str, ...]:
        """Names of the weld states in an action, one per arm; empty if actions are joints."""
        return weld_names(self.config)

    def open_episodes(self) -> Iterator[StoredEpisode]:
        """See `ExportSource.open_episodes`."""
        for directory in self.directories:
            episode = self.selection.open_episode(directory) if self.selection else open_episode(directory)
            _require_same_as_first(episode, self.first, ("cameras", "frame_period_s", "objects", "arms"))
            yield episode


@dataclass(frozen=True)
class RealEpisode(RecordedEpisode):
    """A recording of real arms with the recorded frame of each exported frame, `frame_numbers`; frames may repeat."""

    record: RealEpisodeRecord
    frame_numbers: tuple[int, ...]

    def frames(self) -> list[dict[str, Any]]:
        """Read the low-dimensional data of the selected frames."""
        recorded = {
            k: self.decode_frame_data(k, self.read_verified(lowdim_path(k))) for k in dict.fromkeys(self.frame_numbers)
        }
        return [recorded[k] for k in self.frame_numbers]

    def image(self, camera: str, number: int) -> bytes:
        """Return the JPEG bytes of exported frame `number`."""
        return self.read_verified(image_path(camera, self.frame_numbers[number]))


@dataclass(frozen=True)
class RealSource(ExportSource):
    """Selected recordings of real arms, all with the same cameras and arms.

    Attributes:
        period: time between exported frames, s.
        is_resampled: whether to export the frames nearest to evenly spaced times instead of all recorded frames.
    """

    config: RealConfig
    period: float
    is_resampled: bool

    @property
    def frame_period(self) -> float:
        """Time from one exported frame to the next, s."""
        return self.period

    @property
    def drive_names(self) -> tuple[str, ...]:
        """Names of the drives in `joints`, without grippers if these were not recorded."""
        rig, count = self.rig, self.first.record.drives
        named = zip(self.arm_prefixes, rig.recording_order, strict=True)
        return tuple(prefix + name for prefix, k in named for name in rig.arms[k].robot.drive_names[:count])

    def open_episodes(self) -> Iterator[RealEpisode]:
        """See `ExportSource.open_episodes`."""
        for directory in self.directories:
            episode = open_recorded_episode(directory)
            _require_same_as_first(episode, self.first, ("cameras", "arms", "drives"))
            usual = episode.record.frame_period_s
            if not self.is_resampled and abs(usual / self.period - 1) > _MAX_UNEVENNESS:
                raise DatasetError(
                    f"{directory} has a frame every {1000 * usual:.1f} ms, but the chosen episodes usually every "
                    f"{1000 * self.period:.1f} ms: export it separately with --episodes, or give --fps"
                )
            yield self._select_frames(episode)

    def _select_frames(self, episode: RecordedEpisode) -> RealEpisode:
        record = episode.record
        assert isinstance(record, RealEpisodeRecord), "the dataset's config says so"
        trimmed = self.selection.trim(episode) if self.selection else episode
        chosen = tuple(range(trimmed.first_frame, trimmed.first_frame + trimmed.record.frames))
        if self.is_resampled:
            times = np.array([frame["timestamp"] for frame in trimmed.frames()])
            chosen = tuple(trimmed.first_frame + k for k in nearest_to_even(times, self.period))
            record = record.model_copy(update={"frame_period_s": self.period})
        record = record.model_copy(update={"frames": len(chosen)})
        return RealEpisode(episode.directory, record, chosen)

    def with_gripper_shares(self, values: ArrayLike) -> Array:
        """Reshape rows (n, arms * drives) of joints (rad) and finger openings (m) to (n, arms, drives), with openings
        as shares.

        Shares are 0 closed to 1 open, without clipping.
        """
        record = self.first.record
        rows = np.array(values, dtype=np.float64).reshape(-1, record.arms, record.drives)
        for k, arm in enumerate(self.rig.recording_order):
            robot = self.rig.arms[arm].robot
            if robot.fingers is not None and record.drives > robot.dof:
                rows[:, k, robot.dof] /= robot.fingers.full_opening
        return rows

    def actions(self, episode: RealEpisode, frames: Frames, source: ActionSource) -> Array:
        """Return the actions (n, arms, drives): joints in rad, grippers as shares of the opening.

        The source "measured" takes the joints one frame later; the last frame repeats its own.
        """
        if source == "measured":
            return self.with_gripper_shares([frame["joints"] for frame in (*frames[1:], frames[-1])])
        if not all("ctrl" in frame for frame in frames):
            raise DatasetError(
                f"{episode.directory} has no commands, because they were not recorded; --actions measured takes the "
                "joints measured one frame later"
            )
        return self.with_gripper_shares([frame["ctrl"] for frame in frames])

    def describe_uneven_times(self, episode: RecordedEpisode, frames: Frames) -> str | None:
        """Warn if an episode was recorded at uneven times and is exported at even times."""
        pauses = np.diff([frame["timestamp"] for frame in frames])
        if self.is_resampled or len(pauses) == 0 or np.abs(pauses / self.period - 1).max() <= _MAX_UNEVENNESS:
            return None
        return (
            f"{episode.directory.name}: its frames were recorded {1000 * pauses.min():.1f} to "
            f"{1000 * pauses.max():.1f} ms apart, but are exported {1000 * self.period:.1f} ms apart, "
            f"{len(pauses) * self.period:.2f} s instead of {pauses.sum():.2f} s; --fps gives evenly spaced frames"
        )


def _require_same_as_first(episode: RecordedEpisode, first: RecordedEpisode, keys: Sequence[str]) -> None:
    for key in keys:
        here, there = getattr(episode.record, key), getattr(first.record, key)
        if here != there:
            raise DatasetError(
                f"{episode.directory} has other {key} than {first.directory.name} ({here}, not {there}): "
                "export them separately with --episodes"
            )


def nearest_to_even(times: Array, period: float) -> tuple[int, ...]:
    """Return the index of the frame nearest to each multiple of `period` (s), up to the last frame.

    Args:
        times: (n,), increasing, s.
    """
    since = times - times[0]
    even = np.arange(math.floor((since[-1] + ROUNDING_S) / period) + 1) * period
    middles = (since[1:] + since[:-1]) / 2
    # Halfway between two frames, up to rounding, select the earlier frame.
    return tuple(np.searchsorted(middles, even - ROUNDING_S).tolist())


def open_source(
    dataset: Path, episodes: str | None, locations: Locations, selection: AppliedSelection | None = None
) -> SimulatedSource:
    """Open selected episodes of a simulated dataset.

    Args:
        episodes: numbers and ranges, such as `0,3,5-9`; None for all.
        selection: decisions of a person, which also cut off frames.

    Raises DatasetError if the episodes have no images.
    """
    directories = _select_directories(dataset, episodes, selection)
    first = selection.open_episode(directories[0]) if selection else open_episode(directories[0])
    if not first.record.cameras:
        raise DatasetError(
            f"{dataset} has no pictures, which exports need; make them with `yamsim draw {dataset} --out drawn`, and "
            "export drawn"
        )
    return SimulatedSource(dataset, directories, first, read_recording_config(dataset, locations), selection=selection)


def _select_directories(dataset: Path, episodes: str | None, selection: AppliedSelection | None) -> tuple[Path, ...]:
    chosen = select_episode_directories(dataset, episodes, None, selection.kept if selection else None)
    if not chosen and selection:
        chooser = selection.path or f"--who {selection.who}"
        raise UsageError(f"--episodes {episodes}: {chooser} keeps none of these; give others")
    return tuple(directory for _, directory in chosen)


def open_real_source(
    dataset: Path,
    episodes: str | None,
    locations: Locations,
    fps: float | None = None,
    selection: AppliedSelection | None = None,
) -> RealSource:
    """Open selected episodes of a dataset of real recordings.

    Args:
        episodes: numbers and ranges, such as `0,3,5-9`; None for all.
        fps: frames per second of the export, at even times; None for all recorded frames, at the median recorded rate.
        selection: decisions of a person, which also cut off frames.
    """
    directories = _select_directories(dataset, episodes, selection)
    config = read_imported_config(dataset, locations)
    opened = [open_recorded_episode(directory) for directory in directories]
    for episode in opened:
        if isinstance(episode, StoredEpisode):
            raise DatasetError(f"{episode.directory} was simulated, and its dataset holds real recordings: move it out")
    rate = fps or _common_fps([episode.record.frame_period_s for episode in opened])
    return RealSource(dataset, directories, opened[0], config, 1 / rate, fps is not None, selection=selection)


def _common_fps(periods: Sequence[float]) -> float:
    rate = 1 / float(np.median(periods))
    whole = round(rate)
    return float(whole) if abs(rate - whole) <= _FPS_TOLERANCE * rate else round(rate, 3)


def depth_cameras(episode: StoredEpisode) -> tuple[str, ...]:
    """Return the cameras with depth images."""
    return tuple(camera for camera in episode.record.cameras if depth_path(camera, 0) in episode.record.files)
