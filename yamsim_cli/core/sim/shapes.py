"""Where MuJoCo's geoms lie and how much room they take, exactly."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from ..geometry.loft import Surface
from ..geometry.se3 import Array, pose_from_quat

_GEOM = mujoco.mjtGeom

# Points on a round geom, around and from end to end.
_AROUND, _RISE = 24, 7


def geom_bounds(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Array:
    """The lowest and highest corner (2, 3) in `world` of the block along its axes that encloses a geom."""
    R, at, size = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom], model.geom_size[geom]
    match model.geom_type[geom]:
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
            points = _vertices(model, geom) @ R.T + at
            return np.array([points.min(axis=0), points.max(axis=0)])
    return np.array([at - half, at + half])


def body_block(model: mujoco.MjModel, geoms: Sequence[int]) -> Array:
    """The lowest and highest corner (2, 3) of the block along a body's axes that encloses some of its geoms."""
    blocks = np.array([_geom_block(model, geom, *_pose(model, geom)) for geom in geoms])
    return np.array([blocks[:, 0].min(axis=0), blocks[:, 1].max(axis=0)])


def geom_points(model: mujoco.MjModel, geoms: Sequence[int], count: int) -> Array:
    """Points (count, 3), spread evenly over the room that geoms of one body take, in the body's frame.

    What several geoms share counts once. The points are the same for the same geoms.
    """
    placed = [(geom, _pose(model, geom)) for geom in geoms]
    low, high = body_block(model, geoms)
    found: list[Array] = []
    drawn, kept = 0, 0
    while kept < count and drawn < 200 * count:
        points = low + _halton(drawn, 4 * count) * (high - low)
        drawn += len(points)
        inside = np.zeros(len(points), bool)
        for geom, (R, at) in placed:
            inside |= _inside(model, geom, (points - at) @ R)
        found.append(points[inside])
        kept += int(inside.sum())
    points = np.concatenate(found)[:count]
    # A thing of hardly any volume, such as a sheet: its middle has to do.
    return points if len(points) else np.array([(low + high) / 2])


def geom_surface(model: mujoco.MjModel, geom: int) -> Surface:
    """Points (n, 3) on a geom in its body's frame, and its triangles where it is a mesh."""
    T = pose_from_quat(model.geom_pos[geom], model.geom_quat[geom])
    faces = np.zeros((0, 3), np.int32)
    size = model.geom_size[geom]
    match model.geom_type[geom]:
        case _GEOM.mjGEOM_MESH | _GEOM.mjGEOM_SDF:
            mesh = model.geom_dataid[geom]
            start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            points = model.mesh_vert[start : start + count].astype(float)
            start, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
            faces = model.mesh_face[start : start + count]
        case _GEOM.mjGEOM_BOX:
            points = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
        case _GEOM.mjGEOM_CYLINDER:
            points = np.concatenate([_circle(size[0], z) for z in (-size[1], size[1])])
        case _:
            half = size[1] if model.geom_type[geom] == _GEOM.mjGEOM_CAPSULE else 0.0
            rise = np.linspace(0, np.pi / 2, _RISE)
            cap = np.concatenate([_circle(size[0] * np.cos(a), half + size[0] * np.sin(a)) for a in rise])
            points = np.concatenate([cap, cap * [1, 1, -1]])
    return points @ T[:3, :3].T + T[:3, 3], faces


def _pose(model: mujoco.MjModel, geom: int) -> tuple[Array, Array]:
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, model.geom_quat[geom])
    return R.reshape(3, 3), model.geom_pos[geom].copy()


def _geom_block(model: mujoco.MjModel, geom: int, R: Array, at: Array) -> Array:
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    middle, reach = R @ centre + at, np.abs(R) @ half
    return np.array([middle - reach, middle + reach])


def _inside(model: mujoco.MjModel, geom: int, points: Array) -> Array:
    """Whether points (n, 3) in a geom's own frame lie in it."""
    size, x, y, z = model.geom_size[geom], *points.T
    match model.geom_type[geom]:
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
            # A mesh collides as its convex hull; its block is what is known of it without more work.
            centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
            found = (np.abs(points - centre) <= half).all(axis=1)
    inside: Array = found
    return inside


def _vertices(model: mujoco.MjModel, geom: int) -> Array:
    mesh = int(model.geom_dataid[geom])
    first, number = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices: Array = model.mesh_vert[first : first + number].astype(float)
    return vertices


def _halton(start: int, count: int) -> Array:
    """Evenly spread points (count, 3) of the unit cube: Halton's sequence of the bases 2, 3 and 5, from one on."""
    columns = []
    for base in (2, 3, 5):
        numbers, value, share = np.arange(start + 1, start + count + 1), np.zeros(count), 1.0
        for _ in range(math.ceil(math.log(start + count + 1, base)) + 1):
            share /= base
            value += share * (numbers % base)
            numbers //= base
        columns.append(value)
    return np.column_stack(columns)


def _circle(radius: float, z: float) -> Array:
    angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(_AROUND, z)])
