from __future__ import annotations

import math

import mujoco
import numpy as np

from ..attempt_data import MotionMargins
from ..scene.compilation import physics_failure
from ..scene.compiled import CompiledScene

CONTACT_STEPS = 8  # physics steps after which contacts are checked even if their number has not changed


class StepMonitor:
    """Watches joint limits, collisions and fatal physics warnings in each of the `steps` physics steps of a tick.

    Attributes:
        collision: the first contact of an arm with the table or another arm.
        breakdown: MuJoCo's first fatal warning and its time.
    """

    def __init__(self, scene: CompiledScene, steps: int) -> None:
        self._scene, self._model = scene, scene.model
        self._qpos = np.concatenate([arm.joint_qpos for arm in scene.arms])
        self._dof = np.concatenate([arm.joint_dof for arm in scene.arms])
        self._ctrl = np.concatenate([arm.arm_ctrl for arm in scene.arms])
        self._range = np.concatenate([arm.joint_range for arm in scene.arms])
        self._motor_speed = np.concatenate([arm.motor_speed for arm in scene.arms])
        self._max_torque = np.concatenate([arm.max_torque for arm in scene.arms])
        # One row for each physics step of the present control tick.
        self._positions = np.empty((steps, scene.model.nq))
        self._velocities = np.empty((steps, scene.model.nv))
        self._forces = np.empty((steps, scene.model.nu))
        self._step, self._steps = 0, 0
        self._contacts = -1
        self._velocity = self._torque = 0.0
        self._joint_margin = np.inf
        self.collision: str | None = None
        self.breakdown: str | None = None

    def check_step(self, data: mujoco.MjData) -> None:
        """Record the state after a physics step."""
        k = self._step
        self._positions[k], self._velocities[k], self._forces[k] = data.qpos, data.qvel, data.actuator_force
        self._step, self._steps = k + 1, self._steps + 1
        if self.collision is None and (data.ncon != self._contacts or self._steps % CONTACT_STEPS == 0):
            self._contacts = data.ncon
            self._check_contacts(data)

    def check_tick(self, data: mujoco.MjData) -> None:
        """Evaluate the control tick after its last physics step. Without `check_step`, only breakdowns are noticed."""
        if self._step:
            self._update_margins()
        else:
            self._steps += len(self._positions)
        if self.breakdown is None and (text := physics_failure(data)):
            # MuJoCo has reset its own clock, so the time is counted in steps.
            seconds = self._steps * float(self._model.opt.timestep)
            self.breakdown = f"physics broke down within {seconds:.3f} s: {text}"

    def _update_margins(self) -> None:
        steps, low, high = self._step, self._range[:, 0], self._range[:, 1]
        velocities = np.abs(self._velocities[:steps, self._dof]) / self._motor_speed
        forces = np.abs(self._forces[:steps, self._ctrl]) / self._max_torque
        positions = self._positions[:steps, self._qpos]
        self._velocity = max(self._velocity, float(velocities.max()))
        self._torque = max(self._torque, float(forces.max()))
        self._joint_margin = min(self._joint_margin, float(np.minimum(positions - low, high - positions).min()))
        self._step = 0

    def motion_margins(self, slip: float | None = None, tilt: float | None = None) -> MotionMargins:
        """Return the margins so far, with a held object's `slip` (m) and `tilt` (rad)."""
        return MotionMargins(self._velocity, self._torque, float(self._joint_margin), slip, tilt)

    def _check_contacts(self, data: mujoco.MjData) -> None:
        geoms = data.contact.geom
        forbidden = self._scene.mask_forbidden_contacts(geoms)
        if forbidden.any():
            names = " and ".join(self._model.geom(int(geom)).name for geom in geoms[forbidden][0])
            self.collision = f"{names} touch after {data.time:.2f} s"


JOINT_LIMIT_TOLERANCE = 0.01  # rad beyond a limit: joint limits are soft in physics


def describe_exceeded_limits(margins: MotionMargins) -> str | None:
    """Return how a motion exceeds a motor's speed, a drive's torque or a joint limit; None if it does not."""
    if margins.velocity <= 1 and margins.torque < 1 and margins.joint >= -JOINT_LIMIT_TOLERANCE:
        return None
    return (
        f"a joint at {margins.velocity:.0%} of its motor's speed, a drive at {margins.torque:.0%} of its torque, "
        f"{math.degrees(margins.joint):.1f} deg from the nearest joint limit"
    )
