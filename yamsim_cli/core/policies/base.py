"""What a policy is to yamsim: what it sees, what it answers, and what it may ask for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..geometry.se3 import Array

# Six joints and the gripper.
DRIVES = 7

# What an observation holds, beside the images.
SCENE_IMAGE, WRIST_IMAGE = "scene_rgb", "wrist_rgb"
IMAGES = {"scene": SCENE_IMAGE, "wrist": WRIST_IMAGE}

# As a policy sees it: `scene_rgb` and `wrist_rgb` (height, width, 3) of uint8, `joints` (7,) as in a dataset's frame,
# `gripper` (its last), `ee_pose_world` (4, 4) of `grasp_site`, `K_scene` (3, 3), `T_cam_in_world` (4, 4) of the scene
# camera in OpenCV's convention, `time` in s since the start, `prompt`.
Observation = Mapping[str, Any]


class Policy(Protocol):
    """Any object with these two methods.

    It may have, as attributes of the class or the object:

    - `images`: which of "scene" and "wrist" it wants to see; both unless given. What nobody asks for is not drawn.
    - `ticks`: for how many control ticks of 32 ms an action holds; 1 unless given, 2 for the rate of datasets.

    `reset` is given the trial's seed if it has a parameter `seed`.
    """

    def reset(self) -> None:
        """Forget the trial before."""
        ...

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        """Answer an observation: `ctrl` (7,) for the drives, rad and m; `magnet` and `done`, False unless given."""
        ...


@dataclass(frozen=True)
class Action:
    """A policy's answer, once it is known to be one.

    Attributes:
        ctrl: what the drives are told (7,), rad and m.
        magnet: whether the weld is to hold.
        done: whether the policy is finished, once this has acted.
    """

    ctrl: Array
    magnet: bool
    done: bool


class InvalidActionError(ValueError):
    """A policy's answer that is none; the text says what is wrong with it."""


def read_action(answer: object) -> Action:
    """Check a policy's answer.

    Raises:
        InvalidActionError: it is no mapping with `ctrl` of seven finite numbers, or has anything but truth values else.
    """
    if not isinstance(answer, Mapping):
        raise InvalidActionError(f"an action is a dictionary with ctrl, magnet and done, not {type(answer).__name__}")
    if unknown := sorted(map(str, answer.keys() - {"ctrl", "magnet", "done"})):
        raise InvalidActionError(f"an action holds ctrl, magnet and done, and not {', '.join(unknown)}")
    if "ctrl" not in answer:
        raise InvalidActionError("an action needs ctrl, seven numbers")
    try:
        ctrl = np.asarray(answer["ctrl"], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidActionError(f"ctrl is no array of numbers: {error}") from error
    if ctrl.shape != (DRIVES,):
        raise InvalidActionError(f"ctrl has the shape {ctrl.shape}, not ({DRIVES},)")
    if not np.isfinite(ctrl).all():
        raise InvalidActionError(f"ctrl is not finite: {np.array2string(ctrl, precision=3)}")
    return Action(ctrl, _truth(answer, "magnet"), _truth(answer, "done"))


def _truth(answer: Mapping[str, Any], key: str) -> bool:
    value = np.asarray(answer.get(key, False))
    if value.size != 1 or value.dtype.kind not in "bif" or value.ravel()[0] not in (0, 1):
        raise InvalidActionError(f"{key} is {answer[key]!r}, not true or false")
    return bool(value.ravel()[0])
