"""Whole boards from the markers of their grid: for boards on a ground as dark as they are, or hidden in part.

Each dark patch may be a marker. Its neighbours lie where its own edges say, a marker and a gap away; patches that are
found there are put together into a grid. What part of the board a grid is stays open where it has fewer rows or columns
than the board.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ....geometry.board import Board
from ....geometry.se3 import Array

# A neighbour's middle lies within this share of a step of where it is expected, and has a size within this ratio.
_NEAR, _ALIKE = 0.3, 1.6
# A grid has so many markers at least: fewer do not tell its perspective.
_LEAST_MARKERS = 3
# Corners lie within this share of a marker's edge of where the grid has them (root mean square).
_TOLERANCE = 0.12

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
    # Larger patches are told better.
    for seed in np.argsort(-areas):
        if taken[seed]:
            continue
        grid = _grown(int(seed), quads, areas, step)
        if len(grid) < _LEAST_MARKERS:
            continue
        taken[list(grid.values())] = True
        found += list(_placed(grid, quads, board))
    return found


def _grown(seed: int, quads: Array, areas: Array, step: float) -> Grid:
    """The grid (column, row from the seed's) of patches around one."""
    middles = quads.mean(axis=1)
    grid, ends, used = {(0, 0): seed}, [(0, 0)], {seed}
    # The seed's corners are its own; those of others are turned alike.
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


def _placed(grid: Grid, quads: Array, board: Board) -> Iterator[Array]:
    """The board's corners for each part of it that a grid may be."""
    places = np.array(list(grid))
    low, high = places.min(axis=0), places.max(axis=0)
    size = high - low + 1
    if (size > (board.columns, board.rows)).any():
        return
    step = board.marker_length + board.gap
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * board.marker_length
    on_board = np.concatenate([(place - low) * step + unit for place in places])
    corners = _alike(quads[list(grid.values())], quads[grid[0, 0]])
    flat: Any = cv2.findHomography(on_board, corners.reshape(-1, 2))[0]
    # None where corners lie in one line, which OpenCV's type hints do not know of.
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


def _alike(quads: Array, first: Array) -> Array:
    """Patches (n, 4, 2) with their corners in the order of one of them."""
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
