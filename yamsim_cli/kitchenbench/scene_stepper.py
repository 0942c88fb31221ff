"""A realized scene in motion, by actions of a YAM station: joint targets and shares of the grippers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..core.episode.episode import Episode
from ..core.episode.episode_rules import EndReason
from ..core.episode.simulator import Simulator
from ..core.geometry.se3 import Array
from ..core.scene.compiled import ArmAddresses, FingerAddresses

# In actions and states, an arm's joints come before its gripper, and the left arm before the right one.
ARM_JOINTS = 6
_ARM = ARM_JOINTS + 1
ACTION_DIM = 2 * _ARM

CLOSING = 0.35  # s, in which fingers move through their whole range
_SLOW = 0.15  # rad/s and m/s; slower joints and things are at rest
_FINGERS_SLOW = 0.01  # m/s; slower fingers are at rest
_PRESSES = 0.05  # share of a gripper below which it presses, at 0 with its drive's full force


class RealizedScene(Protocol):
    """A scene that is compiled and at rest, see `scene.BenchmarkScene` and `own.TaskScene`."""

    @property
    def simulator(self) -> Simulator:
        """The simulator of the compiled scene."""

    def episode(self) -> Episode:
        """A new episode, at its start."""


class SceneStepper:
    """A scene in motion. The same actions from the same realization give the same bits.

    An action lasts some control ticks of 1/30 s. In these, each joint's reference moves evenly from the last target to
    the new one, or as far as its motor's speed allows; fingers likewise.

    Attributes:
        data: MuJoCo's present state, with current poses and contacts.

    Args:
        ticks: control ticks an action.
    """

    def __init__(self, realization: RealizedScene, ticks: int) -> None:
        simulator = realization.simulator
        self._scene, self._ticks, self._tick = simulator.scene, ticks, simulator.config.task.timing.tick
        self.episode = realization.episode()
        self.data = self.episode.data
        # Cloth sways long after all else is at rest.
        cloth = [one.dof.ravel() for one in self._scene.cloths.values()]
        self._stiff = np.setdiff1d(np.arange(self._scene.model.nv), np.concatenate([[], *cloth]).astype(int))
        self._reference = self.state()
        self._reach = np.concatenate(
            [[*(arm.motor_speed * self._tick), self._tick / CLOSING] for arm in self._scene.arms]
        )

    def state(self) -> Array:
        """Joints in rad and openings of the grippers, 0 closed .. 1 open, (14,); the left arm's first."""
        parts = []
        for arm, fingers in zip(self._scene.arms, scene_fingers(self._scene.arms), strict=True):
            opening = float(self.data.qpos[fingers.qpos[0]] * fingers.sign[0])
            parts += [self.data.qpos[arm.joint_qpos], [np.clip(opening / fingers.stroke, 0.0, 1.0)]]
        return np.concatenate(parts)

    @property
    def reference(self) -> Array:
        """The references (14,) at the end of the last action, as in `state`."""
        return self._reference.copy()

    def is_at_rest(self) -> bool:
        """Whether arms, fingers and stiff things are almost still."""
        fingers = max(float(np.abs(self.data.qvel[fingers.dof]).max()) for fingers in scene_fingers(self._scene.arms))
        return float(np.abs(self.data.qvel[self._stiff]).max()) <= _SLOW and fingers <= _FINGERS_SLOW

    def act(self, action: Array) -> None:
        """Let an action (14,) act."""
        scene, start = self._scene, self._reference
        most = self._reach * self._ticks
        goal = start + np.clip(np.asarray(action, dtype=float) - start, -most, most)
        for tick in range(self._ticks):
            before, after = (start + (goal - start) * (tick + k) / self._ticks for k in (0, 1))
            self.episode.step(self._ctrl(before, after), (False,) * len(scene.arms))
        self._reference = goal

    def broken(self) -> str | None:
        """How physics broke down; None if it did not."""
        end = self.episode.end
        return end.detail if end is not None and end.reason is EndReason.UNSTABLE else None

    def _ctrl(self, before: Array, after: Array) -> Array:
        """Commands to the drives (arms, joints and gripper) on a tick, from the references (14,) at both its ends."""
        rows = []
        for k, (arm, fingers) in enumerate(zip(self._scene.arms, scene_fingers(self._scene.arms), strict=True)):
            gripper = _ARM * k + ARM_JOINTS
            here = slice(_ARM * k, gripper)
            middle, speed = (before[here] + after[here]) / 2, (after[here] - before[here]) / self._tick
            # The term of the speed compensates the drive's damping.
            rows.append([*(middle + arm.kv / arm.kp * speed), commanded_opening(fingers, float(after[gripper]))])
        return np.array(rows)


def commanded_opening(fingers: FingerAddresses, share: float) -> float:
    """The command to a gripper's drive for a share, 0 closed .. 1 open: the opening of one finger, m."""
    low = fingers.ctrl_range[0]
    if share >= _PRESSES:
        return share * fingers.stroke
    return float(low + share / _PRESSES * (_PRESSES * fingers.stroke - low))


def commanded_share(fingers: FingerAddresses, opening: float) -> float:
    """The share whose command to a gripper's drive is an opening (m); the inverse of `commanded_opening`."""
    low = fingers.ctrl_range[0]
    if opening >= _PRESSES * fingers.stroke:
        return float(min(1.0, opening / fingers.stroke))
    return float(max(0.0, _PRESSES * (opening - low) / (_PRESSES * fingers.stroke - low)))


def scene_fingers(arms: Sequence[ArmAddresses]) -> list[FingerAddresses]:
    """The fingers of each arm of the station."""
    found = [arm.fingers for arm in arms if arm.fingers is not None]
    assert len(found) == len(arms), "the station's arms have fingers"
    return found
