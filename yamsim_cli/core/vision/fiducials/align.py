"""Refine a pose by the boards' whole picture rather than by a few corners.

The boards' print is known to the last cell. So it is drawn as the camera would see it from a supposed pose, blurred as
the lens blurs it, and the pose (and the blur) is moved until drawing and photo agree best: least squares over all pixels,
brightness and contrast free for each marker, outlying pixels weighted down. Corners found one by one lie on blurred
black-to-white edges and are pushed about by their neighbours; here neighbours and blur are part of the model.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ...boards.image import board_image, marker_cells
from ...geometry.board import Board
from ...geometry.camera import CameraModel
from ...geometry.se3 import Array, pose, rotation_from_vector
from ..lens import project_points, ray_field

Grey = NDArray[np.float32]

# Points a pixel's edge at which the print is drawn before averaging.
_FINE = 3

# Blur (sigma, px) that is believed: less cannot be told from none, more is no picture of a marker.
BLUR_RANGE = (0.25, 4.0)

# Residuals beyond this many standard deviations count less and less (Huber's 95 % efficiency).
_HUBER = 1.345

# Sharper than this (px a cell), pixels only cost time.
_ENOUGH_PX_A_CELL = 9.0

_MAX_ITERATIONS = 30
# Steps below this no longer matter: shift of the print in the picture, px.
_CONVERGED_PX = 4e-3

# The least noise (grey levels) that is believed: rounding alone makes as much.
_LEAST_NOISE = 0.3
# The longest step of the zoom, and how far (px) a zoom by one moves the print once the distance has made up for most of it.
_ZOOM_STEP = 0.2
_ZOOM_PX = 4.0

# A tile of fewer pixels says nothing about its own brightness.
_MIN_TILE_PIXELS = 12


@dataclass(frozen=True)
class Piece:
    """A board, and where it lies in the reference frame whose pose is sought.

    Attributes:
        T_board_in_ref: pose (4, 4).
        markers: places (k,) in `board.ids` of the markers to compare.
    """

    board: Board
    T_board_in_ref: Array
    markers: tuple[int, ...]


@dataclass(frozen=True)
class Alignment:
    """How a print and its picture agree.

    Attributes:
        T_ref_in_cam: pose (4, 4).
        covariance: (6, 6) of a small rotation (rad, about the camera's axes) about `centre` and of the shift of `centre`
            (m, along them), from the photo's noise alone.
        centre: the point (3,) of the reference frame that the covariance is about: the middle of the pieces.
        blur: sigma, px.
        noise: standard deviation of the residuals, grey levels.
        cost: weighted sum of squared residuals over `pixels` pixels.
        pixels: how many were compared.
        tiles: for each piece, marker -> how drawing and photo agree there.
        zoom, zoom_sigma: natural logarithm of how much longer the focal length is than the camera says, and its standard
            deviation from the noise alone; both 0 where it was not asked for.
    """

    T_ref_in_cam: Array
    covariance: Array
    centre: Array
    blur: float
    noise: float
    cost: float
    pixels: int
    tiles: tuple[dict[int, Tile], ...]
    zoom: float = 0.0
    zoom_sigma: float = 0.0


@dataclass(frozen=True)
class Zoom:
    """That the focal length is to be found too: what is known of ln(focal / the camera's) beforehand."""

    mean: float
    sigma: float


@dataclass(frozen=True)
class _State:
    """What is varied: the pose (4, 4), the blur (sigma, px), and the zoom."""

    T: Array
    blur: float
    zoom: float = 0.0


@dataclass(frozen=True)
class Tile:
    """A marker and half the gap around it.

    Attributes:
        correlation: of drawing and photo, -1..1.
        shift: how far (px, right and down) the photo has it from where the drawing has it.
    """

    correlation: float
    shift: tuple[float, float]


@dataclass(frozen=True)
class _View:
    """The part of the photo that shows a piece, and all that stays the same while the pose moves.

    Its rays are those of the camera as given; at a zoom z, the focal length is exp(z) times that, and they are shorter.
    """

    piece: Piece
    pattern: Grey
    px_per_metre: float
    photo: Grey
    field: NDArray[np.float32]  # Rays at _FINE x _FINE points a pixel.
    centre_rays: Array  # Rays at the pixels' centres, (n, 2).
    px_per_ray: Array  # Derivative of pixel by ray at the pixels' centres, (n, 2, 2).


@dataclass(frozen=True)
class _System:
    """Normal equations over the pose's six parameters and the blur, and what the residuals look like."""

    normal: Array
    gradient: Array
    cost: float
    weight: float
    pixels: int
    noise: float
    tiles: tuple[dict[int, Tile], ...]


def align(
    photo: Grey,
    camera: CameraModel,
    pieces: Sequence[Piece],
    T_ref_in_cam: Array,
    blur: float = 0.9,
    zoom: Zoom | None = None,
) -> Alignment | None:
    """Move a pose until the boards' print agrees best with the photo.

    Args:
        photo: grey levels (height, width).
        pieces: what to compare.
        T_ref_in_cam: where to start, right to about a marker's cell.
        blur: where to start, sigma in px.
        zoom: find the focal length too; without, the camera's is taken as it is.

    Returns:
        None where nothing of the pieces lies in the picture, or the fit breaks down.
    """
    views = _views(photo, camera, pieces, T_ref_in_cam)
    if views is None:
        return None
    fit = _Problem(views, _centre(pieces), zoom)
    state, damping = _State(T_ref_in_cam, blur), 1e-3
    system = fit.system(state, noise=None)
    for _ in range(_MAX_ITERATIONS):
        if system is None:
            return None
        step = np.linalg.solve(system.normal + damping * np.diag(np.diag(system.normal)), system.gradient)
        moved = _shift_px(camera, state.T, fit.centre, step[:6]) + _ZOOM_PX * float(np.abs(step[7:]).sum())
        there = fit.moved(state, step)
        trial = fit.system(there, noise=system.noise)
        if trial is not None and trial.cost / trial.weight <= system.cost / system.weight:
            state, damping = there, max(damping / 8, 1e-6)
            system = replace(trial, noise=_noise(trial))
        else:
            damping *= 8
        if moved < _CONVERGED_PX or damping > 1e4:
            break
    return None if system is None else fit.alignment(system, state)


def agreement(
    photo: Grey, camera: CameraModel, pieces: Sequence[Piece], T_ref_in_cam: Array, blur: float, noise: float
) -> Alignment | None:
    """How well the print agrees with the photo at a given pose, which is not moved; residuals weighted for `noise`."""
    views = _views(photo, camera, pieces, T_ref_in_cam)
    if views is None:
        return None
    fit, state = _Problem(views, _centre(pieces), None), _State(T_ref_in_cam, blur)
    system = fit.system(state, noise)
    return None if system is None else fit.alignment(system, state)


def _views(photo: Grey, camera: CameraModel, pieces: Sequence[Piece], T: Array) -> list[_View] | None:
    views = [view for piece in pieces if (view := _view(photo, camera, piece, T)) is not None]
    return views if views and len(views) == len(pieces) else None


def _centre(pieces: Sequence[Piece]) -> Array:
    middle: Array = np.mean([piece.T_board_in_ref[:3, 3] for piece in pieces], axis=0)
    return middle


def _noise(system: _System) -> float:
    return float(np.sqrt(system.cost / max(1.0, system.weight - 7)))


class _Problem:
    """Least squares over the pose's six parameters, the blur, and the zoom where it is sought."""

    def __init__(self, views: Sequence[_View], centre: Array, zoom: Zoom | None) -> None:
        self.centre = centre
        self._views = views
        self._zoom = zoom
        self._size = 7 if zoom is None else 8

    def system(self, state: _State, noise: float | None) -> _System | None:
        """Normal equations at a state; residuals weighted for a given noise, or for the noise found."""
        parts = [_linearized(view, state, self.centre) for view in self._views]
        whole = [part for part in parts if part is not None]
        if len(whole) < len(parts):
            return None
        residual = np.concatenate([part[0] for part in whole])
        jacobian = np.concatenate([part[1] for part in whole])[:, : self._size]
        if noise is None:
            noise = float(1.4826 * np.median(np.abs(residual)))
        noise = max(noise, _LEAST_NOISE)
        weight = np.minimum(1.0, _HUBER * noise / np.maximum(np.abs(residual), 1e-9))
        weighted = jacobian * weight[:, None]
        normal, gradient = weighted.T @ jacobian + 1e-12 * np.eye(self._size), weighted.T @ residual
        cost = float(weight @ residual**2)
        if self._zoom is not None:
            strength = (noise / self._zoom.sigma) ** 2
            normal[7, 7] += strength
            gradient[7] += strength * (self._zoom.mean - state.zoom)
            cost += strength * (self._zoom.mean - state.zoom) ** 2
        tiles = tuple(part[2] for part in whole)
        return _System(normal, gradient, cost, float(weight.sum()), len(residual), noise, tiles)

    def moved(self, state: _State, step: Array) -> _State:
        """The state a step away."""
        turn = rotation_from_vector(step[:3])
        at = state.T[:3, :3] @ self.centre + state.T[:3, 3]
        R = turn @ state.T[:3, :3]
        blur = float(np.clip(state.blur + step[6], *BLUR_RANGE))
        if self._zoom is None:
            return _State(pose(at + step[3:6] - R @ self.centre, R), blur)
        change = float(np.clip(step[7], -_ZOOM_STEP, _ZOOM_STEP))
        at = at * (1, 1, math.exp(change))
        zoom = state.zoom + change
        return _State(pose(at + step[3:6] - R @ self.centre, R), blur, zoom)

    def alignment(self, system: _System, state: _State) -> Alignment | None:
        """What was found, with its uncertainty; None where the pixels do not determine it."""
        try:
            covariance = np.linalg.inv(system.normal) * system.noise**2
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(covariance).all():
            return None
        zoom_sigma = math.sqrt(max(0.0, covariance[7, 7])) if self._zoom else 0.0
        return Alignment(
            state.T,
            covariance[:6, :6],
            self.centre,
            state.blur,
            system.noise,
            system.cost,
            system.pixels,
            system.tiles,
            state.zoom,
            zoom_sigma,
        )


def _shift_px(camera: CameraModel, T: Array, centre: Array, step: Array) -> float:
    """About how far a step moves the print in the picture: by the shift, and by the turn of something 0.1 m large."""
    depth = float((T[:3, :3] @ centre + T[:3, 3])[2])
    return float(np.linalg.norm(step[3:6]) + 0.1 * np.linalg.norm(step[:3])) * camera.focal / max(depth, 1e-3)


def _view(photo: Grey, camera: CameraModel, piece: Piece, T_ref_in_cam: Array) -> _View | None:
    board, T = piece.board, T_ref_in_cam @ piece.T_board_in_ref
    half = np.array([board.width / 2, board.height / 2])
    corners = np.array([[x, y, 0.0, 1.0] for x in (-half[0], half[0]) for y in (-half[1], half[1])])
    in_cam = (corners @ T.T)[:, :3]
    if in_cam[:, 2].min() <= 1e-3:
        return None
    pixels = project_points(camera, in_cam)
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 3, 0)
    high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 4, [camera.width, camera.height])
    if (high - low < 8).any():
        return None
    crop = photo[low[1] : high[1], low[0] : high[0]]
    cells_across = board.columns * 8 + (board.columns - 1) * 8 * board.gap / board.marker_length
    coarser = max(1, int((pixels.max(axis=0) - pixels.min(axis=0)).max() / cells_across / _ENOUGH_PX_A_CELL))
    if coarser > 1:
        rows, columns = (side // coarser * coarser for side in crop.shape)
        crop = cv2.resize(crop[:rows, :columns], (columns // coarser, rows // coarser), interpolation=cv2.INTER_AREA)
    rows, columns = crop.shape
    x = low[0] + (np.arange(columns * _FINE) - (_FINE - 1) / 2) / _FINE * coarser + (coarser - 1) / 2
    y = low[1] + (np.arange(rows * _FINE) - (_FINE - 1) / 2) / _FINE * coarser + (coarser - 1) / 2
    field = ray_field(camera, x, y)
    pattern, px_per_metre = _pattern(board, float((high - low).max()) / max(board.width, board.height) / coarser)
    middle = slice(_FINE // 2, None, _FINE)
    span = (_FINE - 1) / _FINE
    by_x = (field[middle, _FINE - 1 :: _FINE] - field[middle, ::_FINE]) / span
    by_y = (field[_FINE - 1 :: _FINE, middle] - field[::_FINE, middle]) / span
    ray_per_px = np.stack([by_x, by_y], axis=-1).reshape(-1, 2, 2).astype(np.float64)
    return _View(
        piece,
        pattern,
        px_per_metre,
        np.ascontiguousarray(crop, dtype=np.float32),
        field,
        field[middle, middle].reshape(-1, 2).astype(np.float64),
        _inverse_2x2(ray_per_px),
    )


def _inverse_2x2(matrices: Array) -> Array:
    """Inverses of (n, 2, 2), several times faster than numpy's general ones."""
    (a, b), (c, d) = matrices[:, 0].T, matrices[:, 1].T
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2)
    return adjugate / (a * d - b * c)[:, None, None]


# Cells across a marker, with its black border, that the print is drawn with: the scale only has to be fine enough.
_CELLS = 8


def _pattern(board: Board, seen_px_per_metre: float) -> tuple[Grey, float]:
    """The print (0 black, 1 white) and its scale in px a metre, about as fine as the points it is sampled at."""
    wanted = seen_px_per_metre * _FINE * board.marker_length / _CELLS
    fine, px_per_metre = _fine_pattern(board)
    coarser = 4 if wanted <= 5 else 2 if wanted <= 10 else 1
    return _reduced(board, coarser) if coarser > 1 else fine, px_per_metre / coarser


@functools.lru_cache(maxsize=32)
def _fine_pattern(board: Board) -> tuple[Grey, float]:
    """Markers are whole pixels, so gaps are not quite: of the scales, the one whose rounding moves the markers least."""
    step = (board.marker_length + board.gap) / board.marker_length

    def rounding(cell_px: int) -> float:
        at = np.arange(max(board.columns, board.rows)) * step * cells * cell_px
        return float(np.abs(at - np.round(at)).max()) / cell_px

    cells = marker_cells(board).shape[1]
    cell_px = min(range(16, 33, 4), key=rounding)
    image = board_image(board, cell_px, quiet_cells=0).astype(np.float32) / 255
    return image, cells * cell_px / board.marker_length


@functools.lru_cache(maxsize=64)
def _reduced(board: Board, coarser: int) -> Grey:
    fine, _ = _fine_pattern(board)
    rows, columns = (-(-side // coarser) for side in fine.shape)
    # Padded with what is at the edge, so that every reduced pixel stands for a whole block.
    padded = cv2.copyMakeBorder(
        fine, 0, rows * coarser - fine.shape[0], 0, columns * coarser - fine.shape[1], cv2.BORDER_REPLICATE
    )
    return cv2.resize(padded, (columns, rows), interpolation=cv2.INTER_AREA)


def _drawn(view: _View, state: _State) -> tuple[Grey, Array, NDArray[np.bool_]]:
    """The print as the camera sees it (0..1), where on the board (n, 2) each pixel lies, and which pixels see print alone."""
    T_board_in_cam = state.T @ view.piece.T_board_in_ref
    onto_board = np.linalg.inv(T_board_in_cam[:3, [0, 1, 3]]) @ np.diag([math.exp(-state.zoom)] * 2 + [1.0])
    board = view.piece.board
    field = view.field
    A = onto_board.astype(np.float32)
    w = A[2, 0] * field[..., 0] + A[2, 1] * field[..., 1] + A[2, 2]
    x = (A[0, 0] * field[..., 0] + A[0, 1] * field[..., 1] + A[0, 2]) / w
    y = (A[1, 0] * field[..., 0] + A[1, 1] * field[..., 1] + A[1, 2]) / w
    scale = np.float32(view.px_per_metre)
    map_x = (x + np.float32(board.width / 2)) * scale - np.float32(0.5)
    map_y = (np.float32(board.height / 2) - y) * scale - np.float32(0.5)
    fine = cv2.remap(view.pattern, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    shape = (view.photo.shape[1], view.photo.shape[0])
    drawn = cv2.GaussianBlur(cv2.resize(fine, shape, interpolation=cv2.INTER_AREA), (0, 0), state.blur)
    homogeneous = np.column_stack([view.centre_rays, np.ones(len(view.centre_rays))]) @ onto_board.T
    at = homogeneous[:, :2] / homogeneous[:, 2:]
    return drawn, at, _print_alone(view, at, state.blur)


def _print_alone(view: _View, at: Array, blur: float) -> NDArray[np.bool_]:
    """Pixels so far inside the board's edge that nothing else is blurred into them."""
    board = view.piece.board
    inside = (np.abs(at[:, 0]) < board.width / 2) & (np.abs(at[:, 1]) < board.height / 2)
    mask = inside.reshape(view.photo.shape).astype(np.uint8)
    reach = 1 + round(1.5 * blur)
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return cv2.erode(mask, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0).ravel() > 0


def _linearized(view: _View, state: _State, centre: Array) -> tuple[Array, Array, dict[int, Tile]] | None:
    """Residuals (n,), their Jacobian (n, 8) with each tile's brightness and contrast eliminated, and how tiles agree."""
    board = view.piece.board
    drawn, at, alone = _drawn(view, state)
    step = board.marker_length + board.gap
    column = np.floor((at[:, 0] + board.width / 2 + board.gap / 2) / step).astype(int)
    row = np.floor((board.height / 2 - at[:, 1] + board.gap / 2) / step).astype(int)
    tile = np.where(alone, np.clip(row, 0, board.rows - 1) * board.columns + np.clip(column, 0, board.columns - 1), -1)
    use = np.isin(tile, view.piece.markers)
    counts = np.bincount(tile[use], minlength=board.rows * board.columns)
    use &= np.append(counts >= _MIN_TILE_PIXELS, False)[tile]
    if use.sum() < 3 * _MIN_TILE_PIXELS:
        return None
    tile = tile[use]
    slopes = np.stack([cv2.Scharr(drawn, cv2.CV_32F, 1, 0), cv2.Scharr(drawn, cv2.CV_32F, 0, 1)], axis=-1) / 32
    curvature = cv2.Laplacian(drawn, cv2.CV_32F, ksize=1)
    # By the pose, by the blur (which spreads as heat does), by the zoom, and by a shift in the picture.
    by_shift = -slopes.reshape(-1, 2)[use].astype(np.float64)
    by_ray = np.einsum("ni,nij->nj", by_shift, view.px_per_ray[use])
    columns = np.empty((int(use.sum()), 10))
    columns[:, :6] = _by_pose(view, state, centre, at[use], by_ray)
    columns[:, 6] = state.blur * curvature.ravel()[use]
    # A longer lens farther away: the part of the zoom that the distance makes up for is no part of the search.
    depth = float((state.T[:3, :3] @ centre + state.T[:3, 3])[2])
    columns[:, 7] = (by_ray * view.centre_rays[use]).sum(axis=1) + columns[:, 5] * depth
    columns[:, 8:] = by_shift
    return _without_light(view.photo.ravel()[use], drawn.ravel()[use], columns, tile)


def _by_pose(view: _View, state: _State, centre: Array, at: Array, by_ray: Array) -> Array:
    """Derivative (n, 6) of the drawn print by a turn about `centre` and a shift, at points (n, 2) of the board."""
    R = state.T[:3, :3]
    T_board = view.piece.T_board_in_ref
    from_centre = (np.column_stack([at, np.zeros(len(at))]) @ T_board[:3, :3].T + T_board[:3, 3] - centre) @ R.T
    point = from_centre + R @ centre + state.T[:3, 3]
    depth = point[:, 2]
    # The ray's shift by the point's; the camera's own rays are exp(zoom) times longer.
    by_ray = by_ray * math.exp(state.zoom)
    by_shift = np.column_stack([by_ray, -(by_ray * point[:, :2]).sum(axis=1) / depth]) / depth[:, None]
    return np.column_stack([np.cross(from_centre, by_shift), by_shift])


def _without_light(
    photo: NDArray[np.float32], drawn: NDArray[np.float32], columns: Array, tile: NDArray[np.int_]
) -> tuple[Array, Array, dict[int, Tile]]:
    """Residuals and Jacobian once each tile's best brightness and contrast are taken out (variable projection)."""
    order = np.argsort(tile, kind="stable")
    residual, jacobian = np.empty(len(tile)), np.empty((len(tile), 8))
    numbers, starts = np.unique(tile[order], return_index=True)
    tiles = {}
    for number, index in zip(numbers, np.split(order, starts[1:]), strict=True):
        seen = photo[index].astype(np.float64)
        seen -= seen.mean()
        shape = drawn[index].astype(np.float64)
        shape -= shape.mean()
        slopes = columns[index] - columns[index].mean(axis=0)
        power = float(shape @ shape) + 1e-9
        contrast = float(shape @ seen) / power
        slopes = contrast * (slopes - np.outer(shape, shape @ slopes / power))
        residual[index] = seen - contrast * shape
        jacobian[index] = slopes[:, :8]
        by_shift = slopes[:, 8:]
        shift = np.linalg.solve(by_shift.T @ by_shift + 1e-6 * np.eye(2), by_shift.T @ residual[index])
        correlation = contrast * np.sqrt(power / (float(seen @ seen) + 1e-9))
        tiles[int(number)] = Tile(float(correlation), (float(shift[0]), float(shift[1])))
    return residual, jacobian, tiles
