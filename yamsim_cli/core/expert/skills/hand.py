from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry.se3 import Array, invert_pose
from ...scene.compiled import ArmAddresses
from ..planning.dynamics import ArmDynamics
from ..planning.ik import IkSolver, Tolerance

GRASP_TOLERANCE = Tolerance(1.5e-3, math.radians(2.0))  # m and rad, where fingers close or open
WAYPOINT_TOLERANCE = Tolerance(4e-3, math.radians(6.0), allow_tilt=True)  # m and rad

# rad from its limits that every joint keeps if some grasp allows. Tracking errors and a gripper's load move joints by
# up to 0.05 rad, and a real arm differs from its model.
PREFERRED_JOINT_MARGIN = 0.15

_SIMILAR_DISTANCE, _SIMILAR_ANGLE = 0.01, math.radians(20.0)  # m and rad; grasps that differ by less count as similar


@dataclass(frozen=True)
class HeldObject:
    """An object in a hand, with its last measured pose in the pinch frame."""

    thing: str
    T_thing_in_pinch: Array


class Hand:
    """An arm with its gripper.

    Attributes:
        number: index of the arm in its scene.
        side: "left" or "right".
        ik: inverse kinematics of the pinch frame, which lies where the fingers meet.
        ready_joints: posture (dof,) in which an idle arm waits, rad.
        joints: last commanded joints (dof,), rad.
        opening: last commanded opening of each finger, m.
        grip_force: last commanded force of each finger, N.
        failed_grasps: grasps with which an object could not be brought to its goal; they are not tried again.
        joint_margin: least distance from joint limits in `solve_ik`, rad, see `PlanningContext.planning_limits`.
        allow_tilt: whether `solve_ik` may tilt the hand at waypoints.
    """

    def __init__(
        self,
        number: int,
        side: str,
        arm: ArmAddresses,
        ik: IkSolver,
        dynamics: ArmDynamics,
        ready: Array,
        opening: float,
    ) -> None:
        self.number, self.side, self.arm = number, side, arm
        self.ik, self.dynamics = ik, dynamics
        self.ready_joints = ready
        self.joints, self.opening, self.grip_force = ready.copy(), opening, 0.0
        self.weld_commanded = False
        self.held_object: HeldObject | None = None
        self.failed_grasps: list[HeldObject] = []
        self.joint_margin, self.allow_tilt = 0.0, False

    def is_similar_to_failed_grasp(self, thing: str, T_pinch_in_thing: Array) -> bool:
        """Return whether `failed_grasps` has a grasp similar to this."""
        earlier = [invert_pose(held.T_thing_in_pinch) for held in self.failed_grasps if held.thing == thing]
        return any(
            float(np.linalg.norm(T[:3, 3] - T_pinch_in_thing[:3, 3])) < _SIMILAR_DISTANCE
            and float(T[:3, 2] @ T_pinch_in_thing[:3, 2]) > math.cos(_SIMILAR_ANGLE)
            for T in earlier
        )

    @property
    def max_opening(self) -> float:
        """Largest opening of each finger that can be commanded, m."""
        assert self.arm.fingers is not None, "skills need hands with fingers"
        return float(self.arm.fingers.ctrl_range[1])

    @property
    def grasps_by_weld(self) -> bool:
        """Whether the hand holds objects by a weld instead of by friction."""
        return self.arm.weld is not None

    def pinch_pose(self, joints: Array) -> Array:
        """Return the pinch frame's pose in `world` at joints (dof,), rad."""
        return self.ik.forward_kinematics(joints)

    def solve_ik(
        self, T_pinch_in_world: Array, seeds: Sequence[Array], tolerance: Tolerance = GRASP_TOLERANCE
    ) -> Array | None:
        """Return joints (dof,) with the pinch frame at a pose, near `seeds`; None if none are found."""
        return self.ik.solve_from(T_pinch_in_world, seeds, self._with_planning_limits(tolerance))

    def may_be_reachable(self, T_pinch_in_world: Array, tolerance: Tolerance = GRASP_TOLERANCE) -> Array:
        """Return a flag (n,) for each pose (n, 4, 4). False: `solve_ik` cannot reach the pose without tilt."""
        return self.ik.may_be_reachable(T_pinch_in_world, self._with_planning_limits(tolerance))

    def _with_planning_limits(self, tolerance: Tolerance) -> Tolerance:
        margin, allow_tilt = (
            max(tolerance.joint_limit_margin, self.joint_margin),
            tolerance.allow_tilt and self.allow_tilt,
        )
        return Tolerance(tolerance.position, tolerance.rotation, margin, allow_tilt)
