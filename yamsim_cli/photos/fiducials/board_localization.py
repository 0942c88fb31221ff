"""Locate boards in a photo: each board's pose, or the reason for none.

Each pose that the detected corners allow is fitted to the whole print (`fitting.pose_alignment`). The best is accepted
only if no other explains the photo nearly as well: a distant flat board allows two poses. A board with too few readable
markers is recognized as a whole (`recognition`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, invert_pose

from .board_detection import (
    DEFAULT_POSE_LIMITS,
    PRINT_SCALE_SIGMA,
    BoardDetection,
    BoardStatus,
    PoseLimits,
    judge_detection,
    marker_shift_rms,
    pose_covariance,
)
from .fitting.pose_alignment import (
    INITIAL_BLUR,
    SIGMA_INFLATION,
    LogScalePrior,
    align_pose,
    marginalize_shape,
    measure_agreement,
)
from .fitting.pose_fits import PoseFit, fit_pose, initial_poses
from .fitting.print_view import PrintedBoard, whole_board_piece
from .markers import DetectedMarker, find_markers, group_markers
from .recognition.board_recognizer import BoardRedetector

Grey = NDArray[np.uint8]

_MAX_LOG_SCALE = 3 * PRINT_SCALE_SIGMA  # log of print over nominal size, above which the rig's poses are wrong


def locate_boards(
    grey: Grey,
    camera: CameraModel,
    boards: Sequence[Board],
    T_boards_in_ref: Sequence[Array] = (),
    before: Sequence[Array | None] = (),
    limits: PoseLimits = DEFAULT_POSE_LIMITS,
) -> tuple[list[BoardDetection], dict[str, list[DetectedMarker]]]:
    """Return a detection for each board, and all detected markers by dictionary.

    Args:
        grey: the photo (height, width).
        T_boards_in_ref: approximate poses (4, 4) in a shared frame. Poses that they predict from other boards start the
            search and resolve ambiguities; the fitted pose does not depend on them.
        before: poses (4, 4) in the camera frame in the previous photo; None if not known.

    Raises:
        ConfigError: a board's dictionary does not exist.
    """
    markers = find_markers(grey, sorted({board.dictionary for board in boards}))
    photo = grey.astype(np.float32)
    sightings = [_locate_board_with_markers(photo, camera, board, markers, limits) for board in boards]
    recognizer = BoardRedetector(grey, photo, camera, len(boards), limits)
    located = [seen.status is BoardStatus.OK for seen in sightings]
    for k, seen in enumerate(sightings):
        if seen.status is not BoardStatus.OK and not seen.is_duplicated:
            was = [T] if k < len(before) and (T := before[k]) is not None else []
            sightings[k] = recognizer.detect_again(
                seen, _poses_by_other_boards(k, sightings, T_boards_in_ref), was, anywhere=True
            )
    # Boards recognized only now predict the poses of boards earlier in the list.
    for k, seen in enumerate(sightings):
        if seen.status is not BoardStatus.OK and not seen.is_duplicated:
            new = [
                one if not was else replace(one, T_board_in_cam=None)
                for one, was in zip(sightings, located, strict=True)
            ]
            sightings[k] = recognizer.detect_again(seen, _poses_by_other_boards(k, new, T_boards_in_ref))
    return sightings, markers


def _poses_by_other_boards(
    k: int, detections: Sequence[BoardDetection], T_boards_in_ref: Sequence[Array]
) -> list[Array]:
    """Return the k-th board's pose (4, 4) in the camera frame, as other boards predict it."""
    if not T_boards_in_ref:
        return []
    return [
        T @ invert_pose(T_boards_in_ref[j]) @ T_boards_in_ref[k]
        for j, other in enumerate(detections)
        if j != k and other.status is BoardStatus.OK and (T := other.T_board_in_cam) is not None
    ]


def detections_without_pose(
    grey: Grey, camera: CameraModel, boards: Sequence[Board], reason: str
) -> tuple[list[BoardDetection], dict[str, list[DetectedMarker]]]:
    """Return detections without pose for `reason`, and all markers by dictionary.

    `grey` is (height, width); any focal length of `camera` suffices to group markers.
    """
    markers = find_markers(grey, sorted({board.dictionary for board in boards}))
    sightings = []
    for board in boards:
        found = group_markers(markers[board.dictionary], board, camera)
        ids = tuple(sorted(board.marker_ids[k] for k in found[0].places)) if found else ()
        sightings.append(
            BoardDetection(board, ids, BoardStatus.POOR_FIT, reason) if ids else _not_found_detection(board)
        )
    return sightings, markers


def _not_found_detection(board: Board) -> BoardDetection:
    return BoardDetection(board, (), BoardStatus.NOT_FOUND, "none of its markers was found")


def _locate_board_with_markers(
    photo: NDArray[np.float32],
    camera: CameraModel,
    board: Board,
    markers: Mapping[str, Sequence[DetectedMarker]],
    limits: PoseLimits,
) -> BoardDetection:
    found = group_markers(markers[board.dictionary], board, camera)
    if not found:
        return _not_found_detection(board)
    best = found[0]
    ids = tuple(sorted(board.marker_ids[k] for k in best.places))
    if len(found) > 1 and 2 * len(found[1].places) > len(best.places):
        reason = f"its markers appear in {len(found)} places: hide or remove the other prints"
        return BoardDetection(board, ids, BoardStatus.AMBIGUOUS, reason, is_duplicated=True)
    fits: list[PoseFit] = []
    for T in initial_poses(best, board, camera):
        if fit := fit_pose(photo, camera, board, best.places, T, fits):
            fits.append(fit)
            # The other start could only give a competing pose, which `judge_detection` searches.
            if fit.contradicting_count == 0 or fit.agrees_with_photo:
                break
    if not fits:
        return BoardDetection(
            board,
            ids,
            BoardStatus.POOR_FIT,
            "no pose of the board explains its markers: the print is blurred or bent, or shows another board",
        )
    fit = max(fits, key=lambda one: (len(one.agreeing_markers), -one.mean_square))
    return judge_detection(photo, camera, board, fit, fits, limits=limits)


def replace_board_pose(grey: Grey, camera: CameraModel, seen: BoardDetection, T_board_in_cam: Array) -> BoardDetection:
    """Replace a detection's pose (4, 4) and measure the reprojection error in a photo (height, width)."""
    piece = whole_board_piece(seen.board, [seen.board.marker_ids.index(number) for number in seen.markers])
    check = measure_agreement(
        grey.astype(np.float32), camera, [piece], T_board_in_cam, seen.blur or INITIAL_BLUR, noise=1.0
    )
    rms = None if check is None else marker_shift_rms(check.tiles[0])
    return replace(seen, T_board_in_cam=T_board_in_cam, reprojection_rms=rms)


def locate_boards_together(
    grey: Grey, camera: CameraModel, detections: Sequence[BoardDetection], T_boards_in_ref: Sequence[Array]
) -> list[BoardDetection] | None:
    """Fit one pose to boards with poses and known relative poses: distant boards determine tilt better.

    Args:
        T_boards_in_ref: poses (4, 4) in a shared frame `ref`.

    Returns:
        New detections; None if no print size within 3 `PRINT_SCALE_SIGMA` explains the relative poses.
    """
    pieces = [
        PrintedBoard(seen.board, T, tuple(seen.board.marker_ids.index(number) for number in seen.markers))
        for seen, T in zip(detections, T_boards_in_ref, strict=True)
    ]
    # The most certain board gives the start pose of `ref`.
    best = min(range(len(pieces)), key=lambda k: detections[k].position_sigma or math.inf)
    T_board_in_cam, kernel = detections[best].T_board_in_cam, detections[best].blur or INITIAL_BLUR
    assert T_board_in_cam is not None
    # The print size is fitted too: a size error of 0.25 % would tilt the boards by 0.2 degrees.
    scale_prior = LogScalePrior(
        0.0, PRINT_SCALE_SIGMA / SIGMA_INFLATION, _common_log_scale(detections, T_boards_in_ref)
    )
    T_start = T_board_in_cam.copy()
    T_start[:3, 3] *= math.exp(scale_prior.start)
    T_start = T_start @ invert_pose(T_boards_in_ref[best])
    photo = grey.astype(np.float32)
    alignment = align_pose(photo, camera, pieces, T_start, kernel, log_scale_prior=scale_prior)
    if alignment is None or abs(alignment.log_scale) > _MAX_LOG_SCALE:
        return None
    alignment = marginalize_shape(photo, camera, pieces, alignment, scale_prior)
    T_ref, joint = alignment.T_ref_in_cam, []
    for k, (seen, T) in enumerate(zip(detections, T_boards_in_ref, strict=True)):
        covariance, shared = pose_covariance(alignment, camera, T[:3, 3])
        rms = marker_shift_rms(alignment.tiles[k])
        joint.append(
            BoardDetection(
                seen.board, seen.markers, BoardStatus.OK, "", T_ref @ T, covariance, shared, rms, alignment.blur
            )
        )
    return joint


def _common_log_scale(detections: Sequence[BoardDetection], T_boards_in_ref: Sequence[Array]) -> float:
    """Return the log of print over nominal size at which the boards' distances match `T_boards_in_ref`."""
    logs = []
    for (one, T_one), (two, T_two) in itertools.combinations(zip(detections, T_boards_in_ref, strict=True), 2):
        assert one.T_board_in_cam is not None and two.T_board_in_cam is not None
        seen = float(np.linalg.norm(two.T_board_in_cam[:3, 3] - one.T_board_in_cam[:3, 3]))
        logs.append(math.log(float(np.linalg.norm(T_two[:3, 3] - T_one[:3, 3])) / seen))
    return float(np.clip(np.mean(logs), -2 * _MAX_LOG_SCALE, 2 * _MAX_LOG_SCALE)) if logs else 0.0
