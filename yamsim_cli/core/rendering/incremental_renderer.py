"""Draws the part of a camera's image that has changed, with the same pixels as `mjr_render`.

`mjr_render` draws the whole image, and the shadow map again for each camera. Here OpenGL's scissor test limits drawing
to a rectangle of the image and of the shadow map. It does not change rasterization, so each pixel in the rectangle has
exactly the value that `mjr_render` gives it. Framebuffers, textures, meshes and primitives belong to `MjrContext`.
Source of the passes and of OpenGL's states: `mjr_render` in MuJoCo's `render_gl3.c`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..geometry.se3 import Array, pose
from .geom_display_lists import Builtin, DrawMode, GeomDisplayLists
from .opengl import OpenGlFunctions, address, floats
from .pixel_boxes import Projection, ScissorBox, ShadowTable, ShadowVolumes, box_corners, overlaps, union
from .shadow_shaders import ShadowShaders, warn_of_stepped_shadows

_Floats = NDArray[np.float32]
GEOM, FLEX = int(mujoco.mjtObj.mjOBJ_GEOM), int(mujoco.mjtObj.mjOBJ_FLEX)
SHADOW, _SKYBOX = int(mujoco.mjtRndFlag.mjRND_SHADOW), int(mujoco.mjtRndFlag.mjRND_SKYBOX)
_REFLECTION = int(mujoco.mjtRndFlag.mjRND_REFLECTION)
_UNSUPPORTED_EFFECTS = ("FOG", "WIREFRAME", "ADDITIVE", "SEGMENT")  # of MuJoCo's renderer, which this one lacks
_UNSUPPORTED_FLAGS = [int(getattr(mujoco.mjtRndFlag, f"mjRND_{name}")) for name in _UNSUPPORTED_EFFECTS]
_PLANE, _BOX = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_BOX)
_DIRECTIONAL_LIGHT = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
_DRAWN_TYPES = {
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("PLANE", "SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "MESH", "SDF", "FLEX")
}
_MIN_UPWARD_NORMAL = 0.999  # least vertical part of a plane's normal; shadows end on the lowest plane
_OPAQUE = 0.995  # smallest alpha of a geom that MuJoCo draws as opaque
# Factor and units of the offset away from the light in a shadow map: MuJoCo's, and with smooth edges. Twice MuJoCo's
# factor keeps surfaces that slope to the light from shading themselves through the wider filter.
_POLYGON_OFFSET, _SMOOTH_POLYGON_OFFSET = (-1.5, -4.0), (-3.0, -4.0)
_SKY_DISTANCE = np.float32(0.70)  # distance of the sky from the camera, as a fraction of the far clipping distance
_IMAGE_MARGIN, _SHADOW_MARGIN = 2, 3  # px and texels around a geom, for rounding

# Arrays of the model that decide how geoms and lights look. Poses come from `MjData`.
_APPEARANCE = (
    "geom_rgba", "geom_matid", "geom_group", "geom_size", "geom_dataid", "geom_aabb", "mat_rgba", "mat_emission",
    "mat_specular", "mat_shininess", "mat_reflectance", "mat_texid", "mat_texrepeat", "mat_texuniform", "flex_rgba",
    "flex_matid", "flex_radius", "light_type", "light_castshadow", "light_active", "light_ambient", "light_diffuse",
    "light_specular", "light_cutoff", "light_exponent", "light_attenuation",
)  # fmt: skip


@dataclass
class _Poses:
    """Poses of the scene's geoms, and the points of its cloths, in the single precision in which they are drawn."""

    matrices: _Floats  # (n, 4, 4), rotations by columns, as OpenGL multiplies them
    positions: _Floats  # (n, 3), m
    points: _Floats  # (m, 3), m, of all cloths
    lights: _Floats  # (k, 6), positions, m, and directions


@dataclass
class _View:
    """What a camera's image, or the shadow map, shows: its own pose, the poses of the geoms, and their corners."""

    camera: bytes
    poses: _Poses
    box_corners: Array


@dataclass
class _Layout:
    """The geoms of a scene, which stay the same until the appearance changes."""

    ids: NDArray[np.int_]  # (n,), id of each geom, or of the flex of a cloth
    geoms: NDArray[np.int_]  # (n,), the same, but 0 for cloths
    is_flex: NDArray[np.bool_]  # (n,), whether a geom is a cloth
    casts_shadow: NDArray[np.bool_]  # (n,), whether a geom casts a shadow
    is_plane: NDArray[np.bool_]  # (n,), whether a geom is a plane
    aabb: Array  # (n, 6), m, bounding box in the geom's frame; without meaning for cloths
    shadow_tables: NDArray[np.int_]  # indices of standing boxes that cast shadows
    light: int | None  # index of the light that casts shadows


class IncrementalRenderer:
    """Draws the changed rectangle of a camera's image.

    Args:
        model: the scene's model.
        scene, context: MuJoCo's scene and context; the context must be current in all methods.
        size: width and height of drawn images, px.
        smooth: whether to filter the edges of shadows, in which pixels then differ from `mjr_render`.

    Raises:
        AttributeError: the platform's OpenGL library lacks a function.
        RuntimeError: OpenGL cannot map depths to 0..1, so MuJoCo draws with other matrices.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        scene: mujoco.MjvScene,
        context: mujoco.MjrContext,
        size: tuple[int, int],
        smooth: bool = False,
    ) -> None:
        from OpenGL import GL

        self._gl, self._constants = OpenGlFunctions(), GL
        if b"GL_ARB_clip_control" not in (GL.glGetString(GL.GL_EXTENSIONS) or b""):
            raise RuntimeError("OpenGL lacks GL_ARB_clip_control")
        self._model, self._scene, self._context, self._size = model, scene, context, size
        self._smooth = smooth
        self._shaders: ShadowShaders | None = None
        self._lists: GeomDisplayLists | None = None
        self._layout: _Layout | None = None
        self._appearance = b""
        self._views: dict[str, _View] = {}
        self._shadow_view: _View | None = None  # what the shadow map shows
        self._shadow_matrix = np.empty((4, 4), np.float32)

    def invalidate(self) -> None:
        """Draw everything again at the next call, for example after a texture has changed."""
        self._views.clear()
        self._shadow_view = None

    def draw(self, data: mujoco.MjData, camera: str) -> ScissorBox | None:
        """Draw the changed part of the image of a camera into the offscreen buffer.

        The scene must have been updated with `data` and this camera, and its frustum must have a width.

        Returns:
            The rectangle that was drawn, which the caller copies; the rest of the image is as at the last call for this
            camera. None if the scene has something that only `mjr_render` draws.
        """
        try:
            return self._draw_changes(data, camera)
        except BaseException:
            self.invalidate()
            self._appearance, self._layout = b"", None
            raise

    def _draw_changes(self, data: mujoco.MjData, camera: str) -> ScissorBox | None:
        appearance = self._read_appearance()
        if appearance != self._appearance or (self._layout is not None and len(self._layout.ids) != self._scene.ngeom):
            self.invalidate()
            self._appearance, self._layout = appearance, self._read_layout()
            if self._layout is not None:
                self._set_up_image()  # the shadow map relies on the depth function, clear depth and clip control
        if self._layout is None or self._sees_back_of_plane(data):
            self.invalidate()
            return None
        poses = self._poses(data)
        view = _View(self._camera_pose(), poses, self._corners(poses))
        light = self._layout.light
        projection = self._image_projection()
        boxes, bounded = projection.boxes(view.box_corners)
        box = self._changed_pixel_box(self._views.get(camera), view, projection, boxes, light)
        if not box.is_empty:
            if light is not None:
                self._update_shadow_map(light, view)
            drawn = np.flatnonzero(overlaps(boxes, box) | ~bounded | self._layout.is_plane)
            self._draw_image(view, box, drawn, light)
        self._views[camera] = view
        return box

    def _read_appearance(self) -> bytes:
        """Return everything but poses that decides how geoms look."""
        headlight = self._model.vis.headlight
        lights = floats(*headlight.ambient, *headlight.diffuse, *headlight.specular, headlight.active)
        depths = floats(self._model.vis.map.znear, self._model.vis.map.zfar, self._model.stat.extent)
        arrays = [getattr(self._model, name) for name in _APPEARANCE]
        return b"".join(array.tobytes() for array in (*arrays, lights, depths, self._scene.flags))

    def _read_layout(self) -> _Layout | None:
        """Return the scene's geoms, or None if `mjr_render` has to draw them."""
        scene, model = self._scene, self._model
        geoms = scene.geoms[: scene.ngeom]
        if self._lists is not None:
            self._lists.free()
            self._lists = None
        if not self._is_supported(geoms):
            return None
        ids = np.array([geom.objid for geom in geoms], np.int_)
        is_flex = np.array([geom.objtype == FLEX for geom in geoms], np.bool_)
        decoration = int(mujoco.mjtCatBit.mjCAT_DECOR)
        casts = np.array([bool(geom.castshadow) and geom.category != decoration for geom in geoms], np.bool_)
        geom_ids = np.where(is_flex, 0, ids)
        planes = np.array([geom.type == _PLANE for geom in geoms], np.bool_)
        standing = ~is_flex & (model.body_weldid[model.geom_bodyid[geom_ids]] == 0)
        boxes = standing & casts & np.array([geom.type == _BOX for geom in geoms], np.bool_)
        shadows = scene.flags[SHADOW] and self._context.shadowFBO
        light = next((k for k in range(scene.nlight) if shadows and scene.lights[k].castshadow), None)
        aabb = model.geom_aabb[geom_ids]
        if self._shaders is not None:
            self._shaders.free()
            self._shaders = None
        if self._smooth and light is not None:
            try:
                self._shaders = ShadowShaders(self._gl, scene.nlight, light, self._context.shadowSize)
            except RuntimeError as error:
                warn_of_stepped_shadows(str(error))
        self._lists = GeomDisplayLists(self._gl, self._context, geoms, self._shaders)
        return _Layout(ids, geom_ids, is_flex, casts, planes, aabb, np.flatnonzero(boxes), light)

    def _is_supported(self, geoms: Sequence[mujoco.MjvGeom]) -> bool:
        scene = self._scene
        lights = scene.lights[: scene.nlight]
        if (
            scene.flags[_UNSUPPORTED_FLAGS].any()
            or self._context.offSamples
            or scene.nskin
            or sum(bool(light.castshadow) for light in lights) > 1
            or any(light.type != _DIRECTIONAL_LIGHT for light in lights)
            or (scene.nflex and (scene.flexvertopt or scene.flexedgeopt) and not scene.flexskinopt)
        ):
            return False
        return all(
            geom.type in _DRAWN_TYPES
            and geom.objtype in (GEOM, FLEX)
            and geom.rgba[3] >= _OPAQUE
            and not (geom.reflectance > 0 and scene.flags[_REFLECTION])
            and not geom.label
            and (geom.type != _PLANE or (geom.size[:2].all() and geom.mat[2, 2] > _MIN_UPWARD_NORMAL))
            for geom in geoms
        )

    def _sees_back_of_plane(self, data: mujoco.MjData) -> bool:
        """Return whether the camera is behind a plane, which MuJoCo then draws transparent."""
        assert self._layout is not None
        ids = self._layout.ids[self._layout.is_plane]
        head = np.array(self._camera().pos, np.float64)
        normals = data.geom_xmat[ids].reshape(-1, 3, 3)[:, :, 2]
        return bool((((head - data.geom_xpos[ids]) * normals).sum(axis=1) < 1e-6).any())

    def _poses(self, data: mujoco.MjData) -> _Poses:
        assert self._layout is not None
        geoms = self._layout.geoms
        matrices = np.zeros((len(geoms), 4, 4), np.float32)
        matrices[:, :3, :3] = data.geom_xmat[geoms].reshape(-1, 3, 3).transpose(0, 2, 1)
        matrices[:, 3, 3] = 1
        positions = data.geom_xpos[geoms].astype(np.float32)
        matrices[self._layout.is_flex] = np.eye(4)
        positions[self._layout.is_flex] = 0
        lights = np.concatenate([data.light_xpos, data.light_xdir], axis=1).astype(np.float32)
        return _Poses(matrices, positions, data.flexvert_xpos.astype(np.float32), lights)

    def _corners(self, poses: _Poses, growth: float = 0.0) -> Array:
        """Return the corners (n, 8, 3) of the boxes around all geoms, m, which are larger by `growth` on each side."""
        assert self._layout is not None
        aabb = self._layout.aabb.copy()
        for geom in np.flatnonzero(self._layout.is_flex):
            flex = self._layout.ids[geom]
            first, count = self._model.flex_vertadr[flex], self._model.flex_vertnum[flex]
            points, radius = poses.points[first : first + count], self._model.flex_radius[flex]
            low, high = points.min(axis=0) - radius, points.max(axis=0) + radius
            aabb[geom] = *((low + high) / 2), *((high - low) / 2)
        aabb[:, 3:] += growth
        rotations = poses.matrices[:, :3, :3].transpose(0, 2, 1).astype(np.float64)
        return box_corners(aabb, poses.positions.astype(np.float64), rotations)

    def _camera_pose(self) -> bytes:
        view = self._camera()
        lens = (view.frustum_center, view.frustum_width, view.frustum_bottom, view.frustum_top, view.frustum_near)
        return floats(*view.pos, *view.forward, *view.up, *lens, view.frustum_far).tobytes()

    def _camera(self) -> mujoco.MjvGLCamera:
        """Return the camera between the two eyes, which `mjr_render` draws."""
        return mujoco.mjv_averageCamera(*self._scene.camera)

    def _camera_matrix(self) -> Array:
        """Return the matrix (4, 4) from `world` to the camera's frame, in OpenGL's convention."""
        view = self._camera()
        forward, up = np.array(view.forward, np.float64), np.array(view.up, np.float64)
        R = np.array([np.cross(forward, up), up, -forward])
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, -R @ np.array(view.pos, np.float64)
        return T

    def _image_projection(self) -> Projection:
        view, T = self._camera(), self._camera_matrix()
        half_height = (view.frustum_top - view.frustum_bottom) / 2
        middle = (view.frustum_top + view.frustum_bottom) / 2
        near = view.frustum_near
        lens = np.array(
            [
                [near / view.frustum_width, 0, view.frustum_center / view.frustum_width, 0],
                [0, near / half_height, middle / half_height, 0],
                [0, 0, 0, 0],
                [0, 0, -1, 0],
            ]
        )
        return Projection(lens @ T, 0, self._size, self._size, _IMAGE_MARGIN)

    def _changed_pixel_box(
        self, before: _View | None, view: _View, projection: Projection, boxes: NDArray[np.int_], light: int | None
    ) -> ScissorBox:
        """Return the pixels in which a geom or a shadow has moved since the last image of the camera."""
        everything = ScissorBox(0, 0, *self._size)
        if before is None or before.camera != view.camera or (before.poses.lights != view.poses.lights).any():
            return everything
        changed = self._moved_geoms(before, view)
        if not changed.any():
            return ScissorBox(0, 0, 0, 0)
        assert self._layout is not None
        if (changed & self._layout.is_plane).any():
            return everything
        found = [boxes[changed], projection.boxes(before.box_corners[changed])[0]]
        casting = changed & self._layout.casts_shadow
        if light is not None and casting.any():
            volumes = self._shadow_volumes(light, view)
            if not volumes.is_bounded:
                return everything
            corners = np.concatenate([self._corners(each.poses, volumes.margin)[casting] for each in (before, view)])
            found.append(projection.boxes(volumes.hull_points(corners))[0])
        return union(np.concatenate(found))

    def _moved_geoms(self, before: _View, view: _View) -> NDArray[np.bool_]:
        """Return whether each geom has moved (n,)."""
        assert self._layout is not None
        old, new = before.poses, view.poses
        moved = (new.positions != old.positions).any(axis=1) | (new.matrices != old.matrices).any(axis=(1, 2))
        return np.asarray(moved | (self._layout.is_flex & (new.points != old.points).any()))

    def _shadow_volumes(self, light: int, view: _View) -> ShadowVolumes:
        assert self._layout is not None
        texel = 2 * self._context.shadowClip / self._context.shadowSize
        bounded = view.box_corners[~self._layout.is_plane][..., 2]
        lowest = min([float(bounded.min(initial=0)), *view.poses.positions[self._layout.is_plane, 2].tolist()])
        tables = tuple(
            ShadowTable(
                pose(view.poses.positions[k], view.poses.matrices[k, :3, :3].T.astype(np.float64)),
                self._layout.aabb[k, 3:],
            )
            for k in self._layout.shadow_tables
        )
        direction = np.array(self._scene.lights[light].dir, np.float64)
        return ShadowVolumes(
            direction / np.linalg.norm(direction), lowest, tables, math.sqrt(3) * _SHADOW_MARGIN * texel
        )

    def _update_shadow_map(self, light: int, view: _View) -> None:
        """Draw the changed part of the shadow map, and keep the texture's projection in `_shadow_matrix`."""
        gl, GL, context = self._gl, self._constants, self._context
        assert self._layout is not None
        projection, modelview = self._set_light_view(light)
        side = context.shadowSize
        # Columns of OpenGL's matrices are rows of NumPy's.
        matrix = projection.reshape(4, 4).T.astype(np.float64) @ modelview.reshape(4, 4).T
        texels = Projection(matrix, 1, (side - 2, side - 2), (side, side), _SHADOW_MARGIN)
        boxes, _ = texels.boxes(view.box_corners)
        before, box = self._shadow_view, ScissorBox(0, 0, side, side)
        if before is not None and (before.poses.lights == view.poses.lights).all():
            changed = self._moved_geoms(before, view) & self._layout.casts_shadow
            box = union(np.concatenate([boxes[changed], texels.boxes(before.box_corners[changed])[0]]))
        self._shadow_view = view
        self._shadow_matrix = _texture_matrix(projection, modelview)
        if box.is_empty:
            return
        gl.glBindFramebuffer(GL.GL_FRAMEBUFFER, context.shadowFBO)
        gl.glDrawBuffer(GL.GL_NONE)
        gl.glEnable(GL.GL_DEPTH_TEST)
        gl.glEnable(GL.GL_SCISSOR_TEST)
        gl.glScissor(*box)
        gl.glClear(GL.GL_DEPTH_BUFFER_BIT)
        gl.glViewport(1, 1, side - 2, side - 2)
        gl.glShadeModel(GL.GL_FLAT)
        gl.glDisable(GL.GL_LIGHTING)
        gl.glColorMask(0, 0, 0, 0)
        # `mjr_render` also draws the faces that the light sees from behind. The faces in front of them cast the same
        # shadow, except at edges of thin geoms.
        (gl.glDisable if self._shaders is None else gl.glEnable)(GL.GL_CULL_FACE)
        gl.glEnable(GL.GL_POLYGON_OFFSET_FILL)
        gl.glPolygonOffset(*(_POLYGON_OFFSET if self._shaders is None else _SMOOTH_POLYGON_OFFSET))
        self._draw_geoms(
            view,
            np.flatnonzero((overlaps(boxes, box) | self._layout.is_plane) & self._layout.casts_shadow),
            DrawMode.SHAPE,
        )
        gl.glDisable(GL.GL_POLYGON_OFFSET_FILL)
        gl.glDisable(GL.GL_SCISSOR_TEST)
        gl.glColorMask(1, 1, 1, 1)
        gl.glEnable(GL.GL_LIGHTING)
        gl.glShadeModel(GL.GL_SMOOTH)
        gl.glBindFramebuffer(GL.GL_FRAMEBUFFER, context.offFBO)
        gl.glDrawBuffer(GL.GL_COLOR_ATTACHMENT0)

    def _set_light_view(self, light: int) -> tuple[_Floats, _Floats]:
        """Set OpenGL's matrices to the view of a directional light, and return projection and modelview (16,)."""
        gl, GL = self._gl, self._constants
        source, clip = self._scene.lights[light], self._context.shadowClip
        view = self._camera()
        gl.glMatrixMode(GL.GL_PROJECTION)
        gl.glLoadIdentity()
        gl.glTranslatef(0, 0, 0.5)
        gl.glScalef(1, 1, -0.5)
        gl.glOrtho(-clip, clip, -clip, clip, view.frustum_near, view.frustum_far)
        projection, modelview = np.empty(16, np.float32), np.empty(16, np.float32)
        gl.glGetFloatv(GL.GL_PROJECTION_MATRIX, address(projection))
        gl.glMatrixMode(GL.GL_MODELVIEW)
        gl.glLoadIdentity()
        look = _look_along(np.array(source.pos, np.float32), np.array(source.dir, np.float32))
        gl.glMultMatrixf(address(look))
        gl.glGetFloatv(GL.GL_MODELVIEW_MATRIX, address(modelview))
        return projection, modelview

    def _draw_image(self, view: _View, box: ScissorBox, drawn: NDArray[np.int_], light: int | None) -> None:
        """Draw the geoms `drawn` and the sky into a rectangle of the image. `light` is the light that casts shadows."""
        gl, GL = self._gl, self._constants
        self._set_up_image()
        gl.glViewport(0, 0, *self._size)
        gl.glEnable(GL.GL_SCISSOR_TEST)
        gl.glScissor(*box)
        gl.glClear(GL.GL_COLOR_BUFFER_BIT | GL.GL_DEPTH_BUFFER_BIT)
        # MuJoCo draws floor and table first, and a later geom wins where depths are equal. From last to first, most
        # pixels are shaded once; a strict test keeps the winner.
        drawn = drawn[::-1]
        gl.glDepthFunc(GL.GL_GREATER)
        if self._shaders is not None:
            gl.glActiveTexture(GL.GL_TEXTURE1)
            gl.glBindTexture(GL.GL_TEXTURE_2D, self._context.shadowTex)
            self._shaders.use((self._shadow_matrix @ np.linalg.inv(self._camera_matrix())).astype(np.float32))
            self._draw_geoms(view, drawn, DrawMode.LIT)
            gl.glUseProgram(0)
            gl.glDepthFunc(GL.GL_GEQUAL)
        else:
            self._draw_lights(view, drawn, light)
        if self._scene.flags[_SKYBOX]:
            self._draw_sky()
        gl.glDisable(GL.GL_SCISSOR_TEST)

    def _draw_lights(self, view: _View, drawn: NDArray[np.int_], light: int | None) -> None:
        """Draw geoms as `mjr_render` does: with the lights without shadows, then with the one that casts shadows."""
        gl, GL = self._gl, self._constants
        lights = [GL.GL_LIGHT0 + k for k in range(self._scene.nlight) if k != light]
        for number in lights:
            gl.glEnable(number)
        self._draw_geoms(view, drawn, DrawMode.LIT)
        for number in lights:
            gl.glDisable(number)
        gl.glDepthFunc(GL.GL_GEQUAL)
        if light is not None:
            self._add_shadow_light(view, drawn, GL.GL_LIGHT0 + light)

    def _set_up_image(self) -> None:
        """Let `mjr_render` set OpenGL's matrices, lights and states, by drawing no geom into one pixel."""
        scene = self._scene
        count, flags = scene.ngeom, scene.flags.copy()
        scene.ngeom = 0
        scene.flags[[SHADOW, _SKYBOX]] = 0
        try:
            mujoco.mjr_render(mujoco.MjrRect(0, 0, 1, 1), scene, self._context)
        finally:
            scene.ngeom = count
            scene.flags[:] = flags

    def _add_shadow_light(self, view: _View, drawn: NDArray[np.int_], light: int) -> None:
        """Add the light with OpenGL's number `light` where the shadow map shows no caster."""
        gl, GL = self._gl, self._constants
        states = (GL.GL_TEXTURE_2D, GL.GL_TEXTURE_GEN_S, GL.GL_TEXTURE_GEN_T, GL.GL_TEXTURE_GEN_R, GL.GL_TEXTURE_GEN_Q)
        gl.glActiveTexture(GL.GL_TEXTURE1)
        for state in states:
            gl.glEnable(state)
        gl.glBindTexture(GL.GL_TEXTURE_2D, self._context.shadowTex)
        for axis, row in zip((GL.GL_S, GL.GL_T, GL.GL_R, GL.GL_Q), self._shadow_matrix, strict=True):
            gl.glTexGenfv(axis, GL.GL_EYE_PLANE, address(row))
        for state in (GL.GL_ALPHA_TEST, GL.GL_BLEND, light):
            gl.glEnable(state)
        gl.glBlendFunc(GL.GL_ONE, GL.GL_ONE)
        self._draw_geoms(view, drawn, DrawMode.SHADOW_LIGHT)
        for state in (light, GL.GL_BLEND, GL.GL_ALPHA_TEST):
            gl.glDisable(state)
        gl.glActiveTexture(GL.GL_TEXTURE1)
        for state in states:
            gl.glDisable(state)

    def _draw_sky(self) -> None:
        gl, GL, context = self._gl, self._constants, self._context
        kind = int(mujoco.mjtTexture.mjTEXTURE_SKYBOX)
        texture = next((context.texture[k] for k in range(context.ntexture) if context.textureType[k] == kind), None)
        if texture is None:
            return
        view = self._camera()
        distance = np.float32(view.frustum_far) * _SKY_DISTANCE
        states = (GL.GL_TEXTURE_CUBE_MAP, GL.GL_TEXTURE_GEN_S, GL.GL_TEXTURE_GEN_T, GL.GL_TEXTURE_GEN_R)
        gl.glDisable(GL.GL_LIGHTING)
        gl.glDisable(GL.GL_COLOR_MATERIAL)
        gl.glCullFace(GL.GL_FRONT)
        gl.glPushMatrix()
        gl.glTranslatef(*view.pos)
        gl.glScalef(distance, distance, distance)
        gl.glActiveTexture(GL.GL_TEXTURE0)
        for state in states:
            gl.glEnable(state)
        gl.glBindTexture(GL.GL_TEXTURE_CUBE_MAP, int(texture))
        for axis, plane in ((GL.GL_S, (1, 0, 0, 0)), (GL.GL_T, (0, 0, 1, 0)), (GL.GL_R, (0, -1, 0, 0))):
            row = floats(*plane)
            gl.glTexGenfv(axis, GL.GL_OBJECT_PLANE, address(row))
        gl.glColor4f(1, 1, 1, 1)
        gl.glCallList(context.baseBuiltin + Builtin.CYLINDER)
        for state in states:
            gl.glDisable(state)
        gl.glPopMatrix()
        gl.glEnable(GL.GL_LIGHTING)
        gl.glEnable(GL.GL_COLOR_MATERIAL)
        gl.glCullFace(GL.GL_BACK)

    def _draw_geoms(self, view: _View, geoms: NDArray[np.int_], mode: DrawMode) -> None:
        assert self._lists is not None and self._layout is not None
        gl, matrices = self._gl, address(view.poses.matrices)
        stride = view.poses.matrices.strides[0]
        for geom, position in zip(geoms.tolist(), view.poses.positions[geoms].tolist(), strict=True):
            if self._layout.is_flex[geom]:
                self._draw_flex(geom, mode)
                continue
            gl.glPushMatrix()
            gl.glTranslatef(*position)
            gl.glMultMatrixf(matrices + stride * geom)
            gl.glCallList(self._lists.list_id(geom, mode))
            gl.glPopMatrix()

    def _draw_flex(self, number: int, mode: DrawMode) -> None:
        """Draw the faces of a cloth."""
        assert self._lists is not None
        gl, GL, scene = self._gl, self._constants, self._scene
        geom = scene.geoms[number]
        faces, first = int(scene.flexfaceused[geom.objid]), int(scene.flexfaceadr[geom.objid])
        gl.glCallList(self._lists.list_id(number, mode))
        textured = bool(geom.texcoord) and geom.matid >= 0
        arrays = [GL.GL_VERTEX_ARRAY, GL.GL_NORMAL_ARRAY] + [GL.GL_TEXTURE_COORD_ARRAY] * textured
        for array in arrays:
            gl.glEnableClientState(array)
        gl.glVertexPointer(3, GL.GL_FLOAT, 0, address(scene.flexface[9 * first :]))
        gl.glNormalPointer(GL.GL_FLOAT, 0, address(scene.flexnormal[9 * first :]))
        if textured:
            gl.glTexCoordPointer(2, GL.GL_FLOAT, 0, address(scene.flextexcoord[6 * first :]))
        gl.glDrawArrays(GL.GL_TRIANGLES, 0, 3 * faces)
        for array in arrays:
            gl.glDisableClientState(array)
        if mode is not DrawMode.SHAPE:
            self._lists.end_flex(geom)


def _texture_matrix(projection: _Floats, modelview: _Floats) -> _Floats:
    """Return the rows (4, 4) that map points in `world` to coordinates in the shadow map, as MuJoCo multiplies them."""
    bias = floats(0.5, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 1, 0, 0.5, 0.5, 0, 1)
    return np.ascontiguousarray(_multiply_matrices(bias, _multiply_matrices(projection, modelview)).reshape(4, 4).T)


def _multiply_matrices(left: _Floats, right: _Floats) -> _Floats:
    """Return the product (16,) of two matrices by columns (16,). Sums are in the order of MuJoCo's `mjr_mulMat44`."""
    a, b = left.reshape(4, 4).T, right.reshape(4, 4).T
    total = np.zeros((4, 4), np.float32)
    for k in range(4):
        total += a[:, k, None] * b[None, k]
    return np.ascontiguousarray(total.T).ravel()


def _look_along(eye: _Floats, direction: _Floats) -> _Floats:
    """Return the view matrix (16,) by columns from `eye` along `direction`, in the order of MuJoCo's `mjr_lookAt`."""
    up = _cross(direction, floats(-1, 0, 0))
    up = _unit(up if _dot(up, up) > 0.01 else _cross(direction, floats(0, 1, 0)))
    forward = _unit(direction)
    side = _unit(_cross(forward, up))
    up = _unit(_cross(side, forward))
    rows = np.array([side, up, -forward], np.float32)
    look = np.eye(4, dtype=np.float32)
    look[:3, :3] = rows.T
    look[3, :3] = -_dot(side, eye), -_dot(up, eye), _dot(forward, eye)
    return look.ravel()


def _cross(a: _Floats, b: _Floats) -> _Floats:
    return floats(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _dot(a: _Floats, b: _Floats) -> np.float32:
    return np.float32(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _unit(vector: _Floats) -> _Floats:
    return np.asarray(vector * (np.float32(1) / np.sqrt(_dot(vector, vector))))
