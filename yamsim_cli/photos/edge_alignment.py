"""Compare a rendered arm's outline with the photo's edges, to score and to refine a pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.geometry.se3 import Array, pose, rotation_from_vector

Grey = NDArray[np.uint8]
Mask = NDArray[np.bool_]

# Unit of length: a grain is one pixel or, in a large photo with larger details, several.
_GRAINS_ACROSS = 1000  # approximate grains along the longer side of a large photo
DEFAULT_SEARCH_DISTANCE = 12.0  # grains, search distance for edges on either side of the outline
_SAMPLES_PER_GRAIN = 2  # sample points per grain of the search line
_POINT_SPACING = 3  # grains between outline points
_MIN_SLOPE = 4.0  # grey levels per grain, gradient of an edge
_MIN_SLOPE_SHARE = 0.4  # share of the search line's largest gradient, for an edge
_SIGMA_PER_MAD = 1.4826  # standard deviation over median absolute deviation, normal noise
_TUKEY_CUTOFF = 4.685  # standard deviations, beyond which Tukey's biweight is 0 (95 % efficiency)
_INDEPENDENT_POINTS = 60.0  # maximum number of outline points that count as independent
_IGNORED_BORDER = 3  # grains from the picture's border; outlines there are ignored
_REFINEMENT_ROUNDS = 6  # rounds of a pose refinement
# Each round's search distance over the one before; the last round's is too short for the edges of other objects.
_SEARCH_DISTANCE_RATIO = 0.62


@dataclass(frozen=True)
class MaskOutline:
    """Positions (n, 2), px, on a mask's outline, and outward unit normals (n, 2)."""

    points: Array
    normals: Array


@dataclass(frozen=True)
class EdgeOffsets:
    """Offsets (n,), px, of the photo's edge along outline normals; NaN if none within `search_distance` (px)."""

    offsets: Array
    search_distance: float

    @property
    def median_distance(self) -> float | None:
        """Median distance to the photo's edge, px, `search_distance` for a missing edge; None without an outline."""
        if len(self.offsets) == 0:
            return None
        return float(np.median(np.nan_to_num(np.abs(self.offsets), nan=self.search_distance)))


def grain_px(shape: tuple[int, ...]) -> int:
    """Return the pixels per grain of a picture (height, width, ...)."""
    return max(1, round(max(shape) / _GRAINS_ACROSS))


def mask_outline(mask: Mask, others: Mask | None = None) -> MaskOutline:
    """Return a mask's outline (height, width) with its holes, except near the picture's border.

    Args:
        others: mask of objects that may lie in front; the outline near them is omitted.
    """
    grain = grain_px(mask.shape)
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    # The blur makes normals smooth: steps between pixels have only eight directions.
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 2.0 * grain)
    slope = np.stack([cv2.Sobel(soft, cv2.CV_32F, 1, 0), cv2.Sobel(soft, cv2.CV_32F, 0, 1)], axis=-1)
    chosen = [contour[:: _POINT_SPACING * grain, 0, :] for contour in contours if len(contour) >= 8 * grain]
    if not chosen:
        return MaskOutline(np.zeros((0, 2)), np.zeros((0, 2)))
    at = np.concatenate(chosen)
    height, width = mask.shape
    border = _IGNORED_BORDER * grain
    keep = (at >= border).all(axis=1) & (at[:, 0] < width - border) & (at[:, 1] < height - border)
    if others is not None:
        near = cv2.dilate(others.astype(np.uint8), np.ones((4 * grain + 1, 4 * grain + 1), np.uint8)) > 0
        keep &= ~near[at[:, 1], at[:, 0]]
    at = at[keep]
    out = -slope[at[:, 1], at[:, 0]].astype(np.float64)
    length = np.linalg.norm(out, axis=1)
    clear = length > 1e-3 / grain
    normals = out[clear] / length[clear, None]
    # Contours join pixel centres; the edge is half a pixel further out.
    return MaskOutline(at[clear] + 0.5 * normals, normals)


def edge_offsets(
    grey: Grey, line: MaskOutline, reach: float = DEFAULT_SEARCH_DISTANCE, falling: bool = False
) -> EdgeOffsets:
    """Return the offsets of edges of the photo `grey` (height, width) within `reach` (grains) of an outline.

    With `falling`, only edges count whose outer side is darker.
    """
    grain = grain_px(grey.shape)
    if len(line.points) == 0:
        return EdgeOffsets(np.zeros(0), reach * grain)
    steps = np.arange(-reach * _SAMPLES_PER_GRAIN - 1, reach * _SAMPLES_PER_GRAIN + 2) / _SAMPLES_PER_GRAIN
    at = line.points[:, None, :] + steps[None, :, None] * grain * line.normals[:, None, :]
    smooth = cv2.GaussianBlur(grey, (0, 0), grain).astype(np.float32)
    profile = cv2.remap(
        smooth,
        at[..., 0].astype(np.float32),
        at[..., 1].astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    slope: NDArray[np.float32] = (profile[:, :-2] - profile[:, 2:]) * np.float32(_SAMPLES_PER_GRAIN / 2)
    slope = np.maximum(slope, np.float32(0)) if falling else np.abs(slope)
    inner = steps[1:-1]
    peak = np.zeros_like(slope, dtype=bool)
    peak[:, 1:-1] = (slope[:, 1:-1] >= slope[:, :-2]) & (slope[:, 1:-1] > slope[:, 2:])
    peak &= slope >= np.maximum(_MIN_SLOPE, _MIN_SLOPE_SHARE * slope.max(axis=1, keepdims=True))
    distance = np.where(peak, np.abs(inner)[None, :], np.inf)
    nearest = distance.argmin(axis=1)
    rows = np.arange(len(nearest))
    found = np.isfinite(distance[rows, nearest])
    offsets = np.where(found, inner[nearest] + _peak_shift(slope, nearest) / _SAMPLES_PER_GRAIN, np.nan) * grain
    return EdgeOffsets(offsets, reach * grain)


def _peak_shift(slope: NDArray[np.float32], peak: NDArray[np.intp]) -> Array:
    """Return the shift (n,), samples, to the vertex of the parabola through each row's peak and its neighbours."""
    rows, middle = np.arange(len(peak)), np.clip(peak, 1, slope.shape[1] - 2)
    before, here, after = (slope[rows, middle + k].astype(np.float64) for k in (-1, 0, 1))
    bend = np.minimum(before - 2 * here + after, -1e-9)
    shift: Array = np.clip((before - after) / (2 * bend), -0.5, 0.5)
    return shift


@dataclass(frozen=True)
class PoseCorrection:
    """A pose step (6,): rotation (rad) about `centre` and shift (m), along the camera's axes."""

    step: Array
    centre: Array

    def apply_to_pose(self, T_in_cam: Array) -> Array:
        """Return the moved pose (4, 4) in the camera frame."""
        turn = rotation_from_vector(self.step[:3])
        moved = self.centre + self.step[3:] + turn @ (T_in_cam[:3, 3] - self.centre)
        return pose(moved, turn @ T_in_cam[:3, :3])


@dataclass(frozen=True)
class PoseCorrectionEquations:
    """The normal equations (6, 6) and (6,) of a `PoseCorrection`, from edges along an outline."""

    normal: Array
    right_hand_side: Array


def points_in_camera(pixels: Array, normals: Array, depth: Array, K: Array) -> tuple[Array, Array]:
    """Return outline points (n, 3) in the camera frame, m, and px along the normal by m of movement (n, 3).

    Args:
        pixels, normals: of the outline, (n, 2).
        depth: z (n,) of the points in the camera frame, m.
        K: camera matrix (3, 3).
    """
    focal = K[[0, 1], [0, 1]]
    ray = (pixels - K[:2, 2]) / focal
    across = normals * focal / depth[:, None]
    return np.column_stack([ray * depth[:, None], depth]), np.column_stack([across, -(across * ray).sum(axis=1)])


def edge_spread(offsets: Array, least: float) -> float:
    """Return the standard deviation (px) of edges' offsets (n,), estimated by their median; at least `least`."""
    return max(least, _SIGMA_PER_MAD * float(np.median(np.abs(offsets)))) if len(offsets) else least


def edge_weights(offsets: Array, spread: float | Array, sigma: float | Array) -> Array:
    """Return weights (n,) of the edges of one picture: Tukey's biweight over the variance `sigma` squared.

    Args:
        offsets: (n,), px.
        spread: standard deviation from which outliers are judged, px; one, or one for each edge.
        sigma: standard deviation of an edge's position, px; likewise.
    """
    weights = np.clip(1 - (offsets / (_TUKEY_CUTOFF * spread)) ** 2, 0, None) ** 2
    # Neighbouring points share an edge, so they are not independent.
    result: Array = weights * (min(1.0, _INDEPENDENT_POINTS / max(len(offsets), 1)) / sigma**2)
    return result


def edge_equations(
    line: MaskOutline, depth: Array, offsets: Array, K: Array, centre: Array, edge_sigma: float = 1.0
) -> PoseCorrectionEquations:
    """Return the equations of the pose step that moves an outline onto the photo's edges.

    Args:
        line: in an ideal pinhole picture with camera matrix `K` (3, 3).
        depth: z (n,) of the surface in the camera frame, m.
        offsets: distance (n,) to the edge along each normal, px; NaN for none.
        centre: of rotation, (3,) in the camera frame, m.
        edge_sigma: of an edge's position, px.
    """
    use = np.isfinite(offsets) & (depth > 0)
    points, normals, off = line.points[use], line.normals[use], offsets[use]
    at, by_shift = points_in_camera(points, normals, depth[use], K)
    jacobian = np.column_stack([np.cross(at - centre, by_shift), by_shift])
    weighted = jacobian * edge_weights(off, edge_spread(off, edge_sigma), edge_sigma)[:, None]
    return PoseCorrectionEquations(weighted.T @ jacobian, weighted.T @ off)


def solve_correction(
    equations: Sequence[PoseCorrectionEquations], centre: Array, information: Array, so_far: Array
) -> PoseCorrection:
    """Return the step that moves outlines onto the photo's edges, with the pose from boards as prior.

    Args:
        centre: of rotation, (3,) in the camera frame, m.
        information: inverse covariance (6, 6) of the prior, rotation (rad) and shift (m).
        so_far: sum (6,) of earlier steps from the prior.
    """
    normal = information + sum(part.normal for part in equations)
    right_hand_side = sum(part.right_hand_side for part in equations) - information @ so_far
    return PoseCorrection(np.linalg.solve(normal, right_hand_side).astype(np.float64), centre)


def search_distances() -> list[float]:
    """Return the refinement rounds' decreasing search distances, grains."""
    return [DEFAULT_SEARCH_DISTANCE * _SEARCH_DISTANCE_RATIO**k for k in range(_REFINEMENT_ROUNDS)]
