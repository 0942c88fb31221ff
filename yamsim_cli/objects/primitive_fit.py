"""Fit collision primitives to scans: solids by least squares, floor and rings to the inside of vessels."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..core.config.objects.primitives import Box, Capsule, Cylinder, Primitive, Ring, Sphere
from ..core.geometry.closed_surface import sphere_directions
from ..core.geometry.se3 import Array
from ..core.geometry.shape_generators.generated_shape import simplify_polyline
from ..core.geometry.stl import Faces, decode_stl
from ..core.geometry.surface_distance import sample_surface
from ..least_squares import LeastSquares, solve_least_squares
from .primitives import signed_distance

_SAMPLES = 6000  # points of a surface; another random sample changes no fit by more than 0.1 mm

_PARAMETER_COST = 3e-4  # m, cost of each parameter of a shape: a shape with more must fit that much better
_DIMPLE_DEPTH = 0.0015  # m; points deeper under all tangent planes lie in a dimple, and are left out of a fit
_TANGENT_PLANES = 600  # number of tangent planes around the points, in directions spread over the sphere
_GROUND_SNAP_DISTANCE = 0.004  # m; a capsule's end with less clearance from the ground is moved to the ground
_MAX_STEPS = 30  # iterations of a fit
_DIFFERENCE_STEP = 1e-5  # step of the finite differences in each parameter, m or rad
_MIN_COST_REDUCTION = 1e-6  # relative reduction of the cost below which a fit stops

_MIN_INSIDE_DEPTH_SHARE = 0.3  # depth of a vessel's inside over its height
_MAX_OUT_OF_ROUND = 0.004  # m, a vessel's radius from the middle of its range
_MAX_INNER_DESCENT = 0.006  # m, descent of a vessel's inner surface from middle to rim
_PROFILE_DIRECTIONS = 64  # directions from the opening's middle in which the inside is measured
_TOLERANCES = (0.0008, 0.0012, 0.002, 0.003, 0.005)  # m, of a simplified profile, tried in order
_MAX_SEGMENTS = 6  # of a vessel's profile
_BOXES_PER_RING = 24  # boxes per ring in collisions
_MIN_WALL = 0.002  # m, of a ring; objects could pass through thinner walls

Parts = tuple[Primitive, ...]
MakeParts = Callable[[Array], Parts]  # parameters of a shape -> primitives


@dataclass(frozen=True)
class Scan:
    """Points sampled evenly from a surface; equal surfaces give equal points.

    Attributes:
        points: (n, 3), m.
        normals: outward, (n, 3).
        wall: thickness of a thin shell, m: twice the volume over the area.
    """

    points: Array
    normals: Array
    wall: float

    @classmethod
    def from_stl(cls, stl: bytes) -> Scan:
        """Read a binary STL in metres. Raises `ResourceError`."""
        return cls.from_mesh(*decode_stl(stl))

    @classmethod
    def from_mesh(cls, vertices: Array, faces: Faces) -> Scan:
        """Scan triangles (m, 3) over vertices (n, 3), m."""
        a, b, c = np.moveaxis(vertices[faces], 1, 0)
        normals = np.cross(b - a, c - a)
        twice = np.linalg.norm(normals, axis=1)
        normals /= np.where(twice > 0, twice, 1)[:, None]
        points, chosen = sample_surface((vertices, faces), _SAMPLES, np.random.default_rng(0))
        volume = float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6
        # The volume's sign corrects opposite triangles.
        return cls(points, normals[chosen] * np.sign(volume), 4 * abs(volume) / float(twice.sum()))

    @property
    def lowest_height(self) -> float:
        """Height of the lowest point, m."""
        return float(self.points[:, 2].min())


@dataclass(frozen=True)
class SolidFit:
    """Primitives fitted to a scan, with rms and 99th percentile of its distances, m."""

    parts: Parts
    rms: float
    p99: float


def evaluate_fit(parts: Parts, points: Array) -> SolidFit:
    """Measure how given primitives fit surface points (n, 3), m."""
    distance = np.abs(signed_distance(parts, points))
    return SolidFit(parts, float(np.sqrt(np.mean(distance**2))), float(np.percentile(distance, 99)))


def fit_solid(points: Array) -> SolidFit:
    """Fit points (n, 3), m, by a sphere, cylinder, box, or row of up to three capsules.

    Dimples and holes, such as an apple's, are ignored.
    """
    points = _without_dimples(points)
    best: tuple[float, SolidFit] | None = None
    for make, start in _solid_candidates(points):
        fitted = solve_least_squares(_ShapeProblem(make, points), start, _MAX_STEPS)
        assert fitted is not None  # the distances are defined everywhere
        parts = _extend_to_ground(make(fitted[0]), float(points[:, 2].min()))
        fit = evaluate_fit(parts, points)
        cost = fit.rms + fit.p99 / 4 + _PARAMETER_COST * len(start)
        if best is None or cost < best[0]:
            best = cost, fit
    assert best is not None
    return best[1]


def _without_dimples(points: Array) -> Array:
    heights = points @ np.ascontiguousarray(sphere_directions(_TANGENT_PLANES).T)
    depth = (heights.max(axis=0) - heights).min(axis=1)
    near: Array = points[depth < _DIMPLE_DEPTH]
    return near


def _solid_candidates(points: Array) -> Iterator[tuple[MakeParts, Array]]:
    low, high = np.percentile(points, (0.5, 99.5), axis=0)
    centre, half = (low + high) / 2, (high - low) / 2
    yield lambda p: _spheres_from_parameters(p, half[:2].min()), np.array([*centre, half.mean()])
    yield _cylinders_from_parameters, np.array([*centre, half[:2].mean(), half[2]])
    yaw = min(np.radians(np.arange(0, 90, 2)), key=lambda yaw: float(np.prod(_turned_extent(points, yaw)[1])))
    middle, size = _turned_extent(points, yaw)
    yield _boxes_from_parameters, np.array([*middle, centre[2], *size, half[2], yaw])
    for count in (1, 2, 3):
        yield _capsules_from_parameters, _initial_capsules(points, count)


def _spheres_from_parameters(p: Array, maximum: float) -> Parts:
    """Limit the radius to `maximum`: fingers that fit around the scan then fit around the sphere."""
    return (Sphere(type="sphere", centre=_float_triple(p[:3]), radius=min(_positive_size(p[3]), maximum)),)


def _cylinders_from_parameters(p: Array) -> Parts:
    return (
        Cylinder(
            type="cylinder", centre=_float_triple(p[:3]), radius=_positive_size(p[3]), half_height=_positive_size(p[4])
        ),
    )


def _boxes_from_parameters(p: Array) -> Parts:
    size = (_positive_size(p[3]), _positive_size(p[4]), _positive_size(p[5]))
    return (Box(type="box", centre=_float_triple(p[:3]), half_size=size, yaw_deg=round(math.degrees(p[6]), 2)),)


def _capsules_from_parameters(p: Array) -> Parts:
    """Return capsules from positions (x, y, z) of their shared ends, then a radius each."""
    count = (len(p) - 3) // 4
    joints, radii = p[: 3 * count + 3].reshape(-1, 3), p[3 * count + 3 :]
    return tuple(
        Capsule(
            type="capsule",
            start=_float_triple(joints[k]),
            end=_float_triple(joints[k + 1]),
            radius=_positive_size(radii[k]),
        )
        for k in range(count)
    )


def _turned_extent(points: Array, yaw: float) -> tuple[Array, Array]:
    """Return centre (x, y) and half size (2,), m, of the bounding rectangle seen from above, turned by `yaw`, rad."""
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    low, high = np.percentile(points[:, :2] @ turn.T, (0.5, 99.5), axis=0)
    return (low + high) / 2 @ turn, (high - low) / 2


def _initial_capsules(points: Array, count: int) -> Array:
    """Return initial capsules: equal slices along the longest horizontal axis."""
    centre = points.mean(axis=0)
    along = np.linalg.svd(points[:, :2] - centre[:2], full_matrices=False)[2][0]
    across = np.array([-along[1], along[0]])
    t, w = ((points[:, :2] - centre[:2]) @ axis for axis in (along, across))
    first, end = np.percentile(t, (0.2, 99.8))
    edges = np.linspace(first, end, count + 1)
    length = edges[-1] - edges[0]
    joints, radii = list[Array](), list[float]()

    def horizontal_point(t: float, w: float, z: float) -> Array:
        return np.array([*(centre[:2] + t * along + w * across), z])

    for k in range(count):
        inside = (t >= edges[k]) & (t <= edges[k + 1])
        (w0, w1), (z0, z1) = (np.percentile(value[inside], (1, 99)) for value in (w, points[:, 2]))
        radii.append((w1 - w0 + z1 - z0) / 4)
        start = edges[k] + (min(radii[k], length / 2) if k == 0 else 0)
        joints.append(horizontal_point(start, (w0 + w1) / 2, (z0 + z1) / 2))
        last = horizontal_point(max(start + 1e-3, edges[-1] - radii[k]), (w0 + w1) / 2, (z0 + z1) / 2)
    return np.concatenate([*joints, last, radii])


@dataclass(frozen=True)
class _LinearizedShape:
    """A shape with given parameters, and signed distances (n,) of points from it."""

    make: MakeParts
    points: Array
    parameters: Array

    @cached_property
    def distance(self) -> Array:
        return signed_distance(self.make(self.parameters), self.points)

    @property
    def cost(self) -> float:
        return float(self.distance @ self.distance)

    @cached_property
    def _jacobian(self) -> Array:
        """Derivatives (n, k) of the distances by the parameters, by finite differences."""
        steps = _DIFFERENCE_STEP * np.eye(len(self.parameters))
        nudged = (replace(self, parameters=self.parameters + step).distance for step in steps)
        return np.column_stack([(distance - self.distance) / _DIFFERENCE_STEP for distance in nudged])

    @property
    def normal_matrix(self) -> Array:
        return self._jacobian.T @ self._jacobian

    @property
    def right_hand_side(self) -> Array:
        return -self._jacobian.T @ self.distance


class _ShapeProblem(LeastSquares[Array, _LinearizedShape]):
    """Least squares of points' distances from a shape, over the shape's parameters."""

    def __init__(self, make: MakeParts, points: Array) -> None:
        self._make, self._points = make, points

    def linearize(self, state: Array, before: _LinearizedShape | None) -> _LinearizedShape:
        return _LinearizedShape(self._make, self._points, state)

    def apply_step(self, state: Array, step: Array) -> Array:
        return state + step

    def is_converged(self, state: Array, known: _LinearizedShape, step: Array, gain: Array) -> bool:
        return bool(0 < gain < _MIN_COST_REDUCTION * known.cost)


def _extend_to_ground(parts: Parts, ground: float) -> Parts:
    """Move or extend parts to the ground; a capsule's end only if near or below it."""
    laid: list[Primitive] = []
    for part in parts:
        match part:
            case Sphere():
                laid.append(part.model_copy(update={"centre": (*part.centre[:2], ground + part.radius)}))
            case Capsule():
                ends = {key: getattr(part, key) for key in ("start", "end")}
                for key, (x, y, z) in ends.items():
                    if z - part.radius - ground < _GROUND_SNAP_DISTANCE:
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


def _float_triple(p: Sequence[float] | Array) -> tuple[float, float, float]:
    return float(p[0]), float(p[1]), float(p[2])


def _positive_size(value: float) -> float:
    return max(float(abs(value)), 1e-4)


def fit_vessel(scan: Scan) -> tuple[SolidFit, tuple[float, float]] | None:
    """Fit a floor and rings to a round, upright vessel; None if the scan is none.

    Returns:
        The fit, with origin on the axis at height 0 of the scan, and the axis (x, y), m.
    """
    low, high = np.percentile(scan.points, (0.2, 99.8), axis=0)
    axis = (low[:2] + high[:2]) / 2
    points = scan.points - [*axis, 0]
    radius = np.hypot(points[:, 0], points[:, 1])
    if not _is_round(points, radius):
        return None
    profile = _inner_profile(points, radius, scan.normals, float(high[2]))
    if profile is None or profile[-1, 1] - profile[0, 1] < _MIN_INSIDE_DEPTH_SHARE * (high[2] - low[2]):
        return None
    corners = next(
        found for tolerance in _TOLERANCES if len(found := simplify_polyline(profile, tolerance)) <= _MAX_SEGMENTS + 1
    )
    parts = _vessel_parts(corners, scan.lowest_height, max(scan.wall, _MIN_WALL))
    return evaluate_fit(parts, points), (float(axis[0]), float(axis[1]))


def _is_round(points: Array, radius: Array) -> bool:
    sector = ((np.arctan2(points[:, 1], points[:, 0]) + np.pi) / (2 * np.pi) * 36).astype(int) % 36
    reach = np.array([radius[sector == k].max(initial=0) for k in range(36)])
    return bool(np.ptp(reach) < 2 * _MAX_OUT_OF_ROUND)


def _inner_profile(points: Array, radius: Array, normals: Array, rim: float) -> Array | None:
    """Return radius and height (n, 2), m, of a vessel's inner surface from its middle outwards.

    None if no inner surface rises towards the rim.
    """
    outwards = np.einsum("ij,ij->i", normals[:, :2], points[:, :2]) / np.maximum(radius, 1e-9)
    inside = (normals[:, 2] > -0.1) & (outwards < 0.2)
    if not inside.any():
        return None
    # The angle seen from just above the opening orders the inside's points outwards.
    angle = np.arctan2(radius[inside], rim + 0.002 - points[inside, 2])
    bins = (angle / angle.max() * (_PROFILE_DIRECTIONS - 1)).astype(int)
    found = [(radius[inside][bins == k], points[inside, 2][bins == k]) for k in range(_PROFILE_DIRECTIONS)]
    profile = np.array([(np.median(r), np.median(z)) for r, z in found if len(r) >= 3])
    # Reject an upside-down lid, whose middle is above its edge.
    rises = len(profile) >= 8 and (np.maximum.accumulate(profile[:, 1]) - profile[:, 1]).max() < _MAX_INNER_DESCENT
    return profile if rises else None


def _vessel_parts(corners: Array, foot: float, wall: float) -> tuple[Primitive, ...]:
    top = float(corners[:2, 1].mean())
    edge = float(corners[1, 0])
    half = max((top - foot) / 2, wall / 4)
    floor = Cylinder(type="cylinder", centre=(0.0, 0.0, top - half), radius=edge, half_height=half)
    rings = [
        Ring(
            type="ring",
            # The first ring overlaps the floor, without a gap.
            inner=(float(r0 if k else edge - wall / 2), float(z0 if k else top)),
            outer=(float(r1), float(z1)),
            thickness=wall,
            segments=_BOXES_PER_RING,
        )
        for k, ((r0, z0), (r1, z1)) in enumerate(itertools.pairwise(corners[1:]))
        if r1 - r0 > 1e-5
    ]
    return (floor, *rings)
