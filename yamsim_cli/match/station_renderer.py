"""Renders a station as a view sees it, with any light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..camera_rendering import HIDDEN_GROUP, EffectsRenderer
from ..core.attempt_data import ArmPosture
from ..core.closable import Closable
from ..core.config.rendering import RenderConfig
from ..core.config.rig import RigConfig
from ..core.config.scene import SceneConfig
from ..core.files.resources import Locations
from ..core.geometry.se3 import Array
from ..core.images.image import Image
from ..core.scene.blueprint import Blueprint, PictureSettings
from ..core.scene.cameras import SceneCamera
from ..core.scene.compilation import compile_spec
from ..core.scene.compose import compose_scene
from ..photos.overlay.rendered_arms import place_arm


@dataclass(frozen=True)
class Light:
    """Light of a station, linear RGB factors as in scene configs.

    Attributes:
        ambient, diffuse, headlight: of the ambient light, of one directional light, and of the light at the camera.
        direction: (3,) in which the directional light shines, in `world`.
    """

    ambient: Sequence[float]
    diffuse: Sequence[float]
    direction: Sequence[float]
    headlight: Sequence[float]


class StationRenderer(Closable):
    """Renders the arms of a rig in a scene.

    Args:
        scene: widened for the distance of the rig's arms.
        camera: the view; a plate of the scene has the same name.
        T_bases: pose (4, 4) of each arm's base in `world`; default: as in the rig.

    Raises ResourceError if no OpenGL context is available.
    """

    def __init__(
        self,
        rig: RigConfig,
        scene: SceneConfig,
        quality: RenderConfig,
        camera: SceneCamera,
        size: tuple[int, int],
        locations: Locations,
        T_bases: Sequence[Array] | None = None,
    ) -> None:
        self._T_bases: Sequence[Array | None] = T_bases or [None] * len(rig.arms)
        self._rig, self._camera, self._table = rig, camera.name, scene.table
        pictures = PictureSettings(quality, size)
        blueprint = Blueprint(rig, scene, boards=False, cameras=(camera,), pictures=pictures)
        self._model = model = compile_spec(compose_scene(blueprint, locations))
        self._data = mujoco.MjData(model)
        self._is_arm = model.geom_bodyid > 0
        self._group = model.geom_group.copy()
        plates = [plate for plate in scene.plates if plate.camera == camera.name]
        self._renderer = EffectsRenderer(model, size, quality, {}, plates)

    def set_postures(self, postures: Sequence[ArmPosture]) -> None:
        """Set all arms' joints."""
        model, data = self._model, self._data
        for arm, posture, T_base in zip(self._rig.arms, postures, self._T_bases, strict=True):
            place_arm(model, data, arm, posture, T_base)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)

    def set_light(self, light: Light) -> None:
        """Replace all lights; highlights vanish."""
        model = self._model
        direction = np.asarray(light.direction) / np.linalg.norm(light.direction)
        # The position of a directional light only centres its shadow map.
        middle = model.light_pos[0] + model.light_dir[0]
        model.light_diffuse[:], model.light_specular[:] = 0.0, 0.0
        model.light_diffuse[0] = light.diffuse
        model.light_dir[0], model.light_pos[0] = direction, middle - direction
        model.vis.headlight.ambient, model.vis.headlight.diffuse = light.ambient, light.headlight
        mujoco.mj_camlight(model, self._data)

    def show_white_table(self) -> None:
        """Give the table a white surface, whose image is the light that it reflects."""
        material = int(self._model.geom("table").matid[0])
        self._model.mat_rgba[material] = 1.0
        self._model.mat_specular[material] = self._model.mat_reflectance[material] = 0.0

    def show_arms(self, shown: bool) -> None:
        """Show or hide all arms, which then cast no shadows."""
        self._model.geom_group[self._is_arm] = self._group[self._is_arm] if shown else HIDDEN_GROUP

    def render(self) -> Image:
        """Render an RGB image (height, width, 3)."""
        return self._renderer.render(self._data, self._camera).copy()

    def masks(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return where the arms and where the table's surface are seen, each (height, width)."""
        ids = self._renderer.render_geom_ids(self._data, self._camera)
        return np.append(self._is_arm, False)[ids], ids == self._model.geom("table").id

    def close(self) -> None:
        """Free the OpenGL contexts."""
        self._renderer.close()
