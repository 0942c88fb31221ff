"""A copy of the scene that shows recorded states, for reading and rendering, and is never stepped."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from ..config.objects.object_config import ObjectConfig
from ..geometry.camera import Intrinsics, opencv_from_mujoco
from ..geometry.se3 import Array, inverse, pose
from ..scene.compiled import CompiledScene
from .cloth import ClothState


class StateReplay:
    """Joints and poses of one recorded state. Poses are in the base of the robot, or of the left one of two arms."""

    def __init__(self, scene: CompiledScene) -> None:
        self.scene = scene
        self.data = mujoco.MjData(scene.model)
        self._T_world_in_base = inverse(scene.T_base_in_world)
        self._cloths = {name: ClothState(cloth, self.data) for name, cloth in scene.cloths.items()}
        self._fixed = np.flatnonzero(scene.model.body_mocapid >= 0)

    def show(self, qpos: Array) -> None:
        """Set the state to positions (nq,), and compute the poses of bodies, cameras and lights."""
        model = self.scene.model
        self.data.qpos[:] = qpos
        # The model's present poses of mocap bodies apply, since variations change them.
        for body in self._fixed:
            number = int(model.body_mocapid[body])
            self.data.mocap_pos[number], self.data.mocap_quat[number] = model.body_pos[body], model.body_quat[body]
        mujoco.mj_kinematics(model, self.data)
        mujoco.mj_comPos(model, self.data)
        mujoco.mj_camlight(model, self.data)
        mujoco.mj_flex(model, self.data)

    def joints(self) -> Array:
        """Each arm's joints in rad and the opening of one of its fingers in m, if it has any, (arms, drives)."""
        return np.array([self.data.qpos[arm.recorded_qpos] for arm in self.scene.arms])

    def openings(self) -> Array:
        """The opening of one finger of each arm (arms,), m; 0 for an arm without fingers."""
        fingers = [arm.fingers for arm in self.scene.arms]
        return np.array([self.data.qpos[one.qpos[0]] if one else 0.0 for one in fingers])

    def T_object_in_base(self, name: str) -> Array:
        """Pose (4, 4) of a body, or of a cloth, see `ClothState.pose`."""
        if cloth := self._cloths.get(name):
            return self._T_world_in_base @ cloth.pose
        body = self.data.body(name)
        return self._T_world_in_base @ pose(body.xpos, body.xmat.reshape(3, 3))

    def cloth_points(self) -> dict[str, Array]:
        """Cloth -> positions (n, 3) of its points, m."""
        T = self._T_world_in_base
        return {name: cloth.points @ T[:3, :3].T + T[:3, 3] for name, cloth in self._cloths.items()}

    def object_joints(self, item: ObjectConfig) -> Array:
        """Positions of an articulated object's joints (n,), in the order of its links, m or rad."""
        joints = [self.scene.model.joint(f"{item.name}_{link.name}") for link in item.links]
        return np.array([self.data.qpos[joint.qposadr[0]] for joint in joints])

    def T_grasp_in_base(self) -> Array:
        """Pose of each arm's `grasp_site` (arms, 4, 4)."""
        sites = [self.data.site(f"{arm.prefix}grasp_site") for arm in self.scene.arms]
        return np.array([self._T_world_in_base @ pose(site.xpos, site.xmat.reshape(3, 3)) for site in sites])

    def intrinsics(self, camera: str, size: tuple[int, int]) -> Intrinsics:
        """Intrinsics of a camera for rendered images of `size` (width, height) pixels."""
        return Intrinsics.from_fovy(*size, math.radians(float(self.scene.model.cam(camera).fovy[0])))

    def T_cam_in_base(self, camera: str) -> Array:
        """Pose (4, 4) of a camera, in OpenCV's convention."""
        view = self.data.cam(camera)
        return self._T_world_in_base @ pose(view.xpos, opencv_from_mujoco(view.xmat))
