"""The protocol of a policy: what it sees, what it answers, and what it may ask for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..geometry.se3 import Array

# What a policy may ask to see. "wrist" is every wrist camera that there is.
SCENE, WRIST = "scene", "wrist"
IMAGES = (SCENE, WRIST, "left_wrist", "right_wrist")

# Further numbers that a policy may ask for: the objects' poses, which only a simulation knows, and joint velocities.
OBJECTS, VELOCITIES = "objects", "velocities"
STATE = (OBJECTS, VELOCITIES)

# As a policy sees it. Of two arms, numbers are the left one's and then the right one's.
# - `scene_rgb` (height, width, 3) of uint8; `wrist_rgb`, or of two arms `left_wrist_rgb` and `right_wrist_rgb`; each is
#   rendered when it is first read
# - `joints` (drives,) as in a dataset's frame; `gripper`, the arms' openings: a number, or (2,), 0 without fingers
# - `ee_pose_world` (4, 4) or (2, 4, 4) of `grasp_site`
# - `K_scene` (3, 3), `T_cam_in_world` (4, 4) of the scene camera in OpenCV's convention
# - `time` in s since the start, `prompt`
# - for "objects", `T_object_in_world` (4, 4) of what is picked up, `T_target_in_world` (4, 4) of what it is put onto
# - for "velocities", `joint_velocities` (drives,) in the order of `joints`, rad/s and m/s
Observation = Mapping[str, Any]


class Policy(Protocol):
    """Any object with these two methods.

    It may have these attributes, of the class or the object:

    - `images`: which of `IMAGES` it asks for; "scene" and "wrist" unless given.
    - `wants`: which of `STATE` it asks for; nothing unless given.
    - `ticks`: how many control ticks of 32 ms an action lasts; 1 unless given. 2 is the rate of datasets.

    `reset` gets the trial's seed if it has a parameter `seed`.
    """

    def reset(self) -> None:
        """Forget the previous trial."""
        ...

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        """Answer an observation: `ctrl` (drives,), rad and m; `magnet` and `done`, False unless given.

        For two arms, `ctrl` and `magnet` (2,) have the left one's first.
        """
        ...


def of_arms(poses: Array) -> Array:
    """Poses (arms, 4, 4) as a policy is told of them: of a lone arm, its pose (4, 4)."""
    return poses if len(poses) > 1 else poses[0]


@dataclass(frozen=True)
class Action:
    """A policy's answer, after it was checked.

    Attributes:
        ctrl: what each arm's drives are told (arms, drives), rad and m.
        magnet: whether each arm's weld is to hold.
        done: whether the policy is finished after this action.
    """

    ctrl: Array
    magnet: tuple[bool, ...]
    done: bool


class InvalidActionError(ValueError):
    """A policy's answer that is no valid action; the text says what is wrong with it."""


def read_action(answer: object, arms: int, each: int) -> Action:
    """Check a policy's answer.

    Args:
        arms, each: how many arms it drives, and how many drives each of them has.

    Raises:
        InvalidActionError: it is no mapping with `ctrl` of a finite number for each drive, or has anything but truth
            values else.
    """
    if not isinstance(answer, Mapping):
        raise InvalidActionError(f"an action is a dictionary with ctrl, magnet and done, not {type(answer).__name__}")
    if unknown := sorted(map(str, answer.keys() - {"ctrl", "magnet", "done"})):
        raise InvalidActionError(f"an action holds ctrl, magnet and done, and not {', '.join(unknown)}")
    drives = arms * each
    if "ctrl" not in answer:
        raise InvalidActionError(f"an action needs ctrl, {drives} numbers")
    try:
        ctrl = np.asarray(answer["ctrl"], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidActionError(f"ctrl is no array of numbers: {error}") from error
    if ctrl.shape != (drives,):
        raise InvalidActionError(f"ctrl has the shape {ctrl.shape}, not ({drives},)")
    if not np.isfinite(ctrl).all():
        raise InvalidActionError(f"ctrl is not finite: {np.array2string(ctrl, precision=3)}")
    magnet = _truths(answer, "magnet", arms) if "magnet" in answer else (False,) * arms
    return Action(ctrl.reshape(arms, each), magnet, _truths(answer, "done", 1)[0])


def _truths(answer: Mapping[str, Any], key: str, count: int) -> tuple[bool, ...]:
    values = np.asarray(answer.get(key, False)).ravel()
    if values.size != count or values.dtype.kind not in "bif" or not np.isin(values, (0, 1)).all():
        wanted = "true or false" if count == 1 else f"{count} times true or false, the left arm's first"
        raise InvalidActionError(f"{key} is {answer[key]!r}, not {wanted}")
    return tuple(map(bool, values))
