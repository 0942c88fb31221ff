from __future__ import annotations

import functools
from collections.abc import Sequence

import mujoco
import numpy as np

from ..geometry.loft import Surface, concatenate_surfaces, loft
from ..geometry.se3 import Array

_GEOM = mujoco.mjtGeom

_MESH_GEOM_TYPES = (int(_GEOM.mjGEOM_MESH), int(_GEOM.mjGEOM_SDF))

_CIRCLE_SEGMENTS = 24  # of the polygon that replaces a circle; the error is less than 1 % of the radius


def geom_aabb(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Array:
    """Return a geom's lowest and highest corner (2, 3) in `world`, m."""
    R, at, size = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom], model.geom_size[geom]
    match _GEOM(model.geom_type[geom]):
        case _GEOM.mjGEOM_SPHERE:
            half = np.full(3, size[0])
        case _GEOM.mjGEOM_CAPSULE:
            half = np.abs(R[:, 2]) * size[1] + size[0]
        case _GEOM.mjGEOM_CYLINDER:
            half = np.abs(R[:, 2]) * size[1] + size[0] * np.sqrt(np.clip(1 - R[:, 2] ** 2, 0, 1))
        case _GEOM.mjGEOM_ELLIPSOID:
            half = np.linalg.norm(R * size, axis=1)
        case _GEOM.mjGEOM_BOX:
            half = np.abs(R) @ size
        case _:
            points = _mesh_vertices(model, geom) @ R.T + at
            return np.array([points.min(axis=0), points.max(axis=0)])
    return np.array([at - half, at + half])


def body_box(model: mujoco.MjModel, geoms: Sequence[int], T: Array | None = None) -> Array:
    """Return the lowest and highest corner (2, 3) of geoms of one body, m, in the frame where the body has pose `T`, by
    default its own.
    """
    boxes = []
    for geom in geoms:
        R, at = _geom_pose(model, geom)
        boxes.append(_geom_box(model, geom, *((R, at) if T is None else (T[:3, :3] @ R, T[:3, :3] @ at + T[:3, 3]))))
    return enclosing_box(boxes)


def enclosing_box(boxes: Sequence[Array]) -> Array:
    """Return the lowest and highest corner (2, 3) of all boxes (n, 2, 3)."""
    corners = np.array(boxes)
    return np.array([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])


def body_surface(model: mujoco.MjModel, geoms: Sequence[int]) -> Surface:
    """Return the triangle surface of geoms of one body in the body's frame, m; round primitives have 24 sides."""
    placed = []
    for geom in geoms:
        R, at = _geom_pose(model, geom)
        vertices, faces = _geom_surface(model, geom)
        placed.append((vertices @ R.T + at, faces))
    return concatenate_surfaces(placed)


def geom_corners(model: mujoco.MjModel, geom: int) -> Array:
    """Return points (n, 3) with the same convex hull as a geom, in its body's frame, m; circles have 24 sides."""
    R, at = _geom_pose(model, geom)
    points = (
        _mesh_vertices(model, geom)
        if model.geom_type[geom] in _MESH_GEOM_TYPES
        else np.concatenate(_primitive_loops(model, geom))
    )
    return points @ R.T + at


def geom_points(model: mujoco.MjModel, geoms: Sequence[int], count: int) -> tuple[Array, float]:
    """Return points (count, 3) spread evenly over geoms of one body, in the body's frame, m, and the volume, m3.

    Overlaps of geoms count once. The same geoms always give the same points.
    """
    placed = [(geom, _geom_pose(model, geom)) for geom in geoms]
    low, high = body_box(model, geoms)
    found: list[Array] = []
    drawn, kept = 0, 0
    while kept < count and drawn < 200 * count:
        points = low + _halton_points(drawn, 4 * count) * (high - low)
        drawn += len(points)
        inside = np.zeros(len(points), bool)
        for geom, (R, at) in placed:
            inside |= _are_inside_geom(model, geom, (points - at) @ R)
        found.append(points[inside])
        kept += int(inside.sum())
    points, volume = np.concatenate(found)[:count], max(kept, 1) / drawn * float(np.prod(high - low))
    # The centre of the box represents a body with hardly any volume, such as a sheet.
    return (points, volume) if len(points) else (np.array([(low + high) / 2]), volume)


def _geom_pose(model: mujoco.MjModel, geom: int) -> tuple[Array, Array]:
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, model.geom_quat[geom])
    return R.reshape(3, 3), model.geom_pos[geom].copy()


def _geom_box(model: mujoco.MjModel, geom: int, R: Array, at: Array) -> Array:
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    middle, reach = R @ centre + at, np.abs(R) @ half
    return np.array([middle - reach, middle + reach])


def _are_inside_geom(model: mujoco.MjModel, geom: int, points: Array) -> Array:
    size, x, y, z = model.geom_size[geom], *points.T
    match _GEOM(model.geom_type[geom]):
        case _GEOM.mjGEOM_SPHERE:
            found = (points**2).sum(axis=1) <= size[0] ** 2
        case _GEOM.mjGEOM_CAPSULE:
            along = np.clip(z, -size[1], size[1])
            found = x**2 + y**2 + (z - along) ** 2 <= size[0] ** 2
        case _GEOM.mjGEOM_CYLINDER:
            found = (x**2 + y**2 <= size[0] ** 2) & (np.abs(z) <= size[1])
        case _GEOM.mjGEOM_ELLIPSOID:
            found = ((points / size) ** 2).sum(axis=1) <= 1
        case _GEOM.mjGEOM_BOX:
            found = (np.abs(points) <= size).all(axis=1)
        case _:
            # A mesh collides as its convex hull, which its bounding box approximates.
            centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
            found = (np.abs(points - centre) <= half).all(axis=1)
    inside: Array = found
    return inside


def _geom_surface(model: mujoco.MjModel, geom: int) -> Surface:
    if model.geom_type[geom] not in _MESH_GEOM_TYPES:
        return loft(_primitive_loops(model, geom))
    mesh = int(model.geom_dataid[geom])
    first, number = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return _mesh_vertices(model, geom), model.mesh_face[first : first + number]


def _primitive_loops(model: mujoco.MjModel, geom: int) -> list[Array]:
    """Return loops of points (k, 3) on a primitive in its own frame, from its bottom to its top."""
    size, kind = model.geom_size[geom], _GEOM(model.geom_type[geom])
    if kind == _GEOM.mjGEOM_BOX:
        square = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * size[:2]
        return [np.column_stack([square, np.full(4, z)]) for z in (-size[2], size[2])]
    # All others are solids of revolution about z: radii and heights from bottom to top, then scaled along each axis.
    if kind == _GEOM.mjGEOM_CYLINDER:
        radii, heights, stretch = np.ones(2), np.array([-1.0, 1.0]), np.array([size[0], size[0], size[1]])
    else:
        up = np.linspace(-np.pi / 2, 0, _CIRCLE_SEGMENTS // 4 + 1)
        straight = size[1] / size[0] if kind == _GEOM.mjGEOM_CAPSULE else 0.0
        below = np.sin(up) - straight
        radii, heights = np.concatenate([np.cos(up), np.cos(up)[::-1]]), np.concatenate([below, -below[::-1]])
        stretch = size if kind == _GEOM.mjGEOM_ELLIPSOID else np.full(3, size[0])
    angle = 2 * np.pi * np.arange(_CIRCLE_SEGMENTS) / _CIRCLE_SEGMENTS
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    rings = zip(radii, heights, strict=True)
    return [np.column_stack([r * circle, np.full(_CIRCLE_SEGMENTS, z)]) * stretch for r, z in rings]


def _mesh_vertices(model: mujoco.MjModel, geom: int) -> Array:
    mesh = int(model.geom_dataid[geom])
    first, number = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices: Array = model.mesh_vert[first : first + number].astype(float)
    return vertices


@functools.cache
def _halton_points(start: int, count: int) -> Array:
    """Return points (count, 3) of Halton's sequence in the unit cube, with bases 2, 3 and 5, from `start` on."""
    return np.array([[mujoco.mju_Halton(k, base) for base in (2, 3, 5)] for k in range(start + 1, start + count + 1)])
