"""Fits solid primitives to a scan: each kind by least squares of the signed distance, of which the best is taken."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..config.things.primitives import Box, Capsule, Cylinder, Primitive, Sphere
from ..geometry.least_squares import LeastSquares, descend
from ..geometry.se3 import Array
from .distance import signed_distance

# How much better a shape must fit for each further number that describes it, m.
_WORTH = 3e-4

# Points deeper than this below all planes that touch the surface lie in a dimple, which nothing touches, m.
_DIMPLE = 0.0015
# How many of these planes are tried.
_PLANES = 600

# Ends of a shape less than this above the ground are moved down to it, since the thing touches the table there, m.
_LAID = 0.004

_STEPS = 30
_NUDGE = 1e-5
# A step that makes the squares of the distances less by a smaller share is the last.
_NO_GAIN = 1e-6

Parts = tuple[Primitive, ...]
Make = Callable[[Array], Parts]


@dataclass(frozen=True)
class SolidFit:
    """Primitives, and how well they fit.

    Attributes:
        rms: root mean square of the distances of the scan's surface from theirs, m.
        most: largest of the nearest 99 % of these distances, m.
    """

    parts: Parts
    rms: float
    most: float


def measure(parts: Parts, points: Array) -> SolidFit:
    """The fit of given primitives to points (n, 3) of a surface."""
    distance = np.abs(signed_distance(parts, points))
    return SolidFit(parts, float(np.sqrt(np.mean(distance**2))), float(np.percentile(distance, 99)))


def fit_solid(points: Array) -> SolidFit:
    """The ball, cylinder, block, or row of up to three capsules that fits points (n, 3) of a surface best, m.

    Dimples and holes, such as an apple's, do not count.
    """
    points = _outside(points)
    best: tuple[float, SolidFit] | None = None
    for make, start in _candidates(points):
        fitted = descend(_ShapeProblem(make, points), start, _STEPS)
        assert fitted is not None  # distances can always be told
        parts = _laid(make(fitted[0]), float(points[:, 2].min()))
        fit = measure(parts, points)
        cost = fit.rms + fit.most / 4 + _WORTH * len(start)
        if best is None or cost < best[0]:
            best = cost, fit
    assert best is not None  # there are always candidates
    return best[1]


def _outside(points: Array) -> Array:
    """The points near the convex hull."""
    k = np.arange(_PLANES) + 0.5
    down, round_ = np.arccos(1 - 2 * k / _PLANES), np.pi * (1 + math.sqrt(5)) * k
    heights = points @ np.array([np.cos(round_) * np.sin(down), np.sin(round_) * np.sin(down), np.cos(down)])
    depth = (heights.max(axis=0) - heights).min(axis=1)
    near: Array = points[depth < _DIMPLE]
    return near


def _candidates(points: Array) -> Iterator[tuple[Make, Array]]:
    low, high = np.percentile(points, (0.5, 99.5), axis=0)
    centre, half = (low + high) / 2, (high - low) / 2
    yield lambda p: _sphere(p, half[:2].min()), np.array([*centre, half.mean()])
    yield _cylinder, np.array([*centre, half[:2].mean(), half[2]])
    yaw = min(np.radians(np.arange(0, 90, 2)), key=lambda yaw: float(np.prod(_extent(points, yaw)[1])))
    middle, size = _extent(points, yaw)
    yield _box, np.array([*middle, centre[2], *size, half[2], yaw])
    for count in (1, 2, 3):
        yield _capsules, _row(points, count)


def _sphere(p: Array, most: float) -> Parts:
    """A sphere with a radius of at most `most`: it must not be wider than the scan, so that fingers fit around it."""
    return (Sphere(type="sphere", centre=_vector(p[:3]), radius=min(_size(p[3]), most)),)


def _cylinder(p: Array) -> Parts:
    return (Cylinder(type="cylinder", centre=_vector(p[:3]), radius=_size(p[3]), half_height=_size(p[4])),)


def _box(p: Array) -> Parts:
    size = (_size(p[3]), _size(p[4]), _size(p[5]))
    return (Box(type="box", centre=_vector(p[:3]), half_size=size, yaw_deg=round(math.degrees(p[6]), 2)),)


def _capsules(p: Array) -> Parts:
    """A row of capsules, from the places (x, y, z) of all joints, and then a radius for each capsule."""
    count = (len(p) - 3) // 4
    joints, radii = p[: 3 * count + 3].reshape(-1, 3), p[3 * count + 3 :]
    return tuple(
        Capsule(type="capsule", start=_vector(joints[k]), end=_vector(joints[k + 1]), radius=_size(radii[k]))
        for k in range(count)
    )


def _extent(points: Array, yaw: float) -> tuple[Array, Array]:
    """Centre (x, y) and half-size of the rectangle around points seen from above, turned by `yaw`."""
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    low, high = np.percentile(points[:, :2] @ turn.T, (0.5, 99.5), axis=0)
    return (low + high) / 2 @ turn, (high - low) / 2


def _row(points: Array, count: int) -> Array:
    """Numbers to start the fit of a row of capsules with: slices of equal length along the longest horizontal axis."""
    centre = points.mean(axis=0)
    along = np.linalg.svd(points[:, :2] - centre[:2], full_matrices=False)[2][0]
    across = np.array([-along[1], along[0]])
    t, w = ((points[:, :2] - centre[:2]) @ axis for axis in (along, across))
    first, end = np.percentile(t, (0.2, 99.8))
    edges = np.linspace(first, end, count + 1)
    length = edges[-1] - edges[0]
    joints, radii = list[Array](), list[float]()

    def place(t: float, w: float, z: float) -> Array:
        return np.array([*(centre[:2] + t * along + w * across), z])

    for k in range(count):
        inside = (t >= edges[k]) & (t <= edges[k + 1])
        (w0, w1), (z0, z1) = (np.percentile(value[inside], (1, 99)) for value in (w, points[:, 2]))
        radii.append((w1 - w0 + z1 - z0) / 4)
        start = edges[k] + (min(radii[k], length / 2) if k == 0 else 0)
        joints.append(place(start, (w0 + w1) / 2, (z0 + z1) / 2))
        last = place(max(start + 1e-3, edges[-1] - radii[k]), (w0 + w1) / 2, (z0 + z1) / 2)
    return np.concatenate([*joints, last, radii])


@dataclass(frozen=True)
class _Shape:
    """Numbers of a shape, and how far points are from its surface (n,)."""

    make: Make
    points: Array
    numbers: Array

    @cached_property
    def distance(self) -> Array:
        return signed_distance(self.make(self.numbers), self.points)

    @property
    def cost(self) -> float:
        return float(self.distance @ self.distance)

    @cached_property
    def _slope(self) -> Array:
        """Derivative (n, k) of the distances by the numbers, by small differences."""
        nudged = (replace(self, numbers=self.numbers + nudge).distance for nudge in _NUDGE * np.eye(len(self.numbers)))
        return np.column_stack([(distance - self.distance) / _NUDGE for distance in nudged])

    @property
    def normal(self) -> Array:
        return self._slope.T @ self._slope

    @property
    def gradient(self) -> Array:
        return -self._slope.T @ self.distance


class _ShapeProblem(LeastSquares[Array, _Shape]):
    """Least squares of points' distances from a shape, over the shape's numbers."""

    def __init__(self, make: Make, points: Array) -> None:
        self._make, self._points = make, points

    def linearized(self, state: Array, before: _Shape | None) -> _Shape:
        return _Shape(self._make, self._points, state)

    def moved(self, state: Array, step: Array) -> Array:
        return state + step

    def settled(self, state: Array, known: _Shape, step: Array, gain: Array) -> bool:
        return bool(0 < gain < _NO_GAIN * known.cost)


def _laid(parts: Parts, ground: float) -> Parts:
    """The parts on the ground: what nearly touches it is moved to touch it, and nothing is below it."""
    laid: list[Primitive] = []
    for part in parts:
        match part:
            case Sphere():
                laid.append(part.model_copy(update={"centre": (*part.centre[:2], ground + part.radius)}))
            case Capsule():
                ends = {key: getattr(part, key) for key in ("start", "end")}
                for key, (x, y, z) in ends.items():
                    if z - part.radius - ground < _LAID:
                        ends[key] = (x, y, ground + part.radius)
                laid.append(part.model_copy(update=ends))
            case Cylinder():
                top = part.centre[2] + part.half_height
                half = (top - ground) / 2
                laid.append(part.model_copy(update={"centre": (*part.centre[:2], ground + half), "half_height": half}))
            case Box():
                half = (part.centre[2] + part.half_size[2] - ground) / 2
                size = (*part.half_size[:2], half)
                laid.append(part.model_copy(update={"centre": (*part.centre[:2], ground + half), "half_size": size}))
            case _:
                laid.append(part)
    return tuple(laid)


def _vector(p: Sequence[float] | Array) -> tuple[float, float, float]:
    return float(p[0]), float(p[1]), float(p[2])


def _size(value: float) -> float:
    return max(float(abs(value)), 1e-4)
