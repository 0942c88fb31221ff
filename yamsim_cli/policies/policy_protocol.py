"""Protocol of policies: observations, answers, and optional requests."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..core.attempt_data import WeldStates
from ..core.files.documents.units import QuantityBounds
from ..core.geometry.se3 import Array

# Images that a policy can request; "wrist" stands for all wrist cameras.
SCENE, WRIST = "scene", "wrist"

# Further values that a policy can request: poses of objects, which only a simulation knows, and joint velocities.
OBJECTS, VELOCITIES = "objects", "velocities"
STATE_REQUESTS = (OBJECTS, VELOCITIES)

MAX_ACTIONS = 1000  # in one answer
MIN_PERIOD, MAX_PERIOD = 1e-3, 10.0  # s, of one action
_JOINT_ANGLE_BOUNDS = QuantityBounds("rad", -2 * math.pi, 2 * math.pi)  # rad; larger values are degrees
_MAX_CHUNK_S = 100.0  # s: 1000 actions at 10 Hz; chunks are in memory until they run out

# Keys of an observation. Values of two arms have the left arm's first.
# - `scene_rgb` (height, width, 3), uint8, and `wrist_rgb`, or for two arms `left_wrist_rgb` and `right_wrist_rgb`:
#   images, each rendered at the first access
# - `joints` (drives,): each arm's joints, rad, and then the opening of one finger, m, as in a dataset's frame
# - `gripper`: opening of one finger, m, or (2,) of two arms; 0 without fingers
# - `ee_pose_world` (4, 4), or (2, 4, 4) of two arms: pose of `grasp_site` in the world
# - `K_scene` (3, 3), `T_cam_in_world` (4, 4): scene camera, in OpenCV's convention
# - `time`, s since the start; `prompt`
# - if "objects" is requested: `T_object_in_world` (4, 4) of the object, `T_target_in_world` (4, 4) of its target; in
#   tasks as data `T_<thing>_in_world` of each object, and `<thing>_joints` (n,) of objects with moving parts
# - if "velocities" is requested: `joint_velocities` (drives,) in the order of `joints`, rad/s and m/s
Observation = Mapping[str, Any]


class Policy(Protocol):
    """Interface of a policy: any object with these two methods.

    Optional attributes of the class or the object:

    - `images`: requested images: "scene", "wrist", "left_wrist", "right_wrist", or the name of a camera of a rig that
      has its own; by default "scene" and "wrist".
    - `wants`: requested values, from `STATE_REQUESTS`; by default none.
    - `ticks`: duration of an action in control ticks of 32 ms; by default 1. Datasets use 2.
    - `execute`: executed actions of a chunk before the next inference; by default all.
    """

    @property
    def reset(self) -> Callable[..., None]:
        """Forget the previous trial. The method gets the trial's seed if it has a parameter `seed`."""

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        """Return an action for an observation: `ctrl` (drives,), rad and m; `magnet` and `done`, by default False.

        For two arms, `ctrl` and `magnet` (2,) have the left arm's values first. `ctrl` (n, drives), and `magnet` (n,)
        or (n, 2), are a chunk of n actions. `period` is the duration of each action, s, instead of `ticks`.
        """


def squeeze_single_arm(poses: Array) -> Array:
    """Return poses (arms, 4, 4) unchanged for two arms, and as (4, 4) for a single arm."""
    return poses if len(poses) > 1 else poses[0]


@dataclass(frozen=True)
class ActionChunk:
    """Checked answer of a policy: consecutive actions.

    Attributes:
        ctrl: commands to each arm's drives (actions, arms, drives), rad and m.
        magnet: whether each arm's weld, which attaches an object to the hand, is commanded on (actions, arms).
        period: duration of each action, s; None for the policy's `ticks`.
    """

    ctrl: Array
    magnet: WeldStates
    done: bool
    period: float | None = None


class InvalidActionError(ValueError):
    """A policy's answer is no valid action."""


def read_chunk(answer: object, arms: int, each: int) -> ActionChunk:
    """Check a policy's answer and return its actions.

    Args:
        each: drives of each arm, including the gripper.

    Raises:
        InvalidActionError: the answer is no mapping, lacks a finite number for a drive, or has an invalid value.
    """
    if not isinstance(answer, Mapping):
        raise InvalidActionError(f"an action is a dictionary with ctrl, magnet and done, not {type(answer).__name__}")
    if unknown := sorted(map(str, answer.keys() - {"ctrl", "magnet", "done", "period"})):
        raise InvalidActionError(f"an action holds ctrl, magnet, done and period, not {', '.join(unknown)}")
    ctrl = _read_ctrl(answer, arms * each)
    count = len(ctrl) if ctrl.ndim > 1 else 1
    _check_angles(ctrl.reshape(count, arms, each))
    magnet = (
        _weld_rows(answer["magnet"], ctrl.ndim > 1, count, arms) if "magnet" in answer else [(False,) * arms] * count
    )
    period = answer.get("period")
    if period is not None and not (isinstance(period, int | float) and MIN_PERIOD <= period <= MAX_PERIOD):
        raise InvalidActionError(f"period is {period!r}, not {MIN_PERIOD:g} to {MAX_PERIOD:g} s")
    if period is not None and count * period > _MAX_CHUNK_S:
        raise InvalidActionError(
            f"{count} actions of {period:g} s last {count * period:g} s, not at most {_MAX_CHUNK_S:g}"
        )
    (done,) = _read_truth_values(answer.get("done", False), "done", 1)
    return ActionChunk(ctrl.reshape(count, arms, each), np.array(magnet), done, period)


def _weld_rows(value: Any, is_chunk: bool, count: int, arms: int) -> list[tuple[bool, ...]]:
    rows = _as_array(value, "magnet")
    if is_chunk and rows.size == count * arms:
        return [_read_truth_values(row, "magnet", arms) for row in rows.reshape(count, arms)]
    return [_read_truth_values(value, "magnet", arms)] * count


def _read_ctrl(answer: Mapping[str, Any], drives: int) -> Array:
    if "ctrl" not in answer:
        raise InvalidActionError(f"an action needs ctrl, {drives} numbers")
    try:
        ctrl = np.asarray(answer["ctrl"], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidActionError(f"ctrl is not an array of numbers: {error}") from error
    if ctrl.shape != (drives,) and (ctrl.ndim != 2 or ctrl.shape[1] != drives or not 1 <= len(ctrl) <= MAX_ACTIONS):
        raise InvalidActionError(
            f"ctrl has the shape {ctrl.shape}, not ({drives},), or (1 to {MAX_ACTIONS} actions, {drives})"
        )
    if not np.isfinite(ctrl).all():
        raise InvalidActionError(f"ctrl is not finite: {np.array2string(ctrl, precision=3, threshold=20)}")
    return ctrl


def _check_angles(ctrl: Array) -> None:
    """Refuse joint angles that are not in rad. The last drive is not checked, because it may be a gripper."""
    joints = ctrl[..., :-1]
    if joints.size == 0:
        return
    largest = float(joints.flat[int(np.argmax(np.abs(joints)))])
    try:
        _JOINT_ANGLE_BOUNDS.check(largest)
    except ValueError as error:
        raise InvalidActionError(f"ctrl has a joint at {largest:g}, which {error}") from error


def _read_truth_values(value: object, key: str, count: int) -> tuple[bool, ...]:
    values = _as_array(value, key).ravel()
    if values.size != count or values.dtype.kind not in "bif" or not np.isin(values, (0, 1)).all():
        wanted = "true or false" if count == 1 else f"{count} times true or false, the left arm's first"
        raise InvalidActionError(f"{key} is {repr(value)[:80]}, not {wanted}")
    return tuple(map(bool, values))


def _as_array(value: object, key: str) -> np.ndarray:
    try:
        return np.asarray(value)
    except (TypeError, ValueError) as error:
        raise InvalidActionError(f"{key} is not an array of booleans: {error}") from error
