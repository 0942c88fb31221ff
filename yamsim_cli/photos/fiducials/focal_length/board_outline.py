"""Fit the homography from a board's print to a photo, without a camera model.

A lens without distortion maps a flat print by eight numbers, here four points in the picture. `focal_estimate`
evaluates which cameras and poses explain them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.camera_effects.lens_distortion import viewing_rays
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array

from ..fitting.blur_kernel import BlurKernel
from ..fitting.normal_equations import (
    NormalEquations,
    PixelDerivatives,
    PrintProblem,
    combine_equations,
    linearize_print,
)
from ..fitting.pose_alignment import BLUR_RANGE
from ..fitting.pose_fits import SAME_PRINT_CORRELATION
from ..fitting.print_view import PhotoRegion, PrintedBoard, crop_photo_to_print
from ..markers import MarkerGroup

# px, sigma of a point without noise: the rendering has few sample points per pixel. Source: 350 outlines of random
# views, 95 % of whose squared distances are within the 95 % normal bound.
_MIN_SIGMA_PX = 0.003
# Sigmas over those from noise alone: the print's shape and placement are not marginalized. Source: `python -m
# tools.bench.intervals`.
_COVARIANCE_INFLATION = 2.0
_INITIAL_BLUR = 0.9  # px, sigma at the start of a fit
_FITTED_PARAMETERS = (0, *range(3, 11))  # blur and homography, but not motion


@dataclass(frozen=True)
class BoardOutline:
    """Four points that show a board's position in a photo.

    Attributes:
        points_on_board: (4, 2), m.
        points: the same points (4, 2), px.
        covariance: (8, 8) of `points`, x and y alternating, px^2.
    """

    board: Board
    points_on_board: Array
    points: Array
    covariance: Array


def fit_outline(photo: NDArray[np.float32], group: MarkerGroup, board: Board) -> BoardOutline | None:
    """Fit a homography to the print around detected markers in a photo (height, width); None if it is undetermined."""
    height, width = photo.shape
    # Results are in pixels: any focal length will do.
    camera = CameraModel.from_focal_length(width, height, float(max(width, height)))
    corners = board.marker_corners()[list(group.places)].reshape(-1, 4, 3)[..., :2].reshape(-1, 2)
    plane: Any = cv2.findHomography(corners, viewing_rays(camera, group.corners.reshape(-1, 2)))[0]
    # OpenCV returns None for collinear corners.
    if plane is None:
        return None
    found = _fit_homography(photo, camera, board, group.places, np.asarray(plane, dtype=np.float64))
    if found is None:
        return None
    # Drop partly hidden and misread markers.
    agreeing = tuple(k for k, tile in found[2].tiles[0].items() if tile.correlation >= SAME_PRINT_CORRELATION)
    if not agreeing:
        return None
    if len(agreeing) < len(found[2].tiles[0]):
        found = _fit_homography(photo, camera, board, agreeing, found[1].plane)
        if found is None:
            return None
    fit, state, system = found
    return fit.outline_at(state, system, camera)


@dataclass(frozen=True)
class _MapState:
    """Map (3, 3) from (x, y, 1) on the board, m, to viewing rays, last element 1; blur sigma, px."""

    plane: Array
    blur: float


def _fit_homography(
    photo: NDArray[np.float32], camera: CameraModel, board: Board, places: Sequence[int], plane: Array
) -> tuple[_PlaneProblem, _MapState, NormalEquations] | None:
    plane = plane / plane[2, 2]
    view = crop_photo_to_print(photo, camera, PrintedBoard(board, np.eye(4), tuple(places)), plane)
    if view is None:
        return None
    fit = _PlaneProblem(view, camera.mean_focal_length)
    found = fit.solve(_MapState(plane, _INITIAL_BLUR))
    return None if found is None else (fit, *found)


class _PlaneProblem(PrintProblem[_MapState]):
    def __init__(self, view: PhotoRegion, focal: float) -> None:
        super().__init__()
        self._view, self._focal = view, focal
        board = view.piece.board
        # In half boards, the eight numbers have similar magnitudes.
        self._per_metre = 2 / max(board.width, board.height)
        half = np.array([board.width, board.height]) / math.sqrt(12)
        self._on_board = half * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])

    def equations_at(self, state: _MapState, noise: float | None) -> NormalEquations | None:
        def jacobian_columns(pixels: PixelDerivatives) -> Array:
            return self._derivatives_by_map(state, pixels.board_points, pixels.rays, pixels.brightness_by_ray)

        return combine_equations(
            [linearize_print(self._view, state.plane, BlurKernel(state.blur), jacobian_columns)],
            noise,
            _FITTED_PARAMETERS,
        )

    def _derivatives_by_map(self, state: _MapState, at: Array, seen: Array, by_ray: Array) -> Array:
        """Return derivatives (n, 8) by the map, given `by_ray` (n, 2) by viewing rays."""
        w = np.column_stack([at, np.ones(len(at))]) @ state.plane[2]
        u = np.column_stack([at * self._per_metre, np.ones(len(at))]) / w[:, None]
        along = (by_ray * seen).sum(axis=1, keepdims=True)
        return np.column_stack([by_ray[:, :1] * u, by_ray[:, 1:] * u, -along * u[:, :2]])

    def apply_step(self, state: _MapState, step: Array) -> _MapState:
        change = np.append(step[1:], 0.0).reshape(3, 3) * (self._per_metre, self._per_metre, 1.0)
        coarser = self._view.reduction_factor
        blur = float(np.clip(state.blur + step[0], BLUR_RANGE[0] * coarser, BLUR_RANGE[1] * coarser))
        return _MapState(state.plane + change, blur)

    def print_shift_px(self, state: _MapState, step: Array) -> float:
        return float(np.abs(self._derivatives_by_points(state) @ step[1:]).max())

    def _corner_rays(self, state: _MapState) -> Array:
        in_cam = np.column_stack([self._on_board, np.ones(4)]) @ state.plane.T
        seen: Array = in_cam[:, :2] / in_cam[:, 2:]
        return seen

    def _derivatives_by_points(self, state: _MapState) -> Array:
        seen, focal = self._corner_rays(state), self._focal
        by = [
            self._derivatives_by_map(state, self._on_board, seen, np.tile(axis, (4, 1)))
            for axis in ([focal, 0], [0, focal])
        ]
        return np.stack(by, axis=1).reshape(8, 8)

    def outline_at(self, state: _MapState, system: NormalEquations, camera: CameraModel) -> BoardOutline | None:
        try:
            covariance = np.linalg.inv(system.normal_matrix)[1:, 1:] * system.noise**2
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(covariance).all():
            return None
        by = self._derivatives_by_points(state)
        points = self._corner_rays(state) * camera.mean_focal_length + (camera.K[0][2], camera.K[1][2])
        noise = by @ covariance @ by.T * _COVARIANCE_INFLATION**2 + (
            _MIN_SIGMA_PX * self._view.reduction_factor
        ) ** 2 * np.eye(8)
        return BoardOutline(self._view.piece.board, self._on_board, points, noise)
