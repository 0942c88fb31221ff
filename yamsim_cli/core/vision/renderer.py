"""Draw a scene without a screen: one renderer a process, used for all cameras in turn."""

from __future__ import annotations

import math
from types import TracebackType

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import ResourceError
from ..geometry.camera import Intrinsics
from ..scene.compiled import CompiledScene

Image = NDArray[np.uint8]


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
        scene: what to draw.
        size: width and height in pixels; the scene must have been built for at least this size.

    Raises:
        ResourceError: no OpenGL context could be made.
    """

    def __init__(self, scene: CompiledScene, size: tuple[int, int]) -> None:
        self._scene = scene
        self._width, self._height = size
        try:
            self._renderer = mujoco.Renderer(scene.model, height=self._height, width=self._width)
        # What PyOpenGL and MuJoCo raise differs by backend, driver and what is missing.
        except (ImportError, AttributeError, RuntimeError, OSError, mujoco.FatalError) as error:
            raise ResourceError(
                f"no OpenGL context for rendering: {' '.join(str(error).split())}; see README, 'No GL backend'"
            ) from error
        self._option = mujoco.MjvOption()
        self.description = _opengl_name()

    def intrinsics(self, camera: str) -> Intrinsics:
        """The pinhole camera that a camera's images were taken with."""
        fovy = math.radians(float(self._scene.model.cam(camera).fovy[0]))
        return Intrinsics.from_fovy(self._width, self._height, fovy)

    def draw(self, data: mujoco.MjData, camera: str) -> Image:
        """An RGB image (height, width, 3) of the scene as `data` has it."""
        self._renderer.update_scene(data, camera, self._option)
        image: Image = self._renderer.render()
        return image

    def close(self) -> None:
        """Free the OpenGL context; safe to call twice."""
        self._renderer.close()

    def __enter__(self) -> SceneRenderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
