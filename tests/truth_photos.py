"""Photos of a rig with known truth: rendered at four times the resolution, distorted by the lens, then degraded."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import cv2
import mujoco
import numpy as np

from yamsim_cli.camera_effects.lens_distortion import LensWarp, project_points
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel, opencv_from_mujoco
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose, quat_from_rotation
from yamsim_cli.core.rendering.renderer import SceneRenderer
from yamsim_cli.core.scene.blueprint import Blueprint
from yamsim_cli.core.scene.compilation import compile_spec
from yamsim_cli.viewers.show.compose import compose_at_home

# Camera of the checks.
CAMERA = CameraModel.from_focal_length(640, 480, 600.0)
BLUR, NOISE = 0.6, 2.0

_FINER = 4
# Sight lines along a board's side, and the share of it that they cover.
_SIGHT_LINES, _INSIDE = 25, 0.995
_EDGE_PX = 3


@dataclass(frozen=True)
class PlacedBoard:
    """A board of the rig: its pose in `world`, (4, 4), and its geom."""

    board: Board
    T_in_world: Array
    geom: int


class Photographer:
    """Takes pictures of a rig at home, with primitives. Close it."""

    def __init__(self, rig: str | RigConfig, locations: Locations, camera: CameraModel = CAMERA) -> None:
        self.rig = load_config(RigConfig, "rigs", rig, locations) if isinstance(rig, str) else rig
        self.camera = camera
        self._warp = LensWarp(camera, _FINER)
        scene = load_config(SceneConfig, "scenes", "studio", locations)
        spec, _ = compose_at_home(Blueprint(self.rig, scene), locations)
        body = spec.worldbody.add_body(name="photographer", mocap=True)
        body.add_camera(name="photo", fovy=math.degrees(self._warp.fovy))
        size = self._warp.ideal.width, self._warp.ideal.height
        spec.visual.global_.offwidth, spec.visual.global_.offheight = size
        spec.visual.quality.offsamples = 0
        # Shadows matter for no check here.
        for light in spec.lights:
            light.castshadow = False
        self._model = compile_spec(spec)
        self._data = mujoco.MjData(self._model)
        mujoco.mj_resetDataKeyframe(self._model, self._data, 0)
        mujoco.mj_forward(self._model, self._data)
        self._renderer = SceneRenderer(self._model, size)
        self.boards = [
            PlacedBoard(
                arm.board.board_in_metres,
                self.rig.T_base_in_world(k) @ arm.T_board_in_base,
                self._model.geom(f"{arm.prefix}base_board").id,
            )
            for k, arm in enumerate(self.rig.arms)
            if arm.board
        ]

    def stand(self, T_cam_in_world: Array) -> None:
        mocap = self._model.body("photographer").mocapid[0]
        self._data.mocap_pos[mocap] = T_cam_in_world[:3, 3]
        self._data.mocap_quat[mocap] = quat_from_rotation(opencv_from_mujoco(T_cam_in_world[:3, :3]))
        mujoco.mj_forward(self._model, self._data)

    def shows(self, T_cam_in_world: Array, which: int) -> bool:
        """Whether the whole board is in the picture and nothing hides any of it."""
        placed = self.boards[which]
        half_x, half_y = placed.board.width / 2, placed.board.height / 2
        corners = np.array([[-half_x, half_y, 0], [half_x, half_y, 0], [half_x, -half_y, 0], [-half_x, -half_y, 0]])
        T = invert_pose(T_cam_in_world) @ placed.T_in_world
        in_cam = corners @ T[:3, :3].T + T[:3, 3]
        if (in_cam[:, 2] < 0.05).any() or T[:3, 2] @ T[:3, 3] > 0:
            return False
        pixels = project_points(self.camera, in_cam)
        size = np.array([self.camera.width, self.camera.height])
        if (pixels < _EDGE_PX).any() or (pixels > size - 1 - _EDGE_PX).any():
            return False
        # Sight lines to points all over it have no other first hit.
        across = np.linspace(-1, 1, _SIGHT_LINES)
        on_board = np.array([[half_x * x, half_y * y, 0.0] for x in across for y in across]) * _INSIDE
        towards = on_board @ placed.T_in_world[:3, :3].T + placed.T_in_world[:3, 3] - T_cam_in_world[:3, 3]
        count = len(towards)
        met, far = np.empty(count, np.int32), np.empty(count)
        groups = np.array(mujoco.MjvOption().geomgroup, np.uint8)
        mujoco.mj_multiRay(
            self._model,
            self._data,
            T_cam_in_world[:3, 3].copy(),
            towards.ravel(),
            groups,
            True,
            -1,
            met,
            far,
            None,
            count,
            mujoco.mjMAXVAL,
        )
        return bool((met == placed.geom).all())

    def take(self) -> np.ndarray:
        """The picture as RGB (height, width, 3), without blur and noise."""
        return self._warp.distort_picture(self._renderer.render(self._data, "photo"))

    def close(self) -> None:
        self._renderer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def camera_pose(rng: np.random.Generator, target: Array, distance: float, tilt: tuple[float, float]) -> Array:
    """A random pose (4, 4) in `world` of a camera that sees a point of a flat board, `tilt` (rad) off its normal."""
    angle, azimuth, roll = rng.uniform(*tilt), rng.uniform(-math.pi, math.pi), rng.uniform(-math.pi, math.pi)
    away = np.array([math.sin(angle) * math.cos(azimuth), math.sin(angle) * math.sin(azimuth), math.cos(angle)])
    position = target + distance * away
    aim = target + np.array([*rng.normal(0, 0.1 * distance, 2), 0.0])
    z = (aim - position) / np.linalg.norm(aim - position)
    x = np.cross(z, [math.cos(roll), math.sin(roll), 0.0131])
    x /= np.linalg.norm(x)
    return pose(position, np.column_stack([x, np.cross(z, x), z]))


def shot_of(
    photographer: Photographer,
    rng: np.random.Generator,
    distance: float,
    tilt: tuple[float, float],
    which: int | None = None,
) -> Array:
    """Return a camera pose (4, 4) in `world` with one board (or, without `which`, every one) wholly visible."""
    wanted = range(len(photographer.boards)) if which is None else [which]
    target = np.mean([photographer.boards[k].T_in_world[:3, 3] for k in wanted], axis=0)
    for _ in range(500):
        T = camera_pose(rng, target, distance, tilt)
        photographer.stand(T)
        if all(photographer.shows(T, k) for k in wanted):
            return T
    raise AssertionError(f"no free view of board {which} from {distance} m")


def spoilt(
    image: np.ndarray,
    rng: np.random.Generator,
    *,
    blur: float = BLUR,
    noise: float = NOISE,
    light: float = 1.0,
    motion: float = 0.0,
    jpeg: int | None = None,
) -> np.ndarray:
    """Degrade a clean picture to a grey photo (height, width).

    Args:
        blur: sigma, px.
        noise: standard deviation, grey levels.
        light: exposure, a factor.
        motion: length of a straight smear, px.
        jpeg: quality, if it is compressed.
    """
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    grey = grey.astype(np.float32) * light
    if motion:
        grey = cv2.filter2D(grey, -1, _smear(motion, rng.uniform(0, math.pi)))
    if blur:
        grey = cv2.GaussianBlur(grey, (0, 0), blur)
    grey = np.clip(np.round(grey + rng.normal(0, noise, grey.shape)), 0, 255).astype(np.uint8)
    if jpeg:
        data = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, jpeg])[1]
        grey = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    return grey


def _smear(length: float, angle: float) -> np.ndarray:
    side = 2 * math.ceil(length) + 1
    kernel = np.zeros((side, side), np.float32)
    middle = side // 2
    for step in np.linspace(-length / 2, length / 2, 101):
        x, y = middle + step * math.cos(angle), middle + step * math.sin(angle)
        column, row = math.floor(x), math.floor(y)
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            kernel[row + dy, column + dx] += (1 - abs(x - column - dx)) * (1 - abs(y - row - dy))
    return kernel / kernel.sum()


def covered(
    image: np.ndarray, camera: CameraModel, board: Board, T_board_in_cam: Array, markers: list[int]
) -> np.ndarray:
    """The picture with some of a board's markers (places in `board.ids`) and half the gap around them painted over."""
    result = image.copy()
    grow = (board.marker_length + board.gap) / board.marker_length
    for quad in board.marker_corners()[markers]:
        quad = quad.mean(axis=0) + (quad - quad.mean(axis=0)) * grow
        pixels = project_points(camera, quad @ T_board_in_cam[:3, :3].T + T_board_in_cam[:3, 3])
        colour = (120,) * (1 if image.ndim == 2 else 3)
        cv2.fillConvexPoly(result, np.round(pixels * 16).astype(np.int32), colour, cv2.LINE_AA, 4)
    return result
