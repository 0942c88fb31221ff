"""Disturbances of boards: partly covered, glare, a crease, a bent plate, light from one side."""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np

from yamsim_cli.camera_effects.lens_distortion import project_points, viewing_rays
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array

Grey = np.ndarray
# (random generator, grey picture (height, width), camera, board, its pose (4, 4) in the camera frame) -> damaged
# picture.
Damage = Callable[[np.random.Generator, Grey, CameraModel, Board, Array], Grey]


def _seen(camera: CameraModel, T: Array, on_board: np.ndarray) -> np.ndarray:
    points = np.column_stack([on_board, np.zeros(len(on_board))])
    return project_points(camera, points @ T[:3, :3].T + T[:3, 3])


def half_covered(rng: np.random.Generator, image: Grey, camera: CameraModel, board: Board, T: Array) -> Grey:
    """A hand or cable over one half, up to an edge at any angle through the middle."""
    angle = rng.uniform(-math.pi, math.pi)
    along, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    size = 0.8 * board.width
    quad = np.array([-along, along, along + across, across - along]) * size
    result = image.copy()
    pixels = np.round(_seen(camera, T, quad) * 16).astype(np.int32)
    cv2.fillConvexPoly(result, pixels, float(rng.uniform(40, 200)), cv2.LINE_AA, 4)
    return result


def glaring(rng: np.random.Generator, image: Grey, camera: CameraModel, board: Board, T: Array) -> Grey:
    """A lamp's reflection over a third of the board, saturated, with soft edges."""
    radius = math.sqrt(board.width * board.height / 3 / math.pi)
    angle = np.linspace(0, 2 * math.pi, 60)
    middle = rng.uniform(-0.35, 0.35, 2) * board.width
    disc = middle + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    mask = np.zeros(image.shape, np.float32)
    pixels = _seen(camera, T, disc)
    cv2.fillConvexPoly(mask, np.round(pixels * 16).astype(np.int32), 1.0, cv2.LINE_AA, 4)
    soft = cv2.GaussianBlur(mask, (0, 0), 0.05 * float(np.ptp(pixels, axis=0).max()))
    return np.clip(image + 260 * soft, 0, 255)


def creased(
    rng: np.random.Generator, image: Grey, camera: CameraModel, board: Board, T: Array, degrees: float = 4.0
) -> Grey:
    """The paper folded along a line parallel to an edge, a third to two thirds across."""
    fold, at = math.radians(degrees) * rng.choice([-1, 1]), float(rng.uniform(-1 / 6, 1 / 6)) * board.width
    axis = int(rng.integers(2))
    # The folded half's plane contains the crease.
    along, normal = np.eye(3)[axis], np.array([0.0, 0.0, 1.0])
    bent = math.cos(fold) * along + math.sin(fold) * normal
    bent_normal = math.cos(fold) * normal - math.sin(fold) * along
    seen = _rays_of(camera)
    R, origin = T[:3, :3], T[:3, 3] + T[:3, axis] * at
    depth = (R @ bent_normal) @ origin / (seen @ (R @ bent_normal))
    on_fold = (seen * depth[:, None] - origin) @ R
    past, other = on_fold @ bent, on_fold[:, 1 - axis]
    half = board.width / 2 + 0.002
    here = (past > 0) & (past < half - at) & (np.abs(other) < half)
    flat = np.empty((len(seen), 2))
    flat[:, axis], flat[:, 1 - axis] = at + past, other
    return _moved(image, camera, T, flat, here)


def bowed(rng: np.random.Generator, image: Grey, camera: CameraModel, board: Board, T: Array) -> Grey:
    """The plate bent like a part of a cylinder, two edges 1 to 3 mm above or below its middle; pose of its mean."""
    half = max(board.width, board.height) / 2
    curve = float(rng.choice([-1, 1]) * rng.uniform(1e-3, 3e-3)) / half**2
    axis = np.eye(2)[int(rng.integers(2))]

    def height(at: np.ndarray) -> np.ndarray:
        return curve * ((at @ axis) ** 2 - half**2 / 3)

    on_plate = _met(camera, T, height)
    # Paper does not stretch: its projection is shorter than its length along the curve.
    flat = on_plate + axis * (2 / 3 * curve**2 * (on_plate @ axis) ** 3)[:, None]
    return _moved(image, camera, T, flat, _on_board(flat, board))


def twisted(rng: np.random.Generator, image: Grey, camera: CameraModel, board: Board, T: Array) -> Grey:
    """The plate twisted, its corners alternately 1 to 3 mm above and below its plane."""
    half = max(board.width, board.height) / 2
    twist = float(rng.choice([-1, 1]) * rng.uniform(1e-3, 3e-3)) / half**2
    on_plate = _met(camera, T, lambda at: twist * at[:, 0] * at[:, 1])
    return _moved(image, camera, T, on_plate, _on_board(on_plate, board))


def _rays_of(camera: CameraModel) -> np.ndarray:
    """Viewing rays (n, 3) of all pixels, row by row."""
    y, x = np.mgrid[: camera.height, : camera.width]
    return np.column_stack([viewing_rays(camera, np.column_stack([x.ravel(), y.ravel()])), np.ones(x.size)])


def _met(camera: CameraModel, T: Array, height: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Places (n, 2) on a board, which lies at heights (n,) above its plane, that pixels show; m."""
    seen, raised = _rays_of(camera), np.zeros(camera.width * camera.height)
    R, normal = T[:3, :3], T[:3, 2]
    for _ in range(8):
        depth = (normal @ T[:3, 3] + raised) / (seen @ normal)
        at = (seen * depth[:, None] - T[:3, 3]) @ R[:, :2]
        # Far beside the board, the surface is level.
        raised = height(np.clip(at, -0.2, 0.2))
    return at


def _on_board(at: np.ndarray, board: Board) -> np.ndarray:
    """Whether places (n, 2) are on a board, or so near that it covered them before it was bent."""
    return (np.abs(at) < 0.75 * np.array([board.width, board.height])).all(axis=1)


def _moved(image: Grey, camera: CameraModel, T: Array, flat: np.ndarray, here: np.ndarray) -> Grey:
    """A picture whose pixels (n,) `here` show places (n, 2) of a board that was flat in it."""
    y, x = np.mgrid[: camera.height, : camera.width]
    source = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    source[here] = _seen(camera, T, flat[here])
    maps = source.reshape(*image.shape, 2).astype(np.float32)
    return cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_CUBIC)


def unevenly_lit(rng: np.random.Generator, image: Grey, camera: CameraModel, board: Board, T: Array) -> Grey:
    """Light that falls from full to a quarter across the board."""
    angle = rng.uniform(-math.pi, math.pi)
    corners = _seen(camera, T, np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * board.width / 2)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    axis = np.array([math.cos(angle), math.sin(angle)])
    low, high = (corners @ axis).min(), (corners @ axis).max()
    share = np.clip((x * axis[0] + y * axis[1] - low) / (high - low), 0, 1)
    return image * (0.25 + 0.75 * share)


def enlarged_print(
    rng: np.random.Generator, image: Grey, camera: CameraModel, board: Board, T: Array, across: int = 900
) -> Grey:
    """OpenCV's picture of the board, warped: its markers are rounded to whole pixels, `across`."""
    border, finer = 50, 4
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    size = (board.columns, board.rows)
    grid = cv2.aruco.GridBoard(size, board.marker_length, board.gap, dictionary, np.array(board.marker_ids))
    printed = grid.generateImage((across + 2 * border, across + 2 * border), marginSize=border, borderBits=1)
    on_print = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32) * across + border - 0.5
    at = (_seen(camera, T, board.outer_corners()[:, :2]) + 0.5) * finer - 0.5
    warp = cv2.getPerspectiveTransform(on_print, at.astype(np.float32))
    grey = cv2.GaussianBlur(printed, (0, 0), 0.5).astype(np.float32) * 0.8 + 20
    fine_size = (camera.width * finer, camera.height * finer)
    fine = cv2.warpPerspective(grey, warp, fine_size, flags=cv2.INTER_LINEAR, borderValue=150.0)
    whole = cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(whole, (0, 0), 0.6)
