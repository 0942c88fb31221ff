"""From a photo to the pose of each board in it, or to the reason why there is none.

Find the markers, take every pose that their corners allow, let each compete for the whole print (`align`), and accept
the winner only where no other pose explains the photo nearly as well. A flat board seen from afar has two: refusing is
better than guessing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from ...geometry.board import Board
from ...geometry.camera import CameraModel
from ...geometry.se3 import Array, inverse, pose, rotation_vector
from ..lens import project_points, rays
from .align import Alignment, Tile, agreement, align
from .markers import Group, Marker, find_markers, groups
from .print_view import Piece

Grey = NDArray[np.uint8]

# Sigma, px, where nothing is known yet.
_USUAL_BLUR = 0.9
# A marker whose print and photo correlate less than this is hidden, moved or something else.
_SAME_PRINT = 0.75
# How much more likely the photo has to be under the pose than under its rival (difference of log-likelihoods), with
# neighbouring pixels counted as `_CORRELATED` times fewer independent ones.
_MIN_EVIDENCE = 12.0
_CORRELATED = 4.0
# Poses closer than this are the same one.
_SAME_POSE = math.radians(4.0)
# A rival this much worse before it is fitted (mean squared residual) cannot win.
_HOPELESS = 4.0

# Accepted poses are known at least this well.
_MAX_TURN_SIGMA = math.radians(3.0)
_MAX_SHIFT_SIGMA = 0.03  # of the distance

# The photo's noise is not all there is: how far the truth lies from the found pose, over what noise alone explains.
# Source: `make bench-fiducials`, 95 % of squared distances against those of a normal distribution.
INFLATION = 2.0
# What a printed board's scale is known to where nobody measured it. A printer stretches by a few tenths of a percent.
_PRINT_SIGMA = 0.0025


class Status(StrEnum):
    """What became of a board."""

    OK = "ok"
    NOT_FOUND = "not_found"
    AMBIGUOUS = "ambiguous"
    POOR_FIT = "poor_fit"


@dataclass(frozen=True)
class Sighting:
    """A board in a photo.

    Attributes:
        markers: ids of its markers that were read or, once the pose was known, recognized by their print.
        status: OK where there is a pose.
        reason: why not, for a person; empty with a pose.
        T_board_in_cam: pose (4, 4) of the `board` frame (origin at the centre, z out of the paper), or None.
        covariance: (6, 6) of a small rotation (rad) about the board's centre and of its shift (m), both along the
            camera's axes: noise, and what focal length and print scale are known to.
        shared: (6, 2) the part of it that is the same mistake for all boards of a photo: what one standard deviation of
            the focal length and one of the print scale do to the pose.
        reprojection_rms: root mean square of how far (px) each marker's picture lies from where the pose puts it.
        blur: about the photo's blur, sigma in px; of a board that fills the photo, at most so much.
    """

    board: Board
    markers: tuple[int, ...]
    status: Status
    reason: str = ""
    T_board_in_cam: Array | None = None
    covariance: Array | None = None
    shared: Array | None = None
    reprojection_rms: float | None = None
    blur: float | None = None

    @property
    def position_sigma(self) -> float | None:
        """Standard deviation of the centre's position, all axes together, m."""
        return None if self.covariance is None else math.sqrt(float(np.trace(self.covariance[3:, 3:])))

    @property
    def rotation_sigma(self) -> float | None:
        """Standard deviation of the orientation, all axes together, rad."""
        return None if self.covariance is None else math.sqrt(float(np.trace(self.covariance[:3, :3])))


def locate(grey: Grey, camera: CameraModel, boards: Sequence[Board]) -> tuple[list[Sighting], dict[str, list[Marker]]]:
    """Look for boards in a photo (height, width) that `camera` took.

    Returns:
        One sighting for each board, and by dictionary all markers that were read, whosever they are.

    Raises:
        ConfigError: a board's dictionary does not exist.
    """
    markers = find_markers(grey, sorted({board.dictionary for board in boards}))
    photo = grey.astype(np.float32)
    return [_sighting(photo, camera, board, markers) for board in boards], markers


def _sighting(
    photo: NDArray[np.float32], camera: CameraModel, board: Board, markers: Mapping[str, Sequence[Marker]]
) -> Sighting:
    found = groups(markers[board.dictionary], board, camera)
    if not found:
        return Sighting(board, (), Status.NOT_FOUND, "none of its markers was found")
    best = found[0]
    ids = tuple(sorted(board.ids[k] for k in best.places))
    if len(found) > 1 and 2 * len(found[1].places) > len(best.places):
        reason = f"its markers are in {len(found)} places: hide or remove the other prints"
        return Sighting(board, ids, Status.AMBIGUOUS, reason)
    fits: list[_Fit] = []
    for T in _starts(best, board, camera):
        if fit := _fit(photo, camera, board, best.places, T):
            fits.append(fit)
            # Where the whole print agrees, the other start could at most be its rival, which `_rival` looks for.
            if fit.contradicting == 0:
                break
    if not fits:
        return Sighting(
            board, ids, Status.POOR_FIT, "no pose explains its markers' print: blurred, bent or not this board"
        )
    fit = max(fits, key=lambda one: (len(one.agreeing), -one.mean_square))
    return _judge(photo, camera, board, fit, fits)


def locate_together(
    grey: Grey, camera: CameraModel, sightings: Sequence[Sighting], T_boards_in_ref: Sequence[Array]
) -> list[Sighting] | None:
    """Boards that are known to lie so in one frame, located as if they were one: far apart, they pin each other's tilt.

    Args:
        sightings: of at least one board, each with a pose.
        T_boards_in_ref: pose (4, 4) of each of their boards in the frame that they share.

    Returns:
        The sightings with their poses and figures made anew; None where the fit breaks down.
    """
    pieces = [
        Piece(seen.board, T, tuple(seen.board.ids.index(number) for number in seen.markers))
        for seen, T in zip(sightings, T_boards_in_ref, strict=True)
    ]
    # The board known best says where the shared frame is to begin with.
    start = min(range(len(pieces)), key=lambda k: sightings[k].position_sigma or math.inf)
    T_board_in_cam = sightings[start].T_board_in_cam
    assert T_board_in_cam is not None
    T_start = T_board_in_cam @ inverse(T_boards_in_ref[start])
    alignment = align(grey.astype(np.float32), camera, pieces, T_start, sightings[start].blur or _USUAL_BLUR)
    if alignment is None:
        return None
    T_ref, joint = alignment.T_ref_in_cam, []
    for k, (seen, T) in enumerate(zip(sightings, T_boards_in_ref, strict=True)):
        covariance, shared = _uncertainty(alignment, camera, T[:3, 3])
        rms = _shift_rms(alignment.tiles[k])
        joint.append(
            Sighting(seen.board, seen.markers, Status.OK, "", T_ref @ T, covariance, shared, rms, alignment.blur)
        )
    return joint


def at_pose(grey: Grey, camera: CameraModel, seen: Sighting, T_board_in_cam: Array) -> Sighting:
    """A sighting with a pose from elsewhere, and how far the photo (height, width) has its markers from there."""
    piece = Piece(seen.board, np.eye(4), tuple(seen.board.ids.index(number) for number in seen.markers))
    check = agreement(grey.astype(np.float32), camera, [piece], T_board_in_cam, seen.blur or _USUAL_BLUR, noise=1.0)
    rms = None if check is None else _shift_rms(check.tiles[0])
    return replace(seen, T_board_in_cam=T_board_in_cam, reprojection_rms=rms)


@dataclass(frozen=True)
class _Fit:
    """A pose fitted to a board's print: the markers that agree with it, and how many seen ones do not."""

    alignment: Alignment
    agreeing: tuple[int, ...]
    contradicting: int

    @property
    def T(self) -> Array:
        return self.alignment.T_ref_in_cam

    @property
    def mean_square(self) -> float:
        return self.alignment.cost / self.alignment.pixels


def _starts(group: Group, board: Board, camera: CameraModel) -> list[Array]:
    """Poses (4, 4) that a planar board's corners allow, the likelier one first. Unlikely ones are left out."""
    points = board.corners()[list(group.places)].reshape(-1, 3)
    pixels = group.corners.reshape(-1, 2)
    # IPPE knows no distortion, so it is given viewing rays.
    count, turns, shifts, _ = cv2.solvePnPGeneric(
        points, rays(camera, pixels), np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
    )
    K, distortion = np.array(camera.K), np.array(camera.distortion)
    starts = []
    for k in range(count):
        turn, shift = cv2.solvePnPRefineLM(points, pixels, K, distortion, turns[k], shifts[k])
        T = pose(shift.ravel(), cv2.Rodrigues(turn)[0])
        if not np.isfinite(T).all() or not _faces_camera(T):
            continue
        off = project_points(camera, points @ T[:3, :3].T + T[:3, 3]) - pixels
        starts.append((float(np.sqrt((off**2).sum(axis=1).mean())), T))
    starts.sort(key=lambda start: start[0])
    return [T for _, T in starts]


def _faces_camera(T_board_in_cam: Array) -> bool:
    """Whether the board is in front of the camera with its printed side towards it."""
    return bool(T_board_in_cam[2, 3] > 0 and T_board_in_cam[:3, 2] @ T_board_in_cam[:3, 3] < 0)


def _fit(photo: NDArray[np.float32], camera: CameraModel, board: Board, places: Sequence[int], T: Array) -> _Fit | None:
    """Fit a pose to the markers that were read, then to all whose print shows where it predicts it."""
    first = align(photo, camera, [Piece(board, np.eye(4), tuple(places))], T)
    if first is None or not _faces_camera(first.T_ref_in_cam):
        return None
    everything = Piece(board, np.eye(4), tuple(range(len(board.ids))))
    check = agreement(photo, camera, [everything], first.T_ref_in_cam, first.blur, first.noise)
    if check is None:
        return None
    tiles = check.tiles[0]
    agreeing = tuple(k for k, tile in tiles.items() if tile.correlation >= _SAME_PRINT)
    if not agreeing:
        return None
    if set(agreeing) != set(places):
        piece = Piece(board, np.eye(4), agreeing)
        again = align(photo, camera, [piece], first.T_ref_in_cam, first.blur)
        if again is None or not _faces_camera(again.T_ref_in_cam):
            return None
        first = again
    return _Fit(first, agreeing, len(tiles) - len(agreeing))


def _judge(photo: NDArray[np.float32], camera: CameraModel, board: Board, fit: _Fit, fits: Sequence[_Fit]) -> Sighting:
    ids = tuple(sorted(board.ids[k] for k in fit.agreeing))
    rms = _shift_rms(fit.alignment.tiles[0])
    covariance, shared = _uncertainty(fit.alignment, camera, np.zeros(3))
    if rival := _rival(photo, camera, board, fit, fits):
        reason = (
            f"two poses, {math.degrees(_angle(fit.T, rival.T)):.0f} degrees apart, explain the {len(ids)} markers "
            "about equally well: take the photo from nearer by or from a slant"
        )
        return Sighting(board, ids, Status.AMBIGUOUS, reason, reprojection_rms=rms, blur=fit.alignment.blur)
    sighting = Sighting(board, ids, Status.OK, "", fit.T, covariance, shared, rms, fit.alignment.blur)
    turn, shift = sighting.rotation_sigma, sighting.position_sigma
    assert turn is not None and shift is not None
    distance = float(np.linalg.norm(fit.T[:3, 3]))
    if turn > _MAX_TURN_SIGMA or shift > _MAX_SHIFT_SIGMA * distance + camera.focal_sigma * distance:
        reason = (
            f"its pose is uncertain by {math.degrees(turn):.1f} degrees and {shift * 1000:.0f} mm: too few, too small "
            "or too blurred markers"
        )
        return Sighting(board, ids, Status.POOR_FIT, reason, reprojection_rms=rms, blur=fit.alignment.blur)
    return sighting


def _rival(
    photo: NDArray[np.float32], camera: CameraModel, board: Board, fit: _Fit, fits: Sequence[_Fit]
) -> _Fit | None:
    """Another pose that explains the same markers nearly as well; None where there is none."""
    piece = Piece(board, np.eye(4), fit.agreeing)
    corners = board.corners()[list(fit.agreeing)].reshape(-1, 3)
    exact = corners @ fit.T[:3, :3].T + fit.T[:3, 3]
    count, turns, shifts, _ = cv2.solvePnPGeneric(
        corners, exact[:, :2] / exact[:, 2:], np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
    )
    others = [pose(shifts[k].ravel(), cv2.Rodrigues(turns[k])[0]) for k in range(count)]
    others += [other.T for other in fits]
    for T in others:
        if _angle(T, fit.T) < _SAME_POSE or not _faces_camera(T):
            continue
        alignment = fit.alignment
        before = agreement(photo, camera, [piece], T, alignment.blur, alignment.noise)
        if before is None or before.cost / before.pixels > _HOPELESS * fit.mean_square:
            continue
        after = align(photo, camera, [piece], T, alignment.blur)
        if after is None or _angle(after.T_ref_in_cam, fit.T) < _SAME_POSE or not _faces_camera(after.T_ref_in_cam):
            continue
        rival = _Fit(after, fit.agreeing, 0)
        evidence = 0.5 * fit.alignment.pixels / _CORRELATED * math.log(rival.mean_square / fit.mean_square)
        if evidence < _MIN_EVIDENCE:
            return rival
    return None


def _angle(T_a: Array, T_b: Array) -> float:
    return float(np.linalg.norm(rotation_vector(T_a[:3, :3].T @ T_b[:3, :3])))


def _shift_rms(tiles: Mapping[int, Tile]) -> float:
    shifts = np.array([tile.shift for tile in tiles.values()])
    return float(np.sqrt((shifts**2).sum(axis=1).mean()))


def _uncertainty(alignment: Alignment, camera: CameraModel, point: Array) -> tuple[Array, Array]:
    """Covariance (6, 6) of a turn about a point (3,) of the reference frame and of its shift; its shared part (6, 2).

    The noise's, inflated, with what the uncertainties of focal length and print scale add.
    """
    x, y, z = alignment.T_ref_in_cam[:3, :3] @ (point - alignment.centre)
    # A turn w about the centre moves the point by w x r.
    moved = np.eye(6)
    moved[3:, :3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    scales = [camera.focal_sigma * alignment.by_focal, _PRINT_SIGMA * alignment.by_print]
    shared: Array = moved @ np.column_stack(scales)
    covariance: Array = moved @ alignment.covariance @ moved.T * INFLATION**2 + shared @ shared.T
    return covariance, shared
