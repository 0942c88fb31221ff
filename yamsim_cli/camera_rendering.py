"""Renders cameras with the lens, shutter and sensor of their config `CameraEffects`.

A distorted image is remapped from a wider image of an ideal camera at the same pose. Depth and segmentation are
remapped in the same way, and `LensIntrinsics` projects points, so ground truth fits the images.

A camera with a plate shows a photo in place of the surroundings, see `scene_photos`. Rendered arms and objects occlude
the photo, and their shadows darken it.
"""

from __future__ import annotations

import contextlib
import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .camera_effects.config import CameraEffects
from .camera_effects.lens_distortion import LensWarp, project_points, viewing_rays
from .camera_effects.sensor import Sensor
from .camera_effects.shutter import combine, row_weights, sample_times
from .core.attempt_data import AttemptJob
from .core.closable import Closable
from .core.config.recording import SCENE_CAMERA, RecordConfig
from .core.config.rendering import RenderConfig
from .core.errors import UsageError
from .core.geometry.camera import CameraModel, Intrinsics
from .core.geometry.se3 import Array
from .core.images.image import Image
from .core.rendering.renderer import GeomIds, SceneRenderer
from .core.scene.random_streams import Stream, random_generator
from .core.sim.state_replay import StateReplay
from .photo_rendering.filament_process import FilamentProcess
from .scene_photos.embedded_photos import Plate, decode_photo
from .video_compression import VideoCompression

_MAX_ROUND_TRIP = 1e-3  # of x/z and y/z, error of a projection and its inverse, which agree where the model is valid
_EDGE_PX = 3  # px, width of the transition between a plate and what is before it
_SHADE_FLOOR = 8.0  # of 255, added to both images of a shade, whose quotient is inaccurate in the dark
HIDDEN_GROUP = 5  # MuJoCo's geom group that is not rendered
_LOOK_FIELDS = (  # fields of `MjModel` that change the image of the surroundings
    "light_diffuse", "light_dir", "light_pos", "cam_fovy", "cam_pos", "cam_quat",
    "geom_matid", "mat_rgba", "mat_specular", "mat_shininess",
)  # fmt: skip
_SAME_SURFACE = 0.01  # of the depth: neighbouring pixels that differ by more show different surfaces


@dataclass(frozen=True)
class LensIntrinsics(Intrinsics):
    """Intrinsics of a camera whose lens distorts."""

    model: CameraModel

    @classmethod
    def from_ideal(cls, ideal: Intrinsics, effects: CameraEffects) -> LensIntrinsics:
        """Return the intrinsics of a camera with `effects`, whose sensor has the field of view of `ideal`."""
        model = effects.camera_model(ideal)
        (fx, _, cx), (_, fy, cy), _ = model.K
        return cls(ideal.width, ideal.height, fx, fy, cx, cy, model)

    def project(self, points_in_cam: ArrayLike) -> Array:
        """See `Intrinsics.project`. A point too far off the axis for the lens model is projected as by the pinhole."""
        points = np.atleast_2d(np.asarray(points_in_cam, dtype=np.float64))
        pixels, rays = project_points(self.model, points), points[:, :2] / points[:, 2:]
        # Far outside the image, the polynomials of a lens fold back into the image.
        apart = np.abs(viewing_rays(self.model, pixels) - rays).max(axis=1)
        folded = ~(apart <= _MAX_ROUND_TRIP * (1 + np.abs(rays).max(axis=1)))
        pixels[folded] = super().project(points[folded]) if folded.any() else pixels[folded]
        return pixels

    def rays(self, pixels: ArrayLike) -> Array:
        """See `Intrinsics.rays`."""
        flat = viewing_rays(self.model, np.atleast_2d(np.asarray(pixels, dtype=np.float64)))
        return np.column_stack([flat, np.ones(len(flat))])


def with_lens(ideal: Intrinsics, effects: CameraEffects | None) -> Intrinsics:
    """Return the intrinsics of a camera with a lens; `ideal` without one."""
    return LensIntrinsics.from_ideal(ideal, effects) if effects and effects.has_lens else ideal


class QualityRenderer(SceneRenderer):
    """Renders in a quality. Colour images of `photo` come from Filament, all else from OpenGL.

    Attributes:
        description: name of the OpenGL implementation; with Filament, also its version and the Vulkan device.

    Raises:
        ResourceError: as `SceneRenderer`, or Filament or its Vulkan driver is missing.
    """

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int], quality: RenderConfig) -> None:
        self._filament: FilamentProcess | None = None
        super().__init__(model, size, quality.fine_size(size), smooth_shadows=quality.smooth_shadows)
        if quality.photo_samples:
            self._filament = FilamentProcess(model, size, quality.photo_samples)
            self.description = f"{self.description}; {self._filament.description}"

    def upload_texture(self, texture: int) -> None:
        """See `SceneRenderer.upload_texture`."""
        super().upload_texture(texture)
        if self._filament is not None:
            self._filament.reload_textures()

    def render(self, data: mujoco.MjData, camera: str, out: Image | None = None) -> Image:
        """See `SceneRenderer.render`."""
        if self._filament is None:
            return super().render(data, camera, out)
        image = self._filament.render(data, camera, lambda: self._render_sky(data, camera))
        if out is None:
            return image
        out[:] = image
        return out

    def _render_sky(self, data: mujoco.MjData, camera: str) -> Image:
        """Render the image (height, width, 3) of an empty scene by OpenGL."""
        groups = [(shown, shown.copy()) for shown in (self._option.geomgroup, self._option.flexgroup)]
        for shown, _ in groups:
            shown[:] = 0
        try:
            return super().render(data, camera)
        finally:
            for shown, before in groups:
                shown[:] = before

    def close(self) -> None:
        """Free all contexts. Repeated calls have no effect."""
        if (filament := self.__dict__.get("_filament")) is not None:
            filament.close()
        super().close()


class EffectsRenderer(QualityRenderer):
    """Renders cameras through their lenses and before their plates; other cameras as `QualityRenderer`.

    Each camera with a lens has its own renderer for the ideal image, in a size that its first lens determines.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        size: tuple[int, int],
        quality: RenderConfig,
        effects: Mapping[str, CameraEffects],
        plates: Sequence[Plate] = (),
    ) -> None:
        super().__init__(model, size, quality)
        self._size, self._quality = size, quality
        self._lenses = {name: each for name, each in effects.items() if each.has_lens}
        self._wide: dict[str, tuple[SceneRenderer, tuple[int, int]]] = {}
        self._warps: dict[str, tuple[LensIntrinsics, LensWarp]] = {}
        self._plates = {plate.camera: _resized(decode_photo(plate.photo), size) for plate in plates}
        self._surroundings: _Surroundings | None = None

    def intrinsics(self, camera: str) -> Intrinsics:
        """See `SceneRenderer.intrinsics`; of a camera with a lens, they include the distortion."""
        return with_lens(super().intrinsics(camera), self._lenses.get(camera))

    def upload_texture(self, texture: int) -> None:
        """See `SceneRenderer.upload_texture`."""
        super().upload_texture(texture)
        for renderer, _ in self._wide.values():
            renderer.upload_texture(texture)
        if self._surroundings is not None:
            self._surroundings.upload_texture(texture)

    def render(self, data: mujoco.MjData, camera: str, out: Image | None = None) -> Image:
        """See `SceneRenderer.render`."""
        if camera in self._plates:
            image = super().render(data, camera, out)
            self._lay_behind(self._plates[camera], data, camera, image)
            return image
        if camera not in self._lenses:
            return super().render(data, camera, out)
        with self._wide_view(camera) as (renderer, warp):
            image = warp.distort_picture(renderer.render(data, camera))
        _fill_bars(image, self._lenses[camera], 0)
        if out is None:
            return image
        out[:] = image
        return out

    def _lay_behind(self, plate: Image, data: mujoco.MjData, camera: str, image: Image) -> None:
        """Replace the surroundings in an image (height, width, 3) by a plate of the same size, in place."""
        if self._surroundings is None:
            self._surroundings = _Surroundings(self._model, self._size, self._quality)
        empty = self._surroundings.render(camera).astype(np.float32)
        labels, _ = super().render_labels_and_depth(data, camera, *self._surroundings.front_labels)
        front = cv2.blur((labels > 0).astype(np.float32), (_EDGE_PX, _EDGE_PX))[..., None]
        shade = np.minimum((image + _SHADE_FLOOR) / (empty + _SHADE_FLOOR), 1.0)
        image[:] = np.rint(front * image + (1 - front) * shade * plate)

    def render_geom_ids(self, data: mujoco.MjData, camera: str) -> GeomIds:
        """See `SceneRenderer.render_geom_ids`."""
        if camera not in self._lenses:
            return super().render_geom_ids(data, camera)
        with self._wide_view(camera) as (renderer, warp):
            ids = renderer.render_geom_ids(data, camera)
            ids = warp.remap(ids.astype(np.float32), cv2.INTER_NEAREST).astype(np.int32)
        _fill_bars(ids, self._lenses[camera], -1)
        return ids

    def render_depth(self, data: mujoco.MjData, camera: str) -> NDArray[np.float32]:
        """See `SceneRenderer.render_depth`."""
        if camera not in self._lenses:
            return super().render_depth(data, camera)
        with self._wide_view(camera) as (renderer, warp):
            depth = _remap_depth(warp, renderer.render_depth(data, camera))
        _fill_bars(depth, self._lenses[camera], 0)
        return depth

    def render_labels_and_depth(
        self, data: mujoco.MjData, camera: str, label_of_geom: Image, label_of_flex: Image
    ) -> tuple[Image, NDArray[np.float32]]:
        """See `SceneRenderer.render_labels_and_depth`."""
        if camera not in self._lenses:
            return super().render_labels_and_depth(data, camera, label_of_geom, label_of_flex)
        with self._wide_view(camera) as (renderer, warp):
            labels, depth = renderer.render_labels_and_depth(data, camera, label_of_geom, label_of_flex)
            labels, depth = warp.distort_picture(labels, nearest=True), _remap_depth(warp, depth)
        for values in (labels, depth):
            _fill_bars(values, self._lenses[camera], 0)
        return labels, depth

    @contextlib.contextmanager
    def _wide_view(self, camera: str) -> Iterator[tuple[SceneRenderer, LensWarp]]:
        """Give the model the ideal camera's field of view, which contains the lens's field of view."""
        lens = self.intrinsics(camera)
        assert isinstance(lens, LensIntrinsics)
        known = self._wide.get(camera)
        if camera not in self._warps or self._warps[camera][0] != lens:
            self._warps[camera] = lens, LensWarp(lens.model, size=known[1] if known else None)
        warp = self._warps[camera][1]
        if known is None:
            size = warp.ideal.width, warp.ideal.height
            fine = self._quality.fine_size(size)
            buffer = self._model.vis.global_
            buffer.offwidth, buffer.offheight = max(buffer.offwidth, fine[0]), max(buffer.offheight, fine[1])
            wide = QualityRenderer(self._model, size, self._quality)
            known = self._wide[camera] = wide, size
        number = self._model.cam(camera).id
        fovy = float(self._model.cam_fovy[number])
        self._model.cam_fovy[number] = math.degrees(warp.fovy)
        try:
            yield known[0], warp
        finally:
            self._model.cam_fovy[number] = fovy

    def close(self) -> None:
        """Free all OpenGL contexts. Repeated calls have no effect."""
        for renderer, _ in self.__dict__.get("_wide", {}).values():
            renderer.close()
        if (surroundings := self.__dict__.get("_surroundings")) is not None:
            surroundings.close()
        super().close()


def _resized(photo: Image, size: tuple[int, int]) -> Image:
    """Return a photo (height, width, 3) in a size (width, height), px."""
    smaller = size[0] < photo.shape[1]
    return np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR), np.uint8)


class _Surroundings(Closable):
    """Renders a model without arms and objects: what they shade is the difference to the whole image.

    Attributes:
        front_labels: for `render_labels_and_depth`: 1 for geoms and flexes before the surroundings, else 0.
    """

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int], quality: RenderConfig) -> None:
        self._source = model
        self._model = copy.copy(model)
        moves = model.geom_bodyid > 0
        self._model.geom_group[moves] = HIDDEN_GROUP
        self._model.flex_group[:] = HIDDEN_GROUP
        self.front_labels = moves.astype(np.uint8), np.ones(model.nflex, np.uint8)
        self._data = mujoco.MjData(self._model)
        self._renderer = QualityRenderer(self._model, size, quality)
        self._state = b""
        self._images: dict[str, Image] = {}

    def render(self, camera: str) -> Image:
        """Return the image (height, width, 3) with the source's lights, materials and cameras; not a copy."""
        headlights = [model.vis.headlight for model in (self._source, self._model)]
        values = [getattr(self._source, key) for key in _LOOK_FIELDS] + [headlights[0].ambient, headlights[0].diffuse]
        state = b"".join(np.ascontiguousarray(value).tobytes() for value in values)
        if state != self._state:
            for key in _LOOK_FIELDS:
                getattr(self._model, key)[:] = getattr(self._source, key)
            headlights[1].ambient, headlights[1].diffuse = headlights[0].ambient, headlights[0].diffuse
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_comPos(self._model, self._data)
            mujoco.mj_camlight(self._model, self._data)
            self._state, self._images = state, {}
        if camera not in self._images:
            self._images[camera] = self._renderer.render(self._data, camera).copy()
        return self._images[camera]

    def upload_texture(self, texture: int) -> None:
        """Take over a texture of the source."""
        model, start = self._source, int(self._source.tex_adr[texture])
        end = start + int(model.tex_width[texture] * model.tex_height[texture] * model.tex_nchannel[texture])
        self._model.tex_data[start:end] = model.tex_data[start:end]
        self._renderer.upload_texture(texture)
        self._images = {}

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()


def require_fixed_plates(config: RecordConfig) -> None:
    """Raise UsageError if a camera with a plate would move away from its photo, or has its own lens."""
    ranges = config.randomization
    for plate in config.scene.plates:
        effects = config.effects_of(plate.camera)
        if plate.camera == SCENE_CAMERA and (ranges.camera or ranges.lens_deg):
            raise UsageError(
                f"randomization {ranges.name!r} moves {plate.camera}, but scene {config.scene.name!r} has a photo "
                "behind it, which fits only the camera's own pose; leave `camera` and `lens_deg` out of the ranges"
            )
        if effects and effects.has_lens:
            raise UsageError(
                f"camera_effects give {plate.camera} a lens, but scene {config.scene.name!r} has a photo without "
                "distortion behind it; leave out its `lens`, `distortion`, `principal_point`, `crop` and `letterbox`"
            )


def _fill_bars(image: NDArray[Any], effects: CameraEffects, value: int) -> None:
    """Set the bars above, below and beside the picture in an image (height, width[, channels]) to a value, in place."""
    left, top, right, bottom = effects.picture_box(image.shape[1], image.shape[0])
    image[:top] = image[bottom:] = image[:, :left] = image[:, right:] = value


def _remap_depth(warp: LensWarp, depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the depths z (height, width) of the distorted image, m; 0 for no surface.

    The inverse of z is linear on a plane, so it is interpolated where the neighbours show one surface.
    """
    nearest = warp.remap(depth, cv2.INTER_NEAREST)
    inverse = warp.remap(np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0), cv2.INTER_LINEAR)
    smooth = np.divide(1.0, inverse, out=np.zeros_like(inverse), where=inverse > 0)
    return np.where(np.abs(smooth - nearest) <= _SAME_SURFACE * nearest, smooth, nearest).astype(np.float32)


class EffectsCamera:
    """Takes the images of one camera with `effects`: delay, shutter and sensor. `number` is its index in recordings."""

    def __init__(self, name: str, number: int, effects: CameraEffects, frame_period: float) -> None:
        self.name = name
        self._number = number
        self._effects = effects
        self._period = frame_period
        self._sensor = Sensor(effects)
        self._video = VideoCompression(effects.h264_qp, effects.h264_key_frames) if effects.h264_qp else None

    def take(
        self, renderer: SceneRenderer, replica: StateReplay, positions: Sequence[Array], frame: int, out: Image
    ) -> None:
        """Render the image of a frame into `out`, from the positions (nq,) of all frames.

        Afterwards, `replica` has the state at the end of the exposure, to which the ground truth belongs.
        """
        shown = max(0, frame - self._effects.delay_frames)
        if self._effects.has_shutter:
            images = []
            for time in sample_times(self._effects):
                replica.set_state(_position_at(replica.scene.model, positions, shown + time / self._period))
                images.append(renderer.render(replica.data, self.name))
            out[:] = combine(np.stack(images), row_weights(self._effects, out.shape[0]))
            replica.set_state(positions[shown])
            return
        replica.set_state(positions[shown])
        renderer.render(replica.data, self.name, out)

    def expose(self, image: Image, job: AttemptJob, frame: int) -> None:
        """Apply the sensor to an image (height, width, 3) in place; the noise depends only on job, camera and frame.

        H.264 needs all frames of an attempt in their order.
        """
        left, top, right, bottom = self._effects.picture_box(image.shape[1], image.shape[0])
        picture = np.ascontiguousarray(image[top:bottom, left:right])
        self._sensor.apply(picture, lambda: random_generator(job, Stream.SENSOR, frame, self._number))
        if self._video is not None:
            self._video.apply(picture, frame)
        image[top:bottom, left:right] = picture


def _position_at(model: mujoco.MjModel, positions: Sequence[Array], place: float) -> Array:
    """Return positions (nq,) at a fractional frame, along the shortest motion between frames; before 0, as at 0."""
    place = max(0.0, place)
    first = min(int(place), len(positions) - 1)
    share = place - first
    if share == 0.0 or first + 1 >= len(positions):
        return positions[first]
    speed = np.zeros(model.nv)
    qpos = np.array(positions[first], dtype=np.float64)
    mujoco.mj_differentiatePos(model, speed, 1.0, qpos, np.asarray(positions[first + 1], dtype=np.float64))
    mujoco.mj_integratePos(model, qpos, speed, share)
    return qpos
