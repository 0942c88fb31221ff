"""What is watched while an attempt runs: the arm's limits, what it touches, and how the object is held."""

from __future__ import annotations

import mujoco
import numpy as np

from ..geometry.se3 import Array, inverse, pose, tilt
from ..scene.compiled import FORBIDDEN, CompiledScene, Kind
from ..types import Margins, Motion, Phases


def object_pose(data: mujoco.MjData, name: str) -> Array:
    """Pose (4, 4) of a body in `world`, as of the last forward kinematics."""
    body = data.body(name)
    return pose(body.xpos, body.xmat.reshape(3, 3))


class Watch:
    """Looks at every physics step, and at the object at the start of every control tick in which it is held.

    Args:
        data: the scene at the start.
        carried: name of the object.
        steps: physics steps in all.
    """

    def __init__(self, scene: CompiledScene, data: mujoco.MjData, carried: str, phases: Phases, steps: int) -> None:
        self._scene = scene
        self._carried = carried
        self._phases = phases
        self._positions = np.zeros((steps, 6))
        self._velocities = np.zeros((steps, 6))
        self._torques = np.zeros((steps, 6))
        self._step = 0
        self._at_rest = object_pose(data, carried)
        self._in_hand: list[Array] = []
        self._tilt = 0.0
        self._lost: float | None = None
        self._collision: str | None = None

    def step(self, data: mujoco.MjData) -> None:
        """Look at the state after a physics step."""
        scene, k = self._scene, self._step
        self._positions[k] = data.qpos[scene.joint_qpos]
        self._velocities[k] = data.qvel[scene.joint_dof]
        self._torques[k] = data.actuator_force[scene.arm_ctrl]
        self._step += 1
        if self._collision is None:
            geoms = data.contact.geom
            kinds = scene.geom_kind[geoms]
            forbidden = FORBIDDEN[kinds[:, 0], kinds[:, 1]]
            if forbidden.any():
                names = " and ".join(scene.model.geom(int(geom)).name for geom in geoms[forbidden][0])
                self._collision = f"{names} touch after {data.time:.2f} s"

    def tick(self, tick: int, data: mujoco.MjData) -> None:
        """Look at the object at the start of a control tick; poses have to be up to date."""
        if tick == self._phases.reached:
            self._at_rest = object_pose(data, self._carried)
        if tick not in self._phases.held:
            return
        T_object = object_pose(data, self._carried)
        self._in_hand.append((inverse(object_pose(data, "link_6")) @ T_object)[:3, 3])
        self._tilt = max(self._tilt, tilt(self._at_rest[:3, :3].T @ T_object[:3, :3]))
        kinds = self._scene.geom_kind[data.contact.geom]
        touching = kinds[(kinds == Kind.OBJECT).any(axis=1)]
        if self._lost is None and not all(
            (touching == finger).any() for finger in (Kind.LEFT_FINGER, Kind.RIGHT_FINGER)
        ):
            self._lost = float(data.time)

    @property
    def T_object_before_grasp(self) -> Array:
        """Pose (4, 4) of the object in `world` when the hand had reached it; before that, where it was at the start."""
        return self._at_rest

    def motion(self) -> Motion:
        """What came of all looks."""
        scene = self._scene
        low, high = scene.joint_range.T
        in_hand = np.array(self._in_hand)
        moved = float(np.linalg.norm(in_hand - in_hand[0], axis=1).max()) if len(in_hand) else 0.0
        margins = Margins(
            velocity=float((np.abs(self._velocities).max(axis=0) / scene.motor_speed).max()),
            torque=float((np.abs(self._torques).max(axis=0) / scene.most_torque).max()),
            joint=float(np.minimum(self._positions - low, high - self._positions).min()),
            slip=moved,
            tilt=self._tilt,
        )
        return Motion(margins, self._lost, self._collision)
