"""Render a board's print as seen from a pose: supersampled, averaged to pixels, blurred."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.camera_effects.lens_distortion import project_points, viewing_ray_grid
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.board_image import board_image, marker_cells

from .blur_kernel import BlurKernel

Grey = NDArray[np.float32]

_SUBSAMPLES_PER_PIXEL = 3  # sample points per pixel along each axis
_TARGET_PX_PER_CELL = 2.7  # minimum in a reduced photo; finer pictures only cost time
_MIN_SURROUNDINGS_RADIUS = 0.9  # px, blur radius from which a print's surroundings affect compared pixels
_CROP_MARGIN_PX = 3  # px around the board, by which a fit can move the print
_MIN_VIEW_PX = 8  # px, side of a `PhotoRegion`


@dataclass(frozen=True)
class PrintedBoard:
    """A board with known pose (4, 4) in a frame `ref`, whose pose a fit estimates.

    `markers` are indices into `board.ids` of the markers to compare.
    """

    board: Board
    T_board_in_ref: Array
    markers: tuple[int, ...]


def whole_board_piece(board: Board, markers: Sequence[int] | None = None) -> PrintedBoard:
    """Return a board as its own frame `ref`, with the given markers or all."""
    return PrintedBoard(board, np.eye(4), tuple(range(len(board.marker_ids)) if markers is None else markers))


@dataclass(frozen=True)
class PhotoRegion:
    """The part of a photo that shows a board, with all that rendering needs besides the pose.

    Attributes:
        photo: grey levels (rows, columns), reduced by the factor `reduction_factor`.
        centre_rays: viewing rays (n, 2) of the pixels, row by row.
        px_per_ray: derivative (n, 2, 2) of pixels by rays.
        pattern: the print, 0 black to 1 white, of scale `px_per_metre`.
        field: rays (rows, columns, 2) of the sample points, `_SUBSAMPLES_PER_PIXEL` squared per pixel.
    """

    piece: PrintedBoard
    photo: Grey
    reduction_factor: int
    centre_rays: Array
    px_per_ray: Array
    pattern: Grey
    px_per_metre: float
    sample_rays: NDArray[np.float32]


@dataclass(frozen=True)
class RenderedPrint:
    """The print as the camera sees it.

    Attributes:
        unblurred: (rows, columns) without blur, 0 black to 1 white. Unknown surroundings are black, as the border.
        grey: `unblurred` with blur.
        outside_share: share (rows, columns, 2) of each pixel left or right of the print, and above or below; None with
            little blur.
        blurred_outside_share: `outside_share` with blur.
        board_points: (n, 2) on the board, m.
        marker: marker index (n,) at each pixel, with half the gap around it; -1 for none.
    """

    unblurred: Grey
    grey: Grey
    outside_share: Grey | None
    blurred_outside_share: Grey | None
    board_points: Array
    marker: NDArray[np.int_]


def print_plane(piece: PrintedBoard, T_ref_in_cam: Array, larger: float = 1.0) -> Array:
    """Return the matrix (3, 3) from (x, y, 1), m, on a print `larger` times its nominal size to the camera frame."""
    plane: Array = (T_ref_in_cam @ piece.T_board_in_ref)[:3, [0, 1, 3]] * (larger, larger, 1.0)
    return plane


def crop_photo_to_print(photo: Grey, camera: CameraModel, piece: PrintedBoard, plane: Array) -> PhotoRegion | None:
    """Return the part of a photo (height, width) with the board; None if behind the camera or below 8 px.

    Args:
        plane: (3, 3) from (x, y, 1) on the board, m, to the camera frame, up to a positive factor.
    """
    board = piece.board
    half = np.array([board.width / 2, board.height / 2])
    corners = np.array([[x, y, 1.0] for x in (-half[0], half[0]) for y in (-half[1], half[1])])
    in_cam = corners @ plane.T
    if in_cam[:, 2].min() <= 1e-3 * plane[2, 2]:
        return None
    pixels = project_points(camera, in_cam)
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - _CROP_MARGIN_PX, 0)
    high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + _CROP_MARGIN_PX + 1, [camera.width, camera.height])
    if (high - low < _MIN_VIEW_PX).any():
        return None
    crop = photo[low[1] : high[1], low[0] : high[0]]
    px_per_metre = float((pixels.max(axis=0) - pixels.min(axis=0)).max()) / max(board.width, board.height)
    cell = board.marker_length / marker_cells(board).shape[1]
    coarser = max(1, int(px_per_metre * cell / _TARGET_PX_PER_CELL))
    if coarser > 1:
        rows, columns = (side // coarser * coarser for side in crop.shape)
        size = (columns // coarser, rows // coarser)
        crop = np.asarray(cv2.resize(crop[:rows, :columns], size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    rows, columns = crop.shape
    x = (
        low[0]
        + (np.arange(columns * _SUBSAMPLES_PER_PIXEL) - (_SUBSAMPLES_PER_PIXEL - 1) / 2)
        / _SUBSAMPLES_PER_PIXEL
        * coarser
        + (coarser - 1) / 2
    )
    y = (
        low[1]
        + (np.arange(rows * _SUBSAMPLES_PER_PIXEL) - (_SUBSAMPLES_PER_PIXEL - 1) / 2) / _SUBSAMPLES_PER_PIXEL * coarser
        + (coarser - 1) / 2
    )
    field = viewing_ray_grid(camera, x, y)
    pattern, pattern_px_per_metre = _board_pattern(board, px_per_metre / coarser * cell * _SUBSAMPLES_PER_PIXEL)
    middle = slice(_SUBSAMPLES_PER_PIXEL // 2, None, _SUBSAMPLES_PER_PIXEL)
    span = (_SUBSAMPLES_PER_PIXEL - 1) / _SUBSAMPLES_PER_PIXEL
    by_x = (
        field[middle, _SUBSAMPLES_PER_PIXEL - 1 :: _SUBSAMPLES_PER_PIXEL] - field[middle, ::_SUBSAMPLES_PER_PIXEL]
    ) / span
    by_y = (
        field[_SUBSAMPLES_PER_PIXEL - 1 :: _SUBSAMPLES_PER_PIXEL, middle] - field[::_SUBSAMPLES_PER_PIXEL, middle]
    ) / span
    ray_per_px = np.stack([by_x, by_y], axis=-1).reshape(-1, 2, 2).astype(np.float64)
    return PhotoRegion(
        piece,
        np.ascontiguousarray(crop, dtype=np.float32),
        coarser,
        field[middle, middle].reshape(-1, 2).astype(np.float64),
        _inverse_2x2(ray_per_px),
        pattern,
        pattern_px_per_metre,
        field,
    )


def _inverse_2x2(matrices: Array) -> Array:
    """Several times faster than `np.linalg.inv`."""
    (a, b), (c, d) = matrices[:, 0].T, matrices[:, 1].T
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2)
    inverses: Array = adjugate / (a * d - b * c)[:, None, None]
    return inverses


def _board_pattern(board: Board, points_per_cell: float) -> tuple[Grey, float]:
    fine, px_per_metre = _fine_pattern(board)
    coarser = 4 if points_per_cell <= 5 else 2 if points_per_cell <= 10 else 1
    return _reduced_pattern(board, coarser) if coarser > 1 else fine, px_per_metre / coarser


@functools.lru_cache(maxsize=32)
def _fine_pattern(board: Board) -> tuple[Grey, float]:
    """Return the print and its scale, px/m. Cells are whole pixels, and gaps as nearly as possible."""
    step = (board.marker_length + board.gap) / board.marker_length

    def rounding_error(cell_px: int) -> float:
        at = np.arange(max(board.columns, board.rows)) * step * cells * cell_px
        return float(np.abs(at - np.round(at)).max()) / cell_px

    cells = marker_cells(board).shape[1]
    cell_px = min(range(16, 33, 4), key=rounding_error)
    image = board_image(board, cell_px, quiet_cells=0).astype(np.float32) / np.float32(255)
    return image, cells * cell_px / board.marker_length


@functools.lru_cache(maxsize=64)
def _reduced_pattern(board: Board, coarser: int) -> Grey:
    fine, _ = _fine_pattern(board)
    rows, columns = (-(-side // coarser) for side in fine.shape)
    # Every reduced pixel must cover a whole block.
    padded = cv2.copyMakeBorder(
        fine, 0, rows * coarser - fine.shape[0], 0, columns * coarser - fine.shape[1], cv2.BORDER_REPLICATE
    )
    return np.asarray(cv2.resize(padded, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float32)


def render_print(view: PhotoRegion, plane: Array, blur: BlurKernel) -> RenderedPrint:
    """Render a print with blur (px of the view) from `plane`, as in `crop_photo_to_print`."""
    onto_board: Array = np.linalg.inv(plane).astype(np.float64)
    board = view.piece.board
    x, y = fine_board_points(view, onto_board)
    scale = np.float32(view.px_per_metre)
    map_x = (x + np.float32(board.width / 2)) * scale - np.float32(0.5)
    map_y = (np.float32(board.height / 2) - y) * scale - np.float32(0.5)
    fine = cv2.remap(view.pattern, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    shape = (view.photo.shape[1], view.photo.shape[0])
    outside = beside = None
    if blur.blur_radius < _MIN_SURROUNDINGS_RADIUS:
        sharp = np.asarray(cv2.resize(fine, shape, interpolation=cv2.INTER_AREA), dtype=np.float32)
        grey = blur.blur_picture(sharp)
    else:
        past_x, past_y = np.abs(x) > board.width / 2, np.abs(y) > board.height / 2
        # Beyond a corner, each side gets half of the pixel.
        half = np.float32(1) / (np.float32(1) + (past_x & past_y))
        past = past_x * half, past_y * half
        every = cv2.resize(cv2.merge([fine, *past]), shape, interpolation=cv2.INTER_AREA).astype(np.float32)
        blurred = blur.blur_picture(every)
        sharp, grey = np.ascontiguousarray(every[..., 0]), np.ascontiguousarray(blurred[..., 0])
        outside, beside = every[..., 1:], blurred[..., 1:]
    homogeneous = np.column_stack([view.centre_rays, np.ones(len(view.centre_rays))]) @ onto_board.T
    at = homogeneous[:, :2] / homogeneous[:, 2:]
    return RenderedPrint(sharp, grey, outside, beside, at, _marker_of_pixels(view, at, blur))


def fine_board_points(view: PhotoRegion, onto_board: Array) -> tuple[Grey, Grey]:
    """Return the sample points' positions on the board (m, right and up).

    Args:
        onto_board: (3, 3) from viewing rays (x, y, 1) to (x, y, 1) on the board, m, up to a factor.
    """
    field, A = view.sample_rays, onto_board.astype(np.float32)
    w = A[2, 0] * field[..., 0] + A[2, 1] * field[..., 1] + A[2, 2]
    # A ray may be parallel to the board.
    with np.errstate(divide="ignore"):
        x = (A[0, 0] * field[..., 0] + A[0, 1] * field[..., 1] + A[0, 2]) / w
        y = (A[1, 0] * field[..., 0] + A[1, 1] * field[..., 1] + A[1, 2]) / w
    return x, y


def _marker_of_pixels(view: PhotoRegion, at: Array, blur: BlurKernel) -> NDArray[np.int_]:
    """Return the marker index (n,) at each pixel; -1 within a blur radius of anything else, such as a hand."""
    board = view.piece.board
    step = board.marker_length + board.gap
    column = np.floor((at[:, 0] + board.width / 2 + board.gap / 2) / step).astype(int)
    row = np.floor((board.height / 2 - at[:, 1] + board.gap / 2) / step).astype(int)
    marker = np.clip(row, 0, board.rows - 1) * board.columns + np.clip(column, 0, board.columns - 1)
    inside = (np.abs(at[:, 0]) < board.width / 2) & (np.abs(at[:, 1]) < board.height / 2)
    compared = np.zeros(board.rows * board.columns, dtype=bool)
    compared[list(view.piece.markers)] = True
    inside &= compared[marker]
    reach = 1 + round(blur.blur_radius)
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    mask = inside.reshape(view.photo.shape).astype(np.uint8)
    clear = cv2.erode(mask, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0).ravel() > 0
    return np.where(clear, marker, -1)
