"""One arm as skills see it: what it was told last, what it holds, and how it reaches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.se3 import Array, inverse
from ..planning.dynamics import ArmDynamics
from ..planning.ik import IkSolver, Tolerance
from ..scene.compiled import SceneArm

# Where fingers close or open; and where a hand only passes.
EXACT = Tolerance(1.5e-3, math.radians(2.0))
PASSING = Tolerance(4e-3, math.radians(6.0))

# rad, the distance from its stops that every joint keeps where a choice of grip allows that. Tracking errors and a
# gripper's load move joints by up to 0.05 rad; a real arm also differs from its model.
RESERVE = 0.15

# Ways to hold a thing that differ by less, in where the hand is and from where it comes, reach the same, m and rad.
_SAME_POSITION, _SAME_DIRECTION = 0.01, math.radians(20.0)


@dataclass(frozen=True)
class Held:
    """A thing in a hand, by its pose (4, 4) in the pinch frame, when it was last looked at."""

    thing: str
    T_thing_in_pinch: Array


class Hand:
    """An arm with its gripper.

    Attributes:
        number: of the arm in its scene.
        side: "left" or "right".
        arm: where its parts lie in MuJoCo's arrays, and what it can do.
        ik, dynamics: inverse kinematics of its pinch frame, and its inverse dynamics.
        joints: what it was told to reach last (dof,), rad.
        opening: of one finger, as told last, m.
        grip: how hard each finger is to press, N.
        magnet: whether its magnet is commanded on; without effect on a hand that has none.
        held: what it holds.
        failed_grasps: how it held things that it then could not put where they were to go.
        reserve: least distance of every joint from its stops at what `reach` finds, rad; see `Bench.reserve`.
    """

    def __init__(
        self,
        number: int,
        side: str,
        arm: SceneArm,
        ik: IkSolver,
        dynamics: ArmDynamics,
        ready: Array,
        opening: float,
    ) -> None:
        self.number, self.side, self.arm = number, side, arm
        self.ik, self.dynamics = ik, dynamics
        self.ready = ready
        self.joints, self.opening, self.grip = ready.copy(), opening, 0.0
        self.magnet = False
        self.held: Held | None = None
        self.failed_grasps: list[Held] = []
        self.reserve = 0.0

    def failed_with(self, thing: str, T_pinch_in_thing: Array) -> bool:
        """Whether it held a thing about so earlier, its pinch frame (4, 4) in the thing's, and could not put it where it
        was to go.
        """
        earlier = [inverse(held.T_thing_in_pinch) for held in self.failed_grasps if held.thing == thing]
        return any(
            float(np.linalg.norm(T[:3, 3] - T_pinch_in_thing[:3, 3])) < _SAME_POSITION
            and float(T[:3, 2] @ T_pinch_in_thing[:3, 2]) > math.cos(_SAME_DIRECTION)
            for T in earlier
        )

    @property
    def max_opening(self) -> float:
        """How far one finger can be told to open, m."""
        assert self.arm.fingers is not None, "skills are for hands with fingers"
        return float(self.arm.fingers.ctrl_range[1])

    @property
    def welds(self) -> bool:
        """Whether a weld holds what is in the hand, and not the friction of its fingers."""
        return self.arm.weld is not None

    def pinch_at(self, joints: Array) -> Array:
        """Pose (4, 4) of the pinch frame in `world` with the arm at `joints` (dof,)."""
        return self.ik.pose_of(joints)

    def reach(self, T_pinch_in_world: Array, seeds: Sequence[Array], tolerance: Tolerance = EXACT) -> Array | None:
        """Joints (dof,) that bring the pinch frame to a pose (4, 4), see `IkSolver.reach`."""
        return self.ik.reach(T_pinch_in_world, seeds, self._with_reserve(tolerance))

    def may_reach(self, T_pinch_in_world: Array, tolerance: Tolerance = EXACT) -> Array:
        """Return for which of many poses (n, 4, 4) `reach` may find joints, see `IkSolver.may_reach`."""
        return self.ik.may_reach(T_pinch_in_world, self._with_reserve(tolerance))

    def _with_reserve(self, tolerance: Tolerance) -> Tolerance:
        return replace(tolerance, margin=max(tolerance.margin, self.reserve))
