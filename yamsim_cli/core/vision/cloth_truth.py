"""What a camera sees of a cloth: which of its points, and where its corners are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..dataset.truth_files import DEPTH_TOLERANCE, KeypointRecord, Visibility
from ..geometry.camera import project
from ..geometry.se3 import Array
from ..images.image import Image
from ..scene.cloth import triangles
from ..scene.compiled import SceneCloth

# A point closer than this to the camera's plane has no useful place in the image, m.
NEAREST = 0.01

_AROUND = tuple((u, v) for v in (-1, 0, 1) for u in (-1, 0, 1))


@dataclass(frozen=True)
class LabelledCloth:
    """A cloth of a scene, and how segmentation images show it.

    Attributes:
        name: of the cloth.
        label: its number in segmentation images.
        row: its place among the objects that have poses.
        scene: where its points are.
    """

    name: str
    label: int
    row: int
    scene: SceneCloth

    @property
    def corners(self) -> dict[str, int]:
        """The number of the point at each corner, by the corner's name as the flat cloth's x axis points right."""
        columns, rows = self.scene.grid
        last = columns * rows - 1
        return {
            "top_left": last + 1 - columns,
            "top_right": last,
            "bottom_right": columns - 1,
            "bottom_left": 0,
        }

    @property
    def keypoints(self) -> Iterator[KeypointRecord]:
        """What the corners are called."""
        for side in self.corners:
            yield KeypointRecord(name=f"{self.name}_{side}", body=self.name, kind="cloth")


@dataclass(frozen=True)
class ClothSeen:
    """A cloth in a picture.

    Attributes:
        visible: whether each of its points (n,) is seen.
        places: pixels of its corners (4, 2), zeros behind the camera.
        depths: distances z of its corners (4,), m; 0 behind the camera.
        visibility: of its corners (4,), see `Visibility`.
    """

    visible: NDArray[np.bool_]
    places: Array
    depths: Array
    visibility: NDArray[np.uint8]


def see_cloth(
    cloth: LabelledCloth, qpos: Array, T_world_in_cam: Array, K: Array, labels: Image, depth_mm: NDArray[np.uint16]
) -> ClothSeen:
    """What a picture shows of a cloth.

    Args:
        qpos: MuJoCo's positions (nq,).
        labels, depth_mm: the picture's labels and distances (height, width).
    """
    points = cloth.scene.points(qpos) @ T_world_in_cam[:3, :3].T + T_world_in_cam[:3, 3]
    visible = _seen(points, cloth, K, labels, depth_mm)
    numbers = np.array(list(cloth.corners.values()))
    corners = points[numbers]
    before = corners[:, 2] >= NEAREST
    places, depths = np.zeros((len(corners), 2)), np.zeros(len(corners))
    places[before], depths[before] = project(K, corners[before]), corners[before, 2]
    height, width = labels.shape
    inside = before & (np.rint(places) >= 0).all(axis=1) & (np.rint(places) < (width, height)).all(axis=1)
    shown = np.where(visible[numbers], Visibility.VISIBLE, Visibility.HIDDEN)
    return ClothSeen(visible, places, depths, np.where(inside, shown, Visibility.OUTSIDE).astype(np.uint8))


def drawn_sides(points: Array, corners: NDArray[np.int_], radius: float) -> tuple[Array, Array]:
    """The points (n, 3) of the two sides of a sheet as MuJoCo draws them: each point is moved by half the thickness
    along the mean of the unit normals of its triangles (m, 3).
    """
    a, b, c = (points[corners[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    normals = np.zeros_like(points)
    np.add.at(normals, corners.ravel(), np.repeat(across, 3, axis=0))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return points + radius * normals, points - radius * normals


def _seen(
    points: Array, cloth: LabelledCloth, K: Array, labels: Image, depth_mm: NDArray[np.uint16]
) -> NDArray[np.bool_]:
    """Which points (n, 3), in the camera's frame, are visible: where a pixel at the point's place shows the cloth, at
    the depth of the plane of a triangle that meets there and faces the camera. At the sheet's rim half the pixels show
    what is behind: there a neighbouring pixel counts too.
    """
    (columns, rows), corners = cloth.scene.grid, triangles(*cloth.scene.grid)
    number = np.arange(len(points))
    rim = np.isin(number % columns, (0, columns - 1)) | np.isin(number // columns, (0, rows - 1))
    visible = np.zeros(len(points), bool)
    for side, facing in zip(drawn_sides(points, corners, cloth.scene.radius), (1.0, -1.0), strict=True):
        a, b, c = (side[corners[:, k]] for k in range(3))
        normals = facing * np.cross(b - a, c - a)
        # How far each plane is from the camera, against its normal: below 0 where it faces the camera.
        offsets = np.einsum("ij,ij->i", normals, a)
        faces, ends = np.repeat(np.flatnonzero(offsets < 0), 3), corners[offsets < 0].ravel()
        before = side[ends, 2] >= NEAREST
        faces, ends = faces[before], ends[before]
        at = np.rint(project(K, side[ends])).astype(np.int64)
        for beside in _AROUND:
            u, v = (at + beside).T
            counts = (u >= 0) & (v >= 0) & (u < labels.shape[1]) & (v < labels.shape[0])
            if any(beside):
                counts &= rim[ends]
            u, v, face = u[counts], v[counts], faces[counts]
            rays = np.column_stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(len(u))])
            slant = np.einsum("ij,ij->i", normals[face], rays)
            apart = np.abs(offsets[face] - depth_mm[v, u] / 1000.0 * slant)
            shown = (labels[v, u] == cloth.label) & (apart <= DEPTH_TOLERANCE * np.abs(slant))
            visible[ends[counts][shown]] = True
    return visible
