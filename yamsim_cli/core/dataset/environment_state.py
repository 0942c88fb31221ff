"""Object poses as one row of numbers, for policies that use no images.

Each object contributes its position, the x and y axes of its frame, and its joint positions. Position and axes are in
the robot base frame. Two axes represent a rotation continuously, unlike angles and quaternions.
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
    """Return object -> key of its pose in an observation, for all objects, in the order of `make_state_row`."""
    cast = config.task.typical_roles
    names = {
        thing: role if len(things) == 1 else thing for role, things in cast.objects_by_role.items() for thing in things
    }
    return {thing: f"T_{names[thing]}_in_world" for thing in cast.config_names}


def joints_key(thing: str) -> str:
    """Return the key of an articulated object's joints, in an observation and in a dataset frame."""
    return f"{thing}_joints"


def state_names(things: Sequence[str], joints: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """Return names of the elements of `make_state_row`, such as `cube_x`; `joints`: object -> joint names."""
    parts = {thing: [f"joint_{name}" for name in joints.get(thing, ())] for thing in things}
    return tuple(f"{thing}_{name}" for thing in things for name in (*_POSE_NAMES, *parts[thing]))


def make_state_row(things: Sequence[tuple[Array, ArrayLike]]) -> Array:
    """Return 9 numbers and the joints (m or rad) of each object, from its pose (4, 4) in the robot base and joints."""
    return np.concatenate([part for T, joints in things for part in (T[:3, 3], T[:3, 0], T[:3, 1], np.ravel(joints))])
