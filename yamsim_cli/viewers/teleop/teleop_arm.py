"""One arm that a person or a leader arm drives: its target, its motion, and what blocks it."""

from __future__ import annotations

import mujoco
import numpy as np

from yamsim_cli.core.attempt_data import ArmPosture
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.expert.planning.ik import IkSolver
from yamsim_cli.core.expert.planning.joint_tracker import JointTracker
from yamsim_cli.core.geometry.se3 import Array, inverse, pose
from yamsim_cli.core.scene.arm_model import kinematic_model
from yamsim_cli.core.scene.compiled import CompiledScene
from yamsim_cli.core.sim.placement import ArmCollisionCheck

_IK_ITERATIONS = 12
_REACH = 0.003  # m, from a target to the nearest pose of the hand; a target beyond is out of reach
_AT_LIMIT = 0.005  # rad, from a joint to its stop; a nearer joint counts as at the stop
_CLEARANCE = 0.012  # m, from the pinch frame's target to the table, which the finger tips must not enter


class TeleopArm:
    """Follows a target as fast as its motors can, and stops before the table, the other arm and itself.

    Attributes:
        side: "left" or "right".
        opening: commanded opening of each finger, m.
        widest: largest opening of each finger, m.
        magnet: whether the weld is commanded to hold.
        apart: distance from the target to the nearest pose in reach, m; 0 if the target is in reach.
        blocked: the obstacle that stops the arm; empty for none.

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
        self._ik = IkSolver(kinematic_model(arm), self._arm.T_base_in_world)
        self._pursuit = JointTracker(self._arm.motor_speed, self._arm.joint_range, config.task.timing.tick)
        self._obstruction = ArmCollisionCheck(scene, number)
        self._T_pinch_in_grasp = _fixed_pose(
            scene.model, f"{self._arm.prefix}pinch_site", f"{self._arm.prefix}grasp_site"
        )

    def reset(self, stand: ArmPosture) -> None:
        """Put the arm at rest at joints and an opening."""
        self._pursuit.reset(stand.joints)
        self._joint_target: Array | None = None
        self._target = self._ik.pose_of(stand.joints)
        self.opening, self.magnet = stand.opening, False
        # An arm that starts with closed fingers keeps them closed until it is commanded.
        self._used = self.opening > 0.0
        self.target_distance, self.obstacle = 0.0, ""

    @property
    def target(self) -> Array:
        """Target pose (4, 4) of the pinch frame in `world`."""
        return self._target.copy()

    @property
    def is_open(self) -> bool:
        """Whether the commanded opening is larger than around the held object."""
        return self.opening > self._closed

    @property
    def reference(self) -> Array:
        """The reference of the joints now, rad, and the commanded opening, m, if the arm has fingers."""
        return self._with_opening(self._pursuit.joints)

    @property
    def at_limit(self) -> tuple[str, ...]:
        """Names of the joints that are at a stop."""
        low, high = self._arm.joint_range.T
        joints = self._pursuit.joints
        near = (joints < low + _AT_LIMIT) | (joints > high - _AT_LIMIT)
        return tuple(name for name, there in zip(self._names, near, strict=True) if there)

    def set_target_pose(self, T_pinch_in_world: Array) -> None:
        """Set the hand's target (4, 4); a target inside the table is lifted above it."""
        self._used, self._joint_target = True, None
        self._target = self._above_table(T_pinch_in_world)

    def set_grasp_target(self, T_grasp_in_world: Array) -> None:
        """Set the hand's target: a pose (4, 4) of `grasp_site`."""
        self.set_target_pose(T_grasp_in_world @ self._T_pinch_in_grasp)

    def set_joint_target(self, joints: Array) -> None:
        """Set the target joints (dof,), rad, clipped to the stops."""
        reachable: Array = np.clip(joints, *self._arm.joint_range.T)
        self._used, self._joint_target, self._target = True, reachable, self._ik.pose_of(reachable)

    def set_gripper(self, opening: float) -> None:
        """Set the opening of each finger, m, clipped to its range."""
        self._used, self.opening = True, min(max(opening, 0.0), self.widest)

    def toggle_gripper(self) -> None:
        """Open the gripper fully, or close it: a weld's gripper to the object's opening, another gripper wholly."""
        self.set_gripper(self._closed if self.is_open else self.widest)

    def set_magnet(self, on: bool) -> None:
        """Switch the magnet, which holds an object within its reach."""
        self._used, self.magnet = True, on

    def release(self) -> None:
        """Switch the magnet off, open the gripper, and hold the joints."""
        self.magnet = False
        if self._used:
            self.opening = self.widest
        self.halt()

    def halt(self) -> None:
        """Hold the joints, and keep the grasp."""
        self._joint_target = self._pursuit.joints.copy()

    def step(self, qpos: Array) -> Array:
        """The commands to the drives for the next tick, rad and m.

        Args:
            qpos: MuJoCo's positions (nq,) now.
        """
        before = self._pursuit.joints
        velocity = self._step_reference(qpos)
        # As `episode.commands.drive_commands`, without the compensation of inertia: the next target is not known.
        command = (before + self._pursuit.joints) / 2 + self._arm.kv * velocity / self._arm.kp
        return self._with_opening(command)

    def posture_of(self, asked: Array) -> ArmPosture:
        """The stand of a value of `asked`."""
        return ArmPosture(asked[: self._arm.dof], float(asked[-1]) if self._arm.fingers else 0.0)

    def _with_opening(self, joints: Array) -> Array:
        return joints.copy() if self._arm.fingers is None else np.append(joints, self.opening)

    def _step_reference(self, qpos: Array) -> Array:
        """Move the reference a tick towards the target, unless blocked; returns its velocity (dof,), rad/s."""
        pursuit = self._pursuit
        after = pursuit.next_reference(self._goal())
        depth, name = self._obstruction.depth(qpos, after)
        # A motion out of an obstacle is allowed.
        if depth and depth >= self._obstruction.depth(qpos, pursuit.joints)[0]:
            self.obstacle = name
            pursuit.halt()
            return np.zeros(self._arm.dof)
        self.obstacle = ""
        return pursuit.apply_reference(after)

    def _goal(self) -> Array:
        """The target joints (dof,), rad."""
        if self._joint_target is not None:
            self.target_distance = 0.0
            return self._joint_target
        solution = self._ik.solve_next(self._target, self._ik.solution_at(self._pursuit.joints), _IK_ITERATIONS)
        self.target_distance = solution.position_error if solution.position_error > _REACH else 0.0
        return solution.joints

    def _above_table(self, T: Array) -> Array:
        table, lifted = self._config.table, T.copy()
        x, y, _ = np.abs(T[:3, 3] - table.position)
        if x < table.half_size[0] and y < table.half_size[1]:
            lifted[2, 3] = max(lifted[2, 3], table.top + _CLEARANCE)
        return lifted


def _opening_around_a_thing(config: RecordConfig) -> float:
    """The opening of one finger around the first object to grasp, m, to which the gripper of a weld closes.

    Fingers that hold by friction close until the object stops them: 0.
    """
    grasps = (item.grasp for item in config.task.objects)
    first = next((grasp for grasp in grasps if grasp is not None), None)
    return first.opening if config.grasp == "weld" and first is not None else 0.0


def _fixed_pose(model: mujoco.MjModel, site: str, reference: str) -> Array:
    """Pose (4, 4) of a site in another site of the same body."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    T, T_reference = (pose(data.site(name).xpos, data.site(name).xmat.reshape(3, 3)) for name in (site, reference))
    return inverse(T_reference) @ T
