"""One arm of a session that a person drives: where its hand is to be, how it gets there, and what keeps it from it."""

from __future__ import annotations

import mujoco
import numpy as np

from ..config.recording import RecordConfig
from ..geometry.se3 import Array, inverse, pose
from ..planning.ik import IkSolver
from ..planning.pursuit import Pursuit
from ..scene.compiled import CompiledScene
from ..scene.robot import bare_arm
from ..sim.obstruction import Obstruction
from ..types import Stand

_IK_ITERATIONS = 12
# A target this far from where the hand can be is out of reach, m.
_REACH = 0.003
# This near to its stop a joint is at it, rad.
_AT_LIMIT = 0.005
# The pinch frame's origin is never asked to be nearer to the table than this: the finger tips would be in it, m.
_CLEARANCE = 0.012


class DrivenArm:
    """Follows a target, as fast as its motors can and no nearer to the table, the other arm or itself than it may.

    Attributes:
        side: "left" or "right".
        opening: that each finger is asked for, m.
        widest: how far each finger goes, m.
        magnet: whether its weld is to hold.
        apart: how far the target is out of reach, m; 0 where the hand can be there.
        blocked: what is in its way; empty where nothing is.

    Args:
        number: of the arm, in the scene.
    """

    def __init__(self, config: RecordConfig, scene: CompiledScene, number: int) -> None:
        self._config = config
        self._arm = scene.arms[number]
        arm = config.rig.arms[self._arm.number]
        self.side = arm.side
        self._names = arm.robot.joint_names
        self.widest = self._arm.fingers.stroke if self._arm.fingers else 0.0
        self._closed = min(_opening_around_a_thing(config), self.widest)
        self._ik = IkSolver(bare_arm(arm), self._arm.T_base_in_world)
        self._pursuit = Pursuit(self._arm.motor_speed, self._arm.joint_range, config.task.timing.tick)
        self._obstruction = Obstruction(scene, number)
        self._T_pinch_in_grasp = _fixed_pose(
            scene.model, f"{self._arm.prefix}pinch_site", f"{self._arm.prefix}grasp_site"
        )

    def reset(self, stand: Stand) -> None:
        """Be at rest as it stands there."""
        self._pursuit.reset(stand.joints)
        self._joint_target: Array | None = None
        self._target = self._ik.pose_of(stand.joints)
        self.opening, self.magnet = stand.opening, False
        # One that rests with its fingers closed goes on so until it is asked for something.
        self._used = self.opening > 0.0
        self.apart, self.blocked = 0.0, ""

    @property
    def target(self) -> Array:
        """Where the pinch frame is to be: pose (4, 4) in `world`."""
        return self._target.copy()

    @property
    def is_open(self) -> bool:
        """Whether the fingers are asked to be farther apart than around the object that they hold."""
        return self.opening > self._closed

    @property
    def asked(self) -> Array:
        """The joints, and the opening if it has fingers, that it is asked for now."""
        return self._with_opening(self._pursuit.joints)

    @property
    def at_limit(self) -> tuple[str, ...]:
        """Joints that have come to a stop."""
        low, high = self._arm.joint_range.T
        joints = self._pursuit.joints
        near = (joints < low + _AT_LIMIT) | (joints > high - _AT_LIMIT)
        return tuple(name for name, there in zip(self._names, near, strict=True) if there)

    def aim(self, T_pinch_in_world: Array) -> None:
        """Give the hand another target (4, 4); one in the table is lifted out of it."""
        self._used, self._joint_target = True, None
        self._target = self._above_table(T_pinch_in_world)

    def aim_grasp(self, T_grasp_in_world: Array) -> None:
        """Give the hand another target: a pose (4, 4) of `grasp_site`."""
        self.aim(T_grasp_in_world @ self._T_pinch_in_grasp)

    def aim_joints(self, joints: Array) -> None:
        """Give it joints (dof,) in rad to go to; beyond a stop counts as at it."""
        reachable: Array = np.clip(joints, *self._arm.joint_range.T)
        self._used, self._joint_target, self._target = True, reachable, self._ik.pose_of(reachable)

    def set_gripper(self, opening: float) -> None:
        """Open each finger by so much, m; beyond its range counts as the end of it."""
        self._used, self.opening = True, min(max(opening, 0.0), self.widest)

    def toggle_gripper(self) -> None:
        """Open the gripper wide, or close it: to what the object needs, or as far as what is between lets it."""
        self.set_gripper(self._closed if self.is_open else self.widest)

    def set_magnet(self, on: bool) -> None:
        """Switch its magnet, which holds the object where the hand is at it."""
        self._used, self.magnet = True, on

    def release(self) -> None:
        """Let go of what it holds, and stand still where it is."""
        self.magnet = False
        if self._used:
            self.opening = self.widest
        self.halt()

    def halt(self) -> None:
        """Stand still where it is, and go on holding what it holds."""
        self._joint_target = self._pursuit.joints.copy()

    def step(self, qpos: Array) -> Array:
        """What its drives are told in the next tick, rad and m.

        Args:
            qpos: MuJoCo's positions (nq,) now.
        """
        before = self._pursuit.joints
        velocity = self._step_reference(qpos)
        # As `episode.commands.drive_command`, without what makes up for inertia: where a person goes next is not known.
        command = (before + self._pursuit.joints) / 2 + self._arm.kv * velocity / self._arm.kp
        return self._with_opening(command)

    def stand(self, asked: Array) -> Stand:
        """Joints and opening of what was `asked` once; without fingers there is no opening."""
        return Stand(asked[: self._arm.dof], float(asked[-1]) if self._arm.fingers else 0.0)

    def _with_opening(self, joints: Array) -> Array:
        return joints.copy() if self._arm.fingers is None else np.append(joints, self.opening)

    def _step_reference(self, qpos: Array) -> Array:
        """Go one tick towards the target unless something is in the way; the velocity (dof,) that this means, rad/s."""
        pursuit = self._pursuit
        after = pursuit.towards(self._goal())
        depth, name = self._obstruction.depth(qpos, after)
        # Out of what it is in already, it may go.
        if depth and depth >= self._obstruction.depth(qpos, pursuit.joints)[0]:
            self.blocked = name
            pursuit.halt()
            return np.zeros(self._arm.dof)
        self.blocked = ""
        return pursuit.go(after)

    def _goal(self) -> Array:
        """The joints (dof,) to go to, rad."""
        if self._joint_target is not None:
            self.apart = 0.0
            return self._joint_target
        solution = self._ik.follow(self._target, self._ik.at(self._pursuit.joints), _IK_ITERATIONS)
        self.apart = solution.position_error if solution.position_error > _REACH else 0.0
        return solution.joints

    def _above_table(self, T: Array) -> Array:
        table, lifted = self._config.table, T.copy()
        x, y, _ = np.abs(T[:3, 3] - table.position)
        if x < table.half_size[0] and y < table.half_size[1]:
            lifted[2, 3] = max(lifted[2, 3], table.top + _CLEARANCE)
        return lifted


def _opening_around_a_thing(config: RecordConfig) -> float:
    """Return the opening of one finger around what is taken first, m: fingers that only seem to hold it close so far.

    Fingers that hold by friction close wholly, until the thing stops them.
    """
    grasps = (item.grasp for item in config.task.objects)
    first = next((grasp for grasp in grasps if grasp is not None), None)
    return first.opening if config.grasp == "weld" and first is not None else 0.0


def _fixed_pose(model: mujoco.MjModel, site: str, reference: str) -> Array:
    """Pose (4, 4) of one site of a body in another one of it."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    T, T_reference = (pose(data.site(name).xpos, data.site(name).xmat.reshape(3, 3)) for name in (site, reference))
    return inverse(T_reference) @ T
