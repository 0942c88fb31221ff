"""Dark patches of a photo that may be a board, the likeliest first.

A patch is laid flat by its four corners. Read this way up or another, its bits agree with the board's by chance only,
or by more.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ....boards.board_image import marker_cells
from ....geometry.board import Board
from ....geometry.se3 import Array
from .bits import bits_of

Grey = NDArray[np.uint8]

# Points along a marker's cell at which a patch is looked at.
_POINTS = 2
# A patch whose bits agree with the board's less than this (standard deviations of chance) is not looked at further.
_LEAST_AGREEMENT = 2.5
# Patches whose corners are rough are moved to where their bits agree best: so many of them, by steps of so many px, and
# no further where they agree less than this after them. Source: photos by a physically based renderer, where patches
# that were none reached 4.3 in the end, and boards 7 to 16.
_MOST_MOVED, _STEPS = 4, ((3.0, 3.5), (1.5, 4.5), (0.75, 5.0))
_LEAST_TO_MOVE = 1.5
_ROUNDS = 3


@dataclass(frozen=True)
class Suspect:
    """A patch that may be a board.

    Attributes:
        corners: its outer corners (4, 2) in pixels, clockwise from the board's top left.
        agreement: of its bits with the board's, in standard deviations of chance.
    """

    corners: Array
    agreement: float


def suspects(grey: Grey, board: Board, quads: Sequence[Array], least: float = _LEAST_AGREEMENT) -> list[Suspect]:
    """Patches of a photo (height, width) that may be a board, the likeliest first."""
    # A board may lie any of four ways up.
    turned = [np.roll(quad, turn, axis=0) for quad in quads for turn in range(4)]
    found = [Suspect(corners, _agreement(grey, board, corners)) for corners in turned]
    return sorted((one for one in found if one.agreement > least), key=lambda one: -one.agreement)


def moved_suspects(grey: Grey, board: Board, quads: Sequence[Array]) -> list[Suspect]:
    """As `suspects`, of patches whose corners are only roughly known: each is moved to where its bits agree best."""
    rough = suspects(grey, board, quads, _LEAST_TO_MOVE)[:_MOST_MOVED]
    found = [moved for suspect in rough if (moved := _moved(grey, board, suspect)) is not None]
    return sorted(found, key=lambda one: -one.agreement)


def _moved(grey: Grey, board: Board, suspect: Suspect) -> Suspect | None:
    """A patch whose corners and edges are moved one after the other as long as its bits agree better for it.

    None where they do not agree well then.
    """
    for step, least in _STEPS:
        for _ in range(_ROUNDS):
            before = suspect.agreement
            for move in step * _moves():
                corners = suspect.corners + move
                if (agreement := _agreement(grey, board, corners)) > suspect.agreement:
                    suspect = Suspect(corners, agreement)
            if suspect.agreement == before:
                break
        if suspect.agreement < least:
            return None
    return suspect


@functools.lru_cache(maxsize=1)
def _moves() -> Array:
    """Moves (n, 4, 2) of each corner and of each edge by 1 px along either axis, either way."""
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
    """How well a patch's bits agree with a board's, its markers weighed alike."""
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
    return bits_of(board)


@functools.lru_cache(maxsize=32)
def _bit_points(board: Board) -> tuple[NDArray[np.float32], tuple[int, int, int]]:
    """Points (n, 2) of all bits in shares of the board's sides; how many markers, bits and points a bit they are."""
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
