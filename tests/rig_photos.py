"""Photos of a rig's arms with known truth: camera pose, joints, and mask of the arms."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import mujoco
import numpy as np

from tests.truth_photos import Photographer
from yamsim_cli.core.attempt_data import ArmPosture
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose

# Off-centre and distorted as a webcam's picture.
CAMERA = CameraModel(
    640, 480, ((605.0, 0.0, 326.0), (0.0, 602.0, 234.0), (0.0, 0.0, 1.0)), (-0.12, 0.05, 1e-3, -5e-4, 0)
)
# Both boards of russet and most of both arms are visible, and no finger hides a board.
JOINTS = np.array([[0.9, 1.3, 1.1, -0.2, 0.1, 0.3, 0.03], [-0.9, 0.9, 1.2, 0.2, -0.3, 0.1, 0.01]])


def looking(position: tuple[float, float, float], target: tuple[float, float, float]) -> Array:
    """The pose (4, 4) in `world` of an upright camera that looks at a target."""
    z = np.subtract(target, position) / np.linalg.norm(np.subtract(target, position))
    x = np.cross(z, (0.0, 0.0, 1.0))
    x /= np.linalg.norm(x)
    return pose(position, np.column_stack([x, np.cross(z, x), z]))


def standing(joints: Array) -> tuple[ArmPosture, ...]:
    """Postures of arms with joints and openings (arms, 7)."""
    return tuple(ArmPosture(row[:6], float(row[6])) for row in joints)


@dataclass(frozen=True)
class RigPhoto:
    """A photo (height, width, 3) as RGB, and its truth; `mask` (height, width) is where the arms are."""

    image: np.ndarray
    rig: RigConfig
    camera: CameraModel
    joints: Array
    T_cam_in_world: Array
    mask: np.ndarray

    @property
    def stands(self) -> tuple[ArmPosture, ...]:
        return standing(self.joints)

    def T_base_in_cam(self, arm: int) -> Array:
        return invert_pose(self.T_cam_in_world) @ self.rig.T_base_in_world(arm)


class RigPhotographer(Photographer):
    """Takes pictures of a rig in any posture, with primitives."""

    def shoot(self, T_cam_in_world: Array, joints: Array, noise: float = 2.0, seed: int = 0) -> RigPhoto:
        model, data = self._model, self._data
        for k, arm in enumerate(self.rig.arms):
            for j in range(6):
                data.qpos[model.joint(f"{arm.prefix}joint{j + 1}").qposadr[0]] = joints[k, j]
            for finger, sign in (("left_finger", 1), ("right_finger", -1)):
                data.qpos[model.joint(arm.prefix + finger).qposadr[0]] = sign * joints[k, 6]
        self.stand(T_cam_in_world)
        mujoco.mj_forward(model, data)
        clean = cv2.GaussianBlur(self.take(), (0, 0), 0.6).astype(np.float64)
        noisy = clean + np.random.default_rng(seed).normal(0, noise, clean.shape)
        image = np.clip(np.round(noisy), 0, 255).astype(np.uint8)
        return RigPhoto(image, self.rig, self.camera, joints, T_cam_in_world, self._mask())

    def _mask(self) -> np.ndarray:
        ids = self._renderer.render_geom_ids(self._data, "photo")
        arms = [self._model.body(f"{arm.prefix}arm").id for arm in self.rig.arms]
        is_arm = np.isin(self._model.body_rootid[self._model.geom_bodyid], arms)
        labels = np.append(is_arm, False)[ids].astype(np.uint8)
        return self._warp.distort_picture(labels, nearest=True) > 0
