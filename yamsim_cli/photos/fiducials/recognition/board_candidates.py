"""Find patches of a photo that may be a board with unreadable markers, the likeliest first.

- A distant or blurred print is a patch darker than its paper. Several thresholds suit every light. Thin light lines,
such as gaps between markers, are closed first.
- On a dark background, or if partly hidden, each dark patch may be a marker. Its edges predict its neighbours. The grid
may be any part of the board with the same numbers of rows and columns.
- On a background as bright as the print's average, as in steep views, a print is full of edges.

The corners rectify a patch, whose bits are compared with the board's in four orientations.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.board_image import marker_cells

from .marker_bits import marker_bits

Grey = NDArray[np.uint8]

_WHOLE_PRINT_SEARCH_SCALES = ((1, 3), (2, 3), (2, 7))  # reduction, and width of light lines to close, reduced px
_MARKER_SCALES = ((1, 0),)  # the same for single markers: no change
_MAX_PHOTO_SIDE = 960  # px, longer side of the searched photo
_DARK_THRESHOLDS = np.linspace(0.12, 0.84, 9)  # share of the grey range, below which a pixel is dark
_RANGE_PERCENTILES = (0.5, 99.5)  # percentiles that define a photo's range of grey levels
# Difference within 3 px at an edge, share of the grey range; width of gaps between edges to close, px.
_EDGE_THRESHOLDS = ((0.14, 3), (0.18, 3), (0.22, 3), (0.27, 3), (0.34, 3), (0.42, 5))
_MIN_THICKNESS = 5  # px, of a patch full of edges; a single edge is thinner
_MIN_PATCH_AREA_PX = 30  # px^2
_MIN_CONTOUR = 20  # px
_MAX_PATCH_SHARE = 0.8  # ratio of a patch's sides to the photo's
_MIN_HULL_SHARE = 0.78  # ratio of a patch's area to its convex hull's
_MAX_QUAD_RATIO = 1.3  # ratio of the quadrilateral's area to the hull's
_DUPLICATE_DISTANCE = 0.04  # patch sizes, distance of all corners of duplicates

_MAX_NEIGHBOUR_OFFSET = 0.3  # grid steps, from a neighbour's predicted centre
_MAX_AREA_RATIO = 1.6  # of neighbouring markers
_MIN_MARKERS = 3  # fewer do not determine a grid's perspective
_MAX_CORNER_RMS = 0.12  # marker edges, of corners from the grid

_POINTS_PER_CELL = 2  # sample points of a marker cell along each axis
_MIN_AGREEMENT = 2.5  # standard deviations of random bits
# Step, px, and agreement after it, standard deviations of random bits. Source: photos from a physically based renderer:
# without a board, patches reached 4.3 at the end, and boards 7.
_REFINEMENT_STEPS = ((3.0, 3.5), (1.5, 4.5), (0.75, 5.0))
_MAX_REFINED_PATCHES = 4
_MIN_REFINED_AGREEMENT = 1.5  # standard deviations of random bits, to refine a patch
_ROUNDS_PER_STEP = 3


def dark_quads(grey: Grey, whole: bool) -> list[Array]:
    """Return the corners (4, 2), px, clockwise, of distinct dark patches in a photo (height, width).

    Args:
        whole: search whole prints, with light gaps closed, instead of single markers.
    """
    grey, factor = _limit_resolution(_MAX_PHOTO_SIDE, grey)
    low, high = np.percentile(grey[::4, ::4], _RANGE_PERCENTILES)
    found: list[Array] = []
    for smaller, close in _WHOLE_PRINT_SEARCH_SCALES if whole else _MARKER_SCALES:
        reduced = grey
        if smaller > 1:
            reduced = np.asarray(
                cv2.resize(grey, None, fx=1 / smaller, fy=1 / smaller, interpolation=cv2.INTER_AREA), dtype=np.uint8
            )
        if close:
            reduced = np.asarray(
                cv2.morphologyEx(reduced, cv2.MORPH_OPEN, np.ones((close, close), np.uint8)), dtype=np.uint8
            )
        for level in low + _DARK_THRESHOLDS * (high - low):
            for quad in _enclosed_quads(reduced < level):
                found.append(((quad + 0.5) * smaller * factor) - 0.5)
    return _distinct_quads(found)


def edge_quads(grey: Grey) -> list[Array]:
    """Return the corners (4, 2), px, clockwise, of patches full of edges in a photo (height, width)."""
    grey, factor = _limit_resolution(_MAX_PHOTO_SIDE, grey)
    low, high = np.percentile(grey[::4, ::4], _RANGE_PERCENTILES)
    near, thick = np.ones((3, 3), np.uint8), np.ones((_MIN_THICKNESS, _MIN_THICKNESS), np.uint8)
    difference = cv2.morphologyEx(grey, cv2.MORPH_GRADIENT, near)
    found: list[Array] = []
    for level, apart in _EDGE_THRESHOLDS:
        edges = (difference > level * (high - low)).astype(np.uint8)
        # The gradient widens an edge by a pixel on either side; erosion removes that.
        full = cv2.erode(cv2.morphologyEx(edges, cv2.MORPH_CLOSE, np.ones((apart, apart), np.uint8)), near)
        for quad in _enclosed_quads(cv2.morphologyEx(full, cv2.MORPH_OPEN, thick) > 0):
            found.append((quad + 0.5) * factor - 0.5)
    return _distinct_quads(found)


def _limit_resolution(max_side: int, grey: Grey) -> tuple[Grey, float]:
    factor = max(1.0, max(grey.shape) / max_side)
    if factor > 1:
        size = tuple(round(side / factor) for side in grey.shape[::-1])
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return grey, factor


def _enclosed_quads(dark: NDArray[np.bool_]) -> Iterator[Array]:
    contours, nested = cv2.findContours(dark.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    most = _MAX_PATCH_SHARE * np.array(dark.shape[::-1])
    for k, contour in enumerate(contours):
        if len(contour) < _MIN_CONTOUR or nested[0, k, 3] >= 0:
            continue
        if (np.ptp(contour[:, 0], axis=0) > most).any():
            continue
        hull = cv2.convexHull(contour)
        area = cv2.contourArea(hull)
        if len(hull) < 4 or area < _MIN_PATCH_AREA_PX or cv2.contourArea(contour) < _MIN_HULL_SHARE * area:
            continue
        quad = np.asarray(cv2.approxPolyN(hull, 4), dtype=np.float32).reshape(-1, 2)
        if len(quad) == 4 and cv2.contourArea(quad) < _MAX_QUAD_RATIO * area:
            yield quad.astype(np.float64)


def _distinct_quads(quads: list[Array]) -> list[Array]:
    kept: list[Array] = []
    for quad in quads:
        signed = cv2.contourArea(quad.astype(np.float32), oriented=True)
        quad = quad if signed > 0 else quad[::-1]
        quad = np.roll(quad, -int(np.argmin(quad.sum(axis=1))), axis=0)
        size = np.sqrt(abs(signed))
        if all(np.abs(quad - other).max() > _DUPLICATE_DISTANCE * size for other in kept):
            kept.append(quad)
    return kept


MarkerGrid = dict[tuple[int, int], int]  # (column, row) of a marker -> index of its patch


def board_quads(markers: Sequence[Array], board: Board) -> list[Array]:
    """Return the outer corners (4, 2), px, of boards whose markers the patches (4, 2), px, may be."""
    if len(markers) < _MIN_MARKERS:
        return []
    quads = np.array(markers)
    step = (board.marker_length + board.gap) / board.marker_length
    found = []
    taken = np.zeros(len(quads), dtype=bool)
    areas = np.abs([cv2.contourArea(quad.astype(np.float32)) for quad in quads])
    # Large patches have more accurate corners.
    for seed in np.argsort(-areas):
        if taken[seed]:
            continue
        grid = _grow_grid(int(seed), quads, areas, step)
        if len(grid) < _MIN_MARKERS:
            continue
        taken[list(grid.values())] = True
        found += list(_board_corners(grid, quads, board))
    return found


def _grow_grid(seed: int, quads: Array, areas: Array, step: float) -> MarkerGrid:
    middles = quads.mean(axis=1)
    grid, ends, used = {(0, 0): seed}, [(0, 0)], {seed}
    right = (quads[seed, 1] - quads[seed, 0] + quads[seed, 2] - quads[seed, 3]) / 2 * step
    down = (quads[seed, 3] - quads[seed, 0] + quads[seed, 2] - quads[seed, 1]) / 2 * step
    reach = _MAX_NEIGHBOUR_OFFSET * min(float(np.linalg.norm(right)), float(np.linalg.norm(down)))
    while ends:
        column, row = ends.pop()
        at = grid[column, row]
        for over, below in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            place = (column + over, row + below)
            if place in grid:
                continue
            off = np.linalg.norm(middles - (middles[at] + over * right + below * down), axis=1)
            ratio = areas / areas[at]
            off[(ratio > _MAX_AREA_RATIO) | (ratio < 1 / _MAX_AREA_RATIO)] = np.inf
            best = int(np.argmin(off))
            if off[best] < reach and best not in used:
                grid[place] = best
                used.add(best)
                ends.append(place)
    return grid


def _board_corners(grid: MarkerGrid, quads: Array, board: Board) -> Iterator[Array]:
    places = np.array(list(grid))
    low, high = places.min(axis=0), places.max(axis=0)
    size = high - low + 1
    if (size > (board.columns, board.rows)).any():
        return
    step = board.marker_length + board.gap
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * board.marker_length
    on_board = np.concatenate([(place - low) * step + unit for place in places])
    corners = _align_corner_order(quads[list(grid.values())], quads[grid[0, 0]])
    flat: Any = cv2.findHomography(on_board, corners.reshape(-1, 2))[0]
    # OpenCV returns None for collinear corners.
    if flat is None:
        return
    seen = _apply_homography(flat, on_board)
    edge = float(np.sqrt(np.median([cv2.contourArea(quad.astype(np.float32)) for quad in corners])))
    if float(np.sqrt(((seen - corners.reshape(-1, 2)) ** 2).sum(axis=1).mean())) > _MAX_CORNER_RMS * edge:
        return
    whole = np.array([[0, 0], [board.width, 0], [board.width, board.height], [0, board.height]])
    for column in range(board.columns - size[0] + 1):
        for row in range(board.rows - size[1] + 1):
            outer = _apply_homography(flat, whole - (column * step, row * step))
            if np.isfinite(outer).all() and cv2.isContourConvex(outer.astype(np.float32)):
                yield outer


def _align_corner_order(quads: Array, first: Array) -> Array:
    wanted = first - first.mean(axis=0)
    turned = np.stack([np.roll(quads, turn, axis=1) for turn in range(4)])
    own = turned - turned.mean(axis=2, keepdims=True)
    best = ((own - wanted) ** 2).sum(axis=(2, 3)).argmin(axis=0)
    alike: Array = turned[best, np.arange(len(quads))]
    return alike


def _apply_homography(flat: NDArray[np.float64], points: Array) -> Array:
    at = np.column_stack([points, np.ones(len(points))]) @ flat.T
    mapped: Array = at[:, :2] / at[:, 2:]
    return mapped


@dataclass(frozen=True)
class BoardCandidate:
    """A patch that may be a board.

    Attributes:
        corners: outer corners (4, 2), px, clockwise from the board's top left.
        agreement: correlation of its bits with the board's, standard deviations of random bits.
    """

    corners: Array
    agreement: float


def oriented_candidates(
    grey: Grey, board: Board, quads: Sequence[Array], minimum: float = _MIN_AGREEMENT
) -> list[BoardCandidate]:
    """Return oriented patches that agree with a board by `minimum`, best first."""
    turned = [np.roll(quad, turn, axis=0) for quad in quads for turn in range(4)]
    found = [BoardCandidate(corners, _bit_agreement(grey, board, corners)) for corners in turned]
    return sorted((one for one in found if one.agreement > minimum), key=lambda one: -one.agreement)


def refine_candidates(grey: Grey, board: Board, quads: Sequence[Array]) -> list[BoardCandidate]:
    """Return patches with corners moved to the best agreement, best first."""
    rough = oriented_candidates(grey, board, quads, _MIN_REFINED_AGREEMENT)[:_MAX_REFINED_PATCHES]
    found = [moved for candidate in rough if (moved := _refine_quad(grey, board, candidate)) is not None]
    return sorted(found, key=lambda one: -one.agreement)


def _refine_quad(grey: Grey, board: Board, candidate: BoardCandidate) -> BoardCandidate | None:
    """Move corners and edges while agreement grows; None if it stays too low."""
    for step, least in _REFINEMENT_STEPS:
        for _ in range(_ROUNDS_PER_STEP):
            before = candidate.agreement
            for move in step * _corner_trial_shifts():
                corners = candidate.corners + move
                if (agreement := _bit_agreement(grey, board, corners)) > candidate.agreement:
                    candidate = BoardCandidate(corners, agreement)
            if candidate.agreement == before:
                break
        if candidate.agreement < least:
            return None
    return candidate


@functools.lru_cache(maxsize=1)
def _corner_trial_shifts() -> Array:
    moves = []
    for corner in range(4):
        for along in np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]):
            for places in ([corner], [corner, (corner + 1) % 4]):
                move = np.zeros((4, 2))
                move[places] = along
                moves.append(move)
    return np.array(moves)


_UNIT_SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)


def _bit_agreement(grey: Grey, board: Board, corners: Array) -> float:
    """Return the correlation of bits, with equal weight per marker."""
    at, size = _bit_points(board)
    flat = cv2.getPerspectiveTransform(_UNIT_SQUARE, corners.astype(np.float32))
    seen = np.asarray(cv2.perspectiveTransform(at[None], flat), dtype=np.float32)
    values = cv2.remap(grey, seen[..., 0], seen[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    patch = values.reshape(size).astype(np.float32).mean(axis=2)
    patch -= patch.mean(axis=1, keepdims=True)
    agree = (patch * _board_bits(board)).sum(axis=1) / np.maximum(np.linalg.norm(patch, axis=1), 1e-6)
    return float(agree.sum() / np.sqrt(len(agree)))


@functools.lru_cache(maxsize=32)
def _board_bits(board: Board) -> Array:
    return marker_bits(board)


@functools.lru_cache(maxsize=32)
def _bit_points(board: Board) -> tuple[NDArray[np.float32], tuple[int, int, int]]:
    """Return sample points (n, 2) of all bits, shares of the board's sides, and their shape (marker, bit, point)."""
    side = marker_cells(board).shape[1]
    cell, step = board.marker_length / side, board.marker_length + board.gap
    inner = (np.arange(side - 2)[:, None] + 1 + (np.arange(_POINTS_PER_CELL) + 0.5) / _POINTS_PER_CELL) * cell
    points = []
    for k in range(len(board.marker_ids)):
        row, column = divmod(k, board.columns)
        x, y = column * step + inner, row * step + inner
        grid = np.stack(np.broadcast_arrays(x[None, :, None, :], y[:, None, :, None]), axis=-1)
        points.append(grid.reshape(-1, 2) / (board.width, board.height))
    at = np.concatenate(points).astype(np.float32)
    return at, (len(board.marker_ids), (side - 2) ** 2, _POINTS_PER_CELL**2)
