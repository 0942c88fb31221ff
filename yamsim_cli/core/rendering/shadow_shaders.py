"""OpenGL programs that draw a geom with all lights, and filter the edges of the shadows on it.

`mjr_render` draws each geom twice: with the lights without shadows, and then with the light that casts shadows, where
the shadow map has no caster at all. Edges of its shadows are steps of one texel. A program here needs one drawing, and
takes a weighted mean of nine texels. Away from edges of shadows, most pixels differ by 1 of 255 at most.
Source of the formula of light: OpenGL's specification 2.1, section 2.14.1, with the settings of MuJoCo's `initLights`.
"""

from __future__ import annotations

import functools
import logging
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .opengl import OpenGlFunctions, address

_LOGGER = logging.getLogger("yamsim")


class TextureKind(IntEnum):
    """How a program finds the colour of a geom's texture at a vertex."""

    NONE = 0
    COORDINATES = 1  # a flat texture, at the vertex's own coordinates
    FLAT = 2  # a flat texture, at coordinates from the position
    CUBE = 3  # a cube map, at coordinates from the position


_VERTEX = """#version 120
uniform mat4 shadow_from_eye;
varying vec4 base, light, texel;
void main() {
    vec4 eye = gl_ModelViewMatrix * gl_Vertex;
    vec3 normal = normalize(gl_NormalMatrix * gl_Normal), head = normalize(-eye.xyz);
    vec3 own = gl_FrontLightModelProduct.sceneColor.rgb, shaded = vec3(0.0);
    vec3 towards;
    float facing;
    LIGHTS
    vec3 place = (shadow_from_eye * eye).xyz;
    base = vec4(clamp(own, 0.0, 1.0), place.x);
    light = vec4(clamp(shaded, 0.0, 1.0), place.y);
    texel = vec4(COORDINATES, place.z);
    gl_Position = ftransform();
}
"""
_LIGHT = """
    towards = normalize(gl_LightSource[K].position.xyz);
    facing = dot(normal, towards);
    SUM += gl_FrontLightProduct[K].ambient.rgb + max(facing, 0.0) * gl_FrontLightProduct[K].diffuse.rgb;
    if (facing > 0.0) SUM += gl_FrontLightProduct[K].specular.rgb
        * pow(max(dot(normal, normalize(towards + head)), 0.0), gl_FrontMaterial.shininess);
"""
_FRAGMENT = """#version 120
uniform sampler2DShadow shadow_map;
uniform SAMPLER image;
varying vec4 base, light, texel;
float tap(float x, float y) {
    return shadow2D(shadow_map, vec3(base.w + x, light.w + y, texel.w)).r;
}
void main() {
    float lit = (tap(-STEP, -STEP) + tap(STEP, -STEP) + tap(-STEP, STEP) + tap(STEP, STEP)) * 0.25;
    gl_FragColor = vec4((base.rgb + lit * light.rgb)IMAGE, 1.0);
}
"""
# Kind of texture -> coordinates at a vertex, type of the sampler, and factor in a pixel.
_TEXTURES = {
    TextureKind.NONE: ("0.0, 0.0, 0.0", "sampler2D", ""),
    TextureKind.COORDINATES: (
        "(gl_TextureMatrix[0] * gl_MultiTexCoord0).xyz", "sampler2D", " * texture2D(image, texel.xy).rgb",
    ),
    TextureKind.FLAT: (
        "dot(gl_ObjectPlaneS[0], gl_Vertex), dot(gl_ObjectPlaneT[0], gl_Vertex), 0.0",
        "sampler2D",
        " * texture2D(image, texel.xy).rgb",
    ),
    TextureKind.CUBE: (
        "dot(gl_ObjectPlaneS[0], gl_Vertex), dot(gl_ObjectPlaneT[0], gl_Vertex), dot(gl_ObjectPlaneR[0], gl_Vertex)",
        "samplerCube",
        " * textureCube(image, texel.xyz).rgb",
    ),
}  # fmt: skip
_STEP = 0.5  # texels from a pixel's place to each of four bilinear samples, which together cover 3 x 3 texels


class ShadowShaders:
    """Programs for the lights of a scene, one for each kind of texture.

    Args:
        gl: OpenGL functions. Their context must be current here and in all methods.
        lights: number of lights.
        caster: index of the light that casts shadows.
        side: edge of the shadow map, texels.
    """

    def __init__(self, gl: OpenGlFunctions, lights: int, caster: int, side: int) -> None:
        from OpenGL import GL

        self._gl = gl
        parts = [_LIGHT.replace("K", str(k)).replace("SUM", "shaded" if k == caster else "own") for k in range(lights)]
        self.names: list[int] = []
        self._places: list[int] = []
        for kind in TextureKind:
            coordinates, sampler, image = _TEXTURES[kind]
            vertex = _VERTEX.replace("LIGHTS", "".join(parts)).replace("COORDINATES", coordinates)
            fragment = _FRAGMENT.replace("SAMPLER", sampler).replace("IMAGE", image)
            program = _link(GL, vertex, fragment.replace("STEP", repr(_STEP / side)))
            GL.glUseProgram(program)
            GL.glUniform1i(GL.glGetUniformLocation(program, "shadow_map"), 1)
            GL.glUniform1i(GL.glGetUniformLocation(program, "image"), 0)
            self.names.append(program)
            self._places.append(GL.glGetUniformLocation(program, "shadow_from_eye"))
        GL.glUseProgram(0)

    def use(self, shadow_from_eye: NDArray[np.float32]) -> None:
        """Set the matrix (4, 4) from the camera's frame to the shadow map in all programs."""
        for name, place in zip(self.names, self._places, strict=True):
            self._gl.glUseProgram(name)
            self._gl.glUniformMatrix4fv(place, 1, 1, address(shadow_from_eye))

    def free(self) -> None:
        """Delete the programs."""
        for name in self.names:
            self._gl.glDeleteProgram(name)


@functools.cache
def warn_of_stepped_shadows(reason: str) -> None:
    """Warn, once in a process for each reason, that edges of shadows stay steps of one texel."""
    reason = " ".join(reason.split())
    _LOGGER.warning("quality: smooth_shadows: this OpenGL cannot smooth shadows, so edges have steps: %s", reason)


def _link(GL: Any, vertex: str, fragment: str) -> int:
    """Return OpenGL's name of a new program. Raises RuntimeError if OpenGL cannot compile it."""
    program = GL.glCreateProgram()
    for kind, source in ((GL.GL_VERTEX_SHADER, vertex), (GL.GL_FRAGMENT_SHADER, fragment)):
        shader = GL.glCreateShader(kind)
        GL.glShaderSource(shader, source)
        GL.glCompileShader(shader)
        GL.glAttachShader(program, shader)
        GL.glDeleteShader(shader)
    GL.glLinkProgram(program)
    if not GL.glGetProgramiv(program, GL.GL_LINK_STATUS):
        raise RuntimeError(f"OpenGL cannot link a program: {GL.glGetProgramInfoLog(program)!r}")
    return int(program)
