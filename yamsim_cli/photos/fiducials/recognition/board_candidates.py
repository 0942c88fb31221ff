"""Patches of a photo that may be a board whose markers cannot be read, the likeliest first.

Three kinds of patches are found:

- Seen from afar or blurred, a print is a patch darker than the paper around. The photo is cut at several grey levels,
  since no level suits every light, and each dark patch that four straight edges enclose well is taken. Thin light
  lines, such as the gaps between markers, are closed first.
- On ground as dark as the print, or where the print is hidden in part, each dark patch may be a marker. Its neighbours
  lie where its own edges say, a marker and a gap away, and patches found there make a grid. The grid may be any part of
  the board that has as many rows and columns.
- On ground as bright as the print is on average, as in steep views, a print is a patch full of edges.

A patch is rectified by its four corners. Its bits, read in each of four turns, are compared with the board's.
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

_LOOKS = ((1, 3), (2, 3), (2, 7))  # reductions of the photo for whole prints, and the light lines to close, px there
_MARKER_LOOKS = ((1, 0),)  # the same for single markers
_LARGEST = 960  # px, longer side to which larger photos are reduced
_LEVELS = np.linspace(0.12, 0.84, 9)  # of the photo's range, grey levels at which it is cut
_ENDS = (0.5, 99.5)  # percentiles of the photo's range
# Least differences within 3 px at an edge, of the photo's range, and largest distances of edges in one patch, px.
_EDGES = ((0.14, 3), (0.18, 3), (0.22, 3), (0.27, 3), (0.34, 3), (0.42, 5))
_THICK = 5  # px, least thickness of a patch full of edges: a single edge is thinner
_LEAST_AREA = 30  # px^2, of a patch
_LEAST_CONTOUR = 20  # px, length of a patch's contour
_LARGEST_SHARE = 0.8  # of the photo's sides, largest patch
_FILLED = 0.78  # of its convex hull, least area of a patch
_LOOSE = 1.3  # largest area within the four edges, over that of the hull
_SAME = 0.04  # of a patch's size, distance of all corners below which two patches are the same

# Grids of markers.
_NEAR = 0.3  # of a step, largest distance of a neighbour's centre from its expected place
_ALIKE = 1.6  # largest ratio of neighbours' areas
_LEAST_MARKERS = 3  # fewest markers of a grid: fewer do not determine its perspective
_TOLERANCE = 0.12  # of a marker's edge, largest rms distance of corners from the grid's

# Bits of patches.
_POINTS = 2  # points along a marker's cell at which a patch is read
_LEAST_AGREEMENT = 2.5  # standard deviations of chance, least agreement of a candidate's bits
# Patches with rough corners are moved to where their bits agree best: steps, px, and the agreement needed after each,
# standard deviations. Source: photos by a physically based renderer: other patches reached 4.3 at the end, boards 7.
_STEPS = ((3.0, 3.5), (1.5, 4.5), (0.75, 5.0))
_MOST_MOVED = 4  # patches that are moved
_LEAST_TO_MOVE = 1.5  # standard deviations of chance, least agreement of a patch that is moved
_ROUNDS = 3  # moves of all corners and edges with each step


def dark_quads(grey: Grey, whole: bool) -> list[Array]:
    """Corners (4, 2) in pixels, clockwise in the picture, of patches in a photo (height, width); each patch once.

    Args:
        whole: with light lines closed, for whole prints; otherwise as they are, for markers.
    """
    grey, factor = _at_most(_LARGEST, grey)
    low, high = np.percentile(grey[::4, ::4], _ENDS)
    found: list[Array] = []
    for smaller, close in _LOOKS if whole else _MARKER_LOOKS:
        look = grey
        if smaller > 1:
            look = np.asarray(
                cv2.resize(grey, None, fx=1 / smaller, fy=1 / smaller, interpolation=cv2.INTER_AREA), dtype=np.uint8
            )
        if close:
            look = np.asarray(cv2.morphologyEx(look, cv2.MORPH_OPEN, np.ones((close, close), np.uint8)), dtype=np.uint8)
        for level in low + _LEVELS * (high - low):
            for quad in _enclosed_quads(look < level):
                found.append(((quad + 0.5) * smaller * factor) - 0.5)
    return _distinct_quads(found)


def edge_quads(grey: Grey) -> list[Array]:
    """Corners (4, 2) in pixels, clockwise in the picture, of patches full of edges in a photo (height, width)."""
    grey, factor = _at_most(_LARGEST, grey)
    low, high = np.percentile(grey[::4, ::4], _ENDS)
    near, thick = np.ones((3, 3), np.uint8), np.ones((_THICK, _THICK), np.uint8)
    difference = cv2.morphologyEx(grey, cv2.MORPH_GRADIENT, near)
    found: list[Array] = []
    for level, apart in _EDGES:
        edges = (difference > level * (high - low)).astype(np.uint8)
        # An edge counts a pixel to either side of it.
        full = cv2.erode(cv2.morphologyEx(edges, cv2.MORPH_CLOSE, np.ones((apart, apart), np.uint8)), near)
        for quad in _enclosed_quads(cv2.morphologyEx(full, cv2.MORPH_OPEN, thick) > 0):
            found.append((quad + 0.5) * factor - 0.5)
    return _distinct_quads(found)


def _at_most(longest: int, grey: Grey) -> tuple[Grey, float]:
    """The photo with a longer side of at most `longest` px, and the factor of reduction."""
    factor = max(1.0, max(grey.shape) / longest)
    if factor > 1:
        size = tuple(round(side / factor) for side in grey.shape[::-1])
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return grey, factor


def _enclosed_quads(dark: NDArray[np.bool_]) -> Iterator[Array]:
    """The four corners (4, 2) of each patch that four edges enclose well."""
    contours, nested = cv2.findContours(dark.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    most = _LARGEST_SHARE * np.array(dark.shape[::-1])
    for k, contour in enumerate(contours):
        if len(contour) < _LEAST_CONTOUR or nested[0, k, 3] >= 0:
            continue
        if (np.ptp(contour[:, 0], axis=0) > most).any():
            continue
        hull = cv2.convexHull(contour)
        area = cv2.contourArea(hull)
        if len(hull) < 4 or area < _LEAST_AREA or cv2.contourArea(contour) < _FILLED * area:
            continue
        quad = np.asarray(cv2.approxPolyN(hull, 4), dtype=np.float32).reshape(-1, 2)
        if len(quad) == 4 and cv2.contourArea(quad) < _LOOSE * area:
            yield quad.astype(np.float64)


def _distinct_quads(quads: list[Array]) -> list[Array]:
    """Each patch once, with its corners clockwise from the one nearest the top left."""
    kept: list[Array] = []
    for quad in quads:
        signed = cv2.contourArea(quad.astype(np.float32), oriented=True)
        quad = quad if signed > 0 else quad[::-1]
        quad = np.roll(quad, -int(np.argmin(quad.sum(axis=1))), axis=0)
        size = np.sqrt(abs(signed))
        if all(np.abs(quad - other).max() > _SAME * size for other in kept):
            kept.append(quad)
    return kept


Grid = dict[tuple[int, int], int]


def board_quads(markers: Sequence[Array], board: Board) -> list[Array]:
    """Outer corners (4, 2) of boards, px, that patches (4, 2) with corners clockwise may be markers of."""
    if len(markers) < _LEAST_MARKERS:
        return []
    quads = np.array(markers)
    step = (board.marker_length + board.gap) / board.marker_length
    found = []
    taken = np.zeros(len(quads), dtype=bool)
    areas = np.abs([cv2.contourArea(quad.astype(np.float32)) for quad in quads])
    # Larger patches are more exact.
    for seed in np.argsort(-areas):
        if taken[seed]:
            continue
        grid = _grow_grid(int(seed), quads, areas, step)
        if len(grid) < _LEAST_MARKERS:
            continue
        taken[list(grid.values())] = True
        found += list(_board_corners(grid, quads, board))
    return found


def _grow_grid(seed: int, quads: Array, areas: Array, step: float) -> Grid:
    """The grid of patches around a seed, by column and row from the seed's."""
    middles = quads.mean(axis=1)
    grid, ends, used = {(0, 0): seed}, [(0, 0)], {seed}
    right = (quads[seed, 1] - quads[seed, 0] + quads[seed, 2] - quads[seed, 3]) / 2 * step
    down = (quads[seed, 3] - quads[seed, 0] + quads[seed, 2] - quads[seed, 1]) / 2 * step
    reach = _NEAR * min(float(np.linalg.norm(right)), float(np.linalg.norm(down)))
    while ends:
        column, row = ends.pop()
        at = grid[column, row]
        for over, below in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            place = (column + over, row + below)
            if place in grid:
                continue
            off = np.linalg.norm(middles - (middles[at] + over * right + below * down), axis=1)
            ratio = areas / areas[at]
            off[(ratio > _ALIKE) | (ratio < 1 / _ALIKE)] = np.inf
            best = int(np.argmin(off))
            if off[best] < reach and best not in used:
                grid[place] = best
                used.add(best)
                ends.append(place)
    return grid


def _board_corners(grid: Grid, quads: Array, board: Board) -> Iterator[Array]:
    """The board's corners for each part of the board that a grid may be."""
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
    # OpenCV returns None where corners lie in one line.
    if flat is None:
        return
    seen = _mapped(flat, on_board)
    edge = float(np.sqrt(np.median([cv2.contourArea(quad.astype(np.float32)) for quad in corners])))
    if float(np.sqrt(((seen - corners.reshape(-1, 2)) ** 2).sum(axis=1).mean())) > _TOLERANCE * edge:
        return
    whole = np.array([[0, 0], [board.width, 0], [board.width, board.height], [0, board.height]])
    for column in range(board.columns - size[0] + 1):
        for row in range(board.rows - size[1] + 1):
            outer = _mapped(flat, whole - (column * step, row * step))
            if np.isfinite(outer).all() and cv2.isContourConvex(outer.astype(np.float32)):
                yield outer


def _align_corner_order(quads: Array, first: Array) -> Array:
    """Patches (n, 4, 2) with their corners in the order of the first one's (4, 2)."""
    wanted = first - first.mean(axis=0)
    turned = np.stack([np.roll(quads, turn, axis=1) for turn in range(4)])
    own = turned - turned.mean(axis=2, keepdims=True)
    best = ((own - wanted) ** 2).sum(axis=(2, 3)).argmin(axis=0)
    alike: Array = turned[best, np.arange(len(quads))]
    return alike


def _mapped(flat: NDArray[np.float64], points: Array) -> Array:
    at = np.column_stack([points, np.ones(len(points))]) @ flat.T
    mapped: Array = at[:, :2] / at[:, 2:]
    return mapped


@dataclass(frozen=True)
class BoardCandidate:
    """A patch that may be a board.

    Attributes:
        corners: outer corners (4, 2) in pixels, clockwise from the board's top left.
        agreement: of the patch's bits with the board's, in standard deviations of chance.
    """

    corners: Array
    agreement: float


def candidates(
    grey: Grey, board: Board, quads: Sequence[Array], minimum: float = _LEAST_AGREEMENT
) -> list[BoardCandidate]:
    """Patches of a photo (height, width) that may be a board, the likeliest first."""
    # A board may lie any of four ways up.
    turned = [np.roll(quad, turn, axis=0) for quad in quads for turn in range(4)]
    found = [BoardCandidate(corners, _agreement(grey, board, corners)) for corners in turned]
    return sorted((one for one in found if one.agreement > minimum), key=lambda one: -one.agreement)


def refine_candidates(grey: Grey, board: Board, quads: Sequence[Array]) -> list[BoardCandidate]:
    """As `candidates`, for patches with rough corners: each is moved to where its bits agree best."""
    rough = candidates(grey, board, quads, _LEAST_TO_MOVE)[:_MOST_MOVED]
    found = [moved for candidate in rough if (moved := _refine_quad(grey, board, candidate)) is not None]
    return sorted(found, key=lambda one: -one.agreement)


def _refine_quad(grey: Grey, board: Board, candidate: BoardCandidate) -> BoardCandidate | None:
    """The patch, its corners and edges moved one after the other while its bits agree better.

    None if the bits do not agree well in the end.
    """
    for step, least in _STEPS:
        for _ in range(_ROUNDS):
            before = candidate.agreement
            for move in step * _corner_moves():
                corners = candidate.corners + move
                if (agreement := _agreement(grey, board, corners)) > candidate.agreement:
                    candidate = BoardCandidate(corners, agreement)
            if candidate.agreement == before:
                break
        if candidate.agreement < least:
            return None
    return candidate


@functools.lru_cache(maxsize=1)
def _corner_moves() -> Array:
    """Moves (n, 4, 2) of each corner and of each edge by 1 px in each of four directions."""
    moves = []
    for corner in range(4):
        for along in np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]):
            for places in ([corner], [corner, (corner + 1) % 4]):
                move = np.zeros((4, 2))
                move[places] = along
                moves.append(move)
    return np.array(moves)


_UNIT = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)


def _agreement(grey: Grey, board: Board, corners: Array) -> float:
    """Agreement of a patch's bits with a board's, all markers weighed alike, in standard deviations of chance."""
    at, size = _bit_points(board)
    flat = cv2.getPerspectiveTransform(_UNIT, corners.astype(np.float32))
    seen = np.asarray(cv2.perspectiveTransform(at[None], flat), dtype=np.float32)
    values = cv2.remap(grey, seen[..., 0], seen[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    patch = values.reshape(size).astype(np.float32).mean(axis=2)
    patch -= patch.mean(axis=1, keepdims=True)
    agree = (patch * _bits(board)).sum(axis=1) / np.maximum(np.linalg.norm(patch, axis=1), 1e-6)
    return float(agree.sum() / np.sqrt(len(agree)))


@functools.lru_cache(maxsize=32)
def _bits(board: Board) -> Array:
    return marker_bits(board)


@functools.lru_cache(maxsize=32)
def _bit_points(board: Board) -> tuple[NDArray[np.float32], tuple[int, int, int]]:
    """Points (n, 2) of all bits in shares of the board's sides, and their numbers by marker, bit and point."""
    side = marker_cells(board).shape[1]
    cell, step = board.marker_length / side, board.marker_length + board.gap
    inner = (np.arange(side - 2)[:, None] + 1 + (np.arange(_POINTS) + 0.5) / _POINTS) * cell
    points = []
    for k in range(len(board.ids)):
        row, column = divmod(k, board.columns)
        x, y = column * step + inner, row * step + inner
        grid = np.stack(np.broadcast_arrays(x[None, :, None, :], y[:, None, :, None]), axis=-1)
        points.append(grid.reshape(-1, 2) / (board.width, board.height))
    at = np.concatenate(points).astype(np.float32)
    return at, (len(board.ids), (side - 2) ** 2, _POINTS**2)
