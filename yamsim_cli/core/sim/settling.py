from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene

SETTLE_SECONDS = 2.0  # longest simulated time
CHECK_STEPS = 25  # between two checks of the speeds
MAX_REST_SPEED = 0.01  # m/s and rad/s


class SettledScene(NamedTuple):
    """MuJoCo's positions (nq,), and the largest remaining speed of a rigid object, m/s or rad/s."""

    qpos: Array
    speed: float


def settle_objects(scene: CompiledScene, start: Array, timestep: float) -> SettledScene:
    """Simulate until all objects are at rest, for `SETTLE_SECONDS` at most; arms keep their positions in `start`."""
    data = mujoco.MjData(scene.model)
    scene.reset(data, start)
    stiff = np.concatenate([np.zeros(0, int), *(np.arange(dof, dof + 6) for dof in scene.object_dof.values())])
    loose = [np.arange(d, d + 6) for joints in scene.pieces.values() for d in scene.model.jnt_dofadr[list(joints)]]
    dofs = np.concatenate([stiff, *loose, *(cloth.dof.ravel() for cloth in scene.cloths.values())])
    for _ in range(int(SETTLE_SECONDS / timestep / CHECK_STEPS)):
        scene.step(data, CHECK_STEPS)
        if float(np.abs(data.qvel[dofs]).max()) < MAX_REST_SPEED:
            break
    settled: Array = data.qpos.copy()
    for arm in scene.arms:
        settled[arm.joint_qpos] = start[arm.joint_qpos]
        if arm.fingers is not None:
            settled[arm.fingers.qpos] = start[arm.fingers.qpos]
    return SettledScene(settled, float(np.abs(data.qvel[stiff]).max(initial=0.0)))
