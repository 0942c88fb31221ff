from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import mujoco
import numpy as np

from ..attempt_data import WeldStates
from ..geometry.se3 import Array
from ..scene.compiled import ArmAddresses, CompiledScene
from ..sim.cloth import ClothGraspConstraints


class GraspSimulator(Protocol):
    """Switches, before every control tick, the constraints that hold objects in hands."""

    def update(self, data: mujoco.MjData, ctrl: Array, magnet: Sequence[bool] | WeldStates) -> Sequence[bool]:
        """Switch the constraints for a tick, and return whether one holds an object in each arm's hand (arms,).

        Args:
            data: has poses and contacts up to date; its constraints are switched.
            ctrl: commands (nu,) of all drives for the tick.
            magnet: whether each arm's weld is commanded on (arms,).
        """


class FrictionGraspSimulator:
    """Grasps by friction alone."""

    def __init__(self, scene: CompiledScene) -> None:
        self._none = (False,) * len(scene.arms)

    def update(self, data: mujoco.MjData, ctrl: Array, magnet: Sequence[bool] | WeldStates) -> Sequence[bool]:
        """Return False for each arm: friction needs no constraint."""
        return self._none


class WeldGraspSimulator:
    """A weld in each hand, which if commanded on fixes the object nearest to the pinch point, within `reach` (m; None:
    any).
    """

    def __init__(self, scene: CompiledScene, reach: float | None) -> None:
        self._scene, self._reach = scene, reach
        model = scene.model
        roots = model.body_rootid[model.geom_bodyid]
        things = np.array([model.body(name).id for name in scene.object_qpos])
        self._geoms = np.flatnonzero((model.geom_contype != 0) & np.isin(roots, things))
        self._bodies = roots[self._geoms]

    def update(self, data: mujoco.MjData, ctrl: Array, magnet: Sequence[bool] | WeldStates) -> Sequence[bool]:
        """See `GraspSimulator.update`."""
        return [self._set_weld_active(data, arm, bool(on)) for arm, on in zip(self._scene.arms, magnet, strict=True)]

    def _set_weld_active(self, data: mujoco.MjData, arm: ArmAddresses, on: bool) -> bool:
        if arm.weld is None:
            return False
        if on and not is_weld_active(data, arm):
            body, distance = self._nearest_body(data, data.site(f"{arm.prefix}pinch_site").xpos)
            on = self._reach is None or distance <= self._reach
            if on:
                set_weld_pose(self._scene.model, arm, data, body)
        data.eq_active[arm.weld] = on
        return on

    def _nearest_body(self, data: mujoco.MjData, point: Array) -> tuple[int, float]:
        """Return the body whose geoms' bounding boxes are nearest to a point (3,), and their distance, m.

        Of several bodies whose boxes contain the point, the body with the nearest origin counts.
        """
        model, geoms = self._scene.model, self._geoms
        rotations = data.geom_xmat[geoms].reshape(-1, 3, 3)
        local = np.einsum("gij,gi->gj", rotations, point - data.geom_xpos[geoms])
        outside = np.maximum(np.abs(local - model.geom_aabb[geoms, :3]) - model.geom_aabb[geoms, 3:], 0.0)
        distances = np.linalg.norm(outside, axis=1)
        origins = np.linalg.norm(data.xpos[self._bodies] - point, axis=1)
        nearest = int(np.lexsort((origins, distances))[0])
        return int(self._bodies[nearest]), float(distances[nearest])


class ClothGraspSimulator:
    """Constraints hold points of cloth between closed fingers, see `sim.cloth`; friction holds rigid objects."""

    def __init__(self, scene: CompiledScene) -> None:
        self._cloth_grasp_constraints = ClothGraspConstraints(scene)

    def update(self, data: mujoco.MjData, ctrl: Array, magnet: Sequence[bool] | WeldStates) -> Sequence[bool]:
        """See `GraspSimulator.update`."""
        return self._cloth_grasp_constraints.update_grasps(data, ctrl)


def make_grasp_simulator(scene: CompiledScene, magnet_reach: float | None) -> GraspSimulator:
    """Return the grasp simulator: for cloth if the scene has any, with welds if arms have welds, else with friction."""
    if scene.cloths:
        return ClothGraspSimulator(scene)
    if any(arm.weld is not None for arm in scene.arms):
        return WeldGraspSimulator(scene, magnet_reach)
    return FrictionGraspSimulator(scene)


def is_weld_active(data: mujoco.MjData, arm: ArmAddresses) -> bool:
    """Return whether an arm's weld holds an object."""
    return arm.weld is not None and bool(data.eq_active[arm.weld])


def set_weld_pose(model: mujoco.MjModel, arm: ArmAddresses, data: mujoco.MjData, body: int) -> None:
    """Write a body's present pose in the flange into an arm's weld, so that switching it on moves nothing."""
    assert arm.weld is not None, "an arm without a weld attaches nothing"
    hand, item = data.body(arm.flange), data.body(body)
    position, quat, inverse_quat = np.empty(3), np.empty(4), np.empty(4)
    mujoco.mju_negQuat(inverse_quat, hand.xquat)
    mujoco.mju_rotVecQuat(position, item.xpos - hand.xpos, inverse_quat)
    mujoco.mju_mulQuat(quat, inverse_quat, item.xquat)
    model.eq_obj2id[arm.weld] = body
    # The anchor in the second body (3), the second body's position (3) and quaternion (4) in the first body, and the
    # torque scale (1). Source: MuJoCo's documentation of `mjModel.eq_data`.
    model.eq_data[arm.weld, :11] = [0, 0, 0, *position, *quat, 1]
