"""Observes an attempt while it runs: the arms' limits, what they touch, and how the object is held."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from ..geometry.se3 import Array, inverse, pose, tilt
from ..scene.compiled import CompiledScene, Kind, SceneArm
from ..types import Margins, Motion, Phases
from .faults import Faults


def object_pose(data: mujoco.MjData, name: str) -> Array:
    """Pose (4, 4) of a body in `world`, by the last forward kinematics."""
    body = data.body(name)
    return pose(body.xpos, body.xmat.reshape(3, 3))


class MotionMonitor:
    """Observes every physics step, and the object at the start of every control tick in which it is held.

    Args:
        data: the scene at the start.
        carried: name of the object.
        phases: when it is held, and by which arm.
        steps: number of physics steps in all.
    """

    def __init__(
        self, scene: CompiledScene, data: mujoco.MjData, carried: str, phases: Sequence[Phases], steps: int
    ) -> None:
        self._scene = scene
        self._carried = carried
        self._phases = phases
        self._positions, self._velocities, self._torques = (
            [np.zeros((steps, arm.dof)) for arm in scene.arms] for _ in range(3)
        )
        self._step = 0
        self._at_rest = object_pose(data, carried)
        self._in_hand: list[list[Array]] = [[] for _ in phases]
        self._tilt = 0.0
        self._lost: float | None = None
        self._faults = Faults(scene)

    def step(self, data: mujoco.MjData) -> None:
        """Observe the state after a physics step."""
        scene, k = self._scene, self._step
        for number, arm in enumerate(scene.arms):
            self._positions[number][k] = data.qpos[arm.joint_qpos]
            self._velocities[number][k] = data.qvel[arm.joint_dof]
            self._torques[number][k] = data.actuator_force[arm.arm_ctrl]
        self._step += 1
        self._faults.step(data)

    def end_tick(self, data: mujoco.MjData) -> None:
        """Observe the state after a control tick's last step."""
        self._faults.end_tick(data)

    def tick(self, tick: int, data: mujoco.MjData) -> None:
        """Observe the object at the start of a control tick; poses have to be up to date."""
        if tick == min(phase.reached for phase in self._phases):
            self._at_rest = object_pose(data, self._carried)
        for phase, in_hand in zip(self._phases, self._in_hand, strict=True):
            if tick in phase.held:
                self._observe_hand(data, self._scene.arms[phase.arm], phase.arm, in_hand)

    def _observe_hand(self, data: mujoco.MjData, arm: SceneArm, number: int, in_hand: list[Array]) -> None:
        T_object = object_pose(data, self._carried)
        in_hand.append((inverse(object_pose(data, arm.flange)) @ T_object)[:3, 3])
        self._tilt = max(self._tilt, tilt(self._at_rest[:3, :3].T @ T_object[:3, :3]))
        geoms = data.contact.geom
        of_hand = (self._scene.geom_arm[geoms] == number).any(axis=1)
        kinds = self._scene.geom_kind[geoms[of_hand]]
        touching = kinds[(kinds == Kind.OBJECT).any(axis=1)]
        if self._lost is None and not all(
            (touching == finger).any() for finger in (Kind.LEFT_FINGER, Kind.RIGHT_FINGER)
        ):
            self._lost = float(data.time)

    @property
    def T_object_before_grasp(self) -> Array:
        """Pose (4, 4) of the object in `world` when the hand had reached it; until then, its pose at the start."""
        return self._at_rest

    def motion(self) -> Motion:
        """All that was observed."""
        arms = self._scene.arms
        margins = Margins(
            velocity=max(
                float((np.abs(seen).max(axis=0) / arm.motor_speed).max())
                for arm, seen in zip(arms, self._velocities, strict=True)
            ),
            torque=max(
                float((np.abs(seen).max(axis=0) / arm.most_torque).max())
                for arm, seen in zip(arms, self._torques, strict=True)
            ),
            joint=min(
                float(np.minimum(seen - arm.joint_range[:, 0], arm.joint_range[:, 1] - seen).min())
                for arm, seen in zip(arms, self._positions, strict=True)
            ),
            slip=max((_moved(np.array(places)) for places in self._in_hand), default=0.0),
            tilt=self._tilt,
        )
        return Motion(margins, self._lost, self._faults.collision, self._faults.breakdown)


def _moved(places: Array) -> float:
    """The largest distance of places (n, 3) from the first one."""
    return float(np.linalg.norm(places - places[0], axis=1).max()) if len(places) else 0.0
