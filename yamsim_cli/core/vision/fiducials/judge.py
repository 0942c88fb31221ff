"""Whether a fitted pose is sure enough to be given, and how far it may be off."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...geometry.board import Board
from ...geometry.camera import CameraModel
from ...geometry.se3 import Array
from .advice import advice_on, looks_of
from .fitting.align import Alignment, agreement, with_shape
from .fitting.fits import PoseFit, angle_between, clearly_better, rival_of, without_strange
from .fitting.linearize import Tile
from .fitting.print_shape import CREASED_SHARE
from .fitting.print_view import Piece
from .sighting import Sighting, Status

# Markers that are left out of the fit, but are whole and displaced, lie beyond a crease. Covered ones correlate less,
# or are not shifted. Source: 14 half-covered prints and 3 creased ones.
_LEAST_DISPLACED = 2  # markers
_STILL_ALIKE = 0.5  # correlation of drawing and photo
_DISPLACED_PX = 0.7  # px
_CREASED_IF_DISPLACED = 0.9  # prior probability of a crease then
_WITH_LENS = 4 / 3  # of the largest turn: what is allowed with the lens and the print's scale, which all photos share
_FLAT = 0.5  # probability, below which a message names the print's shape as the cause

# What a printed board's scale is known to where nobody measured it. A printer stretches by a few tenths of a percent.
PRINT_SIGMA = 0.0025


@dataclass(frozen=True)
class Limits:
    """The uncertainty up to which a pose counts as located.

    Attributes:
        turn: standard deviation of the orientation, rad, without what the camera's focal length and the print's scale
            add; with these, a third more is allowed.
        shift: standard deviation of the centre's position, m, without what the camera's focal length and the print's
            scale add: these are the same in all photos.
    """

    turn: float = math.radians(1.5)
    shift: float = 0.01


USUAL_LIMITS = Limits()


def judge(
    photo: NDArray[np.float32],
    camera: CameraModel,
    board: Board,
    fit: PoseFit,
    fits: Sequence[PoseFit],
    beside: Sequence[Array] = (),
    limits: Limits = USUAL_LIMITS,
) -> Sighting:
    """Return what is said of a board whose pose is fitted: the pose with its uncertainty, or why there is none.

    Args:
        photo: grey levels (height, width).
        fit: the best pose.
        fits: all that were fitted.
        beside: about the board's pose (4, 4) as each other board says: which of two it has.
        limits: beyond these, the pose is uncertain.
    """
    fit = without_strange(photo, camera, board, fit)
    rival = rival_of(photo, camera, board, fit, fits, beside)
    if rival is not None and clearly_better(rival, fit):
        # The fit began at the wrong one of the two poses that a flat board may have.
        fit, rival = rival, rival_of(photo, camera, board, rival, [*fits, fit], beside)
    ids = tuple(sorted(board.ids[k] for k in fit.agreeing))
    rms = shift_rms(fit.alignment.tiles[0])
    advice = advice_on(looks_of(board, camera, photo, fit.alignment))
    if rival is not None:
        apart = math.degrees(angle_between(fit.T, rival.T))
        reason = (
            f"two poses, {apart:.0f} degrees apart, explain the {len(ids)} markers about equally well: take the photo "
            "from nearer by or from a slant"
        )
        smear = fit.alignment.smear
        return Sighting(board, ids, Status.AMBIGUOUS, reason, reprojection_rms=rms, smear=smear, advice=advice)
    creased = _CREASED_IF_DISPLACED if _displaced(photo, camera, board, fit) else CREASED_SHARE
    shaped = with_shape(photo, camera, [Piece(board, np.eye(4), fit.agreeing)], fit.alignment, creased=creased)
    covariance, shared = uncertainty(shaped, camera, np.zeros(3))
    sighting = Sighting(board, ids, Status.OK, "", shaped.T_ref_in_cam, covariance, shared, rms, shaped.smear)
    turn, shift = sighting.rotation_sigma, sighting.own_position_sigma
    assert turn is not None and shift is not None
    own_turn = math.sqrt(float(np.trace((covariance - shared @ shared.T)[:3, :3])))
    if own_turn <= limits.turn and turn <= _WITH_LENS * limits.turn and shift <= limits.shift:
        return sighting
    why = (
        "too few, too small or too blurred markers"
        if shaped.flat > _FLAT
        else (
            f"its markers lie {rms:.2f} px off a flat print's: a crease, a bent plate, another lens, or other "
            "measures than the rig's"
        )
    )
    reason = f"its pose is uncertain by {math.degrees(turn):.1f} degrees and {shift * 1000:.0f} mm: {why}"
    return replace(sighting, status=Status.UNCERTAIN, reason=reason, advice=advice)


def _displaced(photo: NDArray[np.float32], camera: CameraModel, board: Board, fit: PoseFit) -> bool:
    """Return whether several markers that the fit left out are there whole, but elsewhere: beyond a crease."""
    if fit.contradicting < _LEAST_DISPLACED:
        return False
    everything = Piece(board, np.eye(4), tuple(range(len(board.ids))))
    check = agreement(photo, camera, [everything], fit.T, fit.alignment.smear, fit.alignment.noise)
    if check is None:
        return False
    left_out = [tile for k, tile in check.tiles[0].items() if k not in fit.agreeing]
    displaced = [t for t in left_out if t.correlation > _STILL_ALIKE and math.hypot(*t.shift) > _DISPLACED_PX]
    return len(displaced) >= _LEAST_DISPLACED


def shift_rms(tiles: Mapping[int, Tile]) -> float:
    """The root mean square of how far (px) markers lie from where the drawing has them."""
    shifts = np.array([tile.shift for tile in tiles.values()])
    return float(np.sqrt((shifts**2).sum(axis=1).mean()))


def uncertainty(alignment: Alignment, camera: CameraModel, point: Array) -> tuple[Array, Array]:
    """Covariance (6, 6) of a turn about a point (3,) of the reference frame and of its shift; its shared part (6, k).

    It holds the photo's noise and the print's shape, and what the uncertainties of the lens and of the print's scale
    add.

    Args:
        alignment: of `with_shape`.
    """
    x, y, z = alignment.T_ref_in_cam[:3, :3] @ (point - alignment.centre)
    # A turn w about the centre moves the point by w x r.
    moved = np.eye(6)
    moved[3:, :3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    mistakes = [alignment.by_lens @ camera.mistakes, PRINT_SIGMA * alignment.by_print]
    shared: Array = moved @ np.column_stack(mistakes)
    covariance: Array = moved @ alignment.covariance @ moved.T + shared @ shared.T
    return covariance, shared
