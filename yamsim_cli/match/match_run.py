"""Match a scene to photos of a station: camera, background, table, light, and a score."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.config.recording import SCENE_CAMERA
from ..core.config.rendering import RenderConfig
from ..core.config.rig import RigConfig
from ..core.config.scene import FixedCamera, SceneConfig
from ..core.config.scene import Light as SceneLight
from ..core.errors import ConfigError, ResourceError
from ..core.files.resources import Locations
from ..core.geometry.camera import CameraModel
from ..core.geometry.se3 import invert_pose, pose, rotation_vector
from ..core.images.image import Image
from ..core.images.image_files import read_image, read_mask, to_grey
from ..core.images.jpeg import encode_jpeg
from ..core.progress import Progress
from ..core.rendering.view_cameras import resize_area
from ..core.scene.cameras import fixed_camera
from ..photos.overlay.joint_files import ArmPostures, home_postures
from ..photos.overlay.outline_fit import mask_iou, score_outlines
from ..photos.overlay.photo_arm_poses import RigInPhoto, find_arms
from ..photos.overlay.photo_cameras import PhotoCameras
from ..photos.overlay.photos import Photo, PlacedCamera, find_mask
from ..photos.overlay.rendered_arms import ArmRenderers
from ..scene_photos.embedded_photos import Plate, photo_text
from .light_fit import HEADLIGHT, LightFit, StationPhoto, fit_light
from .pinhole_view import PinholeView
from .plate import StationPlate, make_plate, table_photo
from .station_renderer import Light, StationRenderer

_FIT_WIDTH = 200  # px, of the images in which the light is fitted
_FIT_PHOTOS = 3  # photos in which the light is fitted; each costs a rendering for each tried direction
_JPEG_QUALITY = 95  # of the photos in the scene
_MOVED_M, _MOVED_DEG = 0.01, 1.0  # differences of the camera's poses between photos, above which there is a note


@dataclass(frozen=True)
class MatchRequest:
    """The input of a match.

    Attributes:
        photos: files.
        postures: of the arms, one for all photos or one each; None for home.
        camera: calibration of the photos, whose pose the boards give; None with `placed`.
        placed: the camera and the arms where a calibration of the station places them.
        masks: a mask of the arms, or a folder with one for each photo.
    """

    photos: Sequence[Path]
    postures: Sequence[ArmPostures] | None = None
    camera: CameraModel | None = None
    placed: PlacedCamera | None = None
    masks: Path | None = None


@dataclass(frozen=True)
class MatchedPhoto:
    """A photo without distortion, the same view of the matched scene, and of the scene before; (height, width, 3).

    Attributes:
        outline_px: median distance of the rendered outlines to the photo's edges.
        iou: overlap of the rendered arms with the given mask; None without one.
        arms_before, arms_after: mean difference of the arms' colours to the photo, of 255, before and after matching.
        all_before, all_after: the same of the whole image.
    """

    path: Path
    photo: Image
    matched: Image
    before: Image
    outline_px: float
    iou: float | None
    arms_before: float
    arms_after: float
    all_before: float
    all_after: float


@dataclass(frozen=True)
class StationMatch:
    """The matched scene and its score.

    Attributes:
        view: the pinhole camera of the scene.
        light: None if too little of the arms was visible, so that the scene keeps its light.
        exposure_ev, white_balance: change of the light's luminance, in powers of two, and of its colour (red, green,
            blue; green is 1), from the scene before to the photos.
        has_table_photo: whether the photos show enough of the table.
    """

    scene: SceneConfig
    view: PinholeView
    plate: StationPlate
    light: LightFit | None
    exposure_ev: float
    white_balance: tuple[float, float, float]
    has_table_photo: bool
    photos: tuple[MatchedPhoto, ...]
    notes: tuple[str, ...]


def match_station(
    rig: RigConfig,
    scene: SceneConfig,
    outline_scene: SceneConfig,
    quality: RenderConfig,
    request: MatchRequest,
    locations: Locations,
    progress: Progress,
) -> StationMatch:
    """Return a scene that looks like the photos, with the table and the floor of `scene`.

    Args:
        outline_scene: without a table, for the outlines of the arms.

    Raises:
        ConfigError: the camera does not fit the photos, or the scene has no table.
        ResourceError: a photo or a mask cannot be read, or the arms cannot be located.
    """
    widened = scene.widened_for_arm_distance(rig.arm_span)
    if widened.table is None:
        raise ConfigError(f"scene {scene.name!r} has no table; give one with a table, such as tabletop")
    steps = _Steps(progress, 6)
    images = [read_image(path) for path in request.photos]
    postures = _postures(rig, request)
    with ExitStack() as stack:
        outlines = stack.enter_context(ArmRenderers(rig, outline_scene, quality, locations))
        located = locate_arms(rig, request, images, postures, outlines)
        steps.done()
        view, notes = common_view(rig, located)
        flat = [view.undistort(image) for image in images]
        size = view.intrinsics.width, view.intrinsics.height
        parts = (rig, widened, quality, view.scene_camera)
        bases = [view.T_cam_in_world @ T for T in request.placed.T_bases_in_cam] if request.placed else None
        small_size = min(_FIT_WIDTH, size[0]), max(1, round(min(_FIT_WIDTH, size[0]) * size[1] / size[0]))
        small = stack.enter_context(StationRenderer(*parts, small_size, locations, bases))
        light = fit_light(small, _fit_photos(flat, postures, small_size), lambda *_: None)
        steps.done()
        station = stack.enter_context(StationRenderer(*parts, size, locations, bases))
        masks, before = [], []
        for posture in postures:
            station.set_postures(posture)
            masks.append(station.masks())
            before.append(station.render())
        steps.done()
        plate = make_plate(flat, [arms for arms, _ in masks])
        used = light.light if light else _light_of(scene)
        station.set_light(used)
        station.show_white_table()
        station.show_arms(False)
        surface = table_photo(plate.image, station.render(), station.masks()[1], view, widened.table)
        matched = _matched_scene(scene, rig, view, light, plate.image, surface)
        steps.done()
        shown = stack.enter_context(_render_scene(rig, matched, quality, size, locations))
        after = []
        for posture in postures:
            shown.set_postures(posture)
            after.append((shown.render(), shown.masks()[0]))
        steps.done()
    photos = tuple(_score(request, view, *each) for each in zip(located, flat, before, after, strict=True))
    ev, balance = _colour_change(_light_of(scene), used)
    steps.done()
    return StationMatch(matched, view, plate, light, ev, balance, surface is not None, photos, notes)


def _render_scene(
    rig: RigConfig, scene: SceneConfig, quality: RenderConfig, size: tuple[int, int], locations: Locations
) -> StationRenderer:
    """Return the renderer of a scene's own camera, as in recordings."""
    widened = scene.widened_for_arm_distance(rig.arm_span)
    assert widened.scene_camera is not None
    return StationRenderer(rig, widened, quality, fixed_camera(SCENE_CAMERA, widened.scene_camera), size, locations)


class _Steps:
    """Counts the steps of a job."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._count = progress, total, 0

    def done(self) -> None:
        """Report one more step."""
        self._count += 1
        self._progress(self._count, self._total)


def _postures(rig: RigConfig, request: MatchRequest) -> list[ArmPostures]:
    """Return the true postures of the arms in each photo: without the calibration's joint offsets."""
    given = request.postures or [home_postures(rig)]
    if len(given) not in (1, len(request.photos)):
        raise ConfigError(
            f"--joints has {len(given)} rows for {len(request.photos)} photos; give one row, or one for each"
        )
    true = [request.placed.true_postures(one) for one in given] if request.placed else list(given)
    return true * len(request.photos) if len(true) == 1 else true


def locate_arms(
    rig: RigConfig,
    request: MatchRequest,
    images: Sequence[Image],
    postures: Sequence[ArmPostures],
    outlines: ArmRenderers,
) -> list[RigInPhoto]:
    """Return the arms' poses in each photo, with the distances of their outlines to edges."""
    cameras = PhotoCameras(rig, request.photos, request.placed.camera if request.placed else request.camera)
    found: list[RigInPhoto] = []
    for path, image, posture in zip(request.photos, images, postures, strict=True):
        photo = Photo(path, postures=posture, placed=request.placed)
        grey = to_grey(image)
        arms = find_arms(rig, photo, grey, cameras.camera_of(photo, image), True, found[-1] if found else None)
        if not arms.base_poses:
            why = next(
                (arm.detection.failure_explanation for arm in arms.arms if arm.detection), "the rig has no boards"
            )
            raise ResourceError(f"{path}: no arm is located: {why}; give --calibration, or a photo with a whole board")
        renderer = outlines.renderer_for(arms.lens.camera)
        renderer.set_poses(arms.base_poses, posture)
        found.append(score_outlines(arms, renderer, grey))
    return found


def common_view(rig: RigConfig, located: Sequence[RigInPhoto]) -> tuple[PinholeView, tuple[str, ...]]:
    """Return the view of the mean pose of the camera, and notes."""
    poses = []
    for found in located:
        k, T_base_in_cam = next(iter(found.base_poses.items()))
        poses.append(rig.T_base_in_world(k) @ invert_pose(T_base_in_cam))
    u, _, vt = np.linalg.svd(np.mean([T[:3, :3] for T in poses], axis=0))
    mean = pose(np.mean([T[:3, 3] for T in poses], axis=0), u @ vt)
    shift = max(float(np.linalg.norm(T[:3, 3] - mean[:3, 3])) for T in poses)
    turn = max(math.degrees(float(np.linalg.norm(rotation_vector(T[:3, :3] @ mean[:3, :3].T)))) for T in poses)
    notes: tuple[str, ...] = ()
    if shift > _MOVED_M or turn > _MOVED_DEG:
        notes = (
            f"the camera's poses in the photos differ by up to {1000 * shift:.0f} mm and {turn:.1f} degrees from "
            "their mean; was the camera moved? Match photos of one pose only",
        )
    return PinholeView.of_camera(located[0].lens.camera, mean), notes


def _fit_photos(flat: Sequence[Image], postures: Sequence[ArmPostures], size: tuple[int, int]) -> list[StationPhoto]:
    chosen = np.unique(np.linspace(0, len(flat) - 1, min(_FIT_PHOTOS, len(flat))).round().astype(int))
    return [StationPhoto(resize_area(flat[k], *size), postures[k]) for k in chosen]


def _light_of(scene: SceneConfig) -> Light:
    """Return a scene's light, with the colours of all directional lights in the first one's direction."""
    total = np.clip(np.sum([light.diffuse for light in scene.lights], axis=0), 0, 1)
    return Light(scene.ambient, tuple(total), scene.lights[0].direction, (HEADLIGHT,) * 3)


def _colour_change(before: Light, after: Light) -> tuple[float, tuple[float, float, float]]:
    """Return the change of the light's luminance, EV, and of its colour with green as 1."""
    sums = [np.maximum(np.add(light.ambient, light.diffuse), 1e-3) for light in (before, after)]
    ratio = sums[1] / sums[0]
    luminance = [float(np.dot((0.2126, 0.7152, 0.0722), total)) for total in sums]
    red, green, blue = (float(part) for part in ratio / ratio[1])
    return math.log2(luminance[1] / luminance[0]), (red, green, blue)


def _matched_scene(
    scene: SceneConfig, rig: RigConfig, view: PinholeView, light: LightFit | None, plate: Image, surface: Image | None
) -> SceneConfig:
    assert scene.table is not None
    changes: dict[str, object] = {"scene_camera": scene_camera_of(view, rig.arm_span)}
    if light is not None:
        ambient, diffuse = (
            tuple(round(float(part), 4) for part in np.clip(values, 0, 1))
            for values in (light.light.ambient, light.light.diffuse)
        )
        direction = tuple(round(float(part), 4) for part in light.light.direction)
        key = SceneLight.model_validate(
            {"direction": direction, "diffuse": diffuse, "specular": (0.05, 0.05, 0.05), "castshadow": True}
        )
        changes |= {"ambient": ambient, "lights": (key,)}
    if surface is not None:
        colour = (*(round(float(part), 3) for part in surface.mean(axis=(0, 1)) / 255), 1.0)
        photo = photo_text(encode_jpeg(surface, _JPEG_QUALITY))
        changes["table"] = scene.table.model_copy(update={"photo": photo, "rgba": colour, "reflectance": 0.0})
    changes["plates"] = (Plate(camera=SCENE_CAMERA, photo=photo_text(encode_jpeg(plate, _JPEG_QUALITY))),)
    return scene.model_copy(update=changes)


def scene_camera_of(view: PinholeView, span: float) -> FixedCamera:
    """Return the view as a scene's camera, which rigs with an arm distance of `span`, m, move back to the view."""
    T = view.T_cam_in_world
    forward, up = T[:3, 2], -T[:3, 1]
    # `look_at` is beyond the shift, so that the stored position is before it.
    shift = 0.5 * span
    reach = 1.0 + 2 * shift
    look_at = T[:3, 3] + reach * forward
    stored = look_at - (reach - shift) * forward
    return FixedCamera.model_validate(
        {
            "position": tuple(round(float(part), 6) for part in stored),
            "look_at": tuple(round(float(part), 6) for part in look_at),
            "fovy_deg": round(math.degrees(view.fovy), 5),
            "up": tuple(round(float(part), 6) for part in up),
        }
    )


def _score(
    request: MatchRequest,
    view: PinholeView,
    located: RigInPhoto,
    photo: Image,
    before: Image,
    after: tuple[Image, NDArray[np.bool_]],
) -> MatchedPhoto:
    matched, arms = after
    iou = None
    if request.masks is not None:
        mask = read_mask(find_mask(request.masks, located.path)).astype(np.uint8)
        if mask.shape != (view.camera.height, view.camera.width):
            raise ConfigError(
                f"the mask for {located.path} has {mask.shape[1]} x {mask.shape[0]} pixels, the photo "
                f"{view.camera.width} x {view.camera.height}"
            )
        iou = mask_iou(arms, view.undistort(mask, nearest=True) > 0)

    def apart(image: Image, where: NDArray[np.bool_]) -> float:
        return float(np.abs(image[where].astype(float) - photo[where]).mean()) if where.any() else 0.0

    whole = np.ones_like(arms)
    return MatchedPhoto(
        located.path,
        photo,
        matched,
        before,
        located.edge_residual or 0.0,
        iou,
        apart(before, arms),
        apart(matched, arms),
        apart(before, whole),
        apart(matched, whole),
    )
