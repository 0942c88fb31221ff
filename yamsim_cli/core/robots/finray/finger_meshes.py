"""Meshes of a fin-ray finger, with the same bytes on every machine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TypeVar

import numpy as np

from ...geometry.stl import encode_stl
from .finger import FinRay

Point = tuple[float, float]
T = TypeVar("T")

_WALL_OVERLAP = 0.0025  # m, of neighbouring pieces of the back wall, which slide along each other in a bend
_TIP_FACES = 12  # around the end of the tip
_COORDINATE_GRID = 1e-7  # m, of all coordinates, so that rounding does not depend on the machine


def segment_file(k: int) -> str:
    """Return the file name of the mesh of segment `k`, counted from 0 at the base."""
    return f"segment_{k + 1}.stl"


def finger_mesh_files(finger: FinRay) -> dict[str, bytes]:
    """Return file name -> binary STL (m) of each segment, in the frame of its hinge.

    That frame has its origin in the middle of the front wall, x to the tip, and y towards the held object.
    """
    return {segment_file(k): _segment_section(finger, k).stl(finger.width) for k in range(finger.segment_count)}


@dataclass
class _CrossSection:
    """A plane figure of convex cells that share their corners, so that its extrusion is a closed surface."""

    points: list[Point] = field(default_factory=list)
    cells: list[list[int]] = field(default_factory=list)

    def add(self, *corners: Point) -> None:
        self.cells.append([self._index(corner) for corner in corners])

    def _index(self, corner: Point) -> int:
        point = (
            round(corner[0] / _COORDINATE_GRID) * _COORDINATE_GRID,
            round(corner[1] / _COORDINATE_GRID) * _COORDINATE_GRID,
        )
        if point not in self.points:
            self.points.append(point)
        return self.points.index(point)

    def stl(self, width: float) -> bytes:
        n = len(self.points)
        vertices = [(*point, side * width / 2) for side in (-1, 1) for point in self.points]
        edges = [(a, b) for cell in self.cells for a, b in _cell_edges(cell)]
        faces: list[tuple[int, int, int]] = []
        for first, *others in self.cells:
            for a, b in pairwise(others):
                faces += [(first, b, a), (first + n, a + n, b + n)]
        for a, b in edges:
            if (b, a) not in edges:
                faces += [(a, b, b + n), (a, b + n, a + n)]
        return encode_stl(vertices, faces)


def _cell_edges(cell: Sequence[T]) -> list[tuple[T, T]]:
    return list(zip(cell, [*cell[1:], cell[0]], strict=True))


def _segment_section(finger: FinRay, k: int) -> _CrossSection:
    """Return a piece of each wall, and the rib at hinge `k` or the end of the tip."""
    half, bay, low = finger.wall_thickness / 2, finger.rib_spacing, k * finger.rib_spacing
    section = _CrossSection()

    def depth_at(x: float) -> float:
        return float(finger.wall_spacing(low + x))

    def add_front_wall(x0: float, x1: float) -> None:
        section.add((x0, -half), (x1, -half), (x1, half), (x0, half))

    def add_back_wall(x0: float, x1: float) -> None:
        a, b = -depth_at(x0), -depth_at(x1)
        section.add((x0, a - half), (x1, b - half), (x1, b + half), (x0, a + half))

    last = k == finger.segment_count - 1
    foot = finger.rib_thickness if k else 0.0
    end = bay - (depth_at(bay) + finger.wall_thickness) / 2 if last else bay
    if k:
        add_front_wall(0.0, foot)
        section.add((0.0, half - depth_at(0.0)), (foot, half - depth_at(foot)), (foot, -half), (0.0, -half))
        add_back_wall(0.0, foot)
        add_back_wall(-_WALL_OVERLAP, 0.0)
    add_front_wall(foot, end)
    add_back_wall(foot, end)
    if last:
        _add_tip_cells(section, end, bay, half, depth_at(end))
    else:
        add_back_wall(bay, bay + _WALL_OVERLAP)
    return section


def _add_tip_cells(section: _CrossSection, start: float, end: float, half: float, depth: float) -> None:
    outline: list[Point] = [(start, -depth - half)]
    middle, across = -depth / 2, depth / 2 + half
    for turn in np.linspace(-math.pi / 2, math.pi / 2, _TIP_FACES + 1)[1:-1]:
        outline.append((start + (end - start) * math.cos(turn), middle + across * math.sin(turn)))
    outline += [(start, half), (start, -half), (start, half - depth)]
    hub = (start + (end - start) / 3, middle)
    for a, b in _cell_edges(outline):
        section.add(hub, a, b)
