"""Measure the evidence that a print is a certain board, by its markers' bits.

At a pose, least squares estimates each marker's bits from the blurred photo, positive for white, without knowledge of
the board's bits. If the photo shows anything else, these are random signs relative to the estimates. The probability of
their agreement then has a known bound.
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
from ..fitting.print_view import PhotoRegion, RenderedPrint, fine_board_points, render_print

_MIN_PIXELS = 12  # pixels of a marker; below, its bits are not estimated


@dataclass(frozen=True)
class BitEvidence:
    """How well the marker bits in a photo agree with the true bits of a board.

    Attributes:
        log_chance_bound: log of an upper bound on the probability that the bits agree by chance at a single pose. A
            search over many poses has to allow for their number.
        markers: indices into `board.ids` of agreeing markers.
        agreement: marker -> dot product of its estimated bits, of norm 1, and true bits (-1 and 1).
    """

    log_chance_bound: float
    markers: tuple[int, ...]
    agreement: dict[int, float]


def measure_bit_agreement(view: PhotoRegion, plane: Array, blur: BlurKernel, noise: float) -> BitEvidence:
    """Compare the bits in a photo with the bits of the board in `view`.

    Args:
        plane: (3, 3) from (x, y, 1) on the board, m, to the camera frame.
        blur: px of the photo.
        noise: standard deviation, grey levels.
    """
    blur = blur.scaled_to_reduced_picture(view.reduction_factor)
    drawing = render_print(view, plane, blur)
    bits = marker_bits(view.piece.board)
    cells = _sample_bit_indices(view, plane)
    agreement = {}
    for k in view.piece.markers:
        if (found := _estimate_bits(view, drawing, blur, cells, k, bits[k], noise)) is not None:
            agreement[k] = float(bits[k] @ found)
    log_chance_bound, markers = most_significant_markers(agreement)
    return BitEvidence(log_chance_bound, markers, agreement)


def most_significant_markers(agreement: dict[int, float]) -> tuple[float, tuple[int, ...]]:
    """Return the log of the lowest bound on chance agreement, and its set of markers.

    By Hoeffding's inequality, random signs with weights of norm 1 sum to over z with a probability of at most exp(-z^2
    / 2), here times the number of possible sets.
    """
    order = sorted(agreement, key=lambda k: -agreement[k])
    best, taken, total = 0.0, tuple[int, ...](), 0.0
    for count, k in enumerate(order, start=1):
        total += agreement[k]
        log_sets = math.log(math.comb(len(order), count) * len(order))
        log_chance_bound = log_sets - max(total, 0.0) ** 2 / (2 * count)
        if log_chance_bound < best:
            best, taken = log_chance_bound, tuple(sorted(order[:count]))
    return best, taken


def marker_bits(board: Board) -> Array:
    """Return bits (n, k) of a board's markers, row by row: -1 black, 1 white."""
    inner = marker_cells(board)[:, 1:-1, 1:-1]
    bits: Array = np.where(inner > 0, 1.0, -1.0).reshape(len(inner), -1)
    return bits


def _sample_bit_indices(view: PhotoRegion, plane: Array) -> NDArray[np.int_]:
    """Return each sample point's bit index (rows, columns), marker by marker; -1 for none."""
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


def _estimate_bits(
    view: PhotoRegion,
    drawing: RenderedPrint,
    blur: BlurKernel,
    cells: NDArray[np.int_],
    marker: int,
    bits: Array,
    noise: float,
) -> Array | None:
    rows, columns = view.photo.shape
    use = (drawing.marker == marker).reshape(rows, columns)
    count, fine = len(bits), cells.shape[0] // rows
    if use.sum() < _MIN_PIXELS:
        return None
    mine = (cells >= marker * count) & (cells < (marker + 1) * count)
    seen = use | (mine.reshape(rows, fine, columns, fine).any(axis=(1, 3)))
    (top, bottom), (left, right) = (np.flatnonzero(seen.any(axis=axis))[[0, -1]] for axis in (1, 0))
    part = np.s_[top : bottom + 1, left : right + 1]
    high, wide = bottom + 1 - top, right + 1 - left
    fine_part = np.s_[top * fine : (bottom + 1) * fine, left * fine : (right + 1) * fine]
    which, points = cells[fine_part] - marker * count, mine[fine_part]
    y, x = (at // fine for at in np.nonzero(points))
    # Share of each pixel that each bit covers.
    share = np.bincount((y * wide + x) * count + which[points], minlength=high * wide * count).astype(np.float32)
    blurred = blur.blur_picture(share.reshape(high, wide, count) / fine**2)
    inside = use[part]
    by_bit = blurred[inside].astype(np.float64)
    drawn, photo = (picture[part][inside].astype(np.float64) for picture in (drawing.grey, view.photo))
    # Project out brightness with gradient, border and surroundings.
    rest = drawn - by_bit @ (bits / 2)
    across, down = np.meshgrid(np.linspace(-1, 1, wide), np.linspace(-1, 1, high))
    light = [np.ones(len(rest)), across[inside], down[inside], rest]
    if drawing.blurred_outside_share is not None:
        light += [*drawing.blurred_outside_share[part][inside].T]
    q, _ = np.linalg.qr(np.column_stack(light))
    by_bit, photo = by_bit - q @ (q.T @ by_bit), photo - q @ (q.T @ photo)
    # The bits' prior variance is the signal's: noise is not amplified.
    strength = max(float(photo @ photo) / max(float((by_bit**2).sum()), 1e-9), 1e-9)
    normal = by_bit.T @ by_bit + noise**2 / strength * np.eye(count)
    found = np.linalg.solve(normal, by_bit.T @ photo)
    length = float(np.linalg.norm(found))
    return found / length if length > 0 else None
