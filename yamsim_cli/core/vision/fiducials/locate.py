"""From a photo to the pose of each board in it, or to the reason why there is none.

Find the markers, take every pose that their corners allow, let each compete for the whole print (`align`), and accept
the winner only where no other pose explains the photo nearly as well. Where too few markers can be read, the board is
recognized as a whole (`recognition`). A flat board seen from afar has two poses: refusing is better than guessing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...geometry.board import Board
from ...geometry.camera import CameraModel
from ...geometry.se3 import Array, inverse
from .fitting.align import USUAL_SMEAR, agreement
from .fitting.fits import PoseFit, fit_pose, starts
from .fitting.print_view import Piece
from .judge import USUAL_LIMITS, Limits, judge, shift_rms
from .markers import DetectedMarker, find_markers, groups
from .recognition.recognizer import Recognizer
from .sighting import Sighting, Status

Grey = NDArray[np.uint8]


def locate(
    grey: Grey,
    camera: CameraModel,
    boards: Sequence[Board],
    T_boards_in_ref: Sequence[Array] = (),
    before: Sequence[Array | None] = (),
    limits: Limits = USUAL_LIMITS,
) -> tuple[list[Sighting], dict[str, list[DetectedMarker]]]:
    """Look for boards in a photo (height, width) that `camera` took.

    Args:
        T_boards_in_ref: about where the boards lie to each other, pose (4, 4) of each in one frame: where to look for
            one that cannot be read beside one that can, and which of two poses one has that the photo leaves open.
            Poses are not made to agree with it.
        before: pose (4, 4) of each board in the camera's frame in a photo just before, None where it is not known.
        limits: the uncertainty up to which a pose counts as located.

    Returns:
        One sighting for each board, and by dictionary all markers that were read, whosever they are.

    Raises:
        ConfigError: a board's dictionary does not exist.
    """
    markers = find_markers(grey, sorted({board.dictionary for board in boards}))
    photo = grey.astype(np.float32)
    sightings = [_read(photo, camera, board, markers, limits) for board in boards]
    recognizer = Recognizer(grey, photo, camera, len(boards), limits)
    located = [seen.status is Status.OK for seen in sightings]
    for k, seen in enumerate(sightings):
        if seen.status is not Status.OK and not seen.twice:
            was = [T] if k < len(before) and (T := before[k]) is not None else []
            sightings[k] = recognizer.sighting(seen, _beside(k, sightings, T_boards_in_ref), was, anywhere=True)
    # Boards that were recognized just now tell where those are that came before them.
    for k, seen in enumerate(sightings):
        if seen.status is not Status.OK and not seen.twice:
            new = [
                one if not was else replace(one, T_board_in_cam=None)
                for one, was in zip(sightings, located, strict=True)
            ]
            sightings[k] = recognizer.sighting(seen, _beside(k, new, T_boards_in_ref))
    return sightings, markers


def _beside(k: int, sightings: Sequence[Sighting], T_boards_in_ref: Sequence[Array]) -> list[Array]:
    """Where the k-th board is in the camera's frame, by each other one that is located."""
    if not T_boards_in_ref:
        return []
    return [
        T @ inverse(T_boards_in_ref[j]) @ T_boards_in_ref[k]
        for j, other in enumerate(sightings)
        if j != k and other.status is Status.OK and (T := other.T_board_in_cam) is not None
    ]


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


def _read(
    photo: NDArray[np.float32],
    camera: CameraModel,
    board: Board,
    markers: Mapping[str, Sequence[DetectedMarker]],
    limits: Limits,
) -> Sighting:
    """A board by those of its markers that were read."""
    found = groups(markers[board.dictionary], board, camera)
    if not found:
        return _not_found(board)
    best = found[0]
    ids = tuple(sorted(board.ids[k] for k in best.places))
    if len(found) > 1 and 2 * len(found[1].places) > len(best.places):
        reason = f"its markers are in {len(found)} places: hide or remove the other prints"
        return Sighting(board, ids, Status.AMBIGUOUS, reason, twice=True)
    fits: list[PoseFit] = []
    for T in starts(best, board, camera):
        if fit := fit_pose(photo, camera, board, best.places, T, fits):
            fits.append(fit)
            # Where the print agrees, the other start could at most be its rival, which `rival_of` looks for.
            if fit.contradicting == 0 or fit.explains_well:
                break
    if not fits:
        return Sighting(
            board, ids, Status.POOR_FIT, "no pose explains its markers' print: blurred, bent or not this board"
        )
    fit = max(fits, key=lambda one: (len(one.agreeing), -one.mean_square))
    return judge(photo, camera, board, fit, fits, limits=limits)


def at_pose(grey: Grey, camera: CameraModel, seen: Sighting, T_board_in_cam: Array) -> Sighting:
    """A sighting with a pose from elsewhere, and how far the photo (height, width) has its markers from there."""
    piece = Piece(seen.board, np.eye(4), tuple(seen.board.ids.index(number) for number in seen.markers))
    check = agreement(grey.astype(np.float32), camera, [piece], T_board_in_cam, seen.smear or USUAL_SMEAR, noise=1.0)
    rms = None if check is None else shift_rms(check.tiles[0])
    return replace(seen, T_board_in_cam=T_board_in_cam, reprojection_rms=rms)
