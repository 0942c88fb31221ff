"""Rectangles of pixels that contain geoms and their shadows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.se3 import Array

_CORNER_SIGNS = np.array(list(product((-1.0, 1.0), repeat=3)))  # (8, 3), corners of a box
_MIN_LIGHT_DESCENT = 0.05  # smallest downward part of a light's unit direction for which shadows are bounded


class ScissorBox(NamedTuple):
    """A rectangle of pixels, in the form of `glScissor`. The origin is the image's lower left corner."""

    left: int
    bottom: int
    width: int
    height: int

    @property
    def is_empty(self) -> bool:
        """Whether the box contains no pixel."""
        return self.width <= 0 or self.height <= 0

    @property
    def pixels(self) -> tuple[slice, slice]:
        """Index of the box in an image whose first row is the lowest."""
        return slice(self.bottom, self.bottom + self.height), slice(self.left, self.left + self.width)

    def aligned(self, across: int, up: int) -> ScissorBox:
        """Return the smallest box around this one whose edges are multiples of `across` and `up` pixels."""
        left, bottom = self.left // across * across, self.bottom // up * up
        right, top = -(-(self.left + self.width) // across) * across, -(-(self.bottom + self.height) // up) * up
        return ScissorBox(left, bottom, right - left, top - bottom)

    def scaled(self, size: Sequence[int], old: Sequence[int]) -> ScissorBox:
        """Return the box, aligned, in an image of another size: height and width of the new and of the old image."""
        x, y = (size[1], old[1]), (size[0], old[0])
        return ScissorBox(*(value * new // before for value, (new, before) in zip(self, (x, y, x, y), strict=True)))


def box_corners(aabb: Array, positions: Array, rotations: Array) -> Array:
    """Return the corners (n, 8, 3) of boxes in `world`, m.

    Args:
        aabb: centre and half size (n, 6) of each box in the frame of its geom, as in `MjModel.geom_aabb`, m.
        positions, rotations: poses (n, 3) and (n, 3, 3) of the geoms in `world`.
    """
    local = aabb[:, None, :3] + _CORNER_SIGNS * aabb[:, None, 3:]
    return np.asarray(local @ rotations.transpose(0, 2, 1) + positions[:, None])


@dataclass(frozen=True)
class Projection:
    """Maps points in `world` to pixels.

    Attributes:
        matrix: projection times view (4, 4), for clip coordinates of OpenGL.
        origin, size: lower left corner and size of the viewport, px.
        framebuffer: width and height of the whole framebuffer, px, which limit rectangles.
        margin: pixels that are added on each side of a rectangle.
    """

    matrix: Array
    origin: int
    size: tuple[int, int]
    framebuffer: tuple[int, int]
    margin: int

    def boxes(self, points: Array) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
        """Return the rectangles (n, 4) around sets of points (n, k, 3): left, bottom, right, top.

        Also returns whether each rectangle is bounded (n,). A set with a point behind the camera is not: it gets the
        whole framebuffer.
        """
        clip = points @ self.matrix[:, :3].T + self.matrix[:, 3]
        depth = clip[..., 3]
        bounded = np.asarray((depth > 1e-6).all(axis=1))
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = self.origin + (clip[..., :2] / depth[..., None] + 1) / 2 * np.array(self.size)
        limits = np.array(self.framebuffer)
        pixels = np.clip(np.nan_to_num(pixels), -1e6, 1e6)
        low = np.clip(np.floor(pixels.min(axis=1)) - self.margin, 0, limits)
        high = np.clip(np.ceil(pixels.max(axis=1)) + self.margin, 0, limits)
        found = np.concatenate([low, high], axis=1).astype(np.int_)
        found[~bounded] = (0, 0, *self.framebuffer)
        return found, bounded


def union(boxes: NDArray[np.int_]) -> ScissorBox:
    """Return the smallest rectangle that contains rectangles (n, 4) of `Projection.boxes`."""
    boxes = boxes[(boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])]
    if not len(boxes):
        return ScissorBox(0, 0, 0, 0)
    left, bottom = boxes[:, :2].min(axis=0)
    right, top = boxes[:, 2:].max(axis=0)
    return ScissorBox(int(left), int(bottom), int(right - left), int(top - bottom))


def overlaps(boxes: NDArray[np.int_], box: ScissorBox) -> NDArray[np.bool_]:
    """Return whether each rectangle (n, 4) of `Projection.boxes` shares a pixel with `box` (n,)."""
    right, top = box.left + box.width, box.bottom + box.height
    across = (boxes[:, 0] < right) & (boxes[:, 2] > box.left)
    return np.asarray(across & (boxes[:, 1] < top) & (boxes[:, 3] > box.bottom))


@dataclass(frozen=True)
class ShadowTable:
    """A standing opaque box. A shadow that falls wholly on its top changes nothing below, which the box shades already.

    Attributes:
        T_in_world: pose (4, 4).
        half_size: half size (3,), m.
    """

    T_in_world: Array
    half_size: Array


@dataclass(frozen=True)
class ShadowVolumes:
    """Bounds the space in which geoms cast shadows in a directional light.

    Attributes:
        direction: unit vector (3,) in which the light travels, in `world`.
        lowest_plane: height of the lowest surface of the scene, m.
        tables: boxes that stop shadows.
        margin: growth of a geom's box on each side, m, so that it covers the blur of the shadow map's texels.
    """

    direction: Array
    lowest_plane: float
    tables: tuple[ShadowTable, ...]
    margin: float

    @property
    def is_bounded(self) -> bool:
        """Whether the light falls so steeply that shadows stay short."""
        return bool(self.direction[2] < -_MIN_LIGHT_DESCENT)

    def hull_points(self, grown: Array) -> Array:
        """Return points (n, 16, 3) whose hull contains the shadows of boxes with the corners `grown` (n, 8, 3), m.

        The boxes enclose the geoms, and are larger by `margin`.
        """
        reach = np.maximum(grown[..., 2] - self.lowest_plane, 0) / -self.direction[2]
        for table in self.tables:
            reach = np.minimum(reach, self._reach_of_table(table, grown))
        return np.concatenate([grown, grown + reach[..., None] * self.direction], axis=1)

    def _reach_of_table(self, table: ShadowTable, corners: Array) -> Array:
        """Return the distance (n, k) to the top of a table; infinite unless the whole shadow of a box falls on it."""
        R, p = table.T_in_world[:3, :3], table.T_in_world[:3, 3]
        local, direction = (corners - p) @ R, self.direction @ R
        if direction[2] > -_MIN_LIGHT_DESCENT:
            return np.full(corners.shape[:2], np.inf)
        reach = (local[..., 2] - table.half_size[2]) / -direction[2]
        there = local + reach[..., None] * direction
        inside = (np.abs(there[..., :2]) < table.half_size[:2] - 2 * self.margin).all(axis=-1) & (reach >= 0)
        return np.asarray(np.where(inside.all(axis=1, keepdims=True), reach, np.inf))
