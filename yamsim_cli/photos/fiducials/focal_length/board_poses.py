"""Fit the poses that explain a flat board's outline at many focal lengths, with principal point and k1."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.least_squares import LeastSquares, solve_least_squares

from .board_outline import BoardOutline

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_MAX_STEPS = 30
_MIN_GAIN = 1e-3  # gain of chi squared, relative to 1 + chi squared; below, a fit ends
_GRID_POINTS = 5  # along each edge of a board, at which distortion is evaluated
_MIN_AREA = 1e-6  # area of a board's picture (longer side squared); below, the view is edge-on
_MAX_DISTORTION_SHIFT = 3.0  # longer sides, shift by k1 = 1; above, rounding errors dominate
_MAX_ROTATION = 0.5  # rad, per step


def fit_board_poses(outline: BoardOutline, size: tuple[int, int], spread: Array) -> list[BoardPoses]:
    """Return a flat board's two solutions, each with a pose per focal length.

    Args:
        size: width and height of the photo, px.
        spread: longer side of the photo over the focal length (n,).
    """
    # Length unit: longer side in the picture, width on the board.
    longer = max(size)
    seen = (outline.points - (np.array(size) - 1) / 2) / longer
    whiten = np.linalg.inv(np.linalg.cholesky(outline.covariance / longer**2))
    on_board = outline.points_on_board / outline.board.width
    return [BoardPoses(on_board, seen, whiten, spread, first) for first in _planar_pose_pairs(on_board, seen, spread)]


def _planar_pose_pairs(on_board: Array, seen: Array, spread: Array) -> list[PosesPerFocalLength]:
    points = np.column_stack([on_board, np.zeros(4)])
    turns, shifts = np.empty((2, len(spread), 3, 3)), np.empty((2, len(spread), 3))
    for k, value in enumerate(spread):
        _, vectors, places, _ = cv2.solvePnPGeneric(
            points, seen * value, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
        )
        # IPPE may return only one pose, which both sets get.
        for pose, which in ((0, 0), (1, -1)):
            turns[pose, k] = cv2.Rodrigues(vectors[which])[0]
            shifts[pose, k] = places[which].ravel()
    sizes = 1 / (shifts[..., 2] * spread)
    return [PosesPerFocalLength(turns[k], shifts[k, :, :2] * sizes[k, :, None], sizes[k]) for k in (0, 1)]


def _homography_jacobian(points: Array) -> Array:
    """Return shifts (2 k, 8) of coplanar points (k, 2) by a homography's eight parameters."""
    x, y = points.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    across, down = (one, zero, x, y, zero, zero, x * x, x * y), (zero, one, zero, zero, x, y, x * y, y * y)
    moves: Array = np.stack([np.stack(across, axis=-1), np.stack(down, axis=-1)], axis=1).reshape(-1, 8)
    return moves


def _invert_2x2(matrices: Array) -> Array:
    """Return inverses (..., 2, 2); singular matrices, as of a board seen edge-on, get huge elements."""
    a, b, c, d = (matrices[..., row, column] for row in (0, 1) for column in (0, 1))
    determinant = a * d - b * c
    determinant = np.where(np.abs(determinant) < _MIN_AREA, _MIN_AREA, determinant)
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2)
    inverses: Array = adjugate / determinant[..., None, None]
    return inverses


@dataclass(frozen=True)
class PosesPerFocalLength:
    """A board's pose at each of n focal lengths.

    `centres` (n, 2) and `widths` (n,) are in the picture's longer sides; `rotations` are (n, 3, 3).
    """

    rotations: Array
    centres: Array
    widths: Array


R = TypeVar("R", bound="DataclassInstance")


def merge_rows(take: NDArray[np.bool_], one: R, other: R) -> R:
    """Return a dataclass of arrays with rows of `one` where `take` (n,), else of `other`."""
    arrays = zip(vars(one).items(), vars(other).values(), strict=True)
    return replace(one, **{name: np.where(take.reshape(-1, *[1] * (a.ndim - 1)), a, b) for (name, a), b in arrays})


class BoardPoses:
    """Poses that explain a board's outline, for n focal lengths.

    With y = R u for a point u of the board, its image is (middle + size y_xy) / (1 + spread size y_z). The spread is
    the picture's longer side over the focal length: an infinite focal length is regular.
    """

    def __init__(self, on_board: Array, seen: Array, whiten: Array, spread: Array, first: PosesPerFocalLength) -> None:
        self._on_board, self._seen, self._whiten, self._spread = on_board, seen, whiten, spread
        self.initial_poses = first
        line = np.linspace(-0.5, 0.5, _GRID_POINTS)
        board = math.sqrt(12) * np.abs(on_board).max(axis=0)
        self._grid = board * np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
        self._flatten = _homography_jacobian(on_board) @ np.linalg.pinv(_homography_jacobian(self._grid))

    def refine_poses(self, poses: PosesPerFocalLength, lens: Array) -> PosesPerFocalLength:
        """Return the best poses nearby for a lens (n, 3): principal point shift and k1."""
        _, _, by_lens = self.linearized_residuals(poses, lens)
        # Distortion shifts hardly change during the fit.
        bend = np.linalg.solve(self._whiten, by_lens[..., 2:])[..., 0].reshape(-1, 4, 2).astype(np.float64)
        found = solve_least_squares(_BoardPosesProblem(self, lens, bend), poses, _MAX_STEPS)
        assert found is not None
        return found[0]

    def _distortion_shifts(self, poses: PosesPerFocalLength, at: Array, w: Array) -> Array:
        """Return shifts (n, 4, 2) of the outline points by distortion with k1 = 1.

        The outline is the homography nearest to the distorted board, so only that part of the distortion on a grid
        counts.
        """
        spread = self._spread[:, None]
        on_grid = self._grid @ np.swapaxes(poses.rotations[:, :, :2], 1, 2) * poses.widths[:, None, None]
        w_grid = np.maximum(1 + spread * on_grid[..., 2], 1e-3)
        grid = (poses.centres[:, None, :] + on_grid[..., :2]) / w_grid[..., None]
        moved = grid * ((grid**2).sum(axis=-1) * spread**2)[..., None]
        on_board = (_invert_2x2(self._rays_by_board_point(poses, grid, w_grid)) @ moved[..., None])[..., 0]
        flat = (on_board.reshape(len(spread), -1) @ self._flatten.T).reshape(len(spread), 4, 2)
        moved_points = (self._rays_by_board_point(poses, at, w) @ flat[..., None])[..., 0]
        # Edge-on, rounding errors dominate.
        possible = np.abs(moved_points).max(axis=(1, 2)) < _MAX_DISTORTION_SHIFT
        return np.where(possible[:, None, None], moved_points, 0.0)

    def _rays_by_board_point(self, poses: PosesPerFocalLength, at: Array, w: Array) -> Array:
        axes = poses.rotations[:, None, :, :2] * poses.widths[:, None, None, None]
        by_depth = at[..., :, None] * (self._spread[:, None, None] * axes[:, :, 2])[:, :, None, :]
        by: Array = (axes[:, :, :2] - by_depth) / w[..., None, None]
        return by

    def linearized_residuals(
        self, poses: PosesPerFocalLength, lens: Array, bend: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return whitened residuals (n, 8) and derivatives by pose (n, 8, 6) and lens (n, 8, 3).

        Args:
            lens: principal point shift (right, down; picture's longer sides) and k1 (n, 3).
            bend: shifts (n, 4, 2) by distortion with k1 = 1; None to compute them.
        """
        turned = self._on_board @ np.swapaxes(poses.rotations[:, :, :2], 1, 2) * poses.widths[:, None, None]
        x, y, z = (turned[..., k] for k in range(3))
        spread = self._spread[:, None]
        w = np.maximum(1 + spread * z, 1e-3)
        at = (poses.centres[:, None, :] + turned[..., :2]) / w[..., None]
        n, zero, one = len(spread), np.zeros_like(x), np.ones_like(x)
        by_pose = np.empty((n, 4, 2, 6))
        for row, (moves_x, moves_y) in enumerate(((zero, -z), (z, zero), (-y, x))):
            moves_z = (y, -x, zero)[row]
            by_pose[..., 0, row] = (moves_x - at[..., 0] * spread * moves_z) / w
            by_pose[..., 1, row] = (moves_y - at[..., 1] * spread * moves_z) / w
        by_pose[..., 3] = np.stack([one / w, zero], axis=-1)
        by_pose[..., 4] = np.stack([zero, one / w], axis=-1)
        by_pose[..., 5] = (turned[..., :2] - at * (w - 1)[..., None]) / w[..., None]
        by_lens = np.zeros((n, 4, 2, 3))
        by_lens[..., 0, 0] = by_lens[..., 1, 1] = 1.0
        by_lens[..., 2] = self._distortion_shifts(poses, at, w) if bend is None else bend
        k1 = lens[:, None, None, 2]
        bent = at + k1 * by_lens[..., 2] + lens[:, None, :2]
        residual = (bent - self._seen).reshape(n, 8) @ self._whiten.T
        return residual, self._whiten @ by_pose.reshape(n, 8, 6), self._whiten @ by_lens.reshape(n, 8, 3)


@dataclass(frozen=True)
class _LinearizedPoses:
    residual: Array
    by_pose: Array

    @property
    def cost(self) -> Array:
        cost: Array = (self.residual**2).sum(axis=1)
        return cost

    @property
    def normal_matrix(self) -> Array:
        normal: Array = np.swapaxes(self.by_pose, 1, 2) @ self.by_pose
        return normal

    @property
    def right_hand_side(self) -> Array:
        right_hand_side: Array = -np.einsum("nij,ni->nj", self.by_pose, self.residual)
        return right_hand_side


class _BoardPosesProblem(LeastSquares[PosesPerFocalLength, _LinearizedPoses]):
    def __init__(self, board: BoardPoses, lens: Array, bend: Array) -> None:
        self._board, self._lens, self._bend = board, lens, bend

    def linearize(self, state: PosesPerFocalLength, before: _LinearizedPoses | None) -> _LinearizedPoses:
        residual, by_pose, _ = self._board.linearized_residuals(state, self._lens, self._bend)
        return _LinearizedPoses(residual, by_pose)

    def apply_step(self, state: PosesPerFocalLength, step: Array) -> PosesPerFocalLength:
        angle = np.linalg.norm(step[:, :3], axis=1)
        axis = step[:, :3] / np.maximum(angle, 1e-12)[:, None]
        angle = np.minimum(angle, _MAX_ROTATION)
        cross = np.zeros((len(step), 3, 3))
        cross[:, [2, 0, 1], [1, 2, 0]] = axis
        cross[:, [1, 2, 0], [2, 0, 1]] = -axis
        sine, cosine = np.sin(angle)[:, None, None], 1 - np.cos(angle)[:, None, None]
        return PosesPerFocalLength(
            (np.eye(3) + sine * cross + cosine * cross @ cross) @ state.rotations,
            state.centres + np.clip(step[:, 3:5], -1, 1),
            state.widths * np.exp(np.clip(step[:, 5], -1, 1)),
        )

    def is_converged(self, state: PosesPerFocalLength, known: _LinearizedPoses, step: Array, gain: Array) -> bool:
        return bool((gain < _MIN_GAIN * (1 + known.cost)).all())

    def select_better(
        self,
        better: NDArray[np.bool_],
        there: tuple[PosesPerFocalLength, _LinearizedPoses],
        here: tuple[PosesPerFocalLength, _LinearizedPoses],
    ) -> tuple[PosesPerFocalLength, _LinearizedPoses]:
        return merge_rows(better, there[0], here[0]), merge_rows(better, there[1], here[1])
