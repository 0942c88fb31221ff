"""Offscreen rendering of a scene. One renderer per process serves all cameras in turn."""

from __future__ import annotations

import atexit
import math
import os
import sys
import weakref
from typing import Any

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from ..closable import Closable
from ..errors import ResourceError
from ..geometry.camera import Intrinsics
from ..images.image import Image
from .incremental_renderer import FLEX, GEOM, SHADOW, IncrementalRenderer
from .shadow_shaders import warn_of_stepped_shadows
from .software_renderers import is_software_renderer

# Id of the process that first used OpenGL; None if none has. Forked processes inherit it, spawned ones do not.
_opengl_pid: int | None = None


def _note_opengl_before_fork() -> None:
    global _opengl_pid
    if _opengl_pid is None:
        _opengl_pid = os.getpid()


def _note_mujoco_renderer() -> None:
    """Before a fork, check whether MuJoCo's own renderer has used OpenGL: it then has an open EGL display."""
    if getattr(sys.modules.get("mujoco.egl"), "EGL_DISPLAY", None) is not None:
        _note_opengl_before_fork()


os.register_at_fork(before=_note_mujoco_renderer)


def _enter_opengl() -> None:
    """Record that this process uses OpenGL.

    OpenGL drivers keep threads and locks. A fork does not copy the threads, so rendering in the fork would hang.

    Raises:
        ResourceError: this process was forked from a process that had used OpenGL.
    """
    if _opengl_pid not in (None, os.getpid()):
        raise ResourceError(
            f"process {os.getpid()} cannot render: it was forked, and process {_opengl_pid} had used OpenGL before, so "
            "OpenGL would hang here; start the processes that render with multiprocessing's 'forkserver' or 'spawn', "
            "as in "
            'AsyncVectorEnv(..., context="forkserver") or '
            'gymnasium.make_vec(..., vectorization_mode="async", vector_kwargs={"context": "forkserver"}), '
            "or render nothing before they are forked"
        )
    _note_opengl_before_fork()


GeomIds = NDArray[np.int32]

_MAX_GEOMS = 10_000  # geoms that can be rendered; more than any scene has
_FONT = mujoco.mjtFontScale.mjFONTSCALE_150.value
# Plain integers, because NumPy does not accept enums as indices.
_SEGMENTATION_FLAGS = [int(mujoco.mjtRndFlag.mjRND_SEGMENT), int(mujoco.mjtRndFlag.mjRND_IDCOLOR)]


def _opengl_name() -> str:
    """Return the name of the current OpenGL implementation, such as "llvmpipe (LLVM 15.0.6, 256 bits)"."""
    # On import, PyOpenGL binds to the platform of the existing context.
    from OpenGL import GL

    name = GL.glGetString(GL.GL_RENDERER)
    return name.decode() if name else "unknown"


class _RenderContexts:
    """A renderer's contexts. `free_contexts` first makes its own current: MuJoCo frees objects of the current one."""

    def __init__(self) -> None:
        self.gl: Any = None
        self.context: mujoco.MjrContext | None = None

    def free_contexts(self) -> None:
        atexit.unregister(self.free_contexts)
        if self.context is not None:
            self.gl.make_current()
            self.context.free()
        if self.gl is not None:
            self.gl.free()
        self.gl = self.context = None


def _averaging_step(fine: int, final: int) -> int:
    """Return the step, in fine pixels, at which edges of fine and final pixels coincide along a side of an image.

    Parts average to the same values as the whole image only where pixels overlap by wholes or halves. Otherwise, the
    step is the whole side.
    """
    common = math.gcd(fine, final)
    return fine // common if final // common <= 2 else fine


class SceneRenderer(Closable):
    """Renders images of a scene's cameras. Close the renderer, or use it as a context manager.

    Each camera keeps the memory of its last image.

    Attributes:
        description: name of the OpenGL implementation.

    Args:
        model: the scene. `scene.environment.apply_quality` must have made its offscreen buffer large enough.
        size: width and height of images, px.
        fine: width and height in which colour images are rendered before averaging to `size`; by default `size`.
        incremental: without a GPU, render only the changed part of a camera's image. The pixels are the same.
        smooth_shadows: filter the edges of shadows, see `core.rendering.shadow_shaders`.

    Raises:
        ResourceError: OpenGL cannot create a context, or this process was forked from one that had used OpenGL. The
            rendering methods raise the second error too.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        size: tuple[int, int],
        fine: tuple[int, int] | None = None,
        *,
        incremental: bool = True,
        smooth_shadows: bool = False,
    ) -> None:
        _enter_opengl()
        self._contexts = _RenderContexts()
        self._free = weakref.finalize(self, self._contexts.free_contexts)
        self._free.atexit = False
        self._model = model
        self._width, self._height = size
        fine = fine or size
        try:
            self._open_contexts(fine)
        # The errors of PyOpenGL and MuJoCo depend on the backend, the driver and the missing part.
        except (ImportError, AttributeError, RuntimeError, OSError, mujoco.FatalError) as error:
            self.close()
            raise ResourceError(
                f"no OpenGL context for rendering: {' '.join(str(error).split())}; run `yamsim doctor`"
            ) from error
        self._rect, self._fine_rect = mujoco.MjrRect(0, 0, *size), mujoco.MjrRect(0, 0, *fine)
        self._pixels = np.empty((fine[1], fine[0], 3), np.uint8)
        self._averaging_steps = (_averaging_step(fine[0], size[0]), _averaging_step(fine[1], size[1]))
        self._option = mujoco.MjvOption()
        self._scene = mujoco.MjvScene(model, maxgeom=_MAX_GEOMS)
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self.description = _opengl_name()
        # A GPU draws a whole image in less time than the changed part takes to be found.
        self._draws_changes = incremental and is_software_renderer(self.description)
        self._images: dict[str, tuple[Image, Image]] = {}  # of each camera, in the fine and in the final size
        self._incremental = (
            self._make_incremental_renderer(fine, smooth_shadows) if self._draws_changes or smooth_shadows else None
        )

    def _make_incremental_renderer(self, size: tuple[int, int], smooth: bool) -> IncrementalRenderer | None:
        try:
            return IncrementalRenderer(self._model, self._scene, self._make_context_current(), size, smooth)
        except (AttributeError, RuntimeError) as error:  # OpenGL lacks something
            if smooth:
                warn_of_stepped_shadows(str(error))
            return None

    def _open_contexts(self, size: tuple[int, int]) -> None:
        self._contexts.gl = mujoco.GLContext(*size)
        # MuJoCo has already registered the closing of its display. Exit handlers run in reverse order.
        atexit.register(self._contexts.free_contexts)
        self._contexts.gl.make_current()
        context = self._contexts.context = mujoco.MjrContext(self._model, _FONT)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
        if context.offWidth < size[0] or context.offHeight < size[1]:
            raise ValueError(f"the model's offscreen buffer is smaller than {size[0]} x {size[1]} pixels")
        context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR

    def intrinsics(self, camera: str) -> Intrinsics:
        """Return the pinhole intrinsics of the named camera for images of `size`."""
        fovy = math.radians(float(self._model.cam(camera).fovy[0]))
        return Intrinsics.from_fovy(self._width, self._height, fovy)

    def upload_texture(self, texture: int) -> None:
        """Copy the texture with the id `texture` to OpenGL again after its pixels have changed in the model."""
        mujoco.mjr_uploadTexture(self._model, self._make_context_current(), texture)
        if self._incremental:
            self._incremental.invalidate()

    def render(self, data: mujoco.MjData, camera: str, out: Image | None = None) -> Image:
        """Render an RGB image (height, width, 3) of the scene in the state `data`, into `out` if given."""
        self._update_scene(data, camera)
        pixels = self._render_changed_part(data, camera) if self._incremental else None
        image = np.empty((self._height, self._width, 3), np.uint8) if out is None else out
        cv2.flip(self._average_pixels(self._render_whole_image()) if pixels is None else pixels, 0, image)
        return image

    def render_geom_ids(self, data: mujoco.MjData, camera: str) -> GeomIds:
        """Render the id of the visible geom at each pixel, as int32 (height, width); -1 for no geom."""
        self._update_scene(data, camera)
        colours = np.empty((self._height, self._width, 3), np.uint8)
        self._render_ids(colours, None)
        # The colour of each geom is its number plus one; 0 is the background.
        number = colours.astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32)
        ids = np.full(self._scene.ngeom + 1, -1, np.int32)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.objtype == GEOM and geom.segid >= 0:
                ids[geom.segid + 1] = geom.objid
        seen: GeomIds = ids[number[::-1]]
        return seen

    def render_depth(self, data: mujoco.MjData, camera: str) -> NDArray[np.float32]:
        """Render the depth z (height, width) at each pixel along the camera's axis, m."""
        self._update_scene(data, camera)
        buffer = np.empty((self._height, self._width), np.float32)
        self._render_ids(None, buffer)
        return self._depth_in_metres(buffer)

    def render_labels_and_depth(
        self, data: mujoco.MjData, camera: str, label_of_geom: Image, label_of_flex: Image
    ) -> tuple[Image, NDArray[np.float32]]:
        """Render the label and the depth z of the geom or cloth at each pixel, both (height, width), in one pass.

        Args:
            label_of_geom: label of each geom (ngeom,), 0 to 254.
            label_of_flex: label of each flex, which is a cloth, (nflex,), 0 to 254.

        Returns:
            Labels and z in m. Both are 0 where the camera sees no surface.
        """
        self._update_scene(data, camera)
        label_of = {GEOM: label_of_geom, FLEX: label_of_flex}
        for geom in self._scene.geoms[: self._scene.ngeom]:
            # Objects of other types get 0 and are not rendered, so they hide nothing.
            geom.segid = label_of[geom.objtype][geom.objid] if geom.objtype in label_of else 0
        colours = np.empty((self._height, self._width, 3), np.uint8)
        buffer = np.empty((self._height, self._width), np.float32)
        self._render_ids(colours, buffer)
        # The colour of a label is the label plus one. The background is 0 and stays 0.
        labels: Image = np.maximum(colours[::-1, :, 0], 1) - np.uint8(1)
        z = self._depth_in_metres(buffer)
        z[buffer[::-1] == 0.0] = 0.0
        return labels, z

    def _depth_in_metres(self, buffer: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return depths z in m, top row first, from OpenGL's depth buffer."""
        extent = self._model.stat.extent
        near, far = self._model.vis.map.znear * extent, self._model.vis.map.zfar * extent
        # The buffer holds 1 at the near plane and 0 at the far one, and is linear in 1 / z.
        z: NDArray[np.float32] = (near * far / (buffer[::-1].astype(np.float64) * (far - near) + near)).astype(
            np.float32
        )
        return z

    def _update_scene(self, data: mujoco.MjData, camera: str) -> None:
        self._camera.fixedcamid = self._model.cam(camera).id
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._camera, everything, self._scene)
        # The fine size is rounded. Keep the field of view of the final size.
        for view in self._scene.camera:
            view.frustum_width = (view.frustum_top - view.frustum_bottom) / 2 * self._width / self._height

    def _render_changed_part(self, data: mujoco.MjData, camera: str) -> Image | None:
        """Return the camera's image in the final size, bottom row first; None if only `mjr_render` can draw it.

        The next call for the same camera overwrites the image.
        """
        assert self._incremental is not None
        context = self._make_context_current()
        if camera not in self._images:
            self._images[camera] = np.empty_like(self._pixels), np.empty((self._height, self._width, 3), np.uint8)
        fine, image = self._images[camera]
        if not self._draws_changes:
            self._incremental.invalidate()
        box = self._incremental.draw(data, camera)
        if box is None:
            return None
        if not box.is_empty:
            try:
                part = np.empty((box.height, box.width, 3), np.uint8)
                mujoco.mjr_readPixels(part, None, mujoco.MjrRect(*box), context)
                fine[box.pixels] = part
                aligned = box.aligned(*self._averaging_steps)
                image[aligned.scaled(image.shape, fine.shape).pixels] = self._average_pixels(fine[aligned.pixels])
            except BaseException:
                self._incremental.invalidate()
                raise
        return image

    def _render_whole_image(self) -> Image:
        """Return the image in the fine size, bottom row first."""
        context = self._make_context_current()
        mujoco.mjr_render(self._fine_rect, self._scene, context)
        mujoco.mjr_readPixels(self._pixels, None, self._fine_rect, context)
        return self._pixels

    def _average_pixels(self, pixels: Image) -> Image:
        """Average the fine pixels of an image or of an aligned part; without supersampling, return `pixels` itself."""
        fine, part = self._fine_rect, pixels.shape
        if (fine.width, fine.height) == (self._width, self._height):
            return pixels
        size = (part[1] * self._width // fine.width, part[0] * self._height // fine.height)
        return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)

    def _render_ids(self, colours: Image | None, depth: NDArray[np.float32] | None) -> None:
        """Render each geom in the colour of its number, without light or smoothing, into the given arrays."""
        context = self._make_context_current()
        flags = self._scene.flags.copy()
        self._scene.flags[_SEGMENTATION_FLAGS] = 1
        self._scene.flags[SHADOW] = 0  # keeps the shadow map
        try:
            mujoco.mjr_render(self._rect, self._scene, context)
            mujoco.mjr_readPixels(colours, depth, self._rect, context)
        finally:
            self._scene.flags[:] = flags

    def _make_context_current(self) -> mujoco.MjrContext:
        assert self._contexts.context is not None, "closed"
        _enter_opengl()
        self._contexts.gl.make_current()
        return self._contexts.context

    def close(self) -> None:
        """Free the OpenGL context. Repeated calls have no effect."""
        self._free()
