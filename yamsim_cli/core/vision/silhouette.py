"""Where a drawn arm ends and where the photo has an edge: a score for a pose, and a way to improve it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..geometry.se3 import Array, pose, rotation_from_vector

Grey = NDArray[np.uint8]
Mask = NDArray[np.bool_]

# All lengths here are in grains: a pixel, or several in a photo so large that its details are several pixels wide.
_GRAINS_ACROSS = 1000
# How far from the outline an edge of the photo is looked for.
REACH = 12.0
# Points to a grain along the line on which it is looked for, and grains between outline points.
_FINE = 2
_SPACING = 3
# An edge is a change of brightness at least this steep, grey levels a grain, and this much of the steepest on its line.
_LEAST_SLOPE = 4.0
# A point's residual beyond this many times the typical one counts nothing (Tukey).
_TUKEY = 4.685
# As many of an outline's points are taken to be independent.
_INDEPENDENT = 60.0
# Outlines closer to the picture's border than this belong to the border.
_BORDER = 3

# Each round looks less far than the one before: what is left then is mostly the arm's own edges.
_ROUNDS, _NARROWER = 6, 0.62


@dataclass(frozen=True)
class Outline:
    """Points of a mask's outline: pixels (n, 2), and unit normals (n, 2) pointing out of the mask."""

    points: Array
    normals: Array


@dataclass(frozen=True)
class EdgeOffsets:
    """Where the photo's edge lies from each outline point (n,), px along its normal; NaN: none within `reach` px."""

    offsets: Array
    reach: float

    @property
    def found(self) -> float:
        """Share of the outline that has an edge within reach."""
        return float(np.isfinite(self.offsets).mean()) if len(self.offsets) else 0.0

    @property
    def residual(self) -> float | None:
        """Median distance, px, to the photo's edge, no edge counting as `reach`; None without an outline."""
        if len(self.offsets) == 0:
            return None
        return float(np.median(np.nan_to_num(np.abs(self.offsets), nan=self.reach)))


def grain_px(shape: tuple[int, ...]) -> int:
    """Pixels to a grain in a picture of a shape (height, width, ...)."""
    return max(1, round(max(shape) / _GRAINS_ACROSS))


def outline(mask: Mask, others: Mask | None = None) -> Outline:
    """The outline of a mask (height, width), holes included, without what runs along the picture's border.

    Args:
        mask: what is outlined.
        others: what may lie in front; the outline against it is left out.
    """
    grain = grain_px(mask.shape)
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    # The normal is that of the mask's softened edge, since the pixels' own steps point in eight directions only.
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 2.0 * grain)
    slope = np.stack([cv2.Sobel(soft, cv2.CV_32F, 1, 0), cv2.Sobel(soft, cv2.CV_32F, 0, 1)], axis=-1)
    chosen = [contour[:: _SPACING * grain, 0, :] for contour in contours if len(contour) >= 8 * grain]
    if not chosen:
        return Outline(np.zeros((0, 2)), np.zeros((0, 2)))
    at = np.concatenate(chosen)
    height, width = mask.shape
    border = _BORDER * grain
    keep = (at >= border).all(axis=1) & (at[:, 0] < width - border) & (at[:, 1] < height - border)
    if others is not None:
        near = cv2.dilate(others.astype(np.uint8), np.ones((4 * grain + 1, 4 * grain + 1), np.uint8)) > 0
        keep &= ~near[at[:, 1], at[:, 0]]
    at = at[keep]
    out = -slope[at[:, 1], at[:, 0]].astype(np.float64)
    length = np.linalg.norm(out, axis=1)
    clear = length > 1e-3 / grain
    normals = out[clear] / length[clear, None]
    # A contour runs through the mask's outermost pixels; its edge is half a pixel further out.
    return Outline(at[clear] + 0.5 * normals, normals)


def edge_offsets(grey: Grey, line: Outline, reach: float = REACH) -> EdgeOffsets:
    """Look along each outline point's normal for the photo's edge: of the steep places, the one nearest by.

    Args:
        grey: the photo (height, width).
        reach: how far to look, grains.
    """
    grain = grain_px(grey.shape)
    if len(line.points) == 0:
        return EdgeOffsets(np.zeros(0), reach * grain)
    steps = np.arange(-reach * _FINE - 1, reach * _FINE + 2) / _FINE
    at = line.points[:, None, :] + steps[None, :, None] * grain * line.normals[:, None, :]
    smooth = cv2.GaussianBlur(grey, (0, 0), grain).astype(np.float32)
    profile = cv2.remap(
        smooth,
        at[..., 0].astype(np.float32),
        at[..., 1].astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    slope = np.abs(profile[:, 2:] - profile[:, :-2]) * _FINE / 2
    inner = steps[1:-1]
    peak = np.zeros_like(slope, dtype=bool)
    peak[:, 1:-1] = (slope[:, 1:-1] >= slope[:, :-2]) & (slope[:, 1:-1] > slope[:, 2:])
    peak &= slope >= np.maximum(_LEAST_SLOPE, 0.4 * slope.max(axis=1, keepdims=True))
    distance = np.where(peak, np.abs(inner)[None, :], np.inf)
    nearest = distance.argmin(axis=1)
    rows = np.arange(len(nearest))
    found = np.isfinite(distance[rows, nearest])
    offsets = np.where(found, inner[nearest] + _beside(slope, nearest) / _FINE, np.nan) * grain
    return EdgeOffsets(offsets, reach * grain)


def _beside(slope: NDArray[np.float32], peak: NDArray[np.intp]) -> Array:
    """How far (steps) from each row's peak (n,) the top of the parabola through it and its neighbours lies."""
    rows, middle = np.arange(len(peak)), np.clip(peak, 1, slope.shape[1] - 2)
    before, here, after = (slope[rows, middle + k].astype(np.float64) for k in (-1, 0, 1))
    bend = np.minimum(before - 2 * here + after, -1e-9)
    beside: Array = np.clip((before - after) / (2 * bend), -0.5, 0.5)
    return beside


@dataclass(frozen=True)
class Correction:
    """A step of a pose: a turn (rad) about `centre` and a shift (m), both along the camera's axes."""

    step: Array
    centre: Array

    def applied(self, T_in_cam: Array) -> Array:
        """A pose (4, 4) in the camera's frame, moved by it."""
        turn = rotation_from_vector(self.step[:3])
        moved = self.centre + self.step[3:] + turn @ (T_in_cam[:3, 3] - self.centre)
        return pose(moved, turn @ T_in_cam[:3, :3])

    @property
    def size(self) -> float:
        """About how far it moves something 0.3 m large, m."""
        return float(np.linalg.norm(self.step[3:]) + 0.3 * np.linalg.norm(self.step[:3]))


@dataclass(frozen=True)
class Pull:
    """What the edges of an outline say of a pose: normal equations (6, 6) and (6,) of a `Correction`'s step."""

    normal: Array
    gradient: Array


def pull(line: Outline, depth: Array, offsets: Array, K: Array, centre: Array, edge_sigma: float = 1.0) -> Pull:
    """How the photo's edges want an outline moved.

    Args:
        line: outline in an ideal pinhole picture with camera matrix `K` (3, 3).
        depth: z (n,) in the camera's frame of the surface at each outline point, m.
        offsets: (n,) px to the photo's edge along each normal; NaN for none.
        centre: the point (3,) in the camera's frame that the turn is about.
        edge_sigma: standard deviation of an edge's place, px.
    """
    use = np.isfinite(offsets) & (depth > 0)
    points, normals, off = line.points[use], line.normals[use], offsets[use]
    z = depth[use]
    ray = np.column_stack([(points[:, 0] - K[0, 2]) / K[0, 0], (points[:, 1] - K[1, 2]) / K[1, 1]])
    at = np.column_stack([ray * z[:, None], z])
    across = normals * np.array([K[0, 0], K[1, 1]]) / z[:, None]
    by_shift = np.column_stack([across, -(across * ray).sum(axis=1)])
    jacobian = np.column_stack([np.cross(at - centre, by_shift), by_shift])
    scale = max(edge_sigma, 1.4826 * float(np.median(np.abs(off)))) if len(off) else edge_sigma
    weight = np.clip(1 - (off / (_TUKEY * scale)) ** 2, 0, None) ** 2
    # Neighbouring outline points see the same edge; a few dozen independent ones are closer to the truth.
    weight *= min(1.0, _INDEPENDENT / max(len(off), 1)) / edge_sigma**2
    weighted = jacobian * weight[:, None]
    return Pull(weighted.T @ jacobian, weighted.T @ off)


def correction(pulls: Sequence[Pull], centre: Array, information: Array, so_far: Array) -> Correction:
    """The step of a pose that brings its outlines onto the photo's edges, without leaving what the boards tell.

    Args:
        pulls: of all outlines that move with the pose.
        centre: the point (3,) in the camera's frame that the turn is about.
        information: inverse covariance (6, 6) of the boards' pose, turn about `centre` (rad) and shift (m).
        so_far: the sum (6,) of the steps taken since the boards' pose.
    """
    normal = information + sum(part.normal for part in pulls)
    gradient = sum(part.gradient for part in pulls) - information @ so_far
    return Correction(np.linalg.solve(normal, gradient).astype(np.float64), centre)


def rounds() -> list[float]:
    """How far edges are looked for in each round of a refinement, grains: wide at first."""
    return [REACH * _NARROWER**k for k in range(_ROUNDS)]
