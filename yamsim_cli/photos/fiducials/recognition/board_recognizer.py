"""Recognize boards with unreadable markers by all bits of their print together.

Patches (`board_candidates`), other boards and the previous photo predict poses, each fitted to the whole print. A fit
counts only if its bits agree far beyond chance (`marker_bits`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.camera_effects.lens_distortion import project_points, viewing_rays
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array

from ..board_detection import (
    BoardDetection,
    BoardStatus,
    PoseLimits,
    judge_detection,
    measure_appearance,
    suggest_improvements,
    suggest_photo_improvements,
)
from ..fitting.blur_kernel import BlurKernel
from ..fitting.pose_alignment import INITIAL_BLUR, Alignment, align_pose
from ..fitting.pose_fits import EXPLAINED_CORRELATION, PoseFit, faces_camera, planar_poses
from ..fitting.print_view import (
    PhotoRegion,
    PrintedBoard,
    crop_photo_to_print,
    print_plane,
    render_print,
    whole_board_piece,
)
from .board_candidates import (
    BoardCandidate,
    board_quads,
    dark_quads,
    edge_quads,
    oriented_candidates,
    refine_candidates,
)
from .marker_bits import BitEvidence, measure_bit_agreement

Grey = NDArray[np.uint8]

FALSE_ALARM_RATE = 1e-4  # accepted rate of photos without the board
# Tried positions and orientations. Source: `make bench-fiducials`: 20 to 60 patches in four orientations, about 250
# moves of each refined patch.
_TRIALS_PER_BOARD = 1200
_TRIALS_PER_FIT = 30  # a fit tries many poses; they count as this number of independent trials
_MAX_BOARD_LOG_CHANCE = -8.0  # log probability of the bits by chance; below, advice assumes the board
_MAX_RETRIED_LOG_CHANCE = -3.0  # the same; below, a fit with low correlation is repeated
_SAME_MOTION_BLUR_PX = 3.0  # px; motion blurs whose lengths differ by less count as equal
_MAX_FITS = 2  # fitted candidates per search method
_MIN_RELATIVE_AGREEMENT = 0.6  # ratio to the best candidate's agreement; below, a candidate is not fitted
_SEARCH_RADIUS = 0.5  # board sizes in the picture, around a predicted position
_SUFFICIENT_CORRELATION = 0.85  # median, of print and photo; above, no other pose is fitted
_MIN_PRINT_DISTANCE = 0.5  # patch sizes, distance between different prints

# Start kernels of a fit.
_BLUR_SIGMAS = (0.9, 2.0, 3.5)  # px
_MOTION_LENGTHS, _MOTION_DIRECTIONS = (4.0, 8.0, 12.0), 8  # px; directions over 180 degrees
_MOVING_BLUR_SIGMA = 1.0  # px, with motion
_MAX_MOTION_RATIO = 0.85  # squared residuals with motion over those with blur; below, motion wins
# Kernels are compared at the pixels that this one selects.
_COMPARISON_BLUR = BlurKernel(_BLUR_SIGMAS[1])


class BoardRedetector:
    """Recognizes boards in one photo by their bits.

    Args:
        grey, photo: the photo (height, width), as bytes and as floats.
        boards: number of boards that are searched.
    """

    def __init__(
        self, grey: Grey, photo: NDArray[np.float32], camera: CameraModel, boards: int, limits: PoseLimits
    ) -> None:
        self._grey, self._photo, self._camera, self._boards, self._limits = grey, photo, camera, boards, limits
        self._likeliest: tuple[float, Alignment] | None = None

    @cached_property
    def _dark_patches_of_prints(self) -> list[Array]:
        return dark_quads(self._grey, whole=True)

    @cached_property
    def _dark_patches_of_markers(self) -> list[Array]:
        return dark_quads(self._grey, whole=False)

    @cached_property
    def _edge_patches(self) -> list[Array]:
        return edge_quads(self._grey)

    def detect_again(
        self,
        seen: BoardDetection,
        predicted_poses: Sequence[Array],
        before: Sequence[Array] = (),
        anywhere: bool = False,
    ) -> BoardDetection:
        """Search a board with unreadable markers; without success, return `seen`.

        Args:
            predicted_poses: approximate poses (4, 4) in the camera frame, from other boards.
            before: poses (4, 4) in the previous photo.
            anywhere: search the whole photo besides.
        """
        board, fits = seen.board, list[PoseFit]()
        self._likeliest = None
        for T in (*before, *predicted_poses):
            if (T_moved := self._shift_to_best_match(board, T)) is not None:
                fits += self._fit_poses(board, [T_moved])
        if anywhere:
            for found in self._candidate_batches(board):
                if fits:
                    break
                for candidate in _best_candidates(found):
                    fits += self._fit_poses(board, self._start_poses(board, candidate))
        if not fits:
            return replace(seen, advice=self._photo_advice(board)) if anywhere else seen
        best = min(fits, key=lambda fit: fit.mean_square)
        size = board.width * self._camera.mean_focal_length / best.T_board_in_cam[2, 3]
        if any(self._distance_px(fit, best) > _MIN_PRINT_DISTANCE * size for fit in fits):
            reason = "the board is in the photo twice: hide or remove the other print"
            return BoardDetection(board, seen.markers, BoardStatus.AMBIGUOUS, reason, is_duplicated=True)
        return judge_detection(self._photo, self._camera, board, best, fits, predicted_poses, self._limits)

    def _candidate_batches(self, board: Board) -> Iterator[list[BoardCandidate]]:
        yield oriented_candidates(self._grey, board, self._dark_patches_of_prints)
        yield oriented_candidates(self._grey, board, board_quads(self._dark_patches_of_markers, board))
        yield refine_candidates(self._grey, board, self._edge_patches)

    def _photo_advice(self, board: Board) -> tuple[str, ...]:
        if self._likeliest is not None and self._likeliest[0] < _MAX_BOARD_LOG_CHANCE:
            found = suggest_improvements(measure_appearance(board, self._camera, self._photo, self._likeliest[1]))
            if found:
                return found
        return suggest_photo_improvements(self._grey)

    def _distance_px(self, one: PoseFit, other: PoseFit) -> float:
        at = project_points(self._camera, np.array([one.T_board_in_cam[:3, 3], other.T_board_in_cam[:3, 3]]))
        return float(np.linalg.norm(at[0] - at[1]))

    def _start_poses(self, board: Board, candidate: BoardCandidate) -> list[Array]:
        poses = planar_poses(board.outer_corners(), viewing_rays(self._camera, candidate.corners))
        return [T for T in poses if np.isfinite(T).all() and faces_camera(T)]

    def _fit_poses(self, board: Board, poses: Sequence[Array]) -> list[PoseFit]:
        found = list[PoseFit]()
        for T in poses:
            if fit := self._fit_by_bits(board, T):
                found.append(fit)
                # The other pose could only compete, which `judge_detection` searches.
                if fit.contradicting_count == 0 and _is_explained(fit.alignment, _SUFFICIENT_CORRELATION):
                    break
        return found

    def _fit_by_bits(self, board: Board, T: Array) -> PoseFit | None:
        whole = whole_board_piece(board)
        found = self._align_with_blur(whole, T)
        if found is not None and not _is_explained(found[0]) and found[1].log_chance_bound < _MAX_RETRIED_LOG_CHANCE:
            again = self._align_with_blur(whole, found[0].T_ref_in_cam, found[0].blur)
            if again is not None and again[1].log_chance_bound < found[1].log_chance_bound:
                found = again
        if found is None:
            return None
        first, bits = found
        if self._likeliest is None or bits.log_chance_bound < self._likeliest[0]:
            self._likeliest = bits.log_chance_bound, first
        # Bonferroni: the accepted rate is divided by the photo's trials.
        if bits.log_chance_bound > math.log(FALSE_ALARM_RATE / (self._boards * _TRIALS_PER_BOARD * _TRIALS_PER_FIT)):
            return None
        if len(bits.markers) < len(first.tiles[0]):
            fewer = align_pose(
                self._photo, self._camera, [whole_board_piece(board, bits.markers)], first.T_ref_in_cam, first.blur
            )
            if fewer is None or not faces_camera(fewer.T_ref_in_cam):
                return None
            first = fewer
        return PoseFit(first, bits.markers, len(bits.agreement) - len(bits.markers))

    def _view_piece(self, piece: PrintedBoard, T: Array) -> tuple[PhotoRegion | None, Array]:
        plane = print_plane(piece, T)
        return crop_photo_to_print(self._photo, self._camera, piece, plane), plane

    def _align_with_blur(
        self, piece: PrintedBoard, T: Array, tried: BlurKernel | None = None
    ) -> tuple[Alignment, BitEvidence] | None:
        """Align a piece with an estimated blur; None if that resembles the earlier blur `tried`."""
        view, plane = self._view_piece(piece, T)
        kernel = None if view is None else estimate_blur(view, plane)
        if kernel is None or (
            tried is not None and abs(kernel.motion_length - tried.motion_length) < _SAME_MOTION_BLUR_PX
        ):
            return None
        fit = align_pose(self._photo, self._camera, [piece], T, kernel)
        if fit is None or not faces_camera(fit.T_ref_in_cam):
            return None
        view, plane = self._view_piece(piece, fit.T_ref_in_cam)
        return None if view is None else (fit, measure_bit_agreement(view, plane, fit.blur, fit.noise))

    def _shift_to_best_match(self, board: Board, T: Array) -> Array | None:
        """Shift a pose along the image plane to the best match; None if the board faces away."""
        if not faces_camera(T):
            return None
        corners = project_points(self._camera, board.outer_corners() @ T[:3, :3].T + T[:3, 3])
        centre = project_points(self._camera, T[None, :3, 3])[0]
        half = np.abs(corners - centre).max(axis=0)
        height, width = self._grey.shape
        reach = np.ceil(half + _SEARCH_RADIUS * 2 * half.max()).astype(int)
        low = np.maximum(np.round(centre).astype(int) - reach, 0)
        high = np.minimum(np.round(centre).astype(int) + reach + 1, (width, height))
        view, plane = self._view_piece(whole_board_piece(board), T)
        if view is None or (high - low < 2 * half).any() or view.reduction_factor > 1:
            return T
        drawing = render_print(view, plane, INITIAL_BLUR)
        seen = self._photo[low[1] : high[1], low[0] : high[0]]
        shape = drawing.grey.shape
        if shape[0] > seen.shape[0] or shape[1] > seen.shape[1]:
            return T
        mask = (drawing.marker >= 0).reshape(shape).astype(np.float32)
        score = cv2.matchTemplate(seen, drawing.grey, cv2.TM_CCOEFF_NORMED, mask=mask)
        score = np.where(np.isfinite(score), score, -1.0)
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        first_pixel = project_points(self._camera, np.append(view.centre_rays[0], 1.0)[None])[0]
        shift = np.array([column + low[0], row + low[1]]) - first_pixel
        ray, shifted_ray = viewing_rays(self._camera, [centre, centre + shift])
        moved = T.copy()
        moved[:2, 3] += T[2, 3] * (shifted_ray - ray)
        return moved


def _best_candidates(found: Sequence[BoardCandidate]) -> Iterator[BoardCandidate]:
    taken = list[BoardCandidate]()
    for one in found:
        if one.agreement < _MIN_RELATIVE_AGREEMENT * found[0].agreement or len(taken) == _MAX_FITS:
            return
        size = float(np.abs(np.ptp(one.corners, axis=0)).max())
        if all(np.abs(one.corners - other.corners).max() > _MIN_PRINT_DISTANCE * size for other in taken):
            taken.append(one)
            yield one


def _is_explained(fit: Alignment, minimum: float = EXPLAINED_CORRELATION) -> bool:
    return float(np.median([tile.correlation for tile in fit.tiles[0].values()])) > minimum


def estimate_blur(view: PhotoRegion, plane: Array) -> BlurKernel | None:
    """Return the blur or motion (px) that explains the photo best; None with too few pixels.

    Args:
        plane: (3, 3) from the board to the camera frame, as for `render_print`.
    """
    drawing = render_print(view, plane, _COMPARISON_BLUR.scaled_to_reduced_picture(view.reduction_factor))
    use = drawing.marker >= 0
    if use.sum() < 2 * len(view.piece.markers):
        return None
    order = np.argsort(drawing.marker[use], kind="stable")
    _, starts, which = np.unique(drawing.marker[use][order], return_index=True, return_inverse=True)
    place = np.flatnonzero(use)[order]
    seen = _subtract_marker_means(view.photo.ravel()[place], starts, which)

    def residual_power(blur: BlurKernel) -> float:
        drawn = blur.scaled_to_reduced_picture(view.reduction_factor).blur_picture(drawing.unblurred).ravel()[place]
        shape = _subtract_marker_means(drawn, starts, which)
        power = np.add.reduceat(shape**2, starts) + 1e-9
        contrast = np.maximum(np.add.reduceat(shape * seen, starts) / power, 0.0)
        return float(((seen - contrast[which] * shape) ** 2).sum())

    angles = np.arange(_MOTION_DIRECTIONS) * math.pi / _MOTION_DIRECTIONS
    vectors = [(length * math.cos(angle), length * math.sin(angle)) for length in _MOTION_LENGTHS for angle in angles]
    blurs = {kernel: residual_power(kernel) for kernel in map(BlurKernel, _BLUR_SIGMAS)}
    motions = {
        kernel: residual_power(kernel) for kernel in (BlurKernel(_MOVING_BLUR_SIGMA, vector) for vector in vectors)
    }
    blurred, moved = min(blurs, key=lambda one: blurs[one]), min(motions, key=lambda one: motions[one])
    return moved if motions[moved] < _MAX_MOTION_RATIO * blurs[blurred] else blurred


def _subtract_marker_means(values: NDArray[np.float32], starts: NDArray[np.int_], which: NDArray[np.int_]) -> Array:
    exact = values.astype(np.float64)
    less: Array = exact - (np.add.reduceat(exact, starts) / np.bincount(which))[which]
    return less
