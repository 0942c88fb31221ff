"""The poses of things as one row of numbers, for policies that use no pictures.

A thing has its position, the first two axes of its frame, both in the robot's base, and the joints of its moving parts.
Two axes represent a rotation continuously, unlike angles and quaternions.
Source: Zhou et al., On the Continuity of Rotation Representations in Neural Networks, 2019.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..config.recording import RecordConfig
from ..geometry.se3 import Array

_POSE_NAMES = tuple(f"{part}{axis}" for part in ("", "x_axis_", "y_axis_") for axis in "xyz")


def object_pose_keys(config: RecordConfig) -> dict[str, str]:
    """Thing -> key of its pose in an observation, of all things of a task, in their order in a row."""
    cast = config.task.typical_roles
    names = {
        thing: role if len(things) == 1 else thing for role, things in cast.objects_by_role.items() for thing in things
    }
    return {thing: f"T_{names[thing]}_in_world" for thing in cast.config_names}


def joints_key(thing: str) -> str:
    """Key of the joints of a thing with moving parts, in an observation and in a dataset's frame."""
    return f"{thing}_joints"


def state_names(things: Sequence[str], joints: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """The name of each number in a row.

    Args:
        joints: thing -> names of its joints, for those that have any.
    """
    parts = {thing: [f"joint_{name}" for name in joints.get(thing, ())] for thing in things}
    return tuple(f"{thing}_{name}" for thing in things for name in (*_POSE_NAMES, *parts[thing]))


def state_row(things: Sequence[tuple[Array, ArrayLike]]) -> Array:
    """The row of numbers, 9 for each thing and one for each of its joints.

    Args:
        things: of each thing, its pose (4, 4) in the robot's base, and its joints (n,), m or rad.
    """
    return np.concatenate([part for T, joints in things for part in (T[:3, 3], T[:3, 0], T[:3, 1], np.ravel(joints))])
