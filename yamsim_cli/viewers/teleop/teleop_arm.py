from __future__ import annotations

import mujoco
import numpy as np

from yamsim_cli.core.attempt_data import ArmPosture
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.expert.planning.ik import IkSolver
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose
from yamsim_cli.core.scene.arm_model import kinematic_model
from yamsim_cli.core.scene.compiled import CompiledScene
from yamsim_cli.core.sim.placement import ArmCollisionCheck

_MAX_SPEED_SHARE = 0.5  # of the motors' no-load speed; the rest overcomes load and friction
_MAX_ACCELERATION = 12.0  # rad/s^2, of each joint
_IK_ITERATIONS = 12  # in a control tick
_REACH_TOLERANCE = 0.003  # m, position error up to which a target counts as reachable
_LIMIT_DISTANCE = 0.005  # rad, below which a joint counts as at its limit
_CLEARANCE = 0.012  # m, smallest height of the finger tips' target above the table


class JointTracker:
    """The reference `joints` (dof,), rad, which follow a moving goal with bounded speed and acceleration, and stop on
    it.

    Args:
        motor_speed: no-load speed (dof,), rad/s.
        joint_range: joint limits (dof, 2), rad.
        tick: s.
    """

    def __init__(self, motor_speed: Array, joint_range: Array, tick: float) -> None:
        self._speed = _MAX_SPEED_SHARE * motor_speed
        self._low, self._high = joint_range.T
        self._tick = tick
        self.joints: Array = np.zeros_like(motor_speed)
        self._velocity: Array = np.zeros_like(motor_speed)

    def reset(self, joints: Array) -> None:
        """Set the reference to `joints` (dof,), rad, at rest."""
        self.joints, self._velocity = joints.copy(), np.zeros_like(joints)

    def next_reference(self, goal: Array) -> Array:
        """Return the reference (dof,) one tick later towards `goal` (dof,), without applying it."""
        distance = np.clip(goal, self._low, self._high) - self.joints
        # The speed from which braking ends at the goal, and the speed that reaches the goal in this tick.
        braking = np.sqrt(2 * _MAX_ACCELERATION * np.abs(distance))
        wanted = np.sign(distance) * np.minimum.reduce([self._speed, braking, np.abs(distance) / self._tick])
        most = _MAX_ACCELERATION * self._tick
        change: Array = np.clip(wanted - self._velocity, -most, most)
        reached: Array = np.clip(self.joints + (self._velocity + change) * self._tick, self._low, self._high)
        return reached

    def apply_reference(self, joints: Array) -> Array:
        """Set the reference to `joints` (dof,), and return the velocity (dof,) of this tick, rad/s."""
        self._velocity = (joints - self.joints) / self._tick
        self.joints = joints.copy()
        return self._velocity

    def halt(self) -> None:
        """Set the velocity to 0."""
        self._velocity = np.zeros_like(self._velocity)


class TeleopArm:
    """Moves an arm to a target with bounded speed, and stops it before a collision.

    Attributes:
        opening, max_opening: commanded and largest opening of each finger, m.
        target_distance: from the target pose to the nearest reachable pose, m; 0 if reachable.
        obstacle: that stops the arm; empty for none.
    """

    def __init__(self, config: RecordConfig, scene: CompiledScene, number: int) -> None:
        self._config = config
        self._arm = scene.arms[number]
        arm = config.rig.arms[self._arm.number]
        self.side = arm.side
        self._names = arm.robot.joint_names
        self.max_opening = self._arm.fingers.full_opening if self._arm.fingers else 0.0
        self._closed = min(_opening_around_object(config), self.max_opening)
        self._ik = IkSolver(kinematic_model(arm), self._arm.T_base_in_world)
        self._tracker = JointTracker(self._arm.motor_speed, self._arm.joint_range, config.task.timing.tick_seconds)
        self._collision_check = ArmCollisionCheck(scene, number)
        self._T_pinch_in_grasp = _fixed_pose(
            scene.model, f"{self._arm.prefix}pinch_site", f"{self._arm.prefix}grasp_site"
        )

    def reset(self, posture: ArmPosture) -> None:
        """Set the reference (the joints at which the commands aim) to a posture."""
        self._tracker.reset(posture.joints)
        self._joint_target: Array | None = None
        self._target = self._ik.forward_kinematics(posture.joints)
        self.opening, self.magnet = posture.opening, False
        # An arm that starts with closed fingers keeps them closed until its first command.
        self._was_commanded = self.opening > 0.0
        self.target_distance, self.obstacle = 0.0, ""

    @property
    def target_pose(self) -> Array:
        """Target pose (4, 4) of the pinch frame in `world`."""
        return self._target.copy()

    @property
    def is_open(self) -> bool:
        """Whether the commanded opening is larger than the closed gripper's."""
        return self.opening > self._closed

    @property
    def command_reference(self) -> Array:
        """Present reference (drives,): joints, rad, and, if the arm has fingers, opening, m."""
        return self._with_opening(self._tracker.joints)

    @property
    def at_limit(self) -> tuple[str, ...]:
        """Names of the joints at a joint limit."""
        low, high = self._arm.joint_range.T
        joints = self._tracker.joints
        near = (joints < low + _LIMIT_DISTANCE) | (joints > high - _LIMIT_DISTANCE)
        return tuple(name for name, there in zip(self._names, near, strict=True) if there)

    def set_target_pose(self, T_pinch_in_world: Array) -> None:
        """Set the target pose (4, 4) of the pinch frame in `world`. A target inside the table is lifted above it."""
        self._was_commanded, self._joint_target = True, None
        self._target = self._above_table(T_pinch_in_world)

    def set_grasp_target(self, T_grasp_in_world: Array) -> None:
        """Set the target pose (4, 4) of `grasp_site` in `world`."""
        self.set_target_pose(T_grasp_in_world @ self._T_pinch_in_grasp)

    def set_joint_target(self, joints: Array) -> None:
        """Set the target joints (dof,), rad, clipped to the joint limits."""
        reachable: Array = np.clip(joints, *self._arm.joint_range.T)
        self._was_commanded, self._joint_target, self._target = True, reachable, self._ik.forward_kinematics(reachable)

    def set_gripper(self, opening: float) -> None:
        """Set the opening of each finger, m, clipped to its range."""
        self._was_commanded, self.opening = True, min(max(opening, 0.0), self.max_opening)

    def toggle_gripper(self) -> None:
        """Open the gripper fully, or close it. With welds, it closes to the opening around the object."""
        self.set_gripper(self._closed if self.is_open else self.max_opening)

    def set_weld(self, on: bool) -> None:
        """Switch the weld, which holds an object near the hand, on or off."""
        self._was_commanded, self.magnet = True, on

    def release(self) -> None:
        """Switch the weld off, open the gripper, and hold the joints."""
        self.magnet = False
        if self._was_commanded:
            self.opening = self.max_opening
        self.halt()

    def halt(self) -> None:
        """Stop the arm at its present joints. Gripper and weld keep their commands."""
        self._joint_target = self._tracker.joints.copy()

    def step(self, qpos: Array) -> Array:
        """Advance the reference by a tick, and return the commands (drives,), rad and m."""
        before = self._tracker.joints
        velocity = self._step_reference(qpos)
        # As in `core.episode.commands.drive_commands`, without the inertia term, which needs the next target.
        command = (before + self._tracker.joints) / 2 + self._arm.velocity_gain * velocity / self._arm.position_gain
        return self._with_opening(command)

    def posture_of(self, reference: Array) -> ArmPosture:
        """Convert a value of `command_reference` (drives,) to a posture."""
        return ArmPosture(reference[: self._arm.dof], float(reference[-1]) if self._arm.fingers else 0.0)

    def _with_opening(self, joints: Array) -> Array:
        return joints.copy() if self._arm.fingers is None else np.append(joints, self.opening)

    def _step_reference(self, qpos: Array) -> Array:
        """Move the reference a tick towards the target, unless blocked. Return its velocity (dof,), rad/s."""
        tracker = self._tracker
        after = tracker.next_reference(self._solve_goal_joints())
        depth, name = self._collision_check.deepest_penetration(qpos, after)
        # A motion that reduces the penetration is allowed.
        if depth and depth >= self._collision_check.deepest_penetration(qpos, tracker.joints)[0]:
            self.obstacle = name
            tracker.halt()
            return np.zeros(self._arm.dof)
        self.obstacle = ""
        return tracker.apply_reference(after)

    def _solve_goal_joints(self) -> Array:
        """Return the target joints (dof,), rad, and update `target_distance`."""
        if self._joint_target is not None:
            self.target_distance = 0.0
            return self._joint_target
        solution = self._ik.solve_next(self._target, self._ik.solution_at(self._tracker.joints), _IK_ITERATIONS)
        self.target_distance = solution.position_error if solution.position_error > _REACH_TOLERANCE else 0.0
        return solution.joints

    def _above_table(self, T: Array) -> Array:
        table, lifted = self._config.widened_table, T.copy()
        x, y, _ = np.abs(T[:3, 3] - table.position)
        if x < table.half_size[0] and y < table.half_size[1]:
            lifted[2, 3] = max(lifted[2, 3], table.top_height + _CLEARANCE)
        return lifted


def _opening_around_object(config: RecordConfig) -> float:
    """Return the opening of one finger around the first object, m, to which grippers with welds close.

    Grasps by friction give 0, since the object stops the fingers.
    """
    grasps = (item.grasp for item in config.task.objects)
    first = next((grasp for grasp in grasps if grasp is not None), None)
    return first.opening if config.grasp == "weld" and first is not None else 0.0


def _fixed_pose(model: mujoco.MjModel, site: str, reference: str) -> Array:
    """Return the pose (4, 4) of a site in the frame of the site `reference` on the same body."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    T, T_reference = (pose(data.site(name).xpos, data.site(name).xmat.reshape(3, 3)) for name in (site, reference))
    return invert_pose(T_reference) @ T
