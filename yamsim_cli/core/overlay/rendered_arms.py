"""A rig's arms as a camera would see them, each from a base pose of its own in the camera's frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..config.recording import RenderConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import ConfigError
from ..geometry.camera import CameraModel, Intrinsics, opencv_from_mujoco
from ..geometry.se3 import Array, quat_from_rotation
from ..resources import Locations
from ..scene.compose import Contents, Meshes, compile_spec, compose
from ..scene.quality import apply_quality
from ..scene.robot import JOINTS, fingers
from ..vision.lens import LensWarp
from ..vision.renderer import SceneRenderer

_CAMERA = "photo"
_HIDDEN_GROUP = 5

# Photos up to this size are drawn twice as fine and averaged: smooth edges from any OpenGL.
_SMOOTHED = 1400
_MAX_PX = 8192


@dataclass(frozen=True)
class Drawn:
    """Arms drawn into a real camera's picture.

    Attributes:
        colour: RGB (height, width, 3), distorted as the photo is.
        labels: (height, width): 0 for none, k for the rig's k-th arm.
    """

    colour: NDArray[np.uint8]
    labels: NDArray[np.uint8]


@dataclass(frozen=True)
class Flat:
    """The same in an ideal pinhole picture: what geometry is done in.

    Attributes:
        labels: (height, width): 0 for none, k for the rig's k-th arm.
        depth: z (height, width) of the surface, m.
        intrinsics: of that picture.
    """

    labels: NDArray[np.uint8]
    depth: NDArray[np.float32]
    intrinsics: Intrinsics


class ArmDrawer:
    """Draws arms for photos of one camera. Close it, or use it as a context manager.

    The world it draws is the camera's own frame; the arms' base bodies are put into it.

    Args:
        camera: whose photos they are.

    Raises:
        ConfigError: the camera's pictures are too large or too wide to draw.
        ResourceError: nothing can draw here.
    """

    def __init__(
        self,
        rig: RigConfig,
        scene: SceneConfig,
        quality: RenderConfig,
        camera: CameraModel,
        locations: Locations,
        meshes: Meshes,
    ) -> None:
        self.rig = rig
        self._warp = LensWarp(camera, 2 if max(camera.width, camera.height) <= _SMOOTHED else 1)
        size = (self._warp.ideal.width, self._warp.ideal.height)
        if max(size) > _MAX_PX:
            raise ConfigError(f"a pinhole picture for this camera has {size[0]} x {size[1]} pixels; at most {_MAX_PX}")
        spec = compose(rig, scene, Contents(boards=False, background=False), locations, meshes)
        for light in list(spec.lights):
            spec.delete(light)
        # Light from the camera: nobody knows where the photo's came from, and no shadow is better than a false one.
        spec.visual.headlight.ambient = (0.35, 0.35, 0.35)
        spec.visual.headlight.diffuse = (0.6, 0.6, 0.6)
        apply_quality(spec, quality, size)
        spec.worldbody.add_camera(
            name=_CAMERA, quat=quat_from_rotation(opencv_from_mujoco(np.eye(3))), fovy=math.degrees(self._warp.fovy)
        )
        self._model = compile_spec(spec)
        self._data = mujoco.MjData(self._model)
        self._group = self._model.geom_group.copy()
        self._roots = [self._model.body(f"{arm.prefix}arm").id for arm in rig.arms]
        arm_of_root = {root: k for k, root in enumerate(self._roots, start=1)}
        numbers = [arm_of_root.get(int(self._model.body_rootid[body]), 0) for body in self._model.geom_bodyid]
        self._arm_of_geom = np.array([*numbers, 0], np.uint8)
        self._labels: NDArray[np.uint8] | None = None
        self._renderer = SceneRenderer(self._model, size)

    def pose(self, T_base_in_cam: Mapping[int, Array], joints: Array) -> None:
        """Put arms where they are.

        Args:
            T_base_in_cam: arm's index -> pose (4, 4); arms left out are not drawn.
            joints: of every arm (arms, 7): six joints in rad, the opening of one finger in m.
        """
        model, data = self._model, self._data
        for k, (arm, root) in enumerate(zip(self.rig.arms, self._roots, strict=True)):
            own = self._arm_of_geom[:-1] == k + 1
            model.geom_group[own] = self._group[own] if k in T_base_in_cam else _HIDDEN_GROUP
            if k in T_base_in_cam:
                model.body_pos[root] = T_base_in_cam[k][:3, 3]
                model.body_quat[root] = quat_from_rotation(T_base_in_cam[k][:3, :3])
            for name, angle in zip(JOINTS, joints[k], strict=False):
                data.qpos[model.joint(arm.prefix + name).qposadr[0]] = angle
            addresses, signs = fingers(model, arm.prefix)
            data.qpos[addresses] = joints[k, 6] * signs
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        self._labels = None

    def draw(self) -> Drawn:
        """The arms as the real camera sees them."""
        colour = self._warp.image(self._renderer.draw(self._data, _CAMERA))
        return Drawn(colour, self._warp.image(self._ideal_labels(), nearest=True))

    def flat_labels(self) -> NDArray[np.uint8]:
        """`flat` without the depth, which takes as long again."""
        step = self._warp.supersample
        return np.ascontiguousarray(self._ideal_labels()[::step, ::step])

    def flat(self) -> Flat:
        """The arms in an ideal pinhole picture."""
        step = self._warp.supersample
        depth = self._renderer.depth(self._data, _CAMERA)[::step, ::step]
        return Flat(self.flat_labels(), np.ascontiguousarray(depth), self._warp.coarse)

    def _ideal_labels(self) -> NDArray[np.uint8]:
        """Drawn once a pose: two of the results need it."""
        if self._labels is None:
            self._labels = self._arm_of_geom[self._renderer.segment(self._data, _CAMERA)]
        return self._labels

    def flattened(self, photo: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """A photo of the camera without its distortion: what `flat` can be compared with."""
        return self._warp.flattened(photo)

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()

    def __enter__(self) -> ArmDrawer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
