"""`SceneStepper`: moves a scene by actions of a YAM station: joint targets and gripper openings, 0..1."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..core.episode.episode import Episode
from ..core.episode.episode_rules import EndReason
from ..core.episode.simulator import Simulator
from ..core.geometry.se3 import Array
from ..core.scene.compiled import ArmAddresses, FingerAddresses

# An arm's joints come before its gripper, and the left arm before the right one.
ARM_JOINTS = 6
_ARM_DIM = ARM_JOINTS + 1
ACTION_DIM = 2 * _ARM_DIM

MIN_CLOSING_S = 0.35  # s, shortest motion of fingers through their whole range
_REST_SPEED = 0.15  # rad/s and m/s; slower joints and objects are at rest
_FINGER_REST_SPEED = 0.01  # m/s; slower fingers are at rest
_MIN_GRIPPER_SHARE = 0.05  # gripper share; at 0 the gripper presses with its drive's full force


class RealizedScene(Protocol):
    """A compiled scene at rest."""

    @property
    def simulator(self) -> Simulator:
        """The simulator of the compiled scene."""

    def new_episode(self) -> Episode:
        """Return a new episode at its start."""


class SceneStepper:
    """Execute actions in a scene. The same actions from the same scene give bit-identical states.

    An action lasts several control ticks of 1/30 s. References of joints and fingers move linearly from the last target
    to the new one, or as far as the motor's speed allows.

    Attributes:
        data: MuJoCo's present state, with poses and contacts up to date.
    """

    def __init__(self, realization: RealizedScene, ticks: int) -> None:
        simulator = realization.simulator
        self._scene, self._ticks, self._tick = simulator.scene, ticks, simulator.config.task.timing.tick_seconds
        self.episode = realization.new_episode()
        self.data = self.episode.data
        # Cloth sways, and loose pieces roll, long after all other objects are at rest.
        model = self._scene.model
        moving = [one.dof.ravel() for one in self._scene.cloths.values()]
        for joints in self._scene.pieces.values():
            moving += [np.arange(dof, dof + 6) for dof in model.jnt_dofadr[list(joints)]]
        self._rigid_dofs = np.setdiff1d(np.arange(model.nv), np.concatenate([[], *moving]).astype(int))
        self._reference = self.measured_state()
        self._max_changes = np.concatenate(
            [[*(arm.motor_speed * self._tick), self._tick / MIN_CLOSING_S] for arm in self._scene.arms]
        )

    def measured_state(self) -> Array:
        """Return joints in rad and gripper openings, 0 closed .. 1 open, (14,); the left arm's first."""
        parts = []
        for arm, fingers in zip(self._scene.arms, scene_fingers(self._scene.arms), strict=True):
            opening = float(self.data.qpos[fingers.qpos[0]] * fingers.sign[0])
            parts += [self.data.qpos[arm.joint_qpos], [np.clip(opening / fingers.full_opening, 0.0, 1.0)]]
        return np.concatenate(parts)

    @property
    def last_reference(self) -> Array:
        """References at the end of the last action, as `measured_state`."""
        return self._reference.copy()

    def is_at_rest(self) -> bool:
        """Whether arms, fingers and rigid objects are almost still; cloth and loose pieces may move."""
        fingers = max(float(np.abs(self.data.qvel[fingers.dof]).max()) for fingers in scene_fingers(self._scene.arms))
        return float(np.abs(self.data.qvel[self._rigid_dofs]).max()) <= _REST_SPEED and fingers <= _FINGER_REST_SPEED

    def execute_action(self, action: Array) -> None:
        """Execute an action (14,): target joints and gripper openings, as `measured_state`."""
        scene, start = self._scene, self._reference
        limit = self._max_changes * self._ticks
        goal = start + np.clip(np.asarray(action, dtype=float) - start, -limit, limit)
        for tick in range(self._ticks):
            before, after = (start + (goal - start) * (tick + k) / self._ticks for k in (0, 1))
            self.episode.step(self._tick_commands(before, after), (False,) * len(scene.arms))
        self._reference = goal

    def physics_failure(self) -> str | None:
        """Return MuJoCo's fatal warning that ended the episode, if any."""
        end = self.episode.end
        return end.detail if end is not None and end.reason is EndReason.UNSTABLE else None

    def _tick_commands(self, before: Array, after: Array) -> Array:
        """Return the drives' commands (arms, 7) in a tick, from the references (14,) at its start and end."""
        rows = []
        for k, (arm, fingers) in enumerate(zip(self._scene.arms, scene_fingers(self._scene.arms), strict=True)):
            gripper = _ARM_DIM * k + ARM_JOINTS
            here = slice(_ARM_DIM * k, gripper)
            middle, speed = (before[here] + after[here]) / 2, (after[here] - before[here]) / self._tick
            # The velocity term compensates the drive's damping.
            rows.append(
                [
                    *(middle + arm.velocity_gain / arm.position_gain * speed),
                    commanded_opening(fingers, float(after[gripper])),
                ]
            )
        return np.array(rows)


def commanded_opening(fingers: FingerAddresses, share: float) -> float:
    """Return the drive command, opening of one finger, m, for a share, 0 closed .. 1 open."""
    low = fingers.ctrl_range[0]
    if share >= _MIN_GRIPPER_SHARE:
        return share * fingers.full_opening
    return float(low + share / _MIN_GRIPPER_SHARE * (_MIN_GRIPPER_SHARE * fingers.full_opening - low))


def commanded_share(fingers: FingerAddresses, opening: float) -> float:
    """Return the share for a drive command, m; the inverse of `commanded_opening`."""
    low = fingers.ctrl_range[0]
    if opening >= _MIN_GRIPPER_SHARE * fingers.full_opening:
        return float(min(1.0, opening / fingers.full_opening))
    return float(max(0.0, _MIN_GRIPPER_SHARE * (opening - low) / (_MIN_GRIPPER_SHARE * fingers.full_opening - low)))


def scene_fingers(arms: Sequence[ArmAddresses]) -> list[FingerAddresses]:
    """Return the fingers of each arm of the station."""
    found = [arm.fingers for arm in arms if arm.fingers is not None]
    assert len(found) == len(arms), "the station's arms have fingers"
    return found
