"""Renders states of a model with MuJoCo's Filament as it is: its own lights, sky, tones and post-processing.

These images differ more from those of OpenGL than images of `--quality photo`, so benchmarks use them as photos.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.photo_rendering.filament_context import open_context, require_filament

_MAX_GEOMS = 5000  # of a scene


class FilamentRenderer:
    """Renders a camera of a model. Lights keep their directions; Filament has its own units and tone curve.

    Two images of one state differ by random noise. The camera's `cam_ipd` in `model` becomes 0.
    """

    def __init__(self, model: mujoco.MjModel, camera: str, size: tuple[int, int]) -> None:
        require_filament()
        self._context = open_context()
        from mujoco import mjrf

        self._model, self._size = model, size
        self._picture = np.zeros((size[1], size[0], 3), np.uint8)
        self._target = self._context.create_render_target(
            mjrf.RenderTargetConfig(color_format=mjrf.PixelFormat.PIXEL_FORMAT_RGB8)
        )
        self._target.resize(*size)
        self._read = mjrf.ReadRequest(target=self._target)
        self._read.set_buffer(self._picture)
        self._resources = mjrf.ModelResources(self._context, model)
        self._scene = self._context.create_scene(mjrf.SceneParams())
        self._scene.configure_from_model(model)
        self._lights = mjrf.ModelLights(self._scene, self._resources)
        self._renderables = mjrf.ModelRenderables(self._scene, self._resources)
        self._options, self._abstract = mujoco.MjvOption(), mujoco.MjvScene(model, _MAX_GEOMS)
        self._fixed = mujoco.MjvCamera()
        self._fixed.type, self._fixed.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(camera).id
        # Both eyes of the stereo camera coincide: the picture has one eye.
        model.cam_ipd[self._fixed.fixedcamid] = 0.0

    def render(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        """Return the picture of a state as RGB (height, width, 3)."""
        from mujoco import mjrf

        mujoco.mj_forward(self._model, data)
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, data, self._options, None, self._fixed, everything, self._abstract)
        self._lights.update(data)
        self._renderables.update(data)
        view, request = self._abstract.camera[0], mjrf.RenderRequest()
        request.scene, request.target = self._scene, self._target
        names = ("pos", "forward", "up", "frustum_bottom", "frustum_top", "frustum_near", "frustum_far")
        request.camera = mjrf.Camera(**{name: getattr(view, name) for name in names})
        request.viewport.left = request.viewport.bottom = 0
        request.viewport.width, request.viewport.height = self._size
        self._context.wait_for_frame(self._context.render([request], [self._read]))
        return self._picture.copy()


def render_positions(
    model: mujoco.MjModel, positions: Sequence[NDArray[np.float64]], camera: str, size: tuple[int, int]
) -> list[NDArray[np.uint8]]:
    """Return the pictures (height, width, 3) of positions (nq,)."""
    data = mujoco.MjData(model)
    renderer = FilamentRenderer(model, camera, size)
    taken = []
    for position in positions:
        data.qpos[:] = position
        taken.append(renderer.render(data))
    return taken
