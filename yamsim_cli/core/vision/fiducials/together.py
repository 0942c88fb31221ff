"""Boards that are known to lie so to each other, located as if they were one."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...geometry.camera import CameraModel
from ...geometry.se3 import Array, inverse
from .fitting.align import INFLATION, USUAL_SMEAR, Guess, align, with_shape
from .fitting.print_view import Piece
from .judge import PRINT_SIGMA, shift_rms, uncertainty
from .sighting import Sighting, Status

Grey = NDArray[np.uint8]

# A print that would have to be so much larger or smaller is none: the boards do not lie where they are said to.
_MOST_GROWTH = 3 * PRINT_SIGMA


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
    T_board_in_cam, smear = sightings[best].T_board_in_cam, sightings[best].smear or USUAL_SMEAR
    assert T_board_in_cam is not None
    # How the boards lie is trusted, the print's size is not: fixed, an error of a quarter of a percent would tilt them
    # by 0.2 degrees.
    growth = Guess(0.0, PRINT_SIGMA / INFLATION, _growth(sightings, T_boards_in_ref))
    T_start = T_board_in_cam.copy()
    T_start[:3, 3] *= math.exp(growth.start)
    T_start = T_start @ inverse(T_boards_in_ref[best])
    photo = grey.astype(np.float32)
    alignment = align(photo, camera, pieces, T_start, smear, growth=growth)
    if alignment is None or abs(alignment.growth) > _MOST_GROWTH:
        return None
    alignment = with_shape(photo, camera, pieces, alignment, growth)
    T_ref, joint = alignment.T_ref_in_cam, []
    for k, (seen, T) in enumerate(zip(sightings, T_boards_in_ref, strict=True)):
        covariance, shared = uncertainty(alignment, camera, T[:3, 3])
        rms = shift_rms(alignment.tiles[k])
        joint.append(
            Sighting(seen.board, seen.markers, Status.OK, "", T_ref @ T, covariance, shared, rms, alignment.smear)
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
