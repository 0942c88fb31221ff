"""OpenGL display lists that draw each geom of a scene as `mjr_render` does."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from .opengl import OpenGlFunctions, address, floats
from .shadow_shaders import ShadowShaders, TextureKind

_TYPE = mujoco.mjtGeom
# Primitives with texture coordinates.
_TEXTURED_PRIMITIVES = {
    int(kind)
    for kind in (
        _TYPE.mjGEOM_PLANE,
        _TYPE.mjGEOM_SPHERE,
        _TYPE.mjGEOM_ELLIPSOID,
        _TYPE.mjGEOM_BOX,
        _TYPE.mjGEOM_CYLINDER,
        _TYPE.mjGEOM_CAPSULE,
    )
}
_TEXTURE_ROLES = int(mujoco.mjtTextureRole.mjNTEXROLE)  # textures of each material in `MjrContext.mat_texid`
_RGB_ROLE = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
_TEXTURE_2D = int(mujoco.mjtTexture.mjTEXTURE_2D)


class Builtin(IntEnum):
    """Offset of a primitive's display list from `MjrContext.baseBuiltin`. Source: MuJoCo's `render_context.h`."""

    SPHERE = 0
    UPPER_HEMISPHERE = 1
    LOWER_HEMISPHERE = 2
    CYLINDER = 3
    OPEN_CYLINDER = 4
    BOX = 6


class DrawMode(IntEnum):
    """What a display list draws."""

    LIT = 0  # with material, texture and emission
    SHADOW_LIGHT = 1  # the same without emission, for the second pass, which adds the light that casts shadows
    SHAPE = 2  # without material, into a shadow map


class GeomDisplayLists:
    """Three display lists for each geom of a scene, one for each `DrawMode`, in the geom's frame.

    Flexes (cloths) have lists with their material alone, because their shape changes.

    Args:
        gl: OpenGL functions. The context `context` must be current here and in all methods.
        geoms: the geoms of an updated `MjvScene`.
        shaders: programs for the lists of `Mode.LIT`.
    """

    def __init__(
        self,
        gl: OpenGlFunctions,
        context: mujoco.MjrContext,
        geoms: Sequence[mujoco.MjvGeom],
        shaders: ShadowShaders | None = None,
    ) -> None:
        from OpenGL import GL

        self._gl, self._constants, self._context, self._shaders = gl, GL, context, shaders
        self._count = len(DrawMode) * len(geoms)
        self._first: int = gl.glGenLists(self._count)
        for number, geom in enumerate(geoms):
            for mode in DrawMode:
                gl.glNewList(self.list_id(number, mode), GL.GL_COMPILE)
                self._draw(geom, mode)
                gl.glEndList()

    def list_id(self, geom: int, mode: DrawMode) -> int:
        """Return OpenGL's name of a display list. `geom` is an index in the geoms of the scene."""
        return self._first + len(DrawMode) * geom + mode

    def free(self) -> None:
        """Delete the lists."""
        self._gl.glDeleteLists(self._first, self._count)

    def _draw(self, geom: mujoco.MjvGeom, mode: DrawMode) -> None:
        if mode is DrawMode.SHAPE:
            self._draw_shape(geom)
            return
        texture = _Texture(self._context, geom) if geom.matid >= 0 else None
        if texture is not None:
            self._map_texture(texture)
        if self._shaders is not None:
            self._gl.glUseProgram(self._shaders.names[texture.kind if texture else TextureKind.NONE])
        self._set_material(geom, mode)
        if geom.type == _TYPE.mjGEOM_FLEX:
            return  # `end_flex` disables the texture
        self._draw_shape(geom)
        if texture is not None:
            self._unmap_texture(texture)

    def _set_material(self, geom: mujoco.MjvGeom, mode: DrawMode) -> None:
        gl, GL = self._gl, self._constants
        rgba, both = np.array(geom.rgba, np.float32), GL.GL_FRONT_AND_BACK
        emission = floats(0, 0, 0, 1)
        if mode is DrawMode.LIT:
            emission[:3] = np.float32(geom.emission) * rgba[:3]
        gl.glMaterialfv(both, GL.GL_EMISSION, address(emission))
        gl.glColor4f(*rgba)
        gl.glMaterialf(both, GL.GL_SHININESS, np.float32(geom.shininess) * np.float32(128))
        specular = floats(geom.specular, geom.specular, geom.specular, 1)
        gl.glMaterialfv(both, GL.GL_SPECULAR, address(specular))

    def _draw_shape(self, geom: mujoco.MjvGeom) -> None:
        gl, context, size = self._gl, self._context, np.array(geom.size, np.float32)
        builtin = context.baseBuiltin
        match geom.type:
            case _TYPE.mjGEOM_PLANE if geom.dataid >= 0:
                gl.glCallList(context.basePlane + geom.dataid + 1)
            case _TYPE.mjGEOM_PLANE:
                gl.glScalef(size[0], size[1], 1)
                gl.glCallList(context.basePlane)
            case _TYPE.mjGEOM_MESH | _TYPE.mjGEOM_SDF if geom.dataid >= 0:
                gl.glCallList(context.baseMesh + geom.dataid)
            case _TYPE.mjGEOM_SPHERE | _TYPE.mjGEOM_ELLIPSOID:
                gl.glScalef(*size)
                gl.glCallList(builtin + Builtin.SPHERE)
            case _TYPE.mjGEOM_CYLINDER:
                gl.glScalef(*size)
                gl.glCallList(builtin + Builtin.CYLINDER)
            case _TYPE.mjGEOM_BOX:
                gl.glScalef(*size)
                gl.glCallList(builtin + Builtin.BOX)
            case _TYPE.mjGEOM_CAPSULE:
                half, radius = size[2], np.float32(0.5) * (size[0] + size[1])
                gl.glScalef(*size)
                gl.glCallList(builtin + Builtin.OPEN_CYLINDER)
                gl.glScalef(1, 1, radius / half)
                gl.glTranslatef(0, 0, (half - radius) / radius)
                gl.glCallList(builtin + Builtin.UPPER_HEMISPHERE)
                gl.glTranslatef(0, 0, 2 * (radius - half) / radius)
                gl.glCallList(builtin + Builtin.LOWER_HEMISPHERE)

    def _map_texture(self, texture: _Texture) -> None:
        gl, GL = self._gl, self._constants
        if texture.number < 0:
            return
        gl.glActiveTexture(GL.GL_TEXTURE0)
        for state in texture.opengl_states(GL):
            gl.glEnable(state)
        gl.glBindTexture(GL.GL_TEXTURE_2D if texture.is_2d else GL.GL_TEXTURE_CUBE_MAP, texture.name)
        if texture.has_coordinates:
            gl.glMatrixMode(GL.GL_TEXTURE)
            gl.glLoadIdentity()
            if texture.is_infinite_plane:
                gl.glTranslatef(-0.5, -0.5, 0)
            gl.glScalef(*texture.repetitions, 1)
            gl.glMatrixMode(GL.GL_MODELVIEW)
        else:
            for axis, plane in zip((GL.GL_S, GL.GL_T, GL.GL_R), texture.planes(), strict=False):
                gl.glTexGenfv(axis, GL.GL_OBJECT_PLANE, address(plane))

    def _unmap_texture(self, texture: _Texture) -> None:
        gl, GL = self._gl, self._constants
        gl.glActiveTexture(GL.GL_TEXTURE0)
        for state in texture.opengl_states(GL):
            gl.glDisable(state)
        if texture.has_coordinates:
            gl.glMatrixMode(GL.GL_TEXTURE)
            gl.glLoadIdentity()
            gl.glMatrixMode(GL.GL_MODELVIEW)

    def end_flex(self, geom: mujoco.MjvGeom) -> None:
        """Disable the texture of a flex, after its faces have been drawn."""
        if geom.matid >= 0:
            self._unmap_texture(_Texture(self._context, geom))


class _Texture:
    """The RGB texture of a geom and how it is laid onto the geom. Source: `settexture` in MuJoCo's `render_gl3.c`.

    Attributes:
        number: id of the texture in the model, -1 for none.
        name: OpenGL's name of the texture.
        is_2d: whether the texture is flat; otherwise, or without a texture, it is a cube map.
        has_coordinates: whether the geom's vertices have texture coordinates; otherwise OpenGL generates them.
    """

    def __init__(self, context: mujoco.MjrContext, geom: mujoco.MjvGeom) -> None:
        self._geom, material = geom, geom.matid
        self._size = np.array(geom.size, np.float32)
        if geom.texid >= 0:
            self.number, self._uniform, self._repeat = int(geom.texid), bool(geom.texuniform), geom.texrepeat
        else:
            self.number = int(np.ravel(context.mat_texid)[_TEXTURE_ROLES * material + _RGB_ROLE])
            self._uniform = bool(context.mat_texuniform[material])
            self._repeat = np.ravel(context.mat_texrepeat)[2 * material : 2 * material + 2]
        exists = self.number >= 0
        self.name = int(context.texture[self.number]) if exists else 0
        flat = exists and int(context.textureType[self.number]) == _TEXTURE_2D
        self.has_coordinates = bool(geom.texcoord) or (flat and int(geom.type) in _TEXTURED_PRIMITIVES)
        self.is_2d = flat or self.has_coordinates
        self.is_infinite_plane = geom.type == _TYPE.mjGEOM_PLANE and not self._size[:2].all()

    @property
    def kind(self) -> TextureKind:
        """How a program finds the texture's colour."""
        if self.number < 0:
            return TextureKind.NONE
        if self.has_coordinates:
            return TextureKind.COORDINATES
        return TextureKind.FLAT if self.is_2d else TextureKind.CUBE

    def opengl_states(self, GL: Any) -> tuple[Any, ...]:
        """Return OpenGL's states that must be enabled while the geom is drawn."""
        if self.has_coordinates:
            return (GL.GL_TEXTURE_2D,)
        generated = (GL.GL_TEXTURE_GEN_S, GL.GL_TEXTURE_GEN_T)
        return (
            (GL.GL_TEXTURE_2D, *generated) if self.is_2d else (GL.GL_TEXTURE_CUBE_MAP, *generated, GL.GL_TEXTURE_GEN_R)
        )

    @property
    def repetitions(self) -> NDArray[np.float32]:
        """How often the texture repeats along x and y (2,)."""
        repeat = np.array(self._repeat, np.float32)
        if self.has_coordinates:
            repeat = np.where(repeat > 0, repeat, np.float32(1))
        elif self._geom.dataid >= 0:  # a mesh's vertices have the size already
            repeat = np.where(self._size[:2] > 0, repeat / np.maximum(self._size[:2], np.float32(1e-15)), repeat)
        return np.where(self._size[:2] > 0, repeat * self._size[:2], repeat) if self._uniform else repeat

    def planes(self) -> list[NDArray[np.float32]]:
        """Return the planes (4,) that give texture coordinates from points in the geom's frame."""
        if self.is_2d:
            across, along = np.float32(0.5) * self.repetitions
            return [floats(across, 0, 0, -0.5), floats(0, -along, 0, -0.5)]
        scale = self._size if self._uniform else np.ones(3, np.float32)
        return [floats(scale[0], 0, 0, 0), floats(0, scale[1], 0, 0), floats(0, 0, scale[2], 0)]
