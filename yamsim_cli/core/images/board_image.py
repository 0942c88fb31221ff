from __future__ import annotations

import cv2
import numpy as np

from ..errors import ConfigError, suggest_similar
from ..geometry.board import Board
from .image import Image

WHITE = 255


def aruco_dictionary(name: str) -> cv2.aruco.Dictionary:
    """Return OpenCV's ArUco dictionary of a name such as "DICT_6X6_250"; raise ConfigError if unknown."""
    names = {known: value for known, value in vars(cv2.aruco).items() if known.startswith("DICT_")}
    if name not in names:
        raise ConfigError(f"unknown dictionary {name!r}; {suggest_similar(name, names)}")
    return cv2.aruco.getPredefinedDictionary(int(names[name]))


def marker_cells(board: Board) -> Image:
    """Return the cells (n, k, k) of a board's markers in the order of `board.ids`: 0 is black, 255 is white.

    A marker is `k` cells wide: the dictionary's bits, with a black border of one cell around them. ConfigError is
    raised if OpenCV does not have the dictionary, or the dictionary does not have the ids.
    """
    try:
        dictionary = aruco_dictionary(board.dictionary)
    except ConfigError as error:
        raise ConfigError(f"board {board.name!r}: {error}") from error
    known = len(dictionary.bytesList)
    if board.marker_ids[-1] >= known:
        raise ConfigError(
            f"board {board.name!r} has the marker ids {board.marker_ids[0]}..{board.marker_ids[-1]}, "
            f"but {board.dictionary} ends at "
            f"{known - 1}; choose a first_id up to {known - len(board.marker_ids)}, or a larger dictionary"
            if len(board.marker_ids) <= known
            else f"board {board.name!r} has {len(board.marker_ids)} markers, but {board.dictionary} only {known}; "
            "choose a larger dictionary"
        )
    cells = dictionary.markerSize + 2
    markers = [dictionary.generateImageMarker(number, cells, borderBits=1) for number in board.marker_ids]
    return np.asarray(markers, dtype=np.uint8)


def board_image(board: Board, cell_px: int, quiet_cells: int = 1) -> Image:
    """Return a grey image (height, width) of a board on white, with exactly `cell_px` pixels per marker cell.

    If the gap between markers is not a whole number of pixels, each marker is drawn within half a pixel of its true
    position. These errors do not accumulate. Detectors need at least one quiet cell or a light background.
    """
    markers = marker_cells(board)
    marker_px = markers.shape[1] * cell_px
    px_per_metre = marker_px / board.marker_length
    border = quiet_cells * cell_px
    shape = round(board.height * px_per_metre) + 2 * border, round(board.width * px_per_metre) + 2 * border
    image = np.full(shape, WHITE, dtype=np.uint8)
    step = (board.marker_length + board.gap) * px_per_metre
    for k, marker in enumerate(markers):
        row, column = divmod(k, board.columns)
        top, left = border + round(row * step), border + round(column * step)
        image[top : top + marker_px, left : left + marker_px] = marker.repeat(cell_px, 0).repeat(cell_px, 1)
    return image


def board_texture(board: Board, cell_px: int = 20) -> Image:
    """Return a grey image (height, width) of a board without a border: `board.width` x `board.height` metres.

    The first row is the board's upper edge (+y), the first column the left edge (-x).
    """
    return board_image(board, cell_px, quiet_cells=0)
