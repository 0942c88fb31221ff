"""Photos of printed boards alone, without a renderer: each print is warped into the picture by its known pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.camera_effects.lens_distortion import project_points, viewing_ray_grid
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, pose, rotation_from_vector, rotation_vector
from yamsim_cli.core.images.board_image import board_image, marker_cells

Photo = NDArray[np.uint8]

CAMERA = CameraModel.from_focal_length(640, 480, 600.0)
_LENGTH = 0.02923077
ONE = Board("one", 217, 3, 3, "DICT_6X6_250", _LENGTH, _LENGTH / 10)
TWO = replace(ONE, name="two", first_id=226)

_FINER = 3
# px; gaps of a tenth of a marker are whole pixels
_CELL_PX = 20
_QUIET_CELLS = 1
_TABLE = 150.0


def facing(x: float, y: float, z: float, tilt_x: float = 0.5, tilt_y: float = 0.2) -> Array:
    """Return the pose (4, 4) of a board in the camera's frame, tilted about two axes off facing the camera."""
    towards_camera = rotation_from_vector([np.pi, 0.0, 0.0])
    return pose((x, y, z), rotation_from_vector([tilt_x, tilt_y, 0.0]) @ towards_camera)


def pose_error(T: Array, truth: Array) -> tuple[float, float]:
    """Distance (m) and angle (rad) of a pose from the truth."""
    turn = rotation_vector(T[:3, :3] @ truth[:3, :3].T)
    return float(np.linalg.norm(T[:3, 3] - truth[:3, 3])), float(np.linalg.norm(turn))


def photograph(
    camera: CameraModel, boards: Sequence[tuple[Board, Array]], blur: float = 0.6, noise: float = 2.0, seed: int = 0
) -> Photo:
    """A grey photo (height, width) of boards on a table.

    Args:
        boards: each with its pose (4, 4) in the camera's frame; a later one lies over the ones before.
        blur: sigma, px.
        noise: standard deviation, grey levels.
    """
    return with_noise(picture(camera, boards, blur), noise, seed)


def picture(camera: CameraModel, boards: Sequence[tuple[Board, Array]], blur: float = 0.6) -> NDArray[np.float32]:
    """Return the photo without noise, in grey levels."""
    photo = np.full((camera.height, camera.width), _TABLE, np.float32)
    low, high = _region(camera, boards, math.ceil(8 * blur))
    x, y = (
        np.arange(first, last, dtype=np.float64).repeat(_FINER)
        + np.tile((np.arange(_FINER) - (_FINER - 1) / 2) / _FINER, last - first)
        for first, last in zip(low, high, strict=True)
    )
    if len(x) and len(y):
        field = viewing_ray_grid(camera, x, y)
        fine = np.full(field.shape[:2], _TABLE, np.float32)
        for board, T in boards:
            _lay(fine, field, board, T)
        size = (high[0] - low[0], high[1] - low[1])
        photo[low[1] : high[1], low[0] : high[0]] = cv2.resize(fine, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(photo, (0, 0), blur), dtype=np.float32)


def _region(
    camera: CameraModel, boards: Sequence[tuple[Board, Array]], beyond: int
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return first and last column and row of the part of a photo that shows boards: large photos are mostly table."""
    whole = (0, 0), (camera.width, camera.height)
    if not boards:
        return (0, 0), (0, 0)
    corners = []
    for board, T in boards:
        half = np.array([board.width, board.height]) * 0.6
        on_board = half * np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]])
        in_cam = np.column_stack([on_board, np.zeros(4)]) @ T[:3, :3].T + T[:3, 3]
        if (in_cam[:, 2] < 1e-2).any():
            return whole
        corners.append(project_points(camera, in_cam))
    pixels = np.concatenate(corners)
    low = np.clip(np.floor(pixels.min(axis=0)) - beyond, whole[0], whole[1]).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)) + beyond + 1, whole[0], whole[1]).astype(int)
    return (int(low[0]), int(low[1])), (int(high[0]), int(high[1]))


def with_noise(clean: NDArray[np.float32], noise: float = 2.0, seed: int = 0) -> Photo:
    """A photo of 8 bits of a clean picture."""
    noisy = clean + np.random.default_rng(seed).normal(0, noise, clean.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def _lay(picture: NDArray[np.float32], field: NDArray[np.float32], board: Board, T: Array) -> None:
    onto_board = np.linalg.inv(T[:3, [0, 1, 3]])
    # Number by number: vectors of doubles would not fit into memory for large photos at three times the resolution.
    x, y, depth = (
        np.float32(a) * field[..., 0] + np.float32(b) * field[..., 1] + np.float32(c) for a, b, c in onto_board
    )
    across, down = x / depth + np.float32(board.width / 2), np.float32(board.height / 2) - y / depth
    image = board_image(board, _CELL_PX, _QUIET_CELLS)
    px_per_metre = marker_cells(board).shape[1] * _CELL_PX / board.marker_length
    border = _QUIET_CELLS * _CELL_PX
    maps = [side * np.float32(px_per_metre) + np.float32(border - 0.5) for side in (across, down)]
    # 0 beside the print and its white border.
    printed = cv2.remap(image.astype(np.float32) + 1, *maps, cv2.INTER_LINEAR, borderValue=0)
    on = (printed >= 1) & (depth > 0)
    # Levels of black ink and white paper.
    picture[on] = 30 + (printed[on] - 1) * (200 / 255)


def scaled_camera(camera: CameraModel, factor: float) -> CameraModel:
    """The camera of images resized by `factor`."""
    (fx, skew, cx), (_, fy, cy), last = camera.K
    shift = (factor - 1) / 2
    K = ((fx * factor, skew * factor, cx * factor + shift), (0.0, fy * factor, cy * factor + shift), last)
    return replace(camera, width=round(camera.width * factor), height=round(camera.height * factor), K=K)
