"""The protocol of a policy: what it sees, what it answers, and what it may ask for."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..documents.units import Within
from ..geometry.se3 import Array
from ..types import Holds

# What a policy may ask to see. "wrist" is every wrist camera that there is.
SCENE, WRIST = "scene", "wrist"
IMAGES = (SCENE, WRIST, "left_wrist", "right_wrist")

# Further numbers that a policy may ask for: the objects' poses, which only a simulation knows, and joint velocities.
OBJECTS, VELOCITIES = "objects", "velocities"
STATE = (OBJECTS, VELOCITIES)

# Actions of the longest answer, and how long one of them may last, s.
MOST_ACTIONS = 1000
SHORTEST, LONGEST = 1e-3, 10.0
_ANGLE = Within("rad", -2 * math.pi, 2 * math.pi)  # Of a joint; none turns further, and degrees do.
_LONGEST_CHUNK = 100.0  # s, how long a chunk may last: 1000 actions at 10 Hz. Chunks are kept until they run out.

# As a policy sees it. Of two arms, numbers are the left one's and then the right one's.
# - `scene_rgb` (height, width, 3) of uint8; `wrist_rgb`, or of two arms `left_wrist_rgb` and `right_wrist_rgb`; each is
#   rendered when it is first read
# - `joints` (drives,) as in a dataset's frame; `gripper`, the arms' openings: a number, or (2,), 0 without fingers
# - `ee_pose_world` (4, 4) or (2, 4, 4) of `grasp_site`
# - `K_scene` (3, 3), `T_cam_in_world` (4, 4) of the scene camera in OpenCV's convention
# - `time` in s since the start, `prompt`
# - for "objects", `T_object_in_world` (4, 4) of what is picked up, `T_target_in_world` (4, 4) of what it is put onto;
#   of tasks as data `T_<thing>_in_world` of each thing, and `<thing>_joints` (n,) of those with parts that move
# - for "velocities", `joint_velocities` (drives,) in the order of `joints`, rad/s and m/s
Observation = Mapping[str, Any]


class Policy(Protocol):
    """Any object with these two methods.

    It may have these attributes, of the class or the object:

    - `images`: which of `IMAGES` it asks for; "scene" and "wrist" unless given.
    - `wants`: which of `STATE` it asks for; nothing unless given.
    - `ticks`: how many control ticks of 32 ms an action lasts; 1 unless given. 2 is the rate of datasets.
    - `execute`: after how many actions of a chunk it is asked again; all of them unless given.

    `reset` gets the trial's seed if it has a parameter `seed`.
    """

    @property
    def reset(self) -> Callable[..., None]:
        """Forget the previous trial: a method with or without a parameter `seed`."""
        ...

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        """Answer an observation: `ctrl` (drives,), rad and m; `magnet` and `done`, False unless given.

        For two arms, `ctrl` and `magnet` (2,) have the left one's first. `ctrl` (n, drives), and `magnet` (n,) or
        (n, 2), are a chunk of n actions; `period` is how long each action lasts, s, where it is not `ticks`.
        """
        ...


def of_arms(poses: Array) -> Array:
    """Poses (arms, 4, 4) as a policy is told of them: of a lone arm, its pose (4, 4)."""
    return poses if len(poses) > 1 else poses[0]


@dataclass(frozen=True)
class Chunk:
    """A policy's answer, after it was checked: actions to come one after the other.

    Attributes:
        ctrl: what each arm's drives are told (actions, arms, drives), rad and m.
        magnet: whether each arm's weld is to hold (actions, arms).
        done: whether the policy is finished after these actions.
        period: how long each of them lasts, s; None for the policy's `ticks`.
    """

    ctrl: Array
    magnet: Holds
    done: bool
    period: float | None = None


class InvalidActionError(ValueError):
    """A policy's answer that is no valid action; the text says what is wrong with it."""


def read_chunk(answer: object, arms: int, each: int) -> Chunk:
    """Check a policy's answer.

    Args:
        arms, each: how many arms it drives, and how many drives each of them has.

    Raises:
        InvalidActionError: it is no mapping with `ctrl` of a finite number for each drive, or has anything but truth
            values, or a period, else.
    """
    if not isinstance(answer, Mapping):
        raise InvalidActionError(f"an action is a dictionary with ctrl, magnet and done, not {type(answer).__name__}")
    if unknown := sorted(map(str, answer.keys() - {"ctrl", "magnet", "done", "period"})):
        raise InvalidActionError(f"an action holds ctrl, magnet, done and period, and not {', '.join(unknown)}")
    ctrl = _ctrl(answer, arms * each)
    count = len(ctrl) if ctrl.ndim > 1 else 1
    _check_angles(ctrl.reshape(count, arms, each))
    magnet = _magnet(answer["magnet"], ctrl.ndim > 1, count, arms) if "magnet" in answer else [(False,) * arms] * count
    period = answer.get("period")
    if period is not None and not (isinstance(period, int | float) and SHORTEST <= period <= LONGEST):
        raise InvalidActionError(f"period is {period!r}, not {SHORTEST:g} to {LONGEST:g} s")
    if period is not None and count * period > _LONGEST_CHUNK:
        raise InvalidActionError(
            f"{count} actions of {period:g} s last {count * period:g} s, not at most {_LONGEST_CHUNK:g}"
        )
    (done,) = _truths(answer.get("done", False), "done", 1)
    return Chunk(ctrl.reshape(count, arms, each), np.array(magnet), done, period)


def _magnet(value: Any, is_chunk: bool, count: int, arms: int) -> list[tuple[bool, ...]]:
    """Of each action, whether each arm's weld is to hold."""
    rows = _values(value, "magnet")
    if is_chunk and rows.size == count * arms:
        return [_truths(row, "magnet", arms) for row in rows.reshape(count, arms)]
    return [_truths(value, "magnet", arms)] * count


def _ctrl(answer: Mapping[str, Any], drives: int) -> Array:
    if "ctrl" not in answer:
        raise InvalidActionError(f"an action needs ctrl, {drives} numbers")
    try:
        ctrl = np.asarray(answer["ctrl"], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidActionError(f"ctrl is no array of numbers: {error}") from error
    if ctrl.shape != (drives,) and (ctrl.ndim != 2 or ctrl.shape[1] != drives or not 1 <= len(ctrl) <= MOST_ACTIONS):
        raise InvalidActionError(
            f"ctrl has the shape {ctrl.shape}, not ({drives},), or (1 to {MOST_ACTIONS} actions, {drives})"
        )
    if not np.isfinite(ctrl).all():
        raise InvalidActionError(f"ctrl is not finite: {np.array2string(ctrl, precision=3, threshold=20)}")
    return ctrl


def _check_angles(ctrl: Array) -> None:
    """Refuse joints in another unit than rad; the last drive may be a gripper's."""
    joints = ctrl[..., :-1]
    if joints.size == 0:
        return
    largest = float(joints.flat[int(np.argmax(np.abs(joints)))])
    try:
        _ANGLE.check(largest)
    except ValueError as error:
        raise InvalidActionError(f"ctrl has a joint at {largest:g}, which {error}") from error


def _truths(value: object, key: str, count: int) -> tuple[bool, ...]:
    values = _values(value, key).ravel()
    if values.size != count or values.dtype.kind not in "bif" or not np.isin(values, (0, 1)).all():
        wanted = "true or false" if count == 1 else f"{count} times true or false, the left arm's first"
        raise InvalidActionError(f"{key} is {repr(value)[:80]}, not {wanted}")
    return tuple(map(bool, values))


def _values(value: object, key: str) -> np.ndarray:
    try:
        return np.asarray(value)
    except (TypeError, ValueError) as error:
        raise InvalidActionError(f"{key} is no array of truth values: {error}") from error
