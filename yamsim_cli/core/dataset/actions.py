"""The actions of a recorded episode, put together from its frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import DatasetError
from ..geometry.se3 import Array
from ..types import Actions
from .lowdim import has_simulation


def recorded_actions(frames: Sequence[Mapping[str, Any]], nq: int, nu: int) -> tuple[Array, Actions] | None:
    """The exact start of an episode and its actions.

    Args:
        frames: the episode's frames, each without faults, see `checks.lowdim.frame_faults`.
        nq, nu: how many positions and drives the scene has.

    Returns:
        MuJoCo's positions (nq,) at the first frame, and the actions. None if any frame lacks simulation data, as in a
        recording of real arms.

    Raises:
        DatasetError: the episode was recorded in another scene.
    """
    if not frames or not all(map(has_simulation, frames)):
        return None
    for k, frame in enumerate(frames):
        found = len(frame["sim_qpos"]), frame["sim_ctrl"].shape[1]
        if found != (nq, nu):
            raise DatasetError(
                f"frame {k} has {found[0]} positions and {found[1]} drives, and its scene {nq} and {nu}: "
                "the episode was made with another robot model or scene than its dataset says"
            )
    counts = [len(frame["sim_ctrl"]) for frame in frames]
    magnet = np.concatenate([frame["sim_magnet"] for frame in frames])
    # A lone arm has no axis in a frame.
    magnet = magnet.reshape(len(magnet), -1)
    asked = np.array([asked_joints(frame, magnet.shape[1]) for frame in frames])
    actions = Actions(np.concatenate([frame["sim_ctrl"] for frame in frames]), magnet, np.repeat(asked, counts, axis=0))
    return frames[0]["sim_qpos"], actions


def asked_joints(frame: Mapping[str, Any], arms: int) -> Array:
    """What a frame's plan asked of each arm: joints in rad and the opening of one finger in m, (arms, drives)."""
    joints: Array = np.asarray(frame["action_joints"], dtype=float).reshape(arms, -1)
    return joints
