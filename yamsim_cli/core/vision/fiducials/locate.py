"""From a photo to the pose of each board in it, or to the reason why there is none.

Find the markers, take every pose that their corners allow, let each compete for the whole print (`align`), and accept
the winner only where no other pose explains the photo nearly as well. A flat board seen from afar has two: refusing is
better than guessing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from ...geometry.board import Board
from ...geometry.camera import CameraModel
from ...geometry.se3 import Array, inverse
from .align import INFLATION, Alignment, Guess, agreement, align
from .fits import PoseFit, angle_between, fit_pose, rival_of, starts
from .linearize import Tile
from .markers import DetectedMarker, find_markers, groups
from .print_view import Piece

Grey = NDArray[np.uint8]

# Sigma, px, where nothing is known yet.
_USUAL_BLUR = 0.9
# Accepted poses are known at least this well.
_MAX_TURN_SIGMA = math.radians(3.0)
_MAX_SHIFT_SIGMA = 0.03  # of the distance

# What a printed board's scale is known to where nobody measured it. A printer stretches by a few tenths of a percent.
_PRINT_SIGMA = 0.0025
# A print that would have to be so much larger or smaller is none: the boards do not lie where they are said to.
_MOST_GROWTH = 3 * _PRINT_SIGMA


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
            camera's axes: noise, and what the lens and the print's scale are known to.
        shared: (6, k) the part of it that is the same mistake for all boards of a photo: what one standard deviation of
            each mistake does to the pose; first the focal length's, last the print scale's.
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


def locate(
    grey: Grey, camera: CameraModel, boards: Sequence[Board]
) -> tuple[list[Sighting], dict[str, list[DetectedMarker]]]:
    """Look for boards in a photo (height, width) that `camera` took.

    Returns:
        One sighting for each board, and by dictionary all markers that were read, whosever they are.

    Raises:
        ConfigError: a board's dictionary does not exist.
    """
    markers = find_markers(grey, sorted({board.dictionary for board in boards}))
    photo = grey.astype(np.float32)
    return [_sighting(photo, camera, board, markers) for board in boards], markers


def unlocated(
    grey: Grey, camera: CameraModel, boards: Sequence[Board], reason: str
) -> tuple[list[Sighting], dict[str, list[DetectedMarker]]]:
    """Boards in a photo (height, width) whose camera is not known well enough for any pose: which are seen.

    Args:
        camera: any, to put markers together.
        reason: why no pose is given, for a person.

    Returns:
        As `locate`.
    """
    markers = find_markers(grey, sorted({board.dictionary for board in boards}))
    sightings = []
    for board in boards:
        found = groups(markers[board.dictionary], board, camera)
        ids = tuple(sorted(board.ids[k] for k in found[0].places)) if found else ()
        sightings.append(Sighting(board, ids, Status.POOR_FIT, reason) if ids else _not_found(board))
    return sightings, markers


def _not_found(board: Board) -> Sighting:
    return Sighting(board, (), Status.NOT_FOUND, "none of its markers was found")


def _sighting(
    photo: NDArray[np.float32], camera: CameraModel, board: Board, markers: Mapping[str, Sequence[DetectedMarker]]
) -> Sighting:
    found = groups(markers[board.dictionary], board, camera)
    if not found:
        return _not_found(board)
    best = found[0]
    ids = tuple(sorted(board.ids[k] for k in best.places))
    if len(found) > 1 and 2 * len(found[1].places) > len(best.places):
        reason = f"its markers are in {len(found)} places: hide or remove the other prints"
        return Sighting(board, ids, Status.AMBIGUOUS, reason)
    fits: list[PoseFit] = []
    for T in starts(best, board, camera):
        if fit := fit_pose(photo, camera, board, best.places, T):
            fits.append(fit)
            # Where the whole print agrees, the other start could at most be its rival, which `rival_of` looks for.
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
        The sightings with their poses and figures made anew; None where they do not lie so, whatever the print's size.
    """
    pieces = [
        Piece(seen.board, T, tuple(seen.board.ids.index(number) for number in seen.markers))
        for seen, T in zip(sightings, T_boards_in_ref, strict=True)
    ]
    # The board known best says where the shared frame is to begin with.
    best = min(range(len(pieces)), key=lambda k: sightings[k].position_sigma or math.inf)
    T_board_in_cam, blur = sightings[best].T_board_in_cam, sightings[best].blur or _USUAL_BLUR
    assert T_board_in_cam is not None
    # How the boards lie is trusted, the print's size is not: fixed, an error of a quarter of a percent would tilt them
    # by 0.2 degrees.
    growth = Guess(0.0, _PRINT_SIGMA / INFLATION, _growth(sightings, T_boards_in_ref))
    T_start = T_board_in_cam.copy()
    T_start[:3, 3] *= math.exp(growth.start)
    T_start = T_start @ inverse(T_boards_in_ref[best])
    alignment = align(grey.astype(np.float32), camera, pieces, T_start, blur, growth=growth)
    if alignment is None or abs(alignment.growth) > _MOST_GROWTH:
        return None
    T_ref, joint = alignment.T_ref_in_cam, []
    for k, (seen, T) in enumerate(zip(sightings, T_boards_in_ref, strict=True)):
        covariance, shared = _uncertainty(alignment, camera, T[:3, 3])
        rms = _shift_rms(alignment.tiles[k])
        joint.append(
            Sighting(seen.board, seen.markers, Status.OK, "", T_ref @ T, covariance, shared, rms, alignment.blur)
        )
    return joint


def _growth(sightings: Sequence[Sighting], T_boards_in_ref: Sequence[Array]) -> float:
    """How much larger (logarithm) the prints have to be for the boards to lie as far apart as they are known to."""
    logs = []
    for (one, T_one), (two, T_two) in itertools.combinations(zip(sightings, T_boards_in_ref, strict=True), 2):
        assert one.T_board_in_cam is not None and two.T_board_in_cam is not None
        seen = float(np.linalg.norm(two.T_board_in_cam[:3, 3] - one.T_board_in_cam[:3, 3]))
        logs.append(math.log(float(np.linalg.norm(T_two[:3, 3] - T_one[:3, 3])) / seen))
    return float(np.clip(np.mean(logs), -2 * _MOST_GROWTH, 2 * _MOST_GROWTH)) if logs else 0.0


def at_pose(grey: Grey, camera: CameraModel, seen: Sighting, T_board_in_cam: Array) -> Sighting:
    """A sighting with a pose from elsewhere, and how far the photo (height, width) has its markers from there."""
    piece = Piece(seen.board, np.eye(4), tuple(seen.board.ids.index(number) for number in seen.markers))
    check = agreement(grey.astype(np.float32), camera, [piece], T_board_in_cam, seen.blur or _USUAL_BLUR, noise=1.0)
    rms = None if check is None else _shift_rms(check.tiles[0])
    return replace(seen, T_board_in_cam=T_board_in_cam, reprojection_rms=rms)


def _judge(
    photo: NDArray[np.float32], camera: CameraModel, board: Board, fit: PoseFit, fits: Sequence[PoseFit]
) -> Sighting:
    ids = tuple(sorted(board.ids[k] for k in fit.agreeing))
    rms = _shift_rms(fit.alignment.tiles[0])
    covariance, shared = _uncertainty(fit.alignment, camera, np.zeros(3))
    if rival := rival_of(photo, camera, board, fit, fits):
        apart = math.degrees(angle_between(fit.T, rival.T))
        reason = (
            f"two poses, {apart:.0f} degrees apart, explain the {len(ids)} markers about equally well: take the photo "
            "from nearer by or from a slant"
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


def _shift_rms(tiles: Mapping[int, Tile]) -> float:
    shifts = np.array([tile.shift for tile in tiles.values()])
    return float(np.sqrt((shifts**2).sum(axis=1).mean()))


def _uncertainty(alignment: Alignment, camera: CameraModel, point: Array) -> tuple[Array, Array]:
    """Covariance (6, 6) of a turn about a point (3,) of the reference frame and of its shift; its shared part (6, k).

    The noise's, inflated, with what the uncertainties of the lens and of the print's scale add.
    """
    x, y, z = alignment.T_ref_in_cam[:3, :3] @ (point - alignment.centre)
    # A turn w about the centre moves the point by w x r.
    moved = np.eye(6)
    moved[3:, :3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    mistakes = [alignment.by_lens @ camera.mistakes, _PRINT_SIGMA * alignment.by_print]
    shared: Array = moved @ np.column_stack(mistakes)
    covariance: Array = moved @ alignment.covariance @ moved.T * INFLATION**2 + shared @ shared.T
    return covariance, shared
