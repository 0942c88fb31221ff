"""What the checks know beforehand: where the episodes are, and what the dataset's own config says."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ...config.limits import JointLimits, load_limits
from ...config.loader import validate_file
from ...config.record import RecordConfig
from ...config.task import Sampling
from ...errors import ConfigError, DatasetError
from ...geometry.se3 import Array, pose
from ...resources import Locations
from ..layout import CONFIG, EPISODE, episode_directories, episode_name
from .problem import Problems

# The only arm there is; a plain recording does not say.
_MODEL = "i2rt_yam"
# What a plain recording's outcome is read from, and judged by. Source: the lab's pick-and-place.
_OBJECT, _TARGET = "banana", "plate"
_THRESHOLD = 0.05
_MAX_HEIGHT = 0.10


@dataclass(frozen=True)
class EpisodeDirectory:
    """Where an episode lies; its number is None where yamsim did not name it."""

    path: Path
    number: int | None


@dataclass(frozen=True)
class Context:
    """What holds for all episodes of a dataset.

    Attributes:
        recorded: whether yamsim recorded it; otherwise it has rgb/ and lowdim/ alone.
        joints: what an arm's joints can do.
        fingers: stops (m) of one finger; None where the gripper is not known, or arms have several.
        T_base_in_world: pose (4, 4) of the base that poses are in: the arm's, or the left one's.
        object, target: what is carried, and whereto.
        sampling: where objects were drawn from, in `world`; None where it is not known.
        threshold, max_height: what the task itself counts as success, m.
    """

    recorded: bool
    joints: tuple[JointLimits, ...]
    fingers: tuple[float, float] | None
    T_base_in_world: Array
    object: str = _OBJECT
    target: str = _TARGET
    sampling: Sampling | None = None
    threshold: float = _THRESHOLD
    max_height: float = _MAX_HEIGHT


def find_episodes(dataset: Path) -> tuple[list[EpisodeDirectory], bool]:
    """Every episode of a dataset, in order, and whether yamsim recorded it.

    Raises:
        DatasetError: there is no dataset, or it is a single episode, or it cannot be read.
    """
    hint = "give the directory that `yamsim record` wrote"
    try:
        if not dataset.is_dir():
            raise DatasetError(f"{dataset} is not a directory; {hint}")
        if _is_episode(dataset):
            raise DatasetError(f"{dataset} is one episode; give the directory around it, {dataset.absolute().parent}")
        numbered = _numbered(dataset)
        if (dataset / CONFIG).is_file() or any((episode.path / EPISODE).is_file() for episode in numbered):
            return numbered, True
        plain = [path for path in dataset.iterdir() if not path.name.startswith(".") and _is_episode(path)]
    except OSError as error:
        raise DatasetError(
            f"{dataset} cannot be read: {error.strerror}; mend its permissions or its disk, or {hint}"
        ) from error
    if not plain:
        raise DatasetError(
            f"{dataset} holds no episodes (ep_NNNNNN, or any with rgb/ and lowdim/) and no {CONFIG}; {hint}"
        )
    return [EpisodeDirectory(path, None) for path in sorted(plain, key=_natural)], False


def _numbered(dataset: Path) -> list[EpisodeDirectory]:
    """Other spellings of a number, such as ep_0000001, are left out: two directories would have the same."""
    return [
        EpisodeDirectory(path, number)
        for number, path in episode_directories(dataset)
        if path.name == episode_name(number)
    ]


def looks_like_episode(path: Path) -> bool:
    """Whether a directory seems to be an episode, whole or not, whatever its name."""
    return path.is_dir() and not path.name.startswith(".") and (path.name.startswith("ep") or _is_episode(path))


def _is_episode(path: Path) -> bool:
    return (path / "lowdim").is_dir() or (path / "rgb").is_dir()


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sorts ep2 before ep10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]{1,18})", path.name)]


def read_context(dataset: Path, recorded: bool, locations: Locations, problems: Problems) -> Context:
    """What the dataset's config says; where there is none, what holds for the arm."""
    parsed: RecordConfig | None = None
    if recorded and not (dataset / CONFIG).is_file():
        problems.add("config.missing")
    elif recorded:
        try:
            parsed = validate_file(RecordConfig, dataset / CONFIG, locations, as_recorded=True)
        except ConfigError as error:
            problems.add("config.damaged", CONFIG, str(error).removeprefix(f"{dataset}/"))
    if parsed is None:
        return Context(recorded, load_limits(_MODEL, locations).joints_with(None), None, pose())
    rig, task = parsed.rig, parsed.task
    limits = load_limits(rig.arms[0].model, locations)
    grippers = {arm.gripper for arm in rig.arms}
    gripper = grippers.pop() if len(grippers) == 1 else None
    return Context(
        recorded,
        limits.joints_with(gripper),
        limits.fingers.get(gripper) if gripper else None,
        rig.T_base_in_world(rig.recorded[0]),
        task.object.name,
        task.target.name,
        parsed.sampled,
        task.success.threshold,
        task.success.max_height,
    )
