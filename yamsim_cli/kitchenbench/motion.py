"""A realized scene in motion, by actions as YAM stations take them: joint targets and shares of the grippers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..core.attempt.simulator import Simulator
from ..core.episode.episode import Episode
from ..core.episode.rules import EndReason
from ..core.geometry.se3 import Array
from ..core.scene.compiled import SceneArm, SceneFingers

#: Joints of a YAM arm. In actions and states they come first, then its gripper; the left arm before the right one.
ARM_JOINTS = 6
_ARM = ARM_JOINTS + 1
ACTION_DIM = 2 * _ARM

#: Fingers cross all of their way in so many seconds.
CLOSING = 0.35
# What is slower than this is at rest, rad/s and m/s; fingers, which close slowly, m/s.
_SLOW, _FINGERS_SLOW = 0.15, 0.01
# Below this share, a gripper that closes on something presses: at 0 with all that its drive gives.
_PRESSES = 0.05


class Realized(Protocol):
    """A scene that is compiled and at rest, see `scene.Realization` and `own.OwnRealization`."""

    @property
    def simulator(self) -> Simulator:
        """With the compiled scene."""

    def episode(self) -> Episode:
        """Return a new episode, at its start."""


class Motion:
    """A scene in motion. The same actions from the same realization give the same bits.

    An action lasts some control ticks of 1/30 s. Over these, each joint's reference goes evenly from where the last
    action left it to the new target, or as far towards it as its motor's speed allows; fingers likewise.

    Attributes:
        episode: which it lets act.
        data: MuJoCo's present state, poses and contacts up to date.

    Args:
        ticks: control ticks an action.
    """

    def __init__(self, realization: Realized, ticks: int) -> None:
        simulator = realization.simulator
        self._scene, self._ticks, self._tick = simulator.scene, ticks, simulator.config.task.timing.tick
        self.episode = realization.episode()
        self.data = self.episode.data
        # Cloth sways for long, and its own speed says little of it.
        cloth = [one.dof.ravel() for one in self._scene.cloths.values()]
        self._stiff = np.setdiff1d(np.arange(self._scene.model.nv), np.concatenate([[], *cloth]).astype(int))
        self._reference = self.state()
        self._reach = np.concatenate(
            [[*(arm.motor_speed * self._tick), self._tick / CLOSING] for arm in self._scene.arms]
        )

    def state(self) -> Array:
        """Joints (14,) in rad, and how far each gripper is open: 0 closed .. 1 open; the left arm's first."""
        parts = []
        for arm, fingers in zip(self._scene.arms, hands(self._scene.arms), strict=True):
            opening = float(self.data.qpos[fingers.qpos[0]] * fingers.sign[0])
            parts += [self.data.qpos[arm.joint_qpos], [np.clip(opening / fingers.stroke, 0.0, 1.0)]]
        return np.concatenate(parts)

    @property
    def reference(self) -> Array:
        """Where the last action left the references (14,), as in `state`."""
        return self._reference.copy()

    def at_rest(self) -> bool:
        """Whether arms, fingers and things are as good as still."""
        fingers = max(float(np.abs(self.data.qvel[fingers.dof]).max()) for fingers in hands(self._scene.arms))
        return float(np.abs(self.data.qvel[self._stiff]).max()) <= _SLOW and fingers <= _FINGERS_SLOW

    def act(self, action: Array) -> None:
        """Let an action (14,) act."""
        scene, start = self._scene, self._reference
        most = self._reach * self._ticks
        goal = start + np.clip(np.asarray(action, dtype=float) - start, -most, most)
        for tick in range(self._ticks):
            before, after = (start + (goal - start) * (tick + k) / self._ticks for k in (0, 1))
            self.episode.step(self._told(before, after), (False,) * len(scene.arms))
        self._reference = goal

    def broken(self) -> str | None:
        """Return what went wrong in physics itself, if anything did."""
        end = self.episode.end
        return end.detail if end is not None and end.reason is EndReason.UNSTABLE else None

    def _told(self, before: Array, after: Array) -> Array:
        """What the drives (arms, joints and gripper) are told on a tick, in which the references (14,) go so far."""
        rows = []
        for k, (arm, fingers) in enumerate(zip(self._scene.arms, hands(self._scene.arms), strict=True)):
            gripper = _ARM * k + ARM_JOINTS
            here = slice(_ARM * k, gripper)
            middle, speed = (before[here] + after[here]) / 2, (after[here] - before[here]) / self._tick
            # A drive damps all motion: this makes up for it.
            rows.append([*(middle + arm.kv / arm.kp * speed), told_opening(fingers, float(after[gripper]))])
        return np.array(rows)


def told_opening(fingers: SceneFingers, share: float) -> float:
    """What a gripper's drive is told for a share, 0 closed .. 1 open: the opening of one finger, m."""
    low = fingers.ctrl_range[0]
    if share >= _PRESSES:
        return share * fingers.stroke
    return float(low + share / _PRESSES * (_PRESSES * fingers.stroke - low))


def told_share(fingers: SceneFingers, opening: float) -> float:
    """The share for which a gripper's drive is told an opening (m): the other way round."""
    low = fingers.ctrl_range[0]
    if opening >= _PRESSES * fingers.stroke:
        return float(min(1.0, opening / fingers.stroke))
    return float(max(0.0, _PRESSES * (opening - low) / (_PRESSES * fingers.stroke - low)))


def hands(arms: Sequence[SceneArm]) -> list[SceneFingers]:
    """The fingers of each arm; the station's have some."""
    found = [arm.fingers for arm in arms if arm.fingers is not None]
    assert len(found) == len(arms), "the station's arms have fingers"
    return found
