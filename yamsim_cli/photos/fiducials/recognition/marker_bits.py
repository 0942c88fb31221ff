"""Measure the evidence that a print is a certain board, by comparing its markers' bits with chance.

At an assumed pose, least squares estimates the bits of each marker from the photo, with blur: one number for each bit,
positive for white. The estimates do not depend on the board's bits. Suppose that the photo shows something else:
another board, orientation or dictionary, or no board. Then the board's bits are random signs relative to the
estimates, and the probability of their agreement has a known bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.board_image import marker_cells

from ..fitting.blur_kernel import BlurKernel
from ..fitting.print_view import PhotoRegion, RenderedPrint, draw_print, fine_board_points

_MIN_PIXELS = 12  # pixels of a marker, below which its bits are not estimated


@dataclass(frozen=True)
class BitEvidence:
    """The agreement of bits in a photo with the bits of a board.

    Attributes:
        log_chance: natural logarithm of a bound on the probability of such agreement by chance, at one pose.
        markers: indices into `board.ids` of the markers that agree.
        agreement: for each visible marker, the dot product of its estimated bits, with norm 1, and its true bits (-1
            and 1).
    """

    log_chance: float
    markers: tuple[int, ...]
    agreement: dict[int, float]


def measure_evidence(view: PhotoRegion, plane: Array, blur: BlurKernel, noise: float) -> BitEvidence:
    """Compare the bits in a photo with those of the board that `view` assumes, at the pose `plane`.

    Args:
        plane: (3, 3) from (x, y, 1) on the board, m, to the camera frame.
        blur: in the photo's pixels.
        noise: standard deviation of the photo's noise, grey levels.
    """
    blur = blur.in_larger_pixels(view.coarser)
    drawing = draw_print(view, plane, blur)
    bits = marker_bits(view.piece.board)
    cells = _cells(view, plane)
    agreement = {}
    for k in view.piece.markers:
        if (found := _estimated(view, drawing, blur, cells, k, bits[k], noise)) is not None:
            agreement[k] = float(bits[k] @ found)
    log_chance, markers = most_significant_markers(agreement)
    return BitEvidence(log_chance, markers, agreement)


def most_significant_markers(agreement: dict[int, float]) -> tuple[float, tuple[int, ...]]:
    """Return the log of the lowest bound on agreement by chance, and the set of markers that has this bound.

    By Hoeffding's inequality, a sum of random signs with weights of norm 1 exceeds z with a probability of at most
    exp(-z^2 / 2). The number of all sets that could have been chosen multiplies this bound.
    """
    order = sorted(agreement, key=lambda k: -agreement[k])
    best, taken, total = 0.0, tuple[int, ...](), 0.0
    for count, k in enumerate(order, start=1):
        total += agreement[k]
        log_sets = math.log(math.comb(len(order), count) * len(order))
        log_chance = log_sets - max(total, 0.0) ** 2 / (2 * count)
        if log_chance < best:
            best, taken = log_chance, tuple(sorted(order[:count]))
    return best, taken


def marker_bits(board: Board) -> Array:
    """Return the bits (n, k) of a board's markers, row by row: -1 for black and 1 for white."""
    inner = marker_cells(board)[:, 1:-1, 1:-1]
    bits: Array = np.where(inner > 0, 1.0, -1.0).reshape(len(inner), -1)
    return bits


def _cells(view: PhotoRegion, plane: Array) -> NDArray[np.int_]:
    """Return the index (rows, columns) of the bit at each sample point, counted marker by marker; -1 for none."""
    board = view.piece.board
    x, y = fine_board_points(view, np.linalg.inv(plane).astype(np.float64))
    step, side = board.marker_length + board.gap, marker_cells(board).shape[1]
    cell = board.marker_length / side
    across, down = x + np.float32(board.width / 2), np.float32(board.height / 2) - y
    column, row = np.floor(across / step).astype(int), np.floor(down / step).astype(int)
    bit_x = np.floor((across - column * step) / cell).astype(int) - 1
    bit_y = np.floor((down - row * step) / cell).astype(int) - 1
    inner = side - 2
    inside = (column >= 0) & (column < board.columns) & (row >= 0) & (row < board.rows)
    inside &= (bit_x >= 0) & (bit_x < inner) & (bit_y >= 0) & (bit_y < inner)
    return np.where(inside, ((row * board.columns + column) * inner + bit_y) * inner + bit_x, -1)


def _estimated(
    view: PhotoRegion,
    drawing: RenderedPrint,
    blur: BlurKernel,
    cells: NDArray[np.int_],
    marker: int,
    bits: Array,
    noise: float,
) -> Array | None:
    """Return a marker's bits (k,) estimated from the photo, scaled to norm 1; None if the marker is not visible."""
    rows, columns = view.photo.shape
    use = (drawing.marker == marker).reshape(rows, columns)
    count, fine = len(bits), cells.shape[0] // rows
    if use.sum() < _MIN_PIXELS:
        return None
    # Crop to the region that the marker affects.
    mine = (cells >= marker * count) & (cells < (marker + 1) * count)
    seen = use | (mine.reshape(rows, fine, columns, fine).any(axis=(1, 3)))
    (top, bottom), (left, right) = (np.flatnonzero(seen.any(axis=axis))[[0, -1]] for axis in (1, 0))
    part = np.s_[top : bottom + 1, left : right + 1]
    high, wide = bottom + 1 - top, right + 1 - left
    fine_part = np.s_[top * fine : (bottom + 1) * fine, left * fine : (right + 1) * fine]
    which, points = cells[fine_part] - marker * count, mine[fine_part]
    y, x = (at // fine for at in np.nonzero(points))
    # The share of each pixel that each bit covers, with blur.
    share = np.bincount((y * wide + x) * count + which[points], minlength=high * wide * count).astype(np.float32)
    blurred = blur.apply(share.reshape(high, wide, count) / fine**2)
    inside = use[part]
    by_bit = blurred[inside].astype(np.float64)
    drawn, photo = (picture[part][inside].astype(np.float64) for picture in (drawing.grey, view.photo))
    # Project out the brightness, its gradient, the marker's border, and the surroundings.
    rest = drawn - by_bit @ (bits / 2)
    across, down = np.meshgrid(np.linspace(-1, 1, wide), np.linspace(-1, 1, high))
    light = [np.ones(len(rest)), across[inside], down[inside], rest]
    if drawing.beside is not None:
        light += [*drawing.beside[part][inside].T]
    q, _ = np.linalg.qr(np.column_stack(light))
    by_bit, photo = by_bit - q @ (q.T @ by_bit), photo - q @ (q.T @ photo)
    # The prior variance of the bits is that of the signal, so that noise is not amplified.
    strength = max(float(photo @ photo) / max(float((by_bit**2).sum()), 1e-9), 1e-9)
    normal = by_bit.T @ by_bit + noise**2 / strength * np.eye(count)
    found = np.linalg.solve(normal, by_bit.T @ photo)
    length = float(np.linalg.norm(found))
    return found / length if length > 0 else None
