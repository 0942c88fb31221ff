"""Poses that a board's print allows: where to start, what fits, and which other pose explains the photo as well."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ....geometry.board import Board
from ....geometry.camera import CameraModel
from ....geometry.se3 import Array, pose, rotation_vector
from ...lens import project_points, rays
from ..markers import Group
from .align import Alignment, agreement, align
from .linearize import Tile
from .print_view import Piece

# A marker whose print and photo correlate less than this is hidden, moved or something else.
SAME_PRINT = 0.75
# A fit whose markers correlate more than this with the photo (the median) needs no other smear and no other start.
EXPLAINED = 0.96
# A marker of which so many times as much stays unexplained as of most others is covered in part, say, if it correlates
# less than this. Source: photos of whole boards have at most 2.5, creased ones 4, half covered ones 40 and more.
_STRANGE, _SPOILT = 5.0, 0.9
# So often, at most, it is asked again which markers are strange: one that is pulls the pose off the others.
_MOST_ROUNDS = 3
# How much more likely the photo has to be under the pose than under its rival (difference of log-likelihoods), with
# neighbouring pixels counted as `_CORRELATED` times fewer independent ones.
_MIN_EVIDENCE = 12.0
_CORRELATED = 4.0
# Poses closer than this are the same one.
_SAME_POSE = math.radians(4.0)
# Another board beside it tells two poses apart if it has the likelier one within this share of the turn between them.
_TOLD = 0.25
# A rival this much worse before it is fitted (mean squared residual) cannot win.
_HOPELESS = 4.0


@dataclass(frozen=True)
class PoseFit:
    """A pose fitted to a board's print: the markers that agree with it, and how many seen ones do not."""

    alignment: Alignment
    agreeing: tuple[int, ...]
    contradicting: int

    @property
    def T(self) -> Array:
        """Pose (4, 4) of the board in the camera's frame."""
        return self.alignment.T_ref_in_cam

    @property
    def explains_well(self) -> bool:
        """Whether drawing and photo agree nearly everywhere, of the markers that agree at all."""
        return float(np.median([tile.correlation for tile in self.alignment.tiles[0].values()])) > EXPLAINED

    @property
    def mean_square(self) -> float:
        """Of the residuals, grey levels squared."""
        return self.alignment.cost / self.alignment.pixels


def starts(group: Group, board: Board, camera: CameraModel) -> list[Array]:
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
        if not np.isfinite(T).all() or not faces_camera(T):
            continue
        off = project_points(camera, points @ T[:3, :3].T + T[:3, 3]) - pixels
        starts.append((float(np.sqrt((off**2).sum(axis=1).mean())), T))
    starts.sort(key=lambda start: start[0])
    return [T for _, T in starts]


def faces_camera(T_board_in_cam: Array) -> bool:
    """Whether the board is in front of the camera with its printed side towards it."""
    return bool(T_board_in_cam[2, 3] > 0 and T_board_in_cam[:3, 2] @ T_board_in_cam[:3, 3] < 0)


def fit_pose(
    photo: NDArray[np.float32],
    camera: CameraModel,
    board: Board,
    places: Sequence[int],
    T: Array,
    known: Sequence[PoseFit] = (),
) -> PoseFit | None:
    """Fit a pose to the markers that were read, then to all whose print shows where it predicts it.

    Returns:
        None where nothing fits, or only a pose that is `known`.
    """
    first = align(photo, camera, [Piece(board, np.eye(4), tuple(places))], T)
    if first is None or not faces_camera(first.T_ref_in_cam):
        return None
    if any(angle_between(first.T_ref_in_cam, fit.T) < _SAME_POSE for fit in known):
        return None
    everything = Piece(board, np.eye(4), tuple(range(len(board.ids))))
    check = agreement(photo, camera, [everything], first.T_ref_in_cam, first.smear, first.noise)
    if check is None:
        return None
    tiles = check.tiles[0]
    agreeing = tuple(k for k, tile in tiles.items() if tile.correlation >= SAME_PRINT)
    if not agreeing:
        return None
    if set(agreeing) != set(places):
        piece = Piece(board, np.eye(4), agreeing)
        again = align(photo, camera, [piece], first.T_ref_in_cam, first.smear)
        if again is None or not faces_camera(again.T_ref_in_cam):
            return None
        first = again
    return PoseFit(first, agreeing, len(tiles) - len(agreeing))


def without_strange(photo: NDArray[np.float32], camera: CameraModel, board: Board, fit: PoseFit) -> PoseFit:
    """A fit without markers that the print explains far worse than the others: those covered in part pull the pose."""
    candidates = Piece(board, np.eye(4), fit.agreeing)
    tiles = fit.alignment.tiles[0]
    for _ in range(_MOST_ROUNDS):
        kept = tuple(k for k in candidates.markers if k in tiles and k not in _strange(tiles))
        if kept == fit.agreeing:
            break
        smear, noise = fit.alignment.smear, fit.alignment.noise
        again = align(photo, camera, [Piece(board, np.eye(4), kept)], fit.T, smear)
        if again is None or not faces_camera(again.T_ref_in_cam):
            break
        fit = PoseFit(again, kept, fit.contradicting + len(fit.agreeing) - len(kept))
        check = agreement(photo, camera, [candidates], fit.T, again.smear, noise)
        if check is None:
            break
        tiles = check.tiles[0]
    return fit


def _strange(tiles: Mapping[int, Tile]) -> set[int]:
    """Markers of which neither the drawing nor a shift of it explains nearly as much as of most."""
    left = np.array([tile.unexplained for tile in tiles.values()])
    least = _STRANGE * max(float(np.median(left)), 1e-9)
    return {k for k, tile in tiles.items() if tile.unexplained > least and tile.correlation < _SPOILT}


def rival_of(
    photo: NDArray[np.float32],
    camera: CameraModel,
    board: Board,
    fit: PoseFit,
    fits: Sequence[PoseFit],
    beside: Sequence[Array] = (),
) -> PoseFit | None:
    """Another pose that explains the same markers nearly as well; None where there is none.

    Args:
        beside: about the board's pose (4, 4) as each other board says.
    """
    piece = Piece(board, np.eye(4), fit.agreeing)
    corners = board.corners()[list(fit.agreeing)].reshape(-1, 3)
    exact = corners @ fit.T[:3, :3].T + fit.T[:3, 3]
    count, turns, shifts, _ = cv2.solvePnPGeneric(
        corners, exact[:, :2] / exact[:, 2:], np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
    )
    others = [pose(shifts[k].ravel(), cv2.Rodrigues(turns[k])[0]) for k in range(count)]
    others += [other.T for other in fits]
    for T in others:
        if angle_between(T, fit.T) < _SAME_POSE or not faces_camera(T):
            continue
        alignment = fit.alignment
        before = agreement(photo, camera, [piece], T, alignment.smear, alignment.noise)
        if before is None or before.cost / before.pixels > _HOPELESS * fit.mean_square:
            continue
        after = align(photo, camera, [piece], T, alignment.smear, roughly=True)
        if (
            after is None
            or angle_between(after.T_ref_in_cam, fit.T) < _SAME_POSE
            or not faces_camera(after.T_ref_in_cam)
        ):
            continue
        rival = PoseFit(after, fit.agreeing, 0)
        if not clearly_better(fit, rival) and not _told_apart(fit, rival, beside):
            return rival
    return None


def _told_apart(fit: PoseFit, rival: PoseFit, beside: Sequence[Array]) -> bool:
    """Whether other boards say so too that a fit is likelier than its rival."""
    near = _TOLD * angle_between(fit.T, rival.T)
    return bool(beside) and fit.mean_square < rival.mean_square and all(angle_between(fit.T, T) < near for T in beside)


def clearly_better(fit: PoseFit, rival: PoseFit) -> bool:
    """Whether the photo is so much likelier under one pose than under another that the other cannot be."""
    evidence = 0.5 * fit.alignment.pixels / _CORRELATED * math.log(rival.mean_square / fit.mean_square)
    return evidence >= _MIN_EVIDENCE


def angle_between(T_a: Array, T_b: Array) -> float:
    """The angle in radians between two poses' orientations."""
    return float(np.linalg.norm(rotation_vector(T_a[:3, :3].T @ T_b[:3, :3])))
