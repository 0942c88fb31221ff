"""`CartesianStation`: hand poses of both arms as actions, by the conventions of `inspect-robots-yam`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from inspect_robots import ActionSemantics, Box

from ..core.config.rig import ArmConfig
from ..core.expert.planning.arm_kinematics import ArmKinematics
from ..core.expert.planning.ik import IkSolver
from ..core.geometry.se3 import Array, pose, rotation_from_vector, rotation_z
from ..core.scene.arm_model import kinematic_model
from .scene_stepper import ACTION_DIM, ARM_JOINTS, MIN_CLOSING_S

EEF_STATE = "eef_state"  # key of the observed hand poses and gripper openings (14,)
EEF_LABELS = tuple(
    f"{side}_{part}" for side in ("left", "right") for part in ("x", "y", "z", "yaw", "pitch", "roll", "gripper")
)

# Bounds of an arm's x, y, z (m), yaw, pitch, roll (rad) and gripper, and joints (rad) and gripper at the start of a
# trial. Source: `config.py` of inspect-robots-yam 0.37.
_LOW = (0.15, -0.25, 0.03, -math.pi, 0.0, 0.0, 0.0)
_HIGH = (0.48, 0.25, 0.40, math.pi, 0.0, 0.0, 1.0)
_TILT_LIMITS = {4: 0.6, 5: math.pi / 2}  # rad, of pitch and roll if they may vary
START = (-0.024, 0.794, 0.645, -0.375, -0.021, -0.012, 1.0)

_IK_ITERATIONS = 100  # of the search for the nearest pose, which runs if a pose is out of reach


class CartesianArm:
    """Poses of a hand's `grasp_site` in the base of its arm.

    A pose is x, y, z (m), yaw, pitch, roll (rad), (6,). The angles turn the hand from its orientation at the start of
    the trial: first by roll about +x, then by pitch about -y and by yaw about +z of the base.
    """

    def __init__(self, arm: ArmConfig) -> None:
        model = kinematic_model(arm)
        self._forward, self._solver = ArmKinematics(model), IkSolver(model, np.eye(4))
        self._solver.set_held_object_frame(self._forward.T_site_in_pinch("grasp_site"))
        self.start_at(arm.robot.home)

    def start_at(self, joints: Sequence[float] | Array) -> None:
        """Set the orientation for which all angles are 0: that at joints (6,), rad."""
        self._R_start = self._forward.T_grasp_in_base(joints)[:3, :3]

    def pose_at(self, joints: Array) -> Array:
        """Return the pose (6,) at joints (6,), rad."""
        T = self._forward.T_grasp_in_base(joints)
        R = T[:3, :3] @ self._R_start.T
        pitch = math.asin(float(np.clip(R[2, 0], -1.0, 1.0)))
        return np.array([*T[:3, 3], math.atan2(R[1, 0], R[0, 0]), pitch, math.atan2(R[2, 1], R[2, 2])])

    def joints_at(self, target: Array, near: Array) -> Array:
        """Return the joints (6,), rad, nearest to joints `near` (6,) that reach a pose (6,).

        For a pose out of reach, return the joints of the nearest pose that a search from `near` finds.
        """
        yaw, pitch, roll = target[3:]
        R = rotation_z(yaw) @ rotation_from_vector([0.0, -pitch, 0.0]) @ rotation_from_vector([roll, 0.0, 0.0])
        return self._solver.solve(pose(target[:3], R @ self._R_start), near, _IK_ITERATIONS).joints


class CartesianStation:
    """Turns actions of hand poses into joint targets; the left arm comes first.

    Args:
        arms: the left and the right arm.
        tilts: whether pitch and roll may vary.
    """

    def __init__(self, arms: Sequence[ArmConfig], *, tilts: bool) -> None:
        self._arms = [CartesianArm(arm) for arm in arms]
        low, high = np.array(_LOW), np.array(_HIGH)
        if tilts:
            for place, limit in _TILT_LIMITS.items():
                low[place], high[place] = -limit, limit
        self._low, self._high = np.tile(low, 2), np.tile(high, 2)

    def action_space(self, period: float) -> Box:
        """Return the space of actions (14,): each arm's pose and gripper opening, 0..1.

        The `period` of an action, s, limits the steps of the grippers.
        """
        steps = [min(1.0, period / MIN_CLOSING_S) if label.endswith("gripper") else None for label in EEF_LABELS]
        semantics = ActionSemantics(
            control_mode="eef_abs_pose", gripper="continuous", dim_labels=EEF_LABELS, max_step=tuple(steps)
        )
        return Box((ACTION_DIM,), self._low, self._high, semantics)

    def start_at(self, state: Array) -> None:
        """Begin a trial at measured joints and grippers (14,)."""
        for arm, own in zip(self._arms, np.split(state, 2), strict=True):
            arm.start_at(own[:ARM_JOINTS])

    def observe(self, state: Array) -> Array:
        """Return poses and gripper openings (14,) at measured joints and grippers (14,)."""
        halves = zip(self._arms, np.split(state, 2), strict=True)
        return np.concatenate([[*arm.pose_at(own[:ARM_JOINTS]), own[ARM_JOINTS]] for arm, own in halves])

    def joint_targets(self, action: Array, references: Array) -> Array:
        """Return joint targets and gripper openings (14,) for an action (14,), which is clipped to its bounds.

        Args:
            references: present joint targets and gripper openings (14,), from which the arms move.
        """
        action = np.clip(action, self._low, self._high)
        halves = zip(self._arms, np.split(action, 2), np.split(references, 2), strict=True)
        return np.concatenate([[*arm.joints_at(own[:6], before[:ARM_JOINTS]), own[6]] for arm, own, before in halves])
