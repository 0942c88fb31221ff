"""raiden's robot interface for policies: arms interpolate between actions, and stop if one is too far.

Source of all figures: `raiden/server.py` and `raiden/robot/controller.py` of TRI-ML/raiden 2353b10.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from yamsim_cli.core.config.rig import ArmConfig
from yamsim_cli.core.expert.planning.arm_kinematics import ArmKinematics
from yamsim_cli.core.expert.planning.ik import IkSolver
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.images.resize import resize_image
from yamsim_cli.core.scene.arm_model import kinematic_model

from .follower import JointController
from .motor_simulation import MotorSimulation
from .render_process import CameraFrames, RenderProcess

_ACTION_DURATION_S = 0.1  # s
_HOMING_DURATION_S = 2.0  # s, motion home after a reset
_COMMAND_PERIOD_S = 0.01  # s between a motion's commands
_MAX_JOINT_STEP = 0.2  # rad, from a joint to its command
_MAX_QUEUED = 32  # waiting actions; further ones are discarded
_IMAGE_SIDE = 384  # px, of the square to which images are stretched

_IK_ITERATIONS = 20  # for one pose, which is near the previous one
_ROTATION_COSTS = (1.0, 1.0, 1.0)  # the position has priority for unreachable poses
# Length of each of a rotation's two given rows, and sine of their angle.
_MIN_ROW_LENGTH = 1e-3


@dataclass(frozen=True)
class CameraView:
    """A camera's RGB image (height, width, 3) with its calibration.

    Attributes:
        K: intrinsics (3, 3).
        T_cam_in_base: pose (4, 4) in the left arm's base, OpenCV's convention.
        time_ns: since 1970.
    """

    picture: Image
    K: Array
    T_cam_in_base: Array
    time_ns: int


@dataclass(frozen=True)
class RobotObservation:
    """A policy's observation: views by camera, arrays (n,) by name, s since 1970, and more."""

    views: Mapping[str, CameraView]
    proprios: Mapping[str, Array]
    time: float
    extra: Mapping[str, Any]


class HandKinematics:
    """Kinematics of an arm's `grasp_site` in its base."""

    def __init__(self, arm: ArmConfig) -> None:
        model = kinematic_model(arm)
        self._forward = ArmKinematics(model)
        self._range: Array = model.jnt_range.copy()
        self._solver = IkSolver(model, np.eye(4), _ROTATION_COSTS)
        home = np.array(arm.robot.home)
        T_pinch, T_grasp = (self._forward.T_site_in_base(home, site) for site in ("pinch_site", "grasp_site"))
        self._solver.set_held_object_frame(invert_pose(T_pinch) @ T_grasp)

    def T_in_base(self, joints: Array) -> Array:
        """Return the hand's pose (4, 4) in the arm's base, at joints (dof,), rad."""
        return self._forward.T_grasp_in_base(joints)

    def solve_joints(self, T_hand_in_base: Array, near: Array) -> Array:
        """Return joints (dof,), rad, found from `near`; the nearest if the pose (4, 4) is unreachable."""
        start = np.clip(near, *self._range.T)
        return self._solver.solve_next(T_hand_in_base, self._solver.solution_at(start), _IK_ITERATIONS).joints


def pose_from_rotation_rows(position: Array, rows: Array) -> Array:
    """Return the pose (4, 4) of a position (3,) and a rotation's first two rows (6,), orthonormalized.

    Raises:
        ValueError: the rows define no rotation.
    """
    first, second = rows[:3], rows[3:]
    lengths = np.linalg.norm(first), np.linalg.norm(second)
    third = np.cross(first, second)
    if min(lengths) < _MIN_ROW_LENGTH or np.linalg.norm(third) < _MIN_ROW_LENGTH * lengths[0] * lengths[1]:
        raise ValueError(
            "the six numbers of a rotation are its first two rows; these are zero or parallel, and give no rotation"
        )
    x = first / lengths[0]
    z = third / np.linalg.norm(third)
    return pose(position, np.array([x, np.cross(z, x), z]))


@dataclass
class _Interpolation:
    start: Array
    goal: Array
    start_time: float
    duration: float


class PolicyRobot:
    """A robot that a policy commands by joints or hand poses, with observations.

    A row has each arm's joints in rad and gripper from 0 (closed) to 1 (open), the left arm's first.

    Attributes:
        stopped: why the arms hold still until the next reset; "" while actions are accepted.
        discarded: actions that did not fit the queue.

    Args:
        sides, followers, hands: of each arm, the left first.
        source: renders the cameras.
        names: camera in the scene -> in the observations.
    """

    def __init__(
        self,
        plant: MotorSimulation,
        sides: Sequence[str],
        followers: Sequence[JointController],
        hands: Sequence[HandKinematics],
        source: RenderProcess,
        names: Mapping[str, str],
    ) -> None:
        self._plant, self._sides, self._followers = plant, tuple(sides), tuple(followers)
        self._hands, self._source, self._names = tuple(hands), source, dict(names)
        self._widths = [follower.num_dofs() for follower in followers]
        self._joint_numbers, self._pose_numbers = sum(self._widths), 10 * len(self._widths)
        self._commanded: Array | None = None
        self._actions: deque[Array] = deque()
        self._motion: _Interpolation | None = None
        self._next_command = 0.0
        self._views: tuple[int, dict[str, CameraView]] = -1, {}
        self.stop_reason = ""
        self.discarded_actions = 0

    @property
    def metadata(self) -> dict[str, Any]:
        """Cameras, arrays, and the layout of an action."""
        parts = (("xyz", 3), ("rot6d", 6), ("grip", 1))
        return {
            "cameras": [self._names[camera] for camera in self._source.cameras],
            "action_type": "ee_pose",
            "action_shape": [self._pose_numbers],
            "action_layout": "+".join(f"{side}_{part}({n})" for part, n in parts for side in self._sides),
            "joint_action_shape": [self._joint_numbers],
            "joint_action_layout": "+".join(
                f"{side}_joints({n})" for side, n in zip(self._sides, self._widths, strict=True)
            ),
            "proprio_names": [name for side in self._sides for name in _proprio_names(side)],
        }

    @property
    def is_going_home(self) -> bool:
        """Whether the arms still move home after a reset."""
        return self._motion is not None and self._motion.duration == _HOMING_DURATION_S

    @property
    def sim_time(self) -> float:
        """Simulated time, s."""
        return self._plant.sim_time

    def reset(self) -> None:
        """Accept actions again, and move home: joints 0, grippers open."""
        goal = np.concatenate([np.append(np.zeros(width - 1), 1.0) for width in self._widths])
        self._actions.clear()
        self.stop_reason = ""
        self._commanded = None
        self._motion = _Interpolation(self._measured_row(), goal, self._plant.sim_time, _HOMING_DURATION_S)

    def stop(self, why: str) -> None:
        """Hold current positions, and ignore actions until the next reset."""
        self.stop_reason = why
        self._actions.clear()
        self._motion = None
        self._send_row(self._measured_row())

    def queue_action(self, numbers: Array) -> None:
        """Queue an action: all joints and grippers, or 10 numbers of hand pose per arm in `metadata`'s layout.

        A joint that would move too far stops the arms. Stopped or homing arms ignore actions.

        Raises:
            ValueError: the action has a wrong shape, is not finite, or has an invalid rotation.
        """
        if not np.isfinite(numbers).all():
            raise ValueError("an action has numbers that are not finite")
        if numbers.shape not in ((self._joint_numbers,), (self._pose_numbers,)):
            raise ValueError(f"an action has {self._pose_numbers} or {self._joint_numbers} numbers")
        if self.stop_reason or self.is_going_home:
            return
        row = numbers if len(numbers) == self._joint_numbers else self._joints_from_hand_poses(numbers)
        if fault := self._jump_message(row):
            self.stop(fault)
            return
        self._commanded = row
        if len(self._actions) >= _MAX_QUEUED:
            self.discarded_actions += 1
            return
        self._actions.append(row)

    def command_next_step(self) -> None:
        """Command the arms for the next physics step."""
        now = self._plant.sim_time
        if self._motion is None and self._actions:
            command = self._commanded_row()
            start = self._measured_row() if command is None else command
            self._motion = _Interpolation(start, self._actions.popleft(), now, _ACTION_DURATION_S)
        motion = self._motion
        if motion is None or now < self._next_command:
            return
        self._next_command = now + _COMMAND_PERIOD_S
        share = min((now - motion.start_time) / motion.duration, 1.0)
        self._send_row((1 - share) * motion.start + share * motion.goal)
        if share == 1.0:
            self._motion = None

    def observe(self, shot: CameraFrames) -> RobotObservation:
        """Return the observation with these frames, and the joints at their time."""
        proprios: dict[str, Array] = {}
        for side, hand, joints in zip(self._sides, self._hands, shot.joints, strict=True):
            T = hand.T_in_base(joints[:-1])
            values = joints, T[:3, 3], T[:2, :3].ravel(), joints[-1:]
            proprios |= dict(zip(_proprio_names(side), values, strict=True))
        if self._views[0] != shot.number:
            self._views = (
                shot.number,
                {self._names[camera]: self._camera_view(shot, camera) for camera in shot.pictures},
            )
        extra = {"sim_time": shot.sim_time, "stopped": self.stop_reason}
        return RobotObservation(self._views[1], proprios, shot.time_ns * 1e-9, extra)

    @property
    def camera_frames(self) -> CameraFrames | None:
        """Newest images of all cameras, if any."""
        return self._source.newest_frames

    def _camera_view(self, shot: CameraFrames, camera: str) -> CameraView:
        width, height = self._source.size
        K = np.diag([_IMAGE_SIDE / width, _IMAGE_SIDE / height, 1.0]) @ self._source.K[camera]
        picture = resize_image(shot.pictures[camera], (_IMAGE_SIDE, _IMAGE_SIDE), pad=False)
        return CameraView(picture, K, shot.T_cam_in_base[camera], shot.time_ns)

    def _joints_from_hand_poses(self, numbers: Array) -> Array:
        """Return a row for an action: all positions (3), all rotations (6), all grippers (1)."""
        arms = len(self._widths)
        positions, rows, grips = np.split(numbers, [3 * arms, 9 * arms])
        near = np.split(
            self._commanded if self._commanded is not None else self._measured_row(), np.cumsum(self._widths)[:-1]
        )
        found = []
        for hand, start, position, row, grip in zip(
            self._hands, near, positions.reshape(arms, 3), rows.reshape(arms, 6), grips, strict=True
        ):
            found.append(np.append(hand.solve_joints(pose_from_rotation_rows(position, row), start[:-1]), grip))
        return np.concatenate(found)

    def _jump_message(self, row: Array) -> str:
        off = np.abs(row - self._measured_row())
        ends = np.cumsum(self._widths)
        off[ends - 1] = 0.0  # may move through their whole range
        if off.max() <= _MAX_JOINT_STEP:
            return ""
        worst = int(off.argmax())
        arm = int(np.searchsorted(ends, worst, side="right"))
        joint = worst - (ends[arm] - self._widths[arm]) + 1
        return (
            f"an action commanded joint {joint} of the {self._sides[arm]} arm to move by {off[worst]:.2f} rad at once, "
            f"more than {_MAX_JOINT_STEP} rad; reset to continue"
        )

    def _commanded_row(self) -> Array | None:
        rows = [follower.commanded_joints for follower in self._followers]
        return None if any(row is None for row in rows) else np.concatenate([row for row in rows if row is not None])

    def _measured_row(self) -> Array:
        return np.concatenate([follower.joint_pos() for follower in self._followers])

    def _send_row(self, row: Array) -> None:
        for follower, joints in zip(self._followers, np.split(row, np.cumsum(self._widths)[:-1]), strict=True):
            follower.command_joint_pos(joints)


def _proprio_names(side: str) -> tuple[str, str, str, str]:
    return (
        f"follower_{side[0]}_joint_pos",
        f"robot__actual__poses__{side}::yam__xyz",
        f"robot__actual__poses__{side}::yam__rot_6d",
        f"robot__actual__grippers__{side}::yam_hand",
    )
