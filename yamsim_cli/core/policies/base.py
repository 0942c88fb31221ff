"""What a policy is to yamsim: what it sees, what it answers, and what it may ask for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..geometry.se3 import Array
from ..types import Holds

# Of an arm: six joints and the gripper.
DRIVES = 7

# What a policy may ask to see. "wrist" is every wrist camera that there is.
SCENE, WRIST = "scene", "wrist"
IMAGES = (SCENE, WRIST, "left_wrist", "right_wrist")

# What a policy may ask to be told besides: where things are, which only a simulation knows, and how fast joints are.
OBJECTS, VELOCITIES = "objects", "velocities"
STATE = (OBJECTS, VELOCITIES)

# As a policy sees it. Of two arms, numbers are the left one's and then the right one's.
# - `scene_rgb` (height, width, 3) of uint8; `wrist_rgb`, or of two arms `left_wrist_rgb` and `right_wrist_rgb`; each is
#   drawn when it is first read
# - `joints` (7,) or (14,) as in a dataset's frame; `gripper`, the openings in it: a number, or (2,)
# - `ee_pose_world` (4, 4) or (2, 4, 4) of `grasp_site`
# - `K_scene` (3, 3), `T_cam_in_world` (4, 4) of the scene camera in OpenCV's convention
# - `time` in s since the start, `prompt`
# - for "objects", `T_object_in_world` (4, 4) of what is picked up, `T_target_in_world` (4, 4) of what it is put onto
# - for "velocities", `joint_velocities` (7,) or (14,) in the order of `joints`, rad/s and m/s
Observation = Mapping[str, Any]


class Policy(Protocol):
    """Any object with these two methods.

    It may have, as attributes of the class or the object:

    - `images`: which of `IMAGES` it wants to see; "scene" and "wrist" unless given.
    - `wants`: which of `STATE` it wants to be told; nothing unless given.
    - `ticks`: for how many control ticks of 32 ms an action holds; 1 unless given, 2 for the rate of datasets.

    `reset` is given the trial's seed if it has a parameter `seed`.
    """

    def reset(self) -> None:
        """Forget the trial before."""
        ...

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        """Answer an observation: `ctrl` (7,) for the drives, rad and m; `magnet` and `done`, False unless given.

        For two arms, `ctrl` (14,) and `magnet` (2,), the left one's first.
        """
        ...


@dataclass(frozen=True)
class Action:
    """A policy's answer, once it is known to be one.

    Attributes:
        ctrl: what the drives are told (7,) or (14,), rad and m.
        magnet: whether the weld is to hold; of two arms, each one's.
        done: whether the policy is finished, once this has acted.
    """

    ctrl: Array
    magnet: Holds
    done: bool


class InvalidActionError(ValueError):
    """A policy's answer that is none; the text says what is wrong with it."""


def read_action(answer: object, arms: int = 1) -> Action:
    """Check a policy's answer.

    Args:
        arms: how many it drives.

    Raises:
        InvalidActionError: it is no mapping with `ctrl` of seven finite numbers an arm, or has anything but truth
            values else.
    """
    if not isinstance(answer, Mapping):
        raise InvalidActionError(f"an action is a dictionary with ctrl, magnet and done, not {type(answer).__name__}")
    if unknown := sorted(map(str, answer.keys() - {"ctrl", "magnet", "done"})):
        raise InvalidActionError(f"an action holds ctrl, magnet and done, and not {', '.join(unknown)}")
    drives = DRIVES * arms
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
    return Action(ctrl, _magnet(answer, arms), _truths(answer, "done", 1)[0])


def _magnet(answer: Mapping[str, Any], arms: int) -> Holds:
    if arms == 1:
        return _truths(answer, "magnet", 1)[0]
    return _truths(answer, "magnet", arms) if "magnet" in answer else (False,) * arms


def _truths(answer: Mapping[str, Any], key: str, count: int) -> tuple[bool, ...]:
    values = np.asarray(answer.get(key, False)).ravel()
    if values.size != count or values.dtype.kind not in "bif" or not np.isin(values, (0, 1)).all():
        wanted = "true or false" if count == 1 else f"{count} times true or false, the left arm's first"
        raise InvalidActionError(f"{key} is {answer[key]!r}, not {wanted}")
    return tuple(map(bool, values))
