"""Find the episodes of a dataset, and read the context for episode checks from its config."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ...config.goals.world import TABLE
from ...config.loader import load_config
from ...config.recording import RecordConfig
from ...config.rig import RigConfig
from ...errors import DatasetError
from ...files.resources import Locations
from ...geometry.se3 import Array, pose
from ...robots.models import JointLimits
from ...robots.robot import widest_joint_limits
from ..dataset_paths import CONFIG_FILE, EPISODE_FILE, episode_directories, episode_name
from ..imported_records import is_imported_dataset, read_dataset_config, read_imported_config
from .problem import ProblemCollector

_ASSUMED_RECORD_CONFIG = (
    "default"  # `record` config with the assumed arm of plain recordings, which have only rgb/ and lowdim/
)
# Objects and success limits (m) for judging a plain recording. Source: the lab's pick-and-place.
_OBJECT, _TARGET = "banana", "plate"
_DEFAULT_SUCCESS_RADIUS = 0.05
_DEFAULT_MAX_HEIGHT = 0.10


@dataclass(frozen=True)
class ArmLimits:
    """Limits of an arm.

    Attributes:
        joints: limits of the joints, from the base to the flange.
        drives: number of elements of this arm in a frame's `joints`: its joints, and its finger opening if it has
            fingers.
        fingers: limits of one finger, m; None if unknown.
    """

    joints: tuple[JointLimits, ...]
    drives: int
    fingers: tuple[float, float] | None


@dataclass(frozen=True)
class EpisodeDirectory:
    """Directory and number of an episode. The number is None if yamsim did not name the directory."""

    path: Path
    number: int | None


@dataclass(frozen=True)
class StartRegion:
    """Rectangle in `world` from which initial positions of object and target are sampled, m."""

    x: tuple[float, float]
    y: tuple[float, float]


@dataclass(frozen=True)
class CheckContext:
    """Properties that all episodes of a dataset share, and that their checks need.

    Attributes:
        recorded: whether yamsim recorded the dataset. A plain recording has only rgb/ and lowdim/.
        real: whether yamsim imported the dataset. Its episodes have records, but no attempts and no outcomes.
        arms: limits of each arm, in the order of frame data; one assumed arm for a plain recording.
        T_base_in_world: pose (4, 4) of the base of the only arm, or of the left arm.
        object, target: names of the carried object and its target; "" if a goal decides success.
        sampling: region of initial positions; None if unknown.
        threshold, max_height: on success, largest distance of the object from its target, and height above it, m.
        wrist_cameras: wrist camera -> index of its arm in `arms`, if known.
        judged_by_goal: whether a goal decides success instead of a distance.
    """

    recorded: bool
    arms: tuple[ArmLimits, ...]
    T_base_in_world: Array
    object: str = _OBJECT
    target: str = _TARGET
    sampling: StartRegion | None = None
    threshold: float = _DEFAULT_SUCCESS_RADIUS
    max_height: float = _DEFAULT_MAX_HEIGHT
    wrist_cameras: Mapping[str, int] = field(default_factory=dict)
    judged_by_goal: bool = False
    real: bool = False


def find_episodes(dataset: Path) -> tuple[list[EpisodeDirectory], bool]:
    """Return the episodes of a dataset, in order, and whether yamsim recorded it. Raise DatasetError if it is none."""
    hint = "give the directory that `yamsim record` wrote"
    try:
        if not dataset.is_dir():
            raise DatasetError(f"{dataset} is not a directory; {hint}")
        if _is_episode(dataset):
            raise DatasetError(f"{dataset} is one episode; give the directory around it, {dataset.absolute().parent}")
        numbered = _numbered_episodes(dataset)
        if is_imported_dataset(dataset):
            return numbered, False
        if (dataset / CONFIG_FILE).is_file() or any((episode.path / EPISODE_FILE).is_file() for episode in numbered):
            return numbered, True
        plain = [path for path in dataset.iterdir() if not path.name.startswith(".") and _is_episode(path)]
    except OSError as error:
        raise DatasetError(
            f"{dataset} cannot be read: {error.strerror}; check its permissions and its disk, or {hint}"
        ) from error
    if not plain:
        raise DatasetError(
            f"{dataset} holds no episodes (ep_NNNNNN, or any with rgb/ and lowdim/) and no {CONFIG_FILE}; {hint}"
        )
    return [EpisodeDirectory(path, None) for path in sorted(plain, key=_natural_sort_key)], False


def _numbered_episodes(dataset: Path) -> list[EpisodeDirectory]:
    """Return the episodes in `ep_NNNNNN`. Spellings such as ep_0000001 are excluded, so that numbers are unique."""
    return [
        EpisodeDirectory(path, number)
        for number, path in episode_directories(dataset)
        if path.name == episode_name(number)
    ]


def looks_like_episode(path: Path) -> bool:
    """Return whether a directory is an episode by its name or its content."""
    return path.is_dir() and not path.name.startswith(".") and (path.name.startswith("ep") or _is_episode(path))


def _is_episode(path: Path) -> bool:
    return (path / "lowdim").is_dir() or (path / "rgb").is_dir()


def _natural_sort_key(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]{1,18})", path.name)]


def read_context(dataset: Path, recorded: bool, locations: Locations, problems: ProblemCollector) -> CheckContext:
    """Build the check context from the dataset's config. Without a config, use limits that hold for every arm."""
    parsed: RecordConfig | None = None
    if recorded and not (dataset / CONFIG_FILE).is_file():
        problems.add("config.missing")
    elif recorded:
        try:
            parsed = read_dataset_config(RecordConfig, dataset, locations)
        except DatasetError as error:
            problems.add("config.damaged", CONFIG_FILE, str(error).removeprefix(f"{dataset}/"))
    if parsed is None and is_imported_dataset(dataset):
        rig = read_imported_config(dataset, locations).rig
        return CheckContext(
            recorded,
            _arm_limits(rig),
            rig.T_base_in_world(rig.recording_order[0]),
            wrist_cameras=_wrist_cameras(rig),
            real=True,
        )
    if parsed is None:
        arm = load_config(RecordConfig, "record", _ASSUMED_RECORD_CONFIG, locations).rig.arms[0]
        return CheckContext(
            recorded, (ArmLimits(widest_joint_limits(arm.model), len(arm.robot.drive_names), None),), pose()
        )
    rig = parsed.rig
    arms, wrists = _arm_limits(rig), _wrist_cameras(rig)
    T_base_in_world = rig.T_base_in_world(rig.recording_order[0])
    target, cast = parsed.task.target_predicate, parsed.task.typical_roles
    if target is None or target.radius is None:
        return CheckContext(recorded, arms, T_base_in_world, "", "", wrist_cameras=wrists, judged_by_goal=True)
    return CheckContext(
        recorded,
        arms,
        T_base_in_world,
        cast.object_of(target.thing),
        cast.object_of(target.surface),
        _bounding_start_region(parsed, (target.thing, target.surface)),
        target.radius,
        _DEFAULT_MAX_HEIGHT,
        wrists,
    )


def _bounding_start_region(config: RecordConfig, roles: Sequence[str]) -> StartRegion | None:
    starts = [
        config.start_regions_in_world[role]
        for role in roles
        if role in config.start_regions_in_world and config.start_regions_in_world[role].on == TABLE
    ]
    if not starts:
        return None
    x, y = ([bound for start in starts for bound in getattr(start, axis)] for axis in "xy")
    return StartRegion((min(x), max(x)), (min(y), max(y)))


def _arm_limits(rig: RigConfig) -> tuple[ArmLimits, ...]:
    robots = [rig.arms[k].robot for k in rig.recording_order]
    return tuple(
        ArmLimits(robot.joints, len(robot.drive_names), robot.fingers.range if robot.fingers else None)
        for robot in robots
    )


def _wrist_cameras(rig: RigConfig) -> dict[str, int]:
    return {rig.arms[k].wrist_camera_name: number for number, k in enumerate(rig.recording_order)}
