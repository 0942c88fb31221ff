from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from yamsim_cli.core.dataset.checks.context import CheckContext
from yamsim_cli.core.dataset.checks.problem import DatasetProblem
from yamsim_cli.core.dataset.lowdim import RIGHT_IN_LEFT_BASE_KEY
from yamsim_cli.core.dataset.records import EpisodeRecord, OutcomeRecord
from yamsim_cli.core.geometry.se3 import Array, yaw

# Frame number -> flat key, such as `intrinsics[camera]` -> value, for values that passed `lowdim.LowdimChecks`.
Values = Mapping[int, Mapping[str, Any]]

POSE_SUFFIX = "_pose"  # end of the keys of poses
_HAND_POSE_KEY = "ee_pose"


@dataclass(frozen=True)
class EpisodeFacts:
    """Facts about an episode, and its problems.

    Attributes:
        number: episode number in that name; None if yamsim did not name the directory.
        record: content of episode.json; None if missing or unreadable.
        seconds: time from the first frame to the last; None if unknown.
        cameras: camera -> (width, height), px.
        images: camera -> paths of decodable images, relative to the episode, in order.
        start_positions, end_positions: object -> (x, y) in `world` in the first and in the last frame, m.
        layout: object -> initial pose as recorded, or else (x, y, z, yaw) in the robot base; m and rad.
        outcome: as recorded, or else derived from the last frame; None without either.
        content: hash of the lowdim values; "" if a frame is unreadable.
        import_faults: faults that the import of a real recording found, one sentence each.
    """

    name: str
    number: int | None
    record: EpisodeRecord | None = None
    record_sha256: str = ""
    frames: int = 0
    bytes: int = 0
    seconds: float | None = None
    cameras: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    images: Mapping[str, Sequence[str]] = field(default_factory=dict)
    start_positions: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    end_positions: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    layout: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    outcome: OutcomeRecord | None = None
    content: str = ""
    problems: Sequence[DatasetProblem] = ()
    import_faults: Sequence[str] = ()


def values_by_frame(values: Values, key: str) -> dict[int, Array]:
    """Return frame number -> value of `key`, for frames that have the key."""
    return {k: entries[key] for k, entries in sorted(values.items()) if key in entries}


def rigid_poses(values: Values) -> dict[str, dict[int, Array]]:
    """Return flat key -> frame number -> pose (4, 4) of objects, `ee_pose`, `extrinsics[camera]` and `BETWEEN_BASES`.

    Two arms have `ee_pose[0]` and `ee_pose[1]`.
    """
    keys = dict.fromkeys(key for entries in values.values() for key in entries)
    named = [
        key
        for key in keys
        if key.endswith(POSE_SUFFIX) or key.startswith("extrinsics[") or key == RIGHT_IN_LEFT_BASE_KEY
    ]
    found = {key: values_by_frame(values, key) for key in named}
    poses = {key: by_frame for key, by_frame in found.items() if _frames_have_shape(by_frame, (4, 4))}
    hands = found.get(_HAND_POSE_KEY, {})
    if hands and _frames_have_shape(hands, (2, 4, 4)):
        poses |= {f"{_HAND_POSE_KEY}[{arm}]": {k: T[arm] for k, T in hands.items()} for arm in range(2)}
    return poses


def _frames_have_shape(by_frame: Mapping[int, Array], shape: tuple[int, ...]) -> bool:
    return all(np.shape(value) == shape for value in by_frame.values())


def object_poses(values: Values, frame: int) -> dict[str, Array]:
    """Return object -> pose (4, 4) in the robot base."""
    return {
        key.removesuffix(POSE_SUFFIX): np.asarray(by_frame[frame], dtype=np.float64)
        for key, by_frame in rigid_poses(values).items()
        if key.endswith(POSE_SUFFIX) and key != _HAND_POSE_KEY and frame in by_frame
    }


def object_positions(values: Values, context: CheckContext, *, last: bool) -> dict[str, tuple[float, float]]:
    """Return object -> (x, y) in `world`, m, in the first or last readable frame."""
    if not values:
        return {}
    poses = object_poses(values, max(values) if last else min(values))
    in_world = {name: context.T_base_in_world @ T for name, T in poses.items()}
    return {name: (float(T[0, 3]), float(T[1, 3])) for name, T in in_world.items()}


def initial_layout(values: Values, record: EpisodeRecord | None) -> dict[str, tuple[float, ...]]:
    """Return object -> initial pose, as recorded, or else (x, y, z, yaw) in the robot base."""
    if record:
        return dict(record.layout)
    if not values:
        return {}
    return {name: (*map(float, T[:3, 3]), yaw(T)) for name, T in object_poses(values, min(values)).items()}


def outcome_from_frames(values: Values, context: CheckContext) -> OutcomeRecord | None:
    """Return the outcome of the last frame; None without stored poses of object and target."""
    if not values:
        return None
    poses = object_poses(values, max(values))
    carried, target = poses.get(context.object), poses.get(context.target)
    if carried is None or target is None:
        return None
    offset = carried[:3, 3] - target[:3, 3]
    dxy, dz = float(np.hypot(offset[0], offset[1])), float(offset[2])
    outcome = OutcomeRecord(
        success=False, cause=None, detail="", dxy_m=dxy, dz_m=dz, speed_mps=None, plan_error_m=None, tilt_rad=None
    )
    return outcome.model_copy(update={"success": outcome.is_within(context.threshold, context.max_height)})
