"""Episodes as in the programs of real stations: joints and gripper shares of each arm, cameras by their role."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.closable import Closable
from ..core.dataset.disk_errors import explain_disk_error
from ..core.dataset.lowdim import ACTION, STATE
from ..core.dataset.reader import RecordedEpisode
from ..core.errors import DatasetError, PartialJobError, UsageError, suggest_similar
from ..core.geometry.se3 import Array
from ..core.progress import Progress
from ..core.workers.executors import OpenRunner
from .episode_jobs import parallel, run_episode_jobs
from .export_source import ActionSource, ExportSource, Frames, RealEpisode, RealSource

SIDES = ("left", "right")  # names of the arms; a single arm is the left one
TOP, WRIST = "top", "wrist"  # roles of the camera above the arms, and of a single arm's wrist camera
ROLES = (TOP, *SIDES, WRIST)  # Source: i2rt-robotics/yam-abc-reproduce 7d9f9d1, `config.py`, CAMERA_ROLE_OPTIONS

_ENDINGS = re.compile(r"(_wrist)?_camera$|_rgb$")  # parts of a camera's name that say nothing about its role


@dataclass(frozen=True)
class StationEpisode:
    """Values of an episode at its n frames.

    Attributes:
        times: s.
        measured, commanded: (n, arms, joints + 1): joints in rad, and last the gripper, 0 closed to 1 open.
        prompt: instruction of the task; may be empty.
    """

    times: Array
    measured: Array
    commanded: Array
    prompt: str


@dataclass(frozen=True)
class StationReader:
    """Reads episodes of one dataset as `StationEpisode`.

    Attributes:
        roles: camera -> role.
        actions: for real recordings: "recorded" for commands, or "measured" for joints one frame later.

    Raises:
        UsageError: the arms have no grippers, or `actions` is "none".
        DatasetError: grippers were not recorded.
    """

    source: ExportSource
    roles: Mapping[str, str]
    actions: ActionSource = "recorded"

    def __post_init__(self) -> None:
        source = self.source
        if self.actions == "none":
            raise UsageError("--actions none: each frame of this format needs an action; give measured, or use lerobot")
        if any(source.rig.arms[k].robot.fingers is None for k in source.rig.recording_order):
            raise UsageError(f"rig {source.rig.name!r} has no gripper, which this format needs: export it as lerobot")
        if isinstance(source, RealSource) and source.first.record.drives != source.rig.drive_count:
            raise DatasetError(
                f"{source.path} has no grippers, because they were not recorded, but this format needs one per arm: "
                "export it as lerobot"
            )

    @property
    def joints(self) -> int:
        """Number of joints of each arm."""
        return self.source.rig.drive_count - 1

    @property
    def sides(self) -> tuple[str, ...]:
        """Name of each arm, in recording order."""
        return SIDES[: len(self.source.rig.recording_order)]

    def read(self, episode: RecordedEpisode) -> tuple[StationEpisode, Frames]:
        """Return the values of an episode, and its frames as recorded."""
        frames, source = episode.frames(), self.source
        times: Array = np.arange(float(len(frames))) * source.frame_period
        if isinstance(source, RealSource):
            assert isinstance(episode, RealEpisode)
            measured = source.with_gripper_shares([frame["joints"] for frame in frames])
            commanded = source.actions(episode, frames, self.actions)
            if not source.is_resampled:
                times = np.array([frame["timestamp"] for frame in frames], dtype=np.float64)
        else:
            measured, commanded = self._simulated_rows(frames)
        return StationEpisode(times, measured, commanded, str(frames[0].get("language_prompt", ""))), frames

    def _simulated_rows(self, frames: Frames) -> tuple[Array, Array]:
        rig, shape = self.source.rig, (len(frames), len(self.sides), -1)
        if ACTION in frames[0]:
            rows = [np.array([frame[key] for frame in frames], np.float64).reshape(shape) for key in (STATE, ACTION)]
        else:
            rows = [np.array([frame[key] for frame in frames], np.float64).reshape(shape) for key in ("joints", "ctrl")]
            for values in rows:
                for k, arm in enumerate(rig.recording_order):
                    fingers = rig.arms[arm].robot.fingers
                    assert fingers is not None, "checked at the start"
                    values[:, k, -1] /= fingers.full_opening
        for values in rows:
            # Contact presses fingers a little beyond their stops; the drives of real grippers report 0 to 1.
            values[..., -1] = values[..., -1].clip(0.0, 1.0)
        return rows[0], rows[1]


def camera_roles(source: ExportSource, top: str | None, *, single_wrist: str = WRIST) -> dict[str, str]:
    """Return camera -> role: the wrist cameras by their arm, and the only other camera, or `top`, as the top camera.

    A camera whose name is a role, with or without `_camera`, has that role. Others keep their names as their roles.

    Args:
        single_wrist: role of the wrist camera of a single arm.

    Raises:
        UsageError: the dataset has no camera `top`.
    """
    cameras = tuple(source.camera_sizes)
    if top is not None and top not in cameras:
        raise UsageError(f"--top {top!r} is not valid; {suggest_similar(top, cameras)}")
    found: dict[str, str] = {} if top is None else {top: TOP}
    rig = source.rig
    wrist_roles = SIDES if len(rig.recording_order) > 1 else (single_wrist,)
    for role, k in zip(wrist_roles, rig.recording_order, strict=True):
        _give_role(found, rig.arms[k].wrist_camera_name, role, cameras)
    for camera in cameras:
        role = _ENDINGS.sub("", camera)
        _give_role(found, camera, single_wrist if role == WRIST else role, cameras, ROLES)
    rest = [camera for camera in cameras if camera not in found]
    if len(rest) == 1:
        _give_role(found, rest[0], TOP, cameras)
    return {camera: found.get(camera, camera) for camera in cameras}


def _give_role(
    found: dict[str, str], camera: str, role: str, cameras: Sequence[str], valid: Sequence[str] | None = None
) -> None:
    if camera in cameras and camera not in found and role not in found.values() and (valid is None or role in valid):
        found[camera] = role


def task_folder(prompt: str) -> str:
    """Return a task's folder: the words of its instruction in lower case, joined by `_`; `untitled` without words."""
    return "_".join(re.findall(r"[^\W_]+", prompt.lower())) or "untitled"


_Job = tuple[RecordedEpisode, int]  # an episode, and its number
_Written = tuple[int, str | None]  # number of frames, and a note


class StationEpisodeWriter(Closable):
    """Writes episodes into subfolders of `root`."""

    def __init__(self, reader: StationReader, root: Path) -> None:
        self._reader, self._root = reader, root

    def close(self) -> None:
        """Do nothing: no file stays open."""

    def run(self, job: _Job) -> _Written:
        """Write an episode, and return the number of its frames, and a note or None."""
        episode, number = job
        values, frames = self._reader.read(episode)
        try:
            self._write(episode, number, values)
        except OSError as error:
            raise PartialJobError(f"{explain_disk_error(error, self._root)}: nothing was exported") from error
        return len(frames), self._note(episode, frames)

    @abstractmethod
    def _write(self, episode: RecordedEpisode, number: int, values: StationEpisode) -> None:
        """Write the files of an episode."""

    def _note(self, episode: RecordedEpisode, frames: Frames) -> str | None:
        """Return what a user should know about an exported episode; None for nothing."""
        return None


def write_station_episodes(
    factory: OpenRunner[_Job, _Written], source: ExportSource, workers: int, progress: Progress
) -> Iterator[_Written]:
    """Write all episodes of a source with up to `workers` processes, and yield the result of each."""
    jobs = ((episode, number) for number, episode in enumerate(source.open_episodes()))
    for done, (_, written) in enumerate(run_episode_jobs(factory, jobs, parallel(workers, source)), start=1):
        progress(done, len(source))
        yield written
