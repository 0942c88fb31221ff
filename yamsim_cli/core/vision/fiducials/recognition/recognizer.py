"""Boards that are seen but cannot be read: recognized as a whole, by all the bits of their print at once.

Where a board may be is told by dark or restless patches of the photo (`suspects`), by another board beside it, and by a
photo that was taken just before. Each such place is fitted to the whole print, like a pose that markers give. It counts
only if the bits that the photo then shows agree with the board's by far more than chance would have it (`bits`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from ....geometry.board import Board
from ....geometry.camera import CameraModel
from ....geometry.se3 import Array, pose
from ...lens import project_points, rays
from ..advice import advice_on, advice_on_photo, looks_of
from ..fitting.align import USUAL_SMEAR, Alignment, align
from ..fitting.fits import EXPLAINED, PoseFit, faces_camera
from ..fitting.print_view import Piece, draw_print, plane_of, view_print
from ..fitting.smear import Smear
from ..judge import Limits, judge
from ..sighting import Sighting, Status
from .bits import Evidence, evidence
from .lattice import board_quads
from .motion import likely_smear
from .quads import dark_quads, restless_quads
from .suspects import Suspect, moved_suspects, suspects

Grey = NDArray[np.uint8]

# How often a photo without the board may have it recognized in it.
FALSE_ALARMS = 1e-4
# So many places and ways up are looked at, about, for each board. Source: photos of strangers (`make bench-fiducials`),
# where there were 20 to 60 patches and their turns, and some 250 moves of each of those that are moved.
_PLACES = 1200
# A fit tries so many poses that differ enough for the bits to be tossed anew.
_LOOKS_A_FIT = 30
# The natural logarithm of chance below which what is seen is probably the board.
_LIKE_A_BOARD = -8.0
# Motions whose lengths (px) differ by less are one.
_SAME_MOTION = 3.0
# The same below which a fit that does not agree well is tried again.
_WORTH_ANOTHER = -3.0
# So many patches, at most, are fitted; none that agrees less than this share of the best one.
_MOST_FITS, _WORTH_A_FIT = 2, 0.6
# A place known from elsewhere is looked for this far around, in shares of the board's size in the picture.
_AROUND = 0.5
# A fit whose markers correlate more than this with the photo (the median) needs no other pose.
_WELL_ENOUGH = 0.85
# Patches whose middles are farther apart than this share of their size are two.
_APART = 0.5


class Recognizer:
    """Looks for boards in one photo (height, width), given as bytes and as floats; `boards` of them in all."""

    def __init__(
        self, grey: Grey, photo: NDArray[np.float32], camera: CameraModel, boards: int, limits: Limits
    ) -> None:
        self._limits = limits
        self._grey, self._photo, self._camera, self._boards = grey, photo, camera, boards
        self._likeliest: tuple[float, Alignment] | None = None

    @cached_property
    def _whole(self) -> list[Array]:
        """Patches that may be whole prints."""
        return dark_quads(self._grey, whole=True)

    @cached_property
    def _markers(self) -> list[Array]:
        """Patches that may be markers."""
        return dark_quads(self._grey, whole=False)

    @cached_property
    def _restless(self) -> list[Array]:
        """Patches full of edges."""
        return restless_quads(self._grey)

    def sighting(
        self, seen: Sighting, beside: Sequence[Array], before: Sequence[Array] = (), anywhere: bool = False
    ) -> Sighting:
        """A board that could not be read (well enough), recognized; or as it was seen.

        Args:
            beside: about its pose (4, 4) in the camera's frame as each other board says.
            before: its pose in a photo before, if there is one.
            anywhere: look for it in the whole photo too.
        """
        board, fits = seen.board, list[PoseFit]()
        self._likeliest = None
        for T in (*before, *beside):
            if (T_moved := self._shifted(board, T)) is not None:
                fits += self._fits(board, [T_moved])
        if not fits and anywhere:
            for suspect in _worth_a_fit(suspects(self._grey, board, self._whole)):
                fits += self._fits(board, self._starts(board, suspect))
        if not fits and anywhere:
            grids = board_quads(self._markers, board)
            for suspect in _worth_a_fit(suspects(self._grey, board, grids)):
                fits += self._fits(board, self._starts(board, suspect))
        if not fits and anywhere:
            for suspect in _worth_a_fit(moved_suspects(self._grey, board, self._restless)):
                fits += self._fits(board, self._starts(board, suspect))
        if not fits:
            return replace(seen, advice=self._advice(board)) if anywhere else seen
        best = min(fits, key=lambda fit: fit.mean_square)
        size = board.width * self._camera.focal / best.T[2, 3]
        if any(self._apart(fit, best) > _APART * size for fit in fits):
            reason = "it is in the photo twice: hide or remove the other print"
            return Sighting(board, seen.markers, Status.AMBIGUOUS, reason, twice=True)
        return judge(self._photo, self._camera, board, best, fits, beside, self._limits)

    def _advice(self, board: Board) -> tuple[str, ...]:
        """What would help a board that is not recognized, by what looks most like it."""
        if self._likeliest is not None and self._likeliest[0] < _LIKE_A_BOARD:
            found = advice_on(looks_of(board, self._camera, self._photo, self._likeliest[1]))
            if found:
                return found
        return advice_on_photo(self._grey)

    def _apart(self, one: PoseFit, other: PoseFit) -> float:
        at = project_points(self._camera, np.array([one.T[:3, 3], other.T[:3, 3]]))
        return float(np.linalg.norm(at[0] - at[1]))

    def _starts(self, board: Board, suspect: Suspect) -> list[Array]:
        """The poses (4, 4) that a patch's corners allow, the likelier one first."""
        count, turns, shifts, _ = cv2.solvePnPGeneric(
            board.outer_corners(), rays(self._camera, suspect.corners), np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
        )
        poses = [pose(shifts[k].ravel(), cv2.Rodrigues(turns[k])[0]) for k in range(count)]
        return [T for T in poses if np.isfinite(T).all() and faces_camera(T)]

    def _fits(self, board: Board, poses: Sequence[Array]) -> list[PoseFit]:
        """The poses, fitted to the print, that its bits speak for."""
        found = list[PoseFit]()
        for T in poses:
            if fit := self._fit(board, T):
                found.append(fit)
                # The other pose could at most be this one's rival, which `judge` looks for.
                if fit.contradicting == 0 and _explained(fit.alignment, _WELL_ENOUGH):
                    break
        return found

    def _fit(self, board: Board, T: Array) -> PoseFit | None:
        everything = Piece(board, np.eye(4), tuple(range(len(board.ids))))
        found = self._recognized(everything, T)
        if found is not None and not _explained(found[0]) and found[1].log_chance < _WORTH_ANOTHER:
            # From nearer by, the smear is told better.
            again = self._recognized(everything, found[0].T_ref_in_cam, found[0].smear)
            if again is not None and again[1].log_chance < found[1].log_chance:
                found = again
        if found is None:
            return None
        first, bits = found
        if self._likeliest is None or bits.log_chance < self._likeliest[0]:
            self._likeliest = bits.log_chance, first
        if bits.log_chance > self._most_chance():
            return None
        if len(bits.markers) < len(first.tiles[0]):
            piece = Piece(board, np.eye(4), bits.markers)
            fewer = align(self._photo, self._camera, [piece], first.T_ref_in_cam, first.smear)
            if fewer is None or not faces_camera(fewer.T_ref_in_cam):
                return None
            first = fewer
        return PoseFit(first, bits.markers, len(bits.agreement) - len(bits.markers))

    def _recognized(self, piece: Piece, T: Array, tried: Smear | None = None) -> tuple[Alignment, Evidence] | None:
        """A piece, aligned from a pose and whatever smear is likely there, and what its bits say.

        Args:
            tried: the smear that led there; None comes back where it is likely still.
        """
        plane = plane_of(piece, T)
        view = view_print(self._photo, self._camera, piece, plane)
        smear = None if view is None else likely_smear(view, plane)
        if smear is not None and tried is not None and abs(smear.length - tried.length) < _SAME_MOTION:
            return None
        fit = None if smear is None else align(self._photo, self._camera, [piece], T, smear)
        if fit is None or not faces_camera(fit.T_ref_in_cam):
            return None
        plane = plane_of(piece, fit.T_ref_in_cam)
        view = view_print(self._photo, self._camera, piece, plane)
        return None if view is None else (fit, evidence(view, plane, fit.smear, fit.noise))

    def _most_chance(self) -> float:
        """The natural logarithm of the chance that is left to one fit: all places of the photo are counted."""
        looks = self._boards * _PLACES * _LOOKS_A_FIT
        return math.log(FALSE_ALARMS / looks)

    def _shifted(self, board: Board, T: Array) -> Array | None:
        """A pose, moved along the picture to where the print agrees best around."""
        piece = Piece(board, np.eye(4), tuple(range(len(board.ids))))
        if not faces_camera(T):
            return None
        corners = project_points(self._camera, board.outer_corners() @ T[:3, :3].T + T[:3, 3])
        middle = project_points(self._camera, T[None, :3, 3])[0]
        half = np.abs(corners - middle).max(axis=0)
        height, width = self._grey.shape
        reach = np.ceil(half + _AROUND * 2 * half.max()).astype(int)
        low = np.maximum(np.round(middle).astype(int) - reach, 0)
        high = np.minimum(np.round(middle).astype(int) + reach + 1, (width, height))
        drawn = view_print(self._photo, self._camera, piece, plane_of(piece, T))
        if drawn is None or (high - low < 2 * half).any() or drawn.coarser > 1:
            return T
        drawing = draw_print(drawn, plane_of(piece, T), USUAL_SMEAR)
        seen = self._photo[low[1] : high[1], low[0] : high[0]]
        shape = drawing.grey.shape
        if shape[0] > seen.shape[0] or shape[1] > seen.shape[1]:
            return T
        mask = (drawing.marker >= 0).reshape(shape).astype(np.float32)
        score = cv2.matchTemplate(seen, drawing.grey, cv2.TM_CCOEFF_NORMED, mask=mask)
        score = np.where(np.isfinite(score), score, -1.0)
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        from_view = self._first_pixel(drawn.centre_rays)
        by = np.array([column + low[0], row + low[1]]) - from_view
        moved = T.copy()
        seen_at, wanted = rays(self._camera, [middle, middle + by])
        moved[:2, 3] += T[2, 3] * (wanted - seen_at)
        return moved

    def _first_pixel(self, centre_rays: Array) -> Array:
        """The pixel (2,) of a view's first viewing ray."""
        first: Array = project_points(self._camera, np.append(centre_rays[0], 1.0)[None])[0]
        return first


def _worth_a_fit(found: Sequence[Suspect]) -> Iterator[Suspect]:
    """The likeliest patches, each place once."""
    taken = list[Suspect]()
    for one in found:
        if one.agreement < _WORTH_A_FIT * found[0].agreement or len(taken) == _MOST_FITS:
            return
        size = float(np.abs(np.ptp(one.corners, axis=0)).max())
        if all(np.abs(one.corners - other.corners).max() > _APART * size for other in taken):
            taken.append(one)
            yield one


def _explained(fit: Alignment, least: float = EXPLAINED) -> bool:
    """Whether drawing and photo agree nearly everywhere."""
    return float(np.median([tile.correlation for tile in fit.tiles[0].values()])) > least
