"""Meshes of a fin-ray finger, made from its figures alone: the same figures give the same bytes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ...geometry.se3 import Array
from ...geometry.stl import stl_bytes
from .parameters import FinRay

Point = tuple[float, float]

# What the pieces of the back wall overlap by, m: where a finger bends, they slide along each other.
_OVERLAP = 0.0025
# Faces around the end of the tip.
_ROUND = 12
# Coordinates are whole multiples of this, so that rounding is no matter of the machine; m.
_GRAIN = 1e-7


def segment_file(k: int) -> str:
    """The file of the mesh of a finger's segment, counted from 0 at the base."""
    return f"segment_{k + 1}.stl"


def meshes(finger: FinRay) -> dict[str, bytes]:
    """File name -> binary STL (m) of each segment, in the frame at its hinge.

    That frame has x to the tip, y towards what is held, and its origin in the middle of the front wall.
    """
    return {segment_file(k): _segment(finger, k).stl(finger.width) for k in range(finger.segments)}


@dataclass
class _Section:
    """Cells in a plane, which share corners where they touch: what is pulled out of it is closed."""

    points: list[Point] = field(default_factory=list)
    cells: list[list[int]] = field(default_factory=list)

    def add(self, *corners: Point) -> None:
        """Add a convex cell, its corners counter-clockwise."""
        self.cells.append([self._index(corner) for corner in corners])

    def _index(self, corner: Point) -> int:
        point = (round(corner[0] / _GRAIN) * _GRAIN, round(corner[1] / _GRAIN) * _GRAIN)
        if point not in self.points:
            self.points.append(point)
        return self.points.index(point)

    def stl(self, width: float) -> bytes:
        """The section pulled out to both sides of its plane by half a width (m)."""
        n = len(self.points)
        vertices = [(*point, side * width / 2) for side in (-1, 1) for point in self.points]
        edges = [(a, b) for cell in self.cells for a, b in _around(cell)]
        faces: list[tuple[int, int, int]] = []
        for first, *others in self.cells:
            for a, b in pairwise(others):
                faces += [(first, b, a), (first + n, a + n, b + n)]
        for a, b in edges:
            if (b, a) not in edges:
                faces += [(a, b, b + n), (a, b + n, a + n)]
        return stl_bytes(vertices, faces)


def _around(cell: Sequence[int]) -> list[tuple[int, int]]:
    return list(zip(cell, [*cell[1:], cell[0]], strict=True))


def _segment(finger: FinRay, k: int) -> _Section:
    """From its hinge to the next: a piece of each wall, with the rib that stands at the hinge, or the tip's end."""
    half, bay, low = finger.wall / 2, finger.bay, k * finger.bay
    section = _Section()

    def depth(x: float) -> float:
        return float(finger.spacing(low + x))

    def front(x0: float, x1: float) -> None:
        section.add((x0, -half), (x1, -half), (x1, half), (x0, half))

    def back(x0: float, x1: float) -> None:
        a, b = -depth(x0), -depth(x1)
        section.add((x0, a - half), (x1, b - half), (x1, b + half), (x0, a + half))

    last = k == finger.segments - 1
    foot = finger.rib if k else 0.0
    end = bay - (depth(bay) + finger.wall) / 2 if last else bay
    if k:
        front(0.0, foot)
        section.add((0.0, half - depth(0.0)), (foot, half - depth(foot)), (foot, -half), (0.0, -half))
        back(0.0, foot)
        back(-_OVERLAP, 0.0)
    front(foot, end)
    back(foot, end)
    if last:
        _tip(section, end, bay, half, depth(end))
    else:
        back(bay, bay + _OVERLAP)
    return section


def _tip(section: _Section, start: float, end: float, half: float, depth: float) -> None:
    """The solid end: from the walls' inner faces a fan out to a round."""
    outline: list[Point] = [(start, -depth - half)]
    middle, across = -depth / 2, depth / 2 + half
    for turn in np.linspace(-math.pi / 2, math.pi / 2, _ROUND + 1)[1:-1]:
        outline.append((start + (end - start) * math.cos(turn), middle + across * math.sin(turn)))
    outline += [(start, half), (start, -half), (start, half - depth)]
    hub = (start + (end - start) / 3, middle)
    for a, b in zip(outline, [*outline[1:], outline[0]], strict=True):
        section.add(hub, a, b)


def volume(vertices: Array, faces: Array) -> float:
    """What a closed mesh holds, m3; negative where its faces look inwards."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)
