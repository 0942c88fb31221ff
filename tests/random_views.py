"""Random photos of a rig's boards by uncalibrated cameras of any size, lens, place, blur and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tests.board_photos import Photo, picture
from tests.truth_photos import camera_pose
from yamsim_cli.camera_effects.lens_distortion import project_points
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, invert_pose

# Webcams at VGA to phones of 12 megapixels.
SIZES = ((640, 480), (1280, 720), (1920, 1080), (4032, 3024))
SIZE_SHARES = (0.35, 0.3, 0.25, 0.1)
# Focal lengths, px, and in image widths: wide webcams to phones, and one lens in ten is longer.
FOCALS = (400.0, 4000.0)
WIDTHS, LONG_WIDTHS, LONG = (0.62, 1.3), (1.3, 5.5), 0.1
# A board's width as a share of the image's, and limits of its distance, m.
SHARES, DISTANCES = (0.1, 0.45), (0.2, 2.5)
TILTS = (0.0, math.radians(70))
BLURS, NOISES = (0.5, 1.3), (0.7, 5.0)
# Of the natural logarithm of the print's size.
PRINT_SIGMA = 0.0025
# px and image widths; smaller markers are not read
_LEAST_MARKER = (13.0, 0.0085)


@dataclass(frozen=True)
class LensSpread:
    """Deviations of real lenses from a centred pinhole: sigma of the principal point, widths, and of k1."""

    centre: float = 0.0
    bend: float = 0.0


@dataclass(frozen=True)
class RandomView:
    """The camera, its pose, and boards; `growth` is of the print.

    Attributes:
        tilt: of the camera off the boards' normal, rad.
        boards: each with its true pose (4, 4) in the camera's frame, by the arm's place in the rig.
    """

    camera: CameraModel
    T_cam_in_world: Array
    tilt: float
    boards: dict[int, tuple[Board, Array]]
    growth: float
    blur: float
    noise: float

    def photo(self, seed: int) -> Photo:
        """The grey photo (height, width)."""
        larger = math.exp(self.growth)
        printed = [
            (replace(board, marker_length=board.marker_length * larger, gap=board.gap * larger), T)
            for board, T in self.boards.values()
        ]
        clean = picture(self.camera, printed, self.blur)
        clean += np.random.default_rng(seed).standard_normal(clean.shape, np.float32) * np.float32(self.noise)
        return cv2.convertScaleAbs(np.maximum(clean, 0, out=clean))


def random_camera(rng: np.random.Generator, lens: LensSpread) -> CameraModel:
    """A camera of random size and focal length; `focal_sigma` stays unchanged."""
    while True:
        width, height = SIZES[rng.choice(len(SIZES), p=SIZE_SHARES)]
        low, high = LONG_WIDTHS if rng.random() < LONG else WIDTHS
        focal = width * math.exp(rng.uniform(math.log(low), math.log(high)))
        if not FOCALS[0] <= focal <= FOCALS[1]:
            continue
        cx, cy = ((side - 1) / 2 + rng.normal() * lens.centre * width for side in (width, height))
        bend = rng.normal() * lens.bend
        K = ((focal, 0.0, cx), (0.0, focal, cy), (0.0, 0.0, 1.0))
        return CameraModel(width, height, K, (bend, 0.0, 0.0, 0.0) if bend else ())


def random_view(
    rng: np.random.Generator,
    rig: RigConfig,
    arms: tuple[int, ...] | None = None,
    lens: LensSpread | None = None,
    camera: CameraModel | None = None,
    tilts: tuple[float, float] = TILTS,
) -> RandomView:
    """A view of one board or of both.

    Args:
        arms: of the shown boards; one, the other or both by chance if None.
        camera: by default `random_camera`.
        tilts: limits of the tilt, rad.
    """
    while True:
        taken = camera or random_camera(rng, lens or LensSpread())
        shown = arms or ((0, 1), (int(rng.integers(2)),))[rng.integers(2)]
        placed = {}
        for k in shown:
            config = rig.arms[k].board
            assert config is not None
            placed[k] = (config.board_in_metres, rig.T_base_in_world(k) @ rig.arms[k].T_board_in_base)
        tilt = float(rng.uniform(*tilts))
        target = np.mean([T[:3, 3] for _, T in placed.values()], axis=0)
        wide = next(iter(placed.values()))[0].width
        distance = float(np.clip(taken.mean_focal_length * wide / (rng.uniform(*SHARES) * taken.width), *DISTANCES))
        for _ in range(20):
            T_cam = camera_pose(rng, target, distance, (tilt, tilt))
            boards = {k: (board, invert_pose(T_cam) @ T) for k, (board, T) in placed.items()}
            if all(_seen(taken, board, T) for board, T in boards.values()):
                blur = float(rng.uniform(*BLURS))
                noise = float(rng.uniform(*NOISES))
                return RandomView(taken, T_cam, tilt, boards, float(rng.normal() * PRINT_SIGMA), blur, noise)


def _seen(camera: CameraModel, board: Board, T: Array) -> bool:
    """Whether the whole board is in the picture with its face to the camera, and its markers are large enough."""
    corners = board.marker_corners()
    in_cam = corners.reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]
    if (in_cam[:, 2] < 0.05).any() or T[:3, 2] @ T[:3, 3] > 0:
        return False
    pixels = project_points(camera, in_cam)
    size = np.array([camera.width, camera.height])
    edges = np.diff(pixels.reshape(-1, 4, 2), axis=1, append=pixels.reshape(-1, 4, 2)[:, :1])
    shortest = float(np.linalg.norm(edges, axis=2).min())
    least = max(_LEAST_MARKER[0], _LEAST_MARKER[1] * camera.width)
    return bool((pixels > 4).all() and (pixels < size - 5).all() and shortest > least)
