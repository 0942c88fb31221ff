"""Accept a board's fitted pose in a photo, or give the reason against it and advice for photos."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.camera_effects.lens_distortion import project_points
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.board_image import marker_cells

from .fitting.blur_kernel import BlurKernel
from .fitting.normal_equations import MarkerTile
from .fitting.pose_alignment import Alignment, marginalize_shape, measure_agreement
from .fitting.pose_fits import PoseFit, angle_between, find_competing_fit, is_clearly_better, refit_without_outliers
from .fitting.print_shape import CREASE_PROBABILITY
from .fitting.print_view import whole_board_piece

Grey = NDArray[np.uint8]

# A marker that the fit excludes, but that is whole and displaced, lies beyond a crease. A covered marker has a low
# correlation or no shift. Source: 14 half-covered prints and 3 creased ones.
_MIN_DISPLACED_MARKERS = 2  # displaced markers that indicate a crease
_MIN_DISPLACED_CORRELATION = 0.5  # correlation of print and photo; above, a marker is whole
_DISPLACED_PX = 0.7  # px, shift; above, a marker is displaced
_CREASED_SHARE_IF_DISPLACED = 0.9  # prior probability of a crease with displaced markers
_TURN_LIMIT_FACTOR = 4 / 3  # factor on `PoseLimits.max_rotation_sigma` for a sigma with errors of lens and print scale
_MIN_FLAT_PROBABILITY = 0.5  # below, messages name the print's shape as the cause

PRINT_SCALE_SIGMA = 0.0025  # relative error of an unmeasured print's size: printers stretch by tenths of a percent

# Limits within which nearly all boards are found. Source: `make bench-fiducials`.
_MAX_MOTION_PX = 3.0  # px, motion blur
_MAX_BLUR_PX = 1.5  # px, sigma of the defocus blur
_MIN_CONTRAST_RATIO = 8.0  # contrast of the print over the noise's sigma
_MIN_CELL_PX = 0.8  # px, shorter side of a marker cell
_MIN_GREY_RANGE = 60.0  # grey levels; below, a photo is dark or has low contrast
_MAX_EDGE_SIGMA = 2.5  # px, sigma of the sharpest edge; above, a photo is blurred
_SMOOTHING_SIGMA = 1.5  # px, against noise before edges are measured
_RANGE_PERCENTILES = (0.5, 99.5)  # percentiles that define a photo's range of grey levels


class BoardStatus(StrEnum):
    """AMBIGUOUS: two poses or prints fit. POOR_FIT: none does. UNCERTAIN: the sigma is too large."""

    OK = "ok"
    NOT_FOUND = "not_found"
    AMBIGUOUS = "ambiguous"
    POOR_FIT = "poor_fit"
    UNCERTAIN = "uncertain"


@dataclass(frozen=True)
class BoardDetection:
    """A board in a photo.

    Attributes:
        markers: ids that were read, or whose print agrees with the pose.
        reason: why the status is not OK, for users; empty for OK.
        T_board_in_cam: pose (4, 4), origin at the board's centre, z out of the paper; None if refused.
        covariance: (6, 6) of a rotation (rad) about the centre and a shift (m) along the camera's axes, from noise,
            print shape, lens and print scale.
        errors_shared_by_boards: (6, k) pose change per sigma of each error that all boards of a photo share: first the
            focal length, last the print scale.
        reprojection_rms: px, of the markers.
        blur: px; an upper bound for a board that fills the photo.
        is_duplicated: the photo shows the print more than once.
        advice: for better photos, if the board is not located.
    """

    board: Board
    markers: tuple[int, ...]
    status: BoardStatus
    reason: str = ""
    T_board_in_cam: Array | None = None
    covariance: Array | None = None
    errors_shared_by_boards: Array | None = None
    reprojection_rms: float | None = None
    blur: BlurKernel | None = None
    is_duplicated: bool = False
    advice: tuple[str, ...] = ()

    @property
    def failure_explanation(self) -> str:
        """The reason and the advice, for users; empty for OK."""
        return f"{self.reason}; advice: {', '.join(self.advice)}" if self.advice else self.reason

    @property
    def position_sigma(self) -> float | None:
        """Root sum square of the centre's position sigmas, m."""
        return None if self.covariance is None else math.sqrt(float(np.trace(self.covariance[3:, 3:])))

    @property
    def own_position_sigma(self) -> float | None:
        """Position sigma, m, without the errors that all boards share."""
        if self.covariance is None or self.errors_shared_by_boards is None:
            return None
        return math.sqrt(
            max(
                0.0,
                float(
                    np.trace((self.covariance - self.errors_shared_by_boards @ self.errors_shared_by_boards.T)[3:, 3:])
                ),
            )
        )

    @property
    def rotation_sigma(self) -> float | None:
        """Root sum square of the rotation sigmas, rad."""
        return None if self.covariance is None else math.sqrt(float(np.trace(self.covariance[:3, :3])))


@dataclass(frozen=True)
class PoseLimits:
    """The largest accepted rotation and position sigmas, rad and m, without errors that all boards of a photo share."""

    max_rotation_sigma: float = math.radians(1.5)
    max_position_sigma: float = 0.01


DEFAULT_POSE_LIMITS = PoseLimits()


def judge_detection(
    photo: NDArray[np.float32],
    camera: CameraModel,
    board: Board,
    fit: PoseFit,
    fits: Sequence[PoseFit],
    predicted_poses: Sequence[Array] = (),
    limits: PoseLimits = DEFAULT_POSE_LIMITS,
) -> BoardDetection:
    """Return a fitted board's pose with its uncertainty, or the reason against it.

    Args:
        photo: grey levels (height, width).
        fit: the best of `fits`, which are from different start poses.
        predicted_poses: approximate poses (4, 4) from other boards, which resolve an ambiguity.
    """
    fit = refit_without_outliers(photo, camera, board, fit)
    rival = find_competing_fit(photo, camera, board, fit, fits, predicted_poses)
    if rival is not None and is_clearly_better(rival, fit):
        # The fit started at the wrong one of a flat board's two poses.
        fit, rival = rival, find_competing_fit(photo, camera, board, rival, [*fits, fit], predicted_poses)
    ids = tuple(sorted(board.marker_ids[k] for k in fit.agreeing_markers))
    rms = marker_shift_rms(fit.alignment.tiles[0])
    advice = suggest_improvements(measure_appearance(board, camera, photo, fit.alignment))
    if rival is not None:
        apart = math.degrees(angle_between(fit.T_board_in_cam, rival.T_board_in_cam))
        reason = (
            f"two poses, {apart:.0f} degrees apart, explain the {len(ids)} markers about equally well: take the photo "
            "from closer or at a slant"
        )
        kernel = fit.alignment.blur
        return BoardDetection(
            board, ids, BoardStatus.AMBIGUOUS, reason, reprojection_rms=rms, blur=kernel, advice=advice
        )
    creased = _CREASED_SHARE_IF_DISPLACED if _has_displaced_markers(photo, camera, board, fit) else CREASE_PROBABILITY
    shaped = marginalize_shape(
        photo, camera, [whole_board_piece(board, fit.agreeing_markers)], fit.alignment, creased=creased
    )
    covariance, shared = pose_covariance(shaped, camera, np.zeros(3))
    detection = BoardDetection(
        board, ids, BoardStatus.OK, "", shaped.T_ref_in_cam, covariance, shared, rms, shaped.blur
    )
    turn, shift = detection.rotation_sigma, detection.own_position_sigma
    assert turn is not None and shift is not None
    own_turn = math.sqrt(float(np.trace((covariance - shared @ shared.T)[:3, :3])))
    if (
        own_turn <= limits.max_rotation_sigma
        and turn <= _TURN_LIMIT_FACTOR * limits.max_rotation_sigma
        and shift <= limits.max_position_sigma
    ):
        return detection
    why = (
        "too few, too small or too blurred markers"
        if shaped.flat_probability > _MIN_FLAT_PROBABILITY
        else (
            f"its markers lie {rms:.2f} px off those of a flat print: the print is creased or bent, or the lens or "
            "the rig's marker_length_mm or gap_mm is wrong"
        )
    )
    reason = f"its pose is uncertain by {math.degrees(turn):.1f} degrees and {shift * 1000:.0f} mm: {why}"
    return replace(detection, status=BoardStatus.UNCERTAIN, reason=reason, advice=advice)


def _has_displaced_markers(photo: NDArray[np.float32], camera: CameraModel, board: Board, fit: PoseFit) -> bool:
    if fit.contradicting_count < _MIN_DISPLACED_MARKERS:
        return False
    check = measure_agreement(
        photo, camera, [whole_board_piece(board)], fit.T_board_in_cam, fit.alignment.blur, fit.alignment.noise
    )
    if check is None:
        return False
    left_out = [tile for k, tile in check.tiles[0].items() if k not in fit.agreeing_markers]
    displaced = [
        t for t in left_out if t.correlation > _MIN_DISPLACED_CORRELATION and math.hypot(*t.shift) > _DISPLACED_PX
    ]
    return len(displaced) >= _MIN_DISPLACED_MARKERS


def marker_shift_rms(tiles: Mapping[int, MarkerTile]) -> float:
    """Return the markers' rms distance (px) from rendered ones."""
    shifts = np.array([tile.shift for tile in tiles.values()])
    return float(np.sqrt((shifts**2).sum(axis=1).mean()))


def pose_covariance(alignment: Alignment, camera: CameraModel, point: Array) -> tuple[Array, Array]:
    """Return a pose's `covariance` and `errors_shared_by_boards` (`BoardDetection`) about a point (3,) of `ref`, m."""
    x, y, z = alignment.T_ref_in_cam[:3, :3] @ (point - alignment.centre)
    # A rotation w moves the point by w x r.
    moved = np.eye(6)
    moved[3:, :3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    error_columns = [
        alignment.derivatives_by_lens @ camera.intrinsics_cholesky,
        PRINT_SCALE_SIGMA * alignment.derivatives_by_print_scale,
    ]
    shared: Array = moved @ np.column_stack(error_columns)
    covariance: Array = moved @ alignment.covariance @ moved.T + shared @ shared.T
    return covariance, shared


@dataclass(frozen=True)
class BoardAppearance:
    """The image quality of a board: marker cell's shorter side, blur sigma and motion length (px).

    `contrast` (black to white) and `noise` (standard deviation) are in grey levels.
    """

    cell: float
    blur: float
    motion: float
    contrast: float
    noise: float


def measure_appearance(
    board: Board, camera: CameraModel, photo: NDArray[np.float32], fit: Alignment
) -> BoardAppearance:
    """Measure a board's image quality at a fitted pose in a photo (height, width)."""
    T = fit.T_ref_in_cam
    corners = project_points(camera, board.outer_corners() @ T[:3, :3].T + T[:3, 3])
    area = cv2.contourArea(corners.astype(np.float32))
    longer = max(float(np.linalg.norm(corners[a] - corners[b])) for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)))
    across = board.width / board.marker_length * marker_cells(board).shape[1]
    left, top = np.maximum(corners.min(axis=0), 0).astype(int)
    right, bottom = np.ceil(corners.max(axis=0)).astype(int)
    part = photo[top : bottom + 1, left : right + 1]
    low, high = np.percentile(part, _RANGE_PERCENTILES) if part.size else (0.0, 0.0)
    shorter = area / max(longer, 1.0)
    return BoardAppearance(shorter / across, fit.blur.blur, fit.blur.motion_length, float(high - low), fit.noise)


def suggest_improvements(looks: BoardAppearance) -> tuple[str, ...]:
    """Return advice for better photos, if any."""
    found = []
    if looks.motion > _MAX_MOTION_PX:
        found.append(f"hold the camera still (motion blurs the board by {looks.motion:.0f} px)")
    if looks.blur > _MAX_BLUR_PX:
        found.append(f"focus the camera (the blur is {looks.blur:.1f} px)")
    if looks.contrast < _MIN_CONTRAST_RATIO * looks.noise:
        found.append(f"add light (the contrast is {looks.contrast:.0f} of 255, the noise {looks.noise:.0f})")
    if looks.cell < _MIN_CELL_PX:
        found.append(
            f"move closer, slant the camera less or use a higher resolution (a marker cell is {looks.cell:.1f} px)"
        )
    return tuple(found)


def suggest_photo_improvements(grey: Grey) -> tuple[str, ...]:
    """Return advice for a photo (height, width) in which nothing resembles a board."""
    low, high = np.percentile(grey[::2, ::2], _RANGE_PERCENTILES)
    found = []
    if high - low < _MIN_GREY_RANGE:
        found.append(f"add light or contrast (grey levels are {low:.0f} to {high:.0f} of 255)")
    if (blur := _min_blur(grey, float(high - low))) > _MAX_EDGE_SIGMA:
        found.append(f"focus the camera or hold it still (no edge is sharper than {blur:.1f} px)")
    return tuple(found) or ("bring the whole board into the photo, or move closer",)


def _min_blur(grey: Grey, contrast: float) -> float:
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTHING_SIGMA)
    across, down = cv2.Scharr(smooth, cv2.CV_32F, 1, 0) / 32, cv2.Scharr(smooth, cv2.CV_32F, 0, 1) / 32
    steepest = float(np.percentile(np.hypot(across, down)[::2, ::2], 99.9))
    blur = contrast / (math.sqrt(2 * math.pi) * max(steepest, 0.1))
    return math.sqrt(max(blur**2 - _SMOOTHING_SIGMA**2, 0.0))
