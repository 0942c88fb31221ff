"""Simulates a scene until its things are at rest."""

from __future__ import annotations

import mujoco
import numpy as np

from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene

SETTLE_SECONDS = 2.0  # s, limit of the simulated time
CHECK_STEPS = 25  # physics steps between two checks of the speeds
AT_REST = 0.01  # m/s and rad/s, the largest speed of a thing that counts as at rest


def settle(scene: CompiledScene, start: Array, timestep: float) -> Array:
    """MuJoCo's positions (nq,) once all things are at rest, with the arms' positions of `start`."""
    data = mujoco.MjData(scene.model)
    scene.reset(data, start)
    stiff = [np.arange(dof, dof + 6) for dof in scene.object_dof.values()]
    dofs = np.concatenate([*stiff, *(cloth.dof.ravel() for cloth in scene.cloths.values())])
    for _ in range(int(SETTLE_SECONDS / timestep / CHECK_STEPS)):
        scene.step(data, CHECK_STEPS)
        if float(np.abs(data.qvel[dofs]).max()) < AT_REST:
            break
    settled: Array = data.qpos.copy()
    for arm in scene.arms:
        settled[arm.joint_qpos] = start[arm.joint_qpos]
        if arm.fingers is not None:
            settled[arm.fingers.qpos] = start[arm.fingers.qpos]
    return settled
