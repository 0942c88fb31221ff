from __future__ import annotations

import math

import mujoco
import numpy as np

from ..config.objects.object_config import ObjectConfig
from ..geometry.camera import Intrinsics, opencv_from_mujoco
from ..geometry.se3 import Array, invert_pose, pose
from ..scene.compiled import CompiledScene
from .cloth import ClothState


class StateReplay:
    """A copy of the scene that is set to recorded states and never stepped.

    Poses are in the base frame of the only arm, or the left one.
    """

    def __init__(self, scene: CompiledScene) -> None:
        self.scene = scene
        self.data = mujoco.MjData(scene.model)
        self._T_world_in_base = invert_pose(scene.T_base_in_world)
        self._cloths = {name: ClothState(cloth, self.data) for name, cloth in scene.cloths.items()}
        self._fixed = np.flatnonzero(scene.model.body_mocapid >= 0)

    def set_state(self, qpos: Array) -> None:
        """Set the state to `qpos` (nq,), and compute the poses of bodies, cameras and lights."""
        model = self.scene.model
        self.data.qpos[:] = qpos
        # Randomization changes the poses of mocap bodies in the model, so the poses are copied from the model.
        for body in self._fixed:
            number = int(model.body_mocapid[body])
            self.data.mocap_pos[number], self.data.mocap_quat[number] = model.body_pos[body], model.body_quat[body]
        mujoco.mj_kinematics(model, self.data)
        mujoco.mj_comPos(model, self.data)
        mujoco.mj_camlight(model, self.data)
        mujoco.mj_flex(model, self.data)

    def joint_positions(self) -> Array:
        """Return each arm's joint positions, rad, and left finger's position, m, as (arms, drives)."""
        return np.array([self.data.qpos[arm.recorded_qpos] for arm in self.scene.arms])

    def finger_openings(self) -> Array:
        """Return each arm's left finger's position (arms,), m; 0 for an arm without fingers."""
        fingers = [arm.fingers for arm in self.scene.arms]
        return np.array([self.data.qpos[one.qpos[0]] if one else 0.0 for one in fingers])

    def T_object_in_base(self, name: str) -> Array:
        """Return the pose of a body, or of a cloth's upright frame at the centroid of its points."""
        if cloth := self._cloths.get(name):
            return self._T_world_in_base @ cloth.pose
        body = self.data.body(name)
        return self._T_world_in_base @ pose(body.xpos, body.xmat.reshape(3, 3))

    def cloth_points(self) -> dict[str, Array]:
        """Return cloth -> positions (n, 3) of its points in the base frame, m."""
        T = self._T_world_in_base
        return {name: cloth.points @ T[:3, :3].T + T[:3, 3] for name, cloth in self._cloths.items()}

    def object_joints(self, item: ObjectConfig) -> Array:
        """Return the joint positions (n,) of an articulated object in the order of its links, m or rad."""
        joints = [self.scene.model.joint(f"{item.name}_{link.name}") for link in item.links]
        return np.array([self.data.qpos[joint.qposadr[0]] for joint in joints])

    def T_grasp_in_base(self) -> Array:
        """Return the pose of each arm's `grasp_site` (arms, 4, 4)."""
        sites = [self.data.site(f"{arm.prefix}grasp_site") for arm in self.scene.arms]
        return np.array([self._T_world_in_base @ pose(site.xpos, site.xmat.reshape(3, 3)) for site in sites])

    def intrinsics(self, camera: str, size: tuple[int, int]) -> Intrinsics:
        """Return the intrinsics of a camera for images of `size` (width, height), px."""
        return Intrinsics.from_fovy(*size, math.radians(float(self.scene.model.cam(camera).fovy[0])))

    def T_cam_in_base(self, camera: str) -> Array:
        """Return the pose of a camera in OpenCV's convention."""
        view = self.data.cam(camera)
        return self._T_world_in_base @ pose(view.xpos, opencv_from_mujoco(view.xmat))
