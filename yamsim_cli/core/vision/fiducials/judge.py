"""Whether a fitted pose is sure enough to be given, and how far it may be off."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...geometry.board import Board
from ...geometry.camera import CameraModel
from ...geometry.se3 import Array
from .advice import advice_on, looks_of
from .fitting.align import INFLATION, Alignment
from .fitting.fits import PoseFit, angle_between, clearly_better, rival_of, without_strange
from .fitting.linearize import Tile
from .sighting import Sighting, Status

# Accepted poses are known at least this well: the turn in all, and, without what lens and print size do, the shift.
_MAX_TURN_SIGMA = math.radians(2.0)
_MAX_SHIFT_SIGMA = 0.01  # of the distance
# Where the markers lie off a flat print's, the turn is to be known better, but for the lens: what it is known to is
# uncertain itself then.
# Source: 120 photos of creased boards, of which one was wrong by more than 3 degrees at 1.5.
_MAX_TURN_SIGMA_BENT = math.radians(1.0)

# Markers that lie off each other this many times as far as noise explains are still no sign of anything else. What more
# there is (a crease, a bent plate, another lens) moves the pose so many times as far as as much noise would.
# Source: photos of creased boards: with 4, errors were 1.1 times what was stated in the median, and 2.4 at most.
_USUAL_SCATTER, _NO_NOISE = 3.0, 6.0
_POSE_PARAMETERS = 6

# What a printed board's scale is known to where nobody measured it. A printer stretches by a few tenths of a percent.
PRINT_SIGMA = 0.0025


def judge(
    photo: NDArray[np.float32],
    camera: CameraModel,
    board: Board,
    fit: PoseFit,
    fits: Sequence[PoseFit],
    beside: Sequence[Array] = (),
) -> Sighting:
    """What is said of a board whose pose is fitted: the pose, or why it is not sure enough.

    Args:
        photo: grey levels (height, width).
        fit: the best pose.
        fits: all that were fitted.
        beside: about the board's pose (4, 4) as each other board says: which of two it has.
    """
    fit = without_strange(photo, camera, board, fit)
    rival = rival_of(photo, camera, board, fit, fits, beside)
    if rival is not None and clearly_better(rival, fit):
        # The fit began at the wrong one of the two poses that a flat board may have.
        fit, rival = rival, rival_of(photo, camera, board, rival, [*fits, fit], beside)
    ids = tuple(sorted(board.ids[k] for k in fit.agreeing))
    rms = shift_rms(fit.alignment.tiles[0])
    covariance, shared = uncertainty(fit.alignment, camera, np.zeros(3))

    def refused(status: Status, reason: str) -> Sighting:
        advice = advice_on(looks_of(board, camera, photo, fit.alignment))
        return Sighting(board, ids, status, reason, reprojection_rms=rms, smear=fit.alignment.smear, advice=advice)

    if rival is not None:
        apart = math.degrees(angle_between(fit.T, rival.T))
        reason = (
            f"two poses, {apart:.0f} degrees apart, explain the {len(ids)} markers about equally well: take the photo "
            "from nearer by or from a slant"
        )
        return refused(Status.AMBIGUOUS, reason)
    sighting = Sighting(board, ids, Status.OK, "", fit.T, covariance, shared, rms, fit.alignment.smear)
    own = covariance - shared @ shared.T
    turn, own_turn, shift = (
        math.sqrt(float(np.trace(part))) for part in (covariance[:3, :3], own[:3, :3], own[3:, 3:])
    )
    bent = _NO_NOISE * _excess_scatter(fit.alignment) > INFLATION
    too_bent = bent and own_turn > _MAX_TURN_SIGMA_BENT
    if turn > _MAX_TURN_SIGMA or too_bent or shift > _MAX_SHIFT_SIGMA * float(np.linalg.norm(fit.T[:3, 3])):
        why = "too few, too small or too blurred markers"
        if bent:
            why = (
                f"its markers lie {rms:.2f} px off a flat print's: a crease, a bent plate, another lens, or other "
                "measures than the rig's"
            )
        reason = f"its pose is uncertain by {math.degrees(turn):.1f} degrees and {shift * 1000:.0f} mm: {why}"
        return refused(Status.POOR_FIT, reason)
    return sighting


def shift_rms(tiles: Mapping[int, Tile]) -> float:
    """The root mean square of how far (px) markers lie from where the drawing has them."""
    shifts = np.array([tile.shift for tile in tiles.values()])
    return float(np.sqrt((shifts**2).sum(axis=1).mean()))


def uncertainty(alignment: Alignment, camera: CameraModel, point: Array) -> tuple[Array, Array]:
    """Covariance (6, 6) of a turn about a point (3,) of the reference frame and of its shift; its shared part (6, k).

    The noise's, inflated, more where markers lie off each other by more than noise explains, with what the
    uncertainties of the lens and of the print's scale add.
    """
    x, y, z = alignment.T_ref_in_cam[:3, :3] @ (point - alignment.centre)
    # A turn w about the centre moves the point by w x r.
    moved = np.eye(6)
    moved[3:, :3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    mistakes = [alignment.by_lens @ camera.mistakes, PRINT_SIGMA * alignment.by_print]
    shared: Array = moved @ np.column_stack(mistakes)
    inflation = max(INFLATION, _NO_NOISE * _excess_scatter(alignment))
    covariance: Array = moved @ alignment.covariance @ moved.T * inflation**2 + shared @ shared.T
    return covariance, shared


def _excess_scatter(alignment: Alignment) -> float:
    """How many times as far markers lie off each other as noise alone explains, beyond what is usual."""
    tiles = [tile for piece in alignment.tiles for tile in piece.values()]
    free = 2 * len(tiles) - _POSE_PARAMETERS
    if free <= 0:
        return 0.0
    # By the median, since glare on some of the markers is no bend: of two squares' sum, it is 2 log 2 of one's mean.
    usual = float(np.median([tile.shifted for tile in tiles])) / (2 * math.log(2))
    scatter = usual * 2 * len(tiles) / free / alignment.noise**2
    return math.sqrt(max(0.0, scatter - _USUAL_SCATTER**2))
