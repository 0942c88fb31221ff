"""Find the poses that a board's print allows: starts from corners, fits to the print, competing fits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.camera_effects.lens_distortion import project_points, viewing_rays
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, pose, rotation_vector

from ..markers import MarkerGroup
from .normal_equations import MarkerTile
from .pose_alignment import Alignment, align_pose, measure_agreement
from .print_view import whole_board_piece

SAME_PRINT_CORRELATION = 0.75  # correlation of print and photo; below, a marker is hidden or displaced
EXPLAINED_CORRELATION = 0.96  # median correlation; above, a fit needs no other blur or start
# An outlier is a marker of low correlation, with a residual variance far above the median: at most 2.5 times in photos
# of whole boards, 4 with creases, 40 or more with half-covered markers.
_OUTLIER_RATIO = 5.0  # residual variance over the median; above, a marker may be an outlier
_OUTLIER_CORRELATION = 0.9  # correlation; above, a marker is no outlier
_MAX_ROUNDS = 3  # several, because one outlier displaces the pose and hides others
_MIN_LOG_LIKELIHOOD_RATIO = 12.0  # difference of log-likelihoods that excludes a competing pose
_PIXELS_PER_SAMPLE = 4.0  # neighbouring pixels that count as one sample
_SAME_POSE_ANGLE = math.radians(4.0)  # rad; at smaller angles, poses are the same
_MAX_PREDICTION_ANGLE_SHARE = 0.25  # share of the angle between two poses; a prediction nearer to one selects it
_MAX_COMPETING_RATIO = 4.0  # ratio of mean squared residuals before the fit; above, a competing fit cannot win


@dataclass(frozen=True)
class PoseFit:
    """A pose fitted to a board's print, with agreeing markers (indices) and the number of others."""

    alignment: Alignment
    agreeing_markers: tuple[int, ...]
    contradicting_count: int

    @property
    def T_board_in_cam(self) -> Array:
        """Pose (4, 4) of the board in the camera frame."""
        return self.alignment.T_ref_in_cam

    @property
    def agrees_with_photo(self) -> bool:
        """Whether print and photo agree well at most agreeing markers."""
        return float(np.median([tile.correlation for tile in self.alignment.tiles[0].values()])) > EXPLAINED_CORRELATION

    @property
    def mean_square(self) -> float:
        """Mean squared residual, grey levels squared."""
        return self.alignment.cost / self.alignment.pixels


def planar_poses(points: Array, seen: Array) -> list[Array]:
    """Return the poses (4, 4) that give coplanar points (n, 3) the viewing rays (n, 2), by OpenCV's IPPE."""
    count, turns, shifts, _ = cv2.solvePnPGeneric(points, seen, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE)
    return [pose(shifts[k].ravel(), cv2.Rodrigues(turns[k])[0]) for k in range(count)]


def initial_poses(group: MarkerGroup, board: Board, camera: CameraModel) -> list[Array]:
    """Return poses (4, 4) in front of the camera, by increasing reprojection error."""
    points = board.marker_corners()[list(group.places)].reshape(-1, 3)
    pixels = group.corners.reshape(-1, 2)
    count, turns, shifts, _ = cv2.solvePnPGeneric(
        points, viewing_rays(camera, pixels), np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
    )
    K, distortion = np.array(camera.K), np.array(camera.distortion)
    starts = []
    for k in range(count):
        turn, shift = cv2.solvePnPRefineLM(points, pixels, K, distortion, turns[k], shifts[k])
        T = pose(shift.ravel(), cv2.Rodrigues(turn)[0])
        if not np.isfinite(T).all() or not faces_camera(T):
            continue
        off = project_points(camera, points @ T[:3, :3].T + T[:3, 3]) - pixels
        starts.append((float(np.sqrt((off**2).sum(axis=1).mean())), T))
    starts.sort(key=lambda start: start[0])
    return [T for _, T in starts]


def faces_camera(T_board_in_cam: Array) -> bool:
    """Return whether the board's printed side is in view."""
    return bool(T_board_in_cam[2, 3] > 0 and T_board_in_cam[:3, 2] @ T_board_in_cam[:3, 3] < 0)


def fit_pose(
    photo: NDArray[np.float32],
    camera: CameraModel,
    board: Board,
    places: Sequence[int],
    T: Array,
    known: Sequence[PoseFit] = (),
) -> PoseFit | None:
    """Fit a pose to detected markers, then to all markers whose print agrees.

    Args:
        places: indices into `board.ids` of the detected markers.
        T: start pose (4, 4) in the camera frame.

    Returns:
        None if no pose fits, or it equals one in `known`.
    """
    first = align_pose(photo, camera, [whole_board_piece(board, places)], T)
    if first is None or not faces_camera(first.T_ref_in_cam):
        return None
    if any(angle_between(first.T_ref_in_cam, fit.T_board_in_cam) < _SAME_POSE_ANGLE for fit in known):
        return None
    check = measure_agreement(photo, camera, [whole_board_piece(board)], first.T_ref_in_cam, first.blur, first.noise)
    if check is None:
        return None
    tiles = check.tiles[0]
    agreeing = tuple(k for k, tile in tiles.items() if tile.correlation >= SAME_PRINT_CORRELATION)
    if not agreeing:
        return None
    if set(agreeing) != set(places):
        again = align_pose(photo, camera, [whole_board_piece(board, agreeing)], first.T_ref_in_cam, first.blur)
        if again is None or not faces_camera(again.T_ref_in_cam):
            return None
        first = again
    return PoseFit(first, agreeing, len(tiles) - len(agreeing))


def refit_without_outliers(photo: NDArray[np.float32], camera: CameraModel, board: Board, fit: PoseFit) -> PoseFit:
    """Repeat a fit without outliers, which displace the pose, such as partly covered markers."""
    candidates = whole_board_piece(board, fit.agreeing_markers)
    tiles = fit.alignment.tiles[0]
    for _ in range(_MAX_ROUNDS):
        kept = tuple(k for k in candidates.markers if k in tiles and k not in _outlier_markers(tiles))
        if kept == fit.agreeing_markers:
            break
        kernel, noise = fit.alignment.blur, fit.alignment.noise
        again = align_pose(photo, camera, [whole_board_piece(board, kept)], fit.T_board_in_cam, kernel)
        if again is None or not faces_camera(again.T_ref_in_cam):
            break
        fit = PoseFit(again, kept, fit.contradicting_count + len(fit.agreeing_markers) - len(kept))
        check = measure_agreement(photo, camera, [candidates], fit.T_board_in_cam, again.blur, noise)
        if check is None:
            break
        tiles = check.tiles[0]
    return fit


def _outlier_markers(tiles: Mapping[int, MarkerTile]) -> set[int]:
    left = np.array([tile.residual_variance for tile in tiles.values()])
    least = _OUTLIER_RATIO * max(float(np.median(left)), 1e-9)
    return {
        k for k, tile in tiles.items() if tile.residual_variance > least and tile.correlation < _OUTLIER_CORRELATION
    }


def find_competing_fit(
    photo: NDArray[np.float32],
    camera: CameraModel,
    board: Board,
    fit: PoseFit,
    fits: Sequence[PoseFit],
    predicted_poses: Sequence[Array] = (),
) -> PoseFit | None:
    """Return another pose that explains the same markers nearly as well, if any.

    `predicted_poses` (4, 4) in the camera frame are approximate, from other boards.
    """
    piece = whole_board_piece(board, fit.agreeing_markers)
    corners = board.marker_corners()[list(fit.agreeing_markers)].reshape(-1, 3)
    exact = corners @ fit.T_board_in_cam[:3, :3].T + fit.T_board_in_cam[:3, 3]
    others = [*planar_poses(corners, exact[:, :2] / exact[:, 2:]), *(other.T_board_in_cam for other in fits)]
    for T in others:
        if angle_between(T, fit.T_board_in_cam) < _SAME_POSE_ANGLE or not faces_camera(T):
            continue
        alignment = fit.alignment
        before = measure_agreement(photo, camera, [piece], T, alignment.blur, alignment.noise)
        if before is None or before.cost / before.pixels > _MAX_COMPETING_RATIO * fit.mean_square:
            continue
        after = align_pose(photo, camera, [piece], T, alignment.blur, coarse=True)
        if (
            after is None
            or angle_between(after.T_ref_in_cam, fit.T_board_in_cam) < _SAME_POSE_ANGLE
            or not faces_camera(after.T_ref_in_cam)
        ):
            continue
        rival = PoseFit(after, fit.agreeing_markers, 0)
        if not is_clearly_better(fit, rival) and not _other_boards_agree(fit, rival, predicted_poses):
            return rival
    return None


def _other_boards_agree(fit: PoseFit, competing: PoseFit, predicted_poses: Sequence[Array]) -> bool:
    near = _MAX_PREDICTION_ANGLE_SHARE * angle_between(fit.T_board_in_cam, competing.T_board_in_cam)
    return (
        bool(predicted_poses)
        and fit.mean_square < competing.mean_square
        and all(angle_between(fit.T_board_in_cam, T) < near for T in predicted_poses)
    )


def is_clearly_better(fit: PoseFit, competing: PoseFit) -> bool:
    """Return whether the photo's likelihood under `fit` excludes `competing`."""
    evidence = 0.5 * fit.alignment.pixels / _PIXELS_PER_SAMPLE * math.log(competing.mean_square / fit.mean_square)
    return evidence >= _MIN_LOG_LIKELIHOOD_RATIO


def angle_between(T_a: Array, T_b: Array) -> float:
    """Return the angle (rad) between orientations."""
    return float(np.linalg.norm(rotation_vector(T_a[:3, :3].T @ T_b[:3, :3])))
