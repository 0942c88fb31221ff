"""Checks that poses are rigid, in metres and in the room, and that cameras' matrices are plausible."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...geometry.camera import project
from ...geometry.se3 import Array, inverse
from .motion import Named
from .problem import Problems

# Largest entry of R R^T - 1, and largest det R - 1, of a rotation. float32 leaves 1e-6, rounding to three digits 1e-3.
_RIGID = 2e-3

# Largest coordinate of a pose, m: larger than any room. Millimetres taken for metres are far beyond.
_ROOM_M = 20.0

# How far a principal point may be from the image's centre, as a share of the width or height. Lenses are off by a few
# per cent, and a matrix of another image size by more than this.
_OFF_CENTRE = 0.1

# Smallest and largest focal length as a share of the image's width: fields of view from 150 degrees to 6.
_FOCAL = (0.13, 10.0)


def check_pose(key: str, poses: Mapping[int, Array], name: Named, problems: Problems) -> None:
    """Note poses (4, 4) under `key`, by frame, that are not rigid transforms in metres."""
    numbers = sorted(poses)
    T = np.array([poses[k] for k in numbers], dtype=np.float64)
    if not len(T):
        return
    R = T[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        skewed = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        determinant = np.linalg.det(R)
    for k, off, det, rows in zip(numbers, skewed, determinant, T, strict=True):
        if not off <= _RIGID or not abs(det - 1) <= _RIGID:
            value = f"{key}: R R^T is off by {off:.2g}, det R is {det:.3g}"
            problems.add("pose.rotation", name(k), value, "orthonormal, det R = 1", about=key)
        if not np.array_equal(rows[3], (0, 0, 0, 1)):
            value = f"{key}: {' '.join(f'{entry:g}' for entry in rows[3])}"
            problems.add("pose.row", name(k), value, about=key)
        if (distance := float(np.abs(rows[:3, 3]).max())) > _ROOM_M:
            problems.add("pose.far", name(k), f"{key}: {distance:.4g} m", f"within {_ROOM_M:g} m", about=key)


def check_intrinsics(
    key: str, matrices: Mapping[int, Array], size: tuple[int, int] | None, name: Named, problems: Problems
) -> None:
    """Note matrices (3, 3) under `key`, by frame, that are no camera matrices, or do not fit images of this size."""
    for k, K in sorted(matrices.items()):
        (fx, skew, cx), (zero, fy, cy), last = np.asarray(K, dtype=np.float64)
        if skew or zero or not np.array_equal(last, (0, 0, 1)) or min(fx, fy) <= 0:
            rows = "; ".join(" ".join(f"{entry:g}" for entry in row) for row in K)
            problems.add("camera.intrinsics", name(k), f"{key}: {rows}", "fx 0 cx; 0 fy cy; 0 0 1", about=key)
            continue
        if size is None:
            continue
        width, height = size
        off_x, off_y = abs(cx - (width - 1) / 2) / width, abs(cy - (height - 1) / 2) / height
        if max(off_x, off_y) > _OFF_CENTRE:
            value, valid = (
                f"{key}: principal point {cx:.1f}, {cy:.1f}",
                f"near {(width - 1) / 2:g}, {(height - 1) / 2:g}",
            )
            problems.add("camera.fit", name(k), f"{value} in {width}x{height}", valid, about=key)
        elif not _FOCAL[0] * width <= fx <= _FOCAL[1] * width or not 0.8 <= fx / fy <= 1.25:
            value, valid = (
                f"{key}: focal length {fx:.4g}, {fy:.4g} px",
                f"{_FOCAL[0] * width:.0f} to {_FOCAL[1] * width:.0f}",
            )
            problems.add("camera.fit", name(k), f"{value} in {width}x{height}", f"{valid}, alike", about=key)


def check_view(
    camera: str,
    values: Mapping[int, Mapping[str, Any]],
    points: list[str],
    size: tuple[int, int] | None,
    problems: Problems,
) -> None:
    """Note a camera that sees none of the poses `points` in any image of the episode.

    This finds extrinsics that are inverted, or in another frame. All poses must have passed the other checks.
    """
    if size is None or not points:
        return
    judged = 0
    for frame in values.values():
        K, T_cam_in_base = frame.get(f"intrinsics[{camera}]"), frame.get(f"extrinsics[{camera}]")
        if K is None or T_cam_in_base is None or any(key not in frame for key in points):
            continue
        judged += 1
        positions = np.array([frame[key][:, 3] for key in points], dtype=np.float64)
        in_cam = (inverse(T_cam_in_base) @ positions.T).T[:, :3]
        in_front = in_cam[in_cam[:, 2] > 0.01]
        if len(in_front):
            pixels = project(K, in_front)
            if bool(((pixels >= -0.5) & (pixels < np.array(size) - 0.5)).all(axis=1).any()):
                return
    if judged:
        problems.add(
            "camera.view", f"rgb/{camera}", ", ".join(points), f"at least one in its {size[0]}x{size[1]} image"
        )
