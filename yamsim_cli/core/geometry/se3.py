"""Rigid transforms as 4 x 4 matrices.

`T_a_in_b` is the pose of frame a in frame b: `p_b = T_a_in_b @ p_a`, so `T_a_in_c = T_b_in_c @ T_a_in_b`. Quaternions
have the order wxyz. Units are m and rad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# x, y and z, m, and the yaw about +z, rad.
UprightPose = tuple[float, float, float, float]

_IDENTITY = np.eye(4)


def pose(position: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike | None = None) -> Array:
    """Return a pose (4, 4) from a position (3,) and a rotation matrix (3, 3)."""
    T = _IDENTITY.copy()
    T[:3, 3] = position
    if rotation is not None:
        T[:3, :3] = rotation
    return T


def rotation_z(angle: float) -> Array:
    """Return the rotation (3, 3) by `angle` about +z."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def pose_from_quat(position: ArrayLike, quat: ArrayLike) -> Array:
    """Return a pose (4, 4) from a position (3,) and a quaternion (4,), not zero, which need not be normalized."""
    q = np.asarray(quat, dtype=np.float64)
    norm = float(np.linalg.norm(q))
    if norm == 0.0:
        raise ValueError("a zero quaternion is not a rotation")
    w, x, y, z = q / norm
    return pose(
        position,
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ],
    )


def quat_from_rotation(rotation: ArrayLike) -> Array:
    """Return the unit quaternion (4,) of a rotation (3, 3), with w >= 0.

    Shepperd's method is accurate near 180 degrees too.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.asarray(rotation, dtype=np.float64).tolist()
    squares = (1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz)
    products = (
        (squares[0], zy - yz, xz - zx, yx - xy),
        (zy - yz, squares[1], yx + xy, xz + zx),
        (xz - zx, yx + xy, squares[2], zy + yz),
        (yx - xy, xz + zx, zy + yz, squares[3]),
    )
    q = np.array(products[squares.index(max(squares))])
    q /= np.linalg.norm(q)
    return -q if q[0] < 0 else q


def invert_pose(T: ArrayLike) -> Array:
    """Return the inverse pose: `T_b_in_a` of `T_a_in_b`."""
    matrix = np.asarray(T, dtype=np.float64)
    R = matrix[:3, :3].T
    return pose(-R @ matrix[:3, 3], R)


def rotation_vector(rotation: ArrayLike) -> Array:
    """Return the rotation vector (3,) of a rotation (3, 3): the axis times the angle, 0..pi rad."""
    w, *xyz = quat_from_rotation(rotation)
    vector = np.asarray(xyz)
    length = float(np.linalg.norm(vector))
    if length < 1e-12:
        return 2.0 * vector
    return vector * (2.0 * math.atan2(length, w) / length)


def rotation_from_vector(vector: Sequence[float] | Array) -> Array:
    """Return the rotation (3, 3) of a rotation vector (3,), rad."""
    v = np.asarray(vector, dtype=np.float64)
    angle = float(np.linalg.norm(v))
    if angle < 1e-12:
        return np.eye(3)
    half = angle / 2
    return pose_from_quat((0, 0, 0), np.concatenate([[math.cos(half)], math.sin(half) * v / angle]))[:3, :3]


def rotation_between(start: ArrayLike, end: ArrayLike) -> Array:
    """Return the smallest rotation (3, 3) that turns a unit vector (3,) onto another one."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    normal, cosine = np.cross(a, b), float(a @ b)
    sine = float(np.linalg.norm(normal))
    if sine < 1e-9:
        if cosine > 0:
            return np.eye(3)
        normal = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])  # opposite vectors: any axis across them
    return rotation_from_vector(normal / np.linalg.norm(normal) * math.atan2(sine, cosine))


def interpolate_rotation(start: ArrayLike, end: ArrayLike, fraction: float) -> Array:
    """Return the rotation (3, 3) at a `fraction` of the shortest arc from `start` to `end`."""
    R0, R1 = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    return R0 @ rotation_from_vector(fraction * rotation_vector(R0.T @ R1))


def tilt_angle(rotation: ArrayLike) -> float:
    """Return the angle, rad, between the z axes of a rotated frame and of its reference frame."""
    return math.acos(min(1.0, max(-1.0, float(np.asarray(rotation)[2, 2]))))


def yaw(T: ArrayLike) -> float:
    """Return the heading of a pose's x axis in the xy plane of the reference frame, rad."""
    matrix = np.asarray(T)
    return math.atan2(float(matrix[1, 0]), float(matrix[0, 0]))
