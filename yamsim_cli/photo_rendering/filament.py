"""Renders colour images of a model with MuJoCo's Filament, a physically based renderer."""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.images.image import Image
from .filament_context import open_context
from .light_samples import (
    SKY,
    LightSample,
    jittered_direction,
    make_dark_samples,
    make_light_samples,
    sky_direction,
)

# Intensities that illuminate a white surface to 1 of 1. Source: measured, of a directional light and of MuJoCo's sky.
_DIRECTIONAL_UNIT, _SKY_UNIT = 120_000.0, 32_300.0
# Factor on all light. OpenGL adds light in sRGB and Filament adds linear light, so sums differ. With this factor, the
# median of a plain scene is the same as in quality `high`.
_EXPOSURE = 0.85
_SRGB_EXPONENT = 2.2  # of linear light, approximately
_SKY_SHADOW_SHARE = 0.4  # share of the sky's light that casts shadows; the rest comes from everywhere
_COVERAGE_SAMPLES = 4  # renderings that find the share of the sky in a pixel, if an image shows any
_SKY_SHADOW_TEXELS = 512  # edge of the sky's shadow map: coarse texels blur shadows that should have no edges
_MIN_TINT = 0.1  # least value of a channel of the sky's light, as a share of the mean of the channels
# Linear light from 0 to 1: darker tones come from renderings with high gain alone, brighter ones from none of them. At
# the brighter end, an 8-bit step of the other renderings is about 1 of 255 in sRGB.
_DARK_TONES = (0.015, 0.05)
_LINEAR_STEPS = 8192  # of linear light in the table of sRGB values: steps of less than 1 of 255
_MAX_GEOMS = 10_000  # as of the classic renderer


_COMPILED_FIELDS = ("geom_group", "geom_matid", "flex_group")  # of `MjModel`, which a scene reads once


class FilamentRenderer:
    """Renders colour images of a model's cameras. Lights, materials and cameras may change between images.

    A process has one at most: two scenes at the same time made Filament 4.0.0 fail where one of them shows the sky.

    Equal states give equal images on the same driver: Filament's post-processing, which adds random noise, is off.

    Args:
        model: the scene. The roughness of a material that states none follows from its shininess.
        size: width and height of images, px.
        samples: renderings that an image averages, see `light_samples`.
    """

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int], samples: int) -> None:
        self._model, self._size, self._samples = model, size, samples
        self._context = open_context()
        from mujoco import mjrf

        self._target = self._context.create_render_target(
            mjrf.RenderTargetConfig(color_format=mjrf.PixelFormat.PIXEL_FORMAT_RGB8)
        )
        self._target.resize(*size)
        self._pixels = np.zeros((size[1], size[0], 3), np.uint8)
        self._read = mjrf.ReadRequest(target=self._target)
        self._read.set_buffer(self._pixels)
        self._option = mujoco.MjvOption()
        self._abstract = mujoco.MjvScene(model, _MAX_GEOMS)
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._scene: _FilamentScene | None = None
        self._scene_state = b""

    def reload_textures(self) -> None:
        """Take the textures of the model again after they have changed."""
        self._scene = None

    def render(self, data: mujoco.MjData, camera: str, background: Callable[[], Image]) -> Image:
        """Render an RGB image (height, width, 3) of the state `data`, before an image of the same shape."""
        scene, model = self._current_scene(), self._model
        self._camera.fixedcamid = model.camera(camera).id
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, everything, self._abstract)
        with _roughness(model):
            scene.renderables.update(data)
        casting = [k for k in range(model.nlight) if model.light_active[k] and model.light_castshadow[k]]
        light = self._average(data, make_light_samples(self._samples, casting))
        dark = self._average(data, make_dark_samples(self._samples, casting))
        covered = self._coverage(data, casting)
        # Each channel of a dark tone comes from the rendering with high gain.
        share = np.clip((_DARK_TONES[1] - light) / (_DARK_TONES[1] - _DARK_TONES[0]), 0, 1)
        colours = (light + share * (dark - light)) * _sky_tint(model).astype(np.float32)
        if covered is not None:
            colours += (1 - covered) * _srgb_decoding_table()[background()]
        return _encode_srgb(colours)

    def _current_scene(self) -> _FilamentScene:
        """Return the scene, made again if parts of it were shown or hidden."""
        state = b"".join(np.ascontiguousarray(getattr(self._model, key)).tobytes() for key in _COMPILED_FIELDS)
        if self._scene is None or state != self._scene_state:
            self._scene = None  # frees the old one first
            self._scene = _FilamentScene(self._context, self._model, self._option)
            self._scene_state = state
        return self._scene

    def _average(self, data: mujoco.MjData, samples: Sequence[LightSample]) -> NDArray[np.float32]:
        """Return the mean linear light (height, width, 3) of samples."""
        assert self._scene is not None
        mean = np.zeros(self._pixels.shape, np.float32)
        sources, tint = frozenset(sample.source for sample in samples), _sky_tint(self._model)
        for sample in samples:
            self._scene.illuminate(data, sample, sources, tint, self._abstract.camera[0].forward)
            self._render_sample(self._scene, sample)
            mean += self._pixels * np.float32(1 / (255 * sample.gain * len(samples)))
        return mean

    def _coverage(self, data: mujoco.MjData, casting: Sequence[int]) -> NDArray[np.float32] | None:
        """Return the share of surfaces in each pixel (height, width, 1); None if they fill the image."""
        assert self._scene is not None
        self._scene.darken()
        self._context.set_clear_color([1.0, 1.0, 1.0])
        seen = np.zeros(self._pixels.shape, np.float32)
        try:
            for sample in make_light_samples(_COVERAGE_SAMPLES, casting):
                self._render_sample(self._scene, sample)
                if not self._pixels.any():
                    return None
                seen += self._pixels / np.float32(255 * _COVERAGE_SAMPLES)
        finally:
            self._context.set_clear_color([0.0, 0.0, 0.0])
        return 1 - seen[..., :1]

    def _render_sample(self, scene: _FilamentScene, sample: LightSample) -> None:
        from mujoco import mjrf

        eyes = self._abstract.camera
        width, height = self._size
        view = eyes[0]
        # The camera's two eyes are mirrored, and their mean is the middle.
        pixel = (view.frustum_top - view.frustum_bottom) / height
        right, up = (pixel * shift for shift in sample.shift)
        request = mjrf.RenderRequest()
        request.scene, request.target = scene.scene, self._target
        request.camera = mjrf.Camera(
            pos=(eyes[0].pos + eyes[1].pos) / 2,
            forward=view.forward,
            up=view.up,
            frustum_center=(eyes[0].frustum_center + eyes[1].frustum_center) / 2 + right,
            frustum_width=(view.frustum_top - view.frustum_bottom) / 2 * width / height,
            frustum_bottom=view.frustum_bottom + up,
            frustum_top=view.frustum_top + up,
            frustum_near=view.frustum_near,
            frustum_far=view.frustum_far,
        )
        request.viewport.left = request.viewport.bottom = 0
        request.viewport.width, request.viewport.height = width, height
        request.post_processing = request.reflections = request.haze = request.skybox = False
        self._context.wait_for_frame(self._context.render([request], [self._read]))


class _FilamentScene:
    """Meshes, materials and lights of a model, as Filament's objects."""

    def __init__(self, context: Any, model: mujoco.MjModel, option: mujoco.MjvOption) -> None:
        from mujoco import mjrf

        self._model = model
        with _srgb_textures(model):
            self._resources = mjrf.ModelResources(context, model)
        self.scene = context.create_scene(mjrf.SceneParams())
        self.scene.configure_from_model(model)
        self.renderables = mjrf.ModelRenderables(self.scene, self._resources)
        self.renderables.set_options(option)
        self._caster = self._add_directional_light(context, int(model.vis.quality.shadowsize))
        self._sky_caster = self._add_directional_light(context, _SKY_SHADOW_TEXELS)
        self._others = [self._add_directional_light(context, 0) for _ in range(model.nlight)]
        self._headlight = self._add_directional_light(context, 0)
        self._texture = _sky_texture(context)
        self._sky = context.create_light(
            mjrf.LightParams(type=mjrf.LightType.LIGHT_IMAGE, texture=self._texture, intensity=0.0)
        )
        self.scene.add_light(self._sky)

    def _add_directional_light(self, context: Any, shadow_texels: int) -> Any:
        from mujoco import mjrf

        light = context.create_light(
            mjrf.LightParams(
                type=mjrf.LightType.LIGHT_DIRECTIONAL,
                intensity=0.0,
                cast_shadow=shadow_texels > 0,
                shadow_map_size=shadow_texels,
            )
        )
        self.scene.add_light(light)
        return light

    def darken(self) -> None:
        """Switch all lights off."""
        for light in (self._caster, self._sky_caster, self._headlight, *self._others, self._sky):
            light.set_intensity(0.0)

    def illuminate(
        self,
        data: mujoco.MjData,
        sample: LightSample,
        sources: Collection[int],
        tint: NDArray[np.float64],
        forward: NDArray[np.float64],
    ) -> None:
        """Set all lights for one rendering.

        Args:
            data: the state, which has the directions of the lights.
            sample: the rendering.
            sources: sources of all samples of the image. Other lights shine without shadows in each rendering.
            tint: colour (3,) of the sky's light.
            forward: direction (3,) of the camera, which the headlight has.
        """
        model, gain = self._model, sample.gain * _EXPOSURE
        ambient = float(np.mean(model.vis.headlight.ambient)) * gain if model.vis.headlight.active else 0.0
        self._sky.set_intensity(_SKY_UNIT * ambient * (1 - _SKY_SHADOW_SHARE))
        self._caster.set_active(sample.source != SKY)
        self._sky_caster.set_active(sample.source == SKY)
        if sample.source == SKY:
            strength = ambient * _SKY_SHADOW_SHARE * sample.weight / sample.offset[1]
            _set_light(self._sky_caster, data, sky_direction(sample.offset), np.full(3, strength))
        for k, light in enumerate(self._others):
            colour = _linear_colour(model.light_diffuse[k]) / tint * gain
            direction = np.asarray(data.light_xdir[k], np.float64)
            if not model.light_active[k] or (k in sources and k != sample.source):
                light.set_active(False)
            elif k == sample.source:
                light.set_active(False)
                _set_light(self._caster, data, jittered_direction(direction, sample.offset), colour * sample.weight)
            else:
                light.set_active(True)
                _set_light(light, data, direction, colour)
        shown = _linear_colour(model.vis.headlight.diffuse) / tint * gain * bool(model.vis.headlight.active)
        _set_light(self._headlight, data, np.asarray(forward, np.float64), shown)


def _set_light(light: Any, data: mujoco.MjData, direction: NDArray[np.float64], colour: NDArray[np.float64]) -> None:
    """Give a directional light its direction (3,), and its colour (3,) in which 1 fully illuminates a surface."""
    peak = float(np.max(colour))
    light.set_intensity(_DIRECTIONAL_UNIT * peak)
    light.set_color(list(colour / peak if peak > 0 else np.ones(3)))
    light.set_pose(list(np.asarray(data.subtree_com[0]) - direction), list(direction))


def _linear_colour(colour: ArrayLike) -> NDArray[np.float64]:
    """Return a light's colour (3,) for linear light. Its mean stays; OpenGL multiplies sRGB values by the colour."""
    values = np.asarray(colour, np.float64)
    mean = float(values.mean())
    if mean <= 0:
        return np.zeros(3)
    linear = (values / mean) ** _SRGB_EXPONENT
    return np.asarray(mean * linear / linear.mean())


def _sky_tint(model: mujoco.MjModel) -> NDArray[np.float64]:
    """Return the colour (3,) of the sky's light, with a mean of 1. Filament's sky is grey."""
    ambient = _linear_colour(model.vis.headlight.ambient)
    mean = float(ambient.mean())
    return np.maximum(ambient / mean, _MIN_TINT) if mean > 0 else np.ones(3)


@contextmanager
def _srgb_textures(model: mujoco.MjModel) -> Iterator[None]:
    """Mark textures without a colour space as sRGB while Filament reads them, as colours without textures are."""
    saved = model.tex_colorspace.copy()
    unknown = saved == mujoco.mjtColorSpace.mjCOLORSPACE_AUTO.value
    model.tex_colorspace[unknown] = mujoco.mjtColorSpace.mjCOLORSPACE_SRGB.value
    try:
        yield
    finally:
        model.tex_colorspace[:] = saved


@contextmanager
def _roughness(model: mujoco.MjModel) -> Iterator[None]:
    """Give materials that lack them metalness and roughness while Filament reads the model.

    The roughness is that of a Blinn-Phong highlight with the exponent 128 x shininess, which OpenGL uses.
    """
    saved = model.mat_roughness.copy(), model.mat_metallic.copy()
    missing = model.mat_roughness < 0
    exponent = 128 * model.mat_shininess[missing]
    model.mat_roughness[missing] = (2 / (exponent + 2)) ** 0.25
    model.mat_metallic[model.mat_metallic < 0] = 0.0
    try:
        yield
    finally:
        model.mat_roughness[:], model.mat_metallic[:] = saved


@functools.cache
def _srgb_decoding_table() -> NDArray[np.float32]:
    encoded = np.arange(256) / 255
    return np.asarray(np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4), np.float32)


@functools.cache
def _srgb_table() -> NDArray[np.uint8]:
    linear = np.arange(_LINEAR_STEPS + 1) / _LINEAR_STEPS
    encoded: NDArray[np.float64] = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * encoded), np.uint8)


def _encode_srgb(linear: NDArray[np.float32]) -> Image:
    """Return the sRGB image of linear light (height, width, 3), in which 1 is white. Source: IEC 61966-2-1."""
    image: Image = _srgb_table()[np.rint(np.minimum(linear, 1.0) * _LINEAR_STEPS).astype(np.int32)]
    return image


def _sky_texture(context: Any) -> Any:
    """Return the sky of MuJoCo's own viewer: an even, grey light that is brighter above."""
    import mujoco.studio
    from mujoco import mjrf

    content = (Path(mujoco.studio.__file__).parent / "assets" / "ibl.ktx").read_bytes()
    config = mjrf.TextureConfig()
    config.width, config.height = len(content), 0
    config.format, config.sampler_type = mjrf.PixelFormat.PIXEL_FORMAT_KTX, mjrf.SamplerType.TEXTURE_CUBE
    texture, data = context.create_texture(config), mjrf.TextureData()
    data.set_image(content)
    texture.upload(data)
    return texture
