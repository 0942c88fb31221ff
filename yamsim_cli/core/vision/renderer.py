"""Draw a scene without a screen: one renderer a process, used for all cameras in turn."""

from __future__ import annotations

import math
from types import TracebackType

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import ResourceError
from ..geometry.camera import Intrinsics

Image = NDArray[np.uint8]
GeomIds = NDArray[np.int32]

# A plain number: numpy would compare each pixel with MuJoCo's enum by a Python call, seconds a picture.
_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)


def _opengl_name() -> str:
    """Name of the OpenGL implementation behind the current context, such as "llvmpipe (LLVM 15.0.6, 256 bits)"."""
    # Imported only now: PyOpenGL binds itself to the platform that MuJoCo has chosen by the time a context exists.
    from OpenGL import GL

    name = GL.glGetString(GL.GL_RENDERER)
    return name.decode() if name else "unknown"


class SceneRenderer:
    """Colour images of a scene's cameras. Close it, or use it as a context manager: teardown at exit is noisy.

    Attributes:
        description: name of the OpenGL implementation that draws.

    Args:
        model: what to draw.
        size: width and height in pixels; the model's offscreen buffer has to be at least as large.

    Raises:
        ResourceError: no OpenGL context could be made.
    """

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int]) -> None:
        self._model = model
        self._width, self._height = size
        try:
            self._renderer = mujoco.Renderer(model, height=self._height, width=self._width)
        # What PyOpenGL and MuJoCo raise differs by backend, driver and what is missing.
        except (ImportError, AttributeError, RuntimeError, OSError, mujoco.FatalError) as error:
            raise ResourceError(
                f"no OpenGL context for rendering: {' '.join(str(error).split())}; see README, 'No GL backend'"
            ) from error
        self._option = mujoco.MjvOption()
        self.description = _opengl_name()

    def intrinsics(self, camera: str) -> Intrinsics:
        """The pinhole camera that a camera's images were taken with."""
        fovy = math.radians(float(self._model.cam(camera).fovy[0]))
        return Intrinsics.from_fovy(self._width, self._height, fovy)

    def draw(self, data: mujoco.MjData, camera: str) -> Image:
        """An RGB image (height, width, 3) of the scene as `data` has it."""
        self._renderer.update_scene(data, camera, self._option)
        image: Image = self._renderer.render()
        return image

    def segment(self, data: mujoco.MjData, camera: str) -> GeomIds:
        """The id of the geom seen at each pixel, (height, width) of int32; -1 where there is none."""
        self._renderer.update_scene(data, camera, self._option)
        self._renderer.enable_segmentation_rendering()
        try:
            objects, kinds = np.moveaxis(self._renderer.render(), 2, 0)
        finally:
            self._renderer.disable_segmentation_rendering()
        ids: GeomIds = np.where(kinds == _GEOM, objects, -1).astype(np.int32)
        return ids

    def depth(self, data: mujoco.MjData, camera: str) -> NDArray[np.float32]:
        """The distance z (height, width) along the camera's axis of what is seen at each pixel, m."""
        self._renderer.update_scene(data, camera, self._option)
        self._renderer.enable_depth_rendering()
        try:
            depth: NDArray[np.float32] = self._renderer.render()
        finally:
            self._renderer.disable_depth_rendering()
        return depth

    def close(self) -> None:
        """Free the OpenGL context; safe to call twice."""
        self._renderer.close()

    def __enter__(self) -> SceneRenderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
