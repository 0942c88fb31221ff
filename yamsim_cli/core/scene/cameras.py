from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from ..config.rig import ArmConfig, RigCamera, RigConfig
from ..config.scene import FixedCamera
from ..geometry.camera import opencv_from_mujoco
from ..geometry.se3 import Array, pose, quat_from_rotation

WORLD_BODY = "world"


@dataclass(frozen=True)
class SceneCamera:
    """A camera of a scene.

    Attributes:
        body: name of the body that carries the camera; `WORLD_BODY` for a fixed camera.
        T_in_body: in MuJoCo's convention: view along -z, +y up in the image.
        fovy_deg: vertical field of view.
    """

    name: str
    body: str
    T_in_body: Array
    fovy_deg: float


def fixed_camera(name: str, camera: FixedCamera) -> SceneCamera:
    """Convert a camera config with a position and a target point."""
    return SceneCamera(name, WORLD_BODY, pose(camera.position, _look_at(camera)), camera.fovy_deg)


def station_camera(rig: RigConfig, camera: RigCamera, size: tuple[int, int]) -> SceneCamera:
    """Convert a fixed camera of a rig's config, for images of `size` (width, height), px."""
    T = rig.T_cam_in_world(camera)
    return SceneCamera(camera.name, WORLD_BODY, pose(T[:3, 3], opencv_from_mujoco(T[:3, :3])), camera.fovy(size))


def wrist_camera(arm: ArmConfig, size: tuple[int, int]) -> SceneCamera:
    """Convert an arm's wrist camera, for images of `size` (width, height), px."""
    T, flange = wrist_camera_pose(arm), arm.prefix + arm.robot.flange
    T_in_flange = pose(T[:3, 3], opencv_from_mujoco(T[:3, :3]))
    return SceneCamera(arm.wrist_camera_name, flange, T_in_flange, arm.wrist_camera.fovy(size))


def wrist_camera_pose(arm: ArmConfig) -> Array:
    """Return the pose (4, 4) of an arm's wrist camera on the flange, in OpenCV's convention."""
    camera = arm.wrist_camera
    x, y = (np.asarray(axis) / np.linalg.norm(axis) for axis in (camera.x_axis, camera.y_axis))
    return pose(camera.position, np.column_stack([x, y, np.cross(x, y)]))


def add_camera(spec: mujoco.MjSpec, camera: SceneCamera) -> None:
    """Add a camera to the spec of a scene."""
    T = camera.T_in_body
    spec.body(camera.body).add_camera(
        name=camera.name, pos=T[:3, 3], quat=quat_from_rotation(T[:3, :3]), fovy=camera.fovy_deg
    )


def _look_at(camera: FixedCamera) -> Array:
    """Return the rotation of a MuJoCo camera in `world`: -z to the target, +y as far up as possible."""
    forward = np.asarray(camera.look_at) - np.asarray(camera.position)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up or (0.0, 0.0, 1.0))
    if np.linalg.norm(right) < 1e-6:
        # In the image of a vertical camera, +x, which points away from the arm, is up.
        right = np.array([0.0, -1.0, 0.0]) * math.copysign(1.0, -forward[2])
    right /= np.linalg.norm(right)
    return np.column_stack([right, np.cross(right, forward), -forward])
