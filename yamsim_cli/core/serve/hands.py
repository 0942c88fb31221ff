"""Hands' poses, for programs that drive arms by them."""

from __future__ import annotations

import numpy as np

from ..config.rig import ArmConfig
from ..geometry.se3 import Array, inverse, pose
from ..planning.arm_kinematics import ArmKinematics
from ..planning.ik import IkSolver
from ..scene.robot import bare_arm

# Of one pose, which lies near the one before. Beyond them the nearest joints have to do.
_ITERATIONS = 20
# The position decides where the arm cannot reach the whole pose.
_ROTATION_COSTS = (1.0, 1.0, 1.0)
# Rows of a rotation that are shorter than this, or so nearly parallel, name none.
_SHORTEST = 1e-3


class Hand:
    """The kinematics of one arm's hand, its `grasp_site`, in the arm's own base."""

    def __init__(self, arm: ArmConfig) -> None:
        model = bare_arm(arm)
        self._forward = ArmKinematics(model)
        self._range: Array = model.jnt_range.copy()
        self._solver = IkSolver(model, np.eye(4), _ROTATION_COSTS)
        home = np.array(arm.robot.home)
        T_pinch, T_grasp = (self._forward.T_site_in_base(home, site) for site in ("pinch_site", "grasp_site"))
        self._solver.hold(inverse(T_pinch) @ T_grasp)

    def T_in_base(self, joints: Array) -> Array:
        """The hand's pose (4, 4) at joints (dof,)."""
        return self._forward.T_grasp_in_base(joints)

    def joints(self, T_hand_in_base: Array, near: Array) -> Array:
        """Joints (dof,) that bring the hand to a pose (4, 4), or the nearest that a search from `near` (dof,) finds."""
        start = np.clip(near, *self._range.T)
        return self._solver.follow(T_hand_in_base, self._solver.at(start), _ITERATIONS).joints


def pose_of_rows(position: Array, rows: Array) -> Array:
    """The pose (4, 4) at a position (3,) whose rotation has these first two rows (6,), made orthonormal.

    Raises:
        ValueError: the rows name no rotation.
    """
    first, second = rows[:3], rows[3:]
    lengths = np.linalg.norm(first), np.linalg.norm(second)
    third = np.cross(first, second)
    if min(lengths) < _SHORTEST or np.linalg.norm(third) < _SHORTEST * lengths[0] * lengths[1]:
        raise ValueError("the six numbers of a rotation are its first two rows, and these name none")
    x = first / lengths[0]
    z = third / np.linalg.norm(third)
    return pose(position, np.array([x, np.cross(z, x), z]))
