"""Render a rig's arms as a camera sees them, each at its own base pose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.camera_effects.lens_distortion import LensWarp
from yamsim_cli.camera_rendering import HIDDEN_GROUP
from yamsim_cli.core.attempt_data import ArmPosture
from yamsim_cli.core.closable import Closable
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.rig import ArmConfig, RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel, Intrinsics, opencv_from_mujoco
from yamsim_cli.core.geometry.se3 import Array, pose, quat_from_rotation
from yamsim_cli.core.rendering.renderer import SceneRenderer
from yamsim_cli.core.scene.arm_model import finger_addresses
from yamsim_cli.core.scene.blueprint import Blueprint, PictureSettings
from yamsim_cli.core.scene.cameras import WORLD_BODY, SceneCamera
from yamsim_cli.core.scene.compilation import compile_spec
from yamsim_cli.core.scene.compose import compose_scene

_CAMERA = "photo"
_MAX_SUPERSAMPLED_SIDE = 1400  # px, up to which double resolution smooths edges in any OpenGL
_MAX_SIDE = 8192  # px, longer side of a rendered picture


@dataclass(frozen=True)
class ArmPicture:
    """Arms as the real, distorted camera sees them.

    `colour` is RGB (height, width, 3), `labels` (height, width): 0 background, k the k-th arm.
    """

    colour: NDArray[np.uint8]
    labels: NDArray[np.uint8]


@dataclass(frozen=True)
class ArmsInPinholePicture:
    """Arms in an ideal pinhole picture with camera `intrinsics`.

    `labels` (height, width): 0 background, k the k-th arm; `depth` is the surface's z in the camera frame, m.
    `outside_photo` (height, width): the pixels that the photo does not show.
    """

    labels: NDArray[np.uint8]
    depth: NDArray[np.float32]
    outside_photo: NDArray[np.bool_]
    intrinsics: Intrinsics


def place_arm(
    model: mujoco.MjModel, data: mujoco.MjData, arm: ArmConfig, posture: ArmPosture, T_base: Array | None
) -> None:
    """Set an arm's joints and fingers, and its base's pose (4, 4) in its parent's frame unless that is None.

    The caller updates the kinematics.
    """
    if T_base is not None:
        root = model.body(arm.prefix + arm.robot.base).id
        model.body_pos[root], model.body_quat[root] = T_base[:3, 3], quat_from_rotation(T_base[:3, :3])
    for name, angle in zip(arm.robot.joint_names, posture.joints, strict=True):
        data.qpos[model.joint(arm.prefix + name).qposadr[0]] = angle
    addresses, signs = finger_addresses(model, arm.robot, arm.prefix)
    data.qpos[addresses] = posture.opening * signs


class ArmRenderer(Closable):
    """Renders arms for photos of one camera. The rendered world frame is the camera frame.

    Raises:
        ConfigError: the camera's pictures are too large or too wide to render.
        ResourceError: no OpenGL context is available.
    """

    def __init__(
        self, rig: RigConfig, scene: SceneConfig, quality: RenderConfig, camera: CameraModel, locations: Locations
    ) -> None:
        self._rig = rig
        self._warp = LensWarp(camera, 2 if max(camera.width, camera.height) <= _MAX_SUPERSAMPLED_SIDE else 1)
        size = (self._warp.ideal.width, self._warp.ideal.height)
        if max(size) > _MAX_SIDE:
            raise ConfigError(
                f"a pinhole picture for this camera has {size[0]} x {size[1]} pixels; at most {_MAX_SIDE}"
            )
        view = SceneCamera(
            _CAMERA, WORLD_BODY, pose(rotation=opencv_from_mujoco(np.eye(3))), math.degrees(self._warp.fovy)
        )
        blueprint = Blueprint(
            rig, scene, boards=False, background=False, cameras=(view,), pictures=PictureSettings(quality, size)
        )
        spec = compose_scene(blueprint, locations)
        for light in list(spec.lights):
            spec.delete(light)
        # The photo's light is unknown; light from the camera casts no visible, wrong shadows.
        spec.visual.headlight.ambient = (0.35, 0.35, 0.35)
        spec.visual.headlight.diffuse = (0.6, 0.6, 0.6)
        self._model = compile_spec(spec)
        self._data = mujoco.MjData(self._model)
        self._group = self._model.geom_group.copy()
        self._roots = [self._model.body(arm.prefix + arm.robot.base).id for arm in rig.arms]
        arm_of_root = {root: k for k, root in enumerate(self._roots, start=1)}
        numbers = [arm_of_root.get(int(self._model.body_rootid[body]), 0) for body in self._model.geom_bodyid]
        self._arm_of_geom = np.array([*numbers, 0], np.uint8)
        self._labels: NDArray[np.uint8] | None = None
        self._renderer = SceneRenderer(self._model, size)

    def set_poses(self, T_base_in_cam: Mapping[int, Array], postures: Sequence[ArmPosture]) -> None:
        """Set base poses by arm index, (4, 4), and all arms' joints; other arms are hidden."""
        model, data = self._model, self._data
        for k, arm in enumerate(self._rig.arms):
            own = self._arm_of_geom[:-1] == k + 1
            model.geom_group[own] = self._group[own] if k in T_base_in_cam else HIDDEN_GROUP
            place_arm(model, data, arm, postures[k], T_base_in_cam.get(k))
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        self._labels = None

    def render(self) -> ArmPicture:
        """Render colours and labels with lens distortion."""
        colour = self._warp.distort_picture(self._renderer.render(self._data, _CAMERA))
        return ArmPicture(colour, self._warp.distort_picture(self._undistorted_labels(), nearest=True))

    def undistorted_label_image(self) -> NDArray[np.uint8]:
        """Render labels without lens distortion: 0 background, k the k-th arm."""
        return self._warp.coarse_picture(self._undistorted_labels())

    def pinhole_arms(self) -> ArmsInPinholePicture:
        """Render labels and depth without lens distortion."""
        depth = self._warp.coarse_picture(self._renderer.render_depth(self._data, _CAMERA))
        return ArmsInPinholePicture(
            self.undistorted_label_image(), depth, self.outside_photo, self._warp.coarse_intrinsics
        )

    def _undistorted_labels(self) -> NDArray[np.uint8]:
        if self._labels is None:
            self._labels = self._arm_of_geom[self._renderer.render_geom_ids(self._data, _CAMERA)]
        return self._labels

    def undistort_photo(self, photo: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Undistort a photo, aligned with `pinhole_arms`."""
        return self._warp.undistort_photo(photo)

    @property
    def outside_photo(self) -> NDArray[np.bool_]:
        """Mask (height, width) of the pixels of an undistorted photo that the photo does not show."""
        return self._warp.outside_photo

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()


class ArmRenderers(Closable):
    """Creates an `ArmRenderer` per camera, and keeps only the last one open."""

    def __init__(self, rig: RigConfig, scene: SceneConfig, quality: RenderConfig, locations: Locations) -> None:
        self._parts = rig, scene, quality, locations
        self._last: tuple[CameraModel, ArmRenderer] | None = None

    def renderer_for(self, camera: CameraModel) -> ArmRenderer:
        """Return a camera's renderer; another camera's is closed."""
        if self._last is None or self._last[0] != camera:
            self.close()
            rig, scene, quality, locations = self._parts
            self._last = camera, ArmRenderer(rig, scene, quality, camera, locations)
        return self._last[1]

    def close(self) -> None:
        """Free the last renderer."""
        if self._last is not None:
            self._last[1].close()
            self._last = None
