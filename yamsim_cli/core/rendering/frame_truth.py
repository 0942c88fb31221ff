"""Ground truth of one image: depth, segmentation, poses, keypoints and boxes, from one segmentation rendering."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from ..dataset.ground_truth_files import DEPTH_TOLERANCE, JOINT_COVER_RADIUS, Visibility, visible_points_key
from ..geometry.camera import Intrinsics, opencv_from_mujoco
from ..geometry.se3 import Array, invert_pose, pose
from ..images.image import Image
from ..scene.cloth import grid_triangles
from .renderer import SceneRenderer
from .scene_labels import LabelledCloth, LabelledKeypoint, SceneLabels

DepthImage = NDArray[np.uint16]

_MAX_DEPTH_MM = 65535  # mm, largest depth that fits into uint16; larger depths are stored as 0
_MIN_DEPTH = 0.01  # m, depth below which a point counts as behind the camera


@dataclass(frozen=True)
class FrameTruth:
    """The ground truth of one image.

    Attributes:
        depth_mm: depth z along the camera's axis (height, width), mm; 0 for no surface or beyond 65 m.
        labels: label of the visible body at each pixel (height, width); 0 for the background.
        arrays: name -> array for poses, keypoints and boxes, as `dataset.ground_truth_files.array_specs` lists them,
            but for one frame.
    """

    depth_mm: DepthImage
    labels: Image
    arrays: dict[str, NDArray[Any]]


def measure_frame(
    data: mujoco.MjData, camera: str, renderer: SceneRenderer, scene: SceneLabels, T_base_in_world: Array
) -> FrameTruth:
    """Render and compute the ground truth of a camera's image. `data` has up-to-date poses of bodies and cameras."""
    labels, distance = renderer.render_labels_and_depth(data, camera, scene.label_of_geom, scene.label_of_flex)
    depth = depth_in_mm(distance)
    lens = renderer.intrinsics(camera)
    view = data.cam(camera)
    T_cam_in_world = pose(view.xpos, opencv_from_mujoco(view.xmat))
    T_world_in_cam = invert_pose(T_cam_in_world)
    boxes, pixels = instance_boxes(labels, scene.instance_of_label, len(scene.names.instances))
    sheets = [measure_cloth_visibility(cloth, data.qpos, T_world_in_cam, lens, labels, depth) for cloth in scene.cloths]
    corners = [(sheet.places, sheet.depths, sheet.visibility) for sheet in sheets]
    points = (_project_keypoints(scene.keypoints, data, T_world_in_cam, lens, labels, depth), *corners)
    places, depths, visibility = (np.concatenate(parts) for parts in zip(*points, strict=True))
    T_object_in_cam = _body_poses_in_camera(data, scene.objects, T_world_in_cam)
    for cloth in scene.cloths:
        T_object_in_cam[cloth.row] = T_world_in_cam @ cloth.scene.pose(data.qpos)
    arrays: dict[str, NDArray[Any]] = {
        "T_cam_in_base": invert_pose(T_base_in_world) @ T_cam_in_world,
        "T_link_in_cam": _body_poses_in_camera(data, scene.links, T_world_in_cam),
        "T_object_in_cam": T_object_in_cam,
        "keypoints": places,
        "keypoint_depth": depths,
        "visibility": visibility,
        "boxes": boxes,
        "pixels": pixels,
    }
    arrays |= {visible_points_key(cloth.name): sheet.visible for cloth, sheet in zip(scene.cloths, sheets, strict=True)}
    return FrameTruth(depth, labels, arrays)


def depth_in_mm(distance: NDArray[np.float32]) -> DepthImage:
    """Convert depths z (height, width) from m to whole mm; depths beyond 65 m become 0."""
    millimetres = np.rint(distance * 1000.0)
    return np.where(millimetres <= _MAX_DEPTH_MM, millimetres, 0).astype(np.uint16)


def _body_poses_in_camera(data: mujoco.MjData, bodies: NDArray[np.int64], T_world_in_cam: Array) -> Array:
    T = np.tile(np.eye(4), (len(bodies), 1, 1))
    T[:, :3, :3] = data.xmat[bodies].reshape(-1, 3, 3)
    T[:, :3, 3] = data.xpos[bodies]
    return T_world_in_cam @ T


def instance_boxes(
    labels: Image, instance_of: NDArray[np.int64], instances: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the smallest box (n, 4) around the visible pixels of each instance, and their number (n,).

    A box is `[x0, y0, x1, y1]`, where x1 - x0 is the width. The box of an invisible instance is all zeros.
    """
    counts = np.bincount(labels.ravel(), minlength=len(instance_of))[: len(instance_of)]
    boxes, pixels = np.zeros((instances, 4), np.int32), np.zeros(instances, np.int32)
    for k in range(instances):
        seen = np.flatnonzero((instance_of == k) & (counts > 0))
        if not len(seen):
            continue
        wanted = np.zeros(256, np.uint8)
        wanted[seen] = 1
        x, y, width, height = cv2.boundingRect(cv2.LUT(labels, wanted))
        boxes[k], pixels[k] = (x, y, x + width, y + height), counts[seen].sum()
    return boxes, pixels


def _project_keypoints(
    points: tuple[LabelledKeypoint, ...],
    data: mujoco.MjData,
    T_world_in_cam: Array,
    lens: Intrinsics,
    labels: Image,
    depth_mm: DepthImage,
) -> tuple[Array, Array, NDArray[np.uint8]]:
    """Return pixel (n, 2), depth z (n,) and visibility (n,) of each keypoint; zeros behind the camera."""
    places, depths = np.zeros((len(points), 2)), np.zeros(len(points))
    visibility = np.full(len(points), Visibility.OUTSIDE, np.uint8)
    height, width = labels.shape
    for k, point in enumerate(points):
        T = T_world_in_cam @ pose(data.xpos[point.body], data.xmat[point.body].reshape(3, 3))
        p = T[:3, :3] @ point.position + T[:3, 3]
        if p[2] < _MIN_DEPTH:
            continue
        places[k], depths[k] = lens.project(p)[0], p[2]
        u, v = np.rint(places[k])
        if 0 <= u < width and 0 <= v < height:
            normal = None if point.normal is None else T[:3, :3] @ point.normal
            seen = is_visible(point, p, normal, lens, (int(u), int(v)), labels, depth_mm)
            visibility[k] = Visibility.VISIBLE if seen else Visibility.HIDDEN
    return places, depths, visibility


def is_visible(
    point: LabelledKeypoint,
    p: Array,
    normal: Array | None,
    lens: Intrinsics,
    pixel: tuple[int, int],
    labels: Image,
    depth_mm: DepthImage,
) -> bool:
    """Return whether a keypoint at `p` (3,) in the camera's frame, m, is visible to the camera.

    A joint's centre is visible if its pixel shows one of the joint's links, at most `JOINT_COVER_RADIUS` nearer. A
    point on a surface is visible if its pixel shows its body at the depth of the tangent plane. A board's corner lies
    on the edge of the print, where half of the pixels show another surface, so its neighbouring pixels count too.

    `normal` (3,) is outward in the camera's frame, or None for a joint's centre. `pixel` is (column, row).
    """
    if normal is None:
        cover = float(p[2]) - depth_mm[pixel[1], pixel[0]] / 1000.0
        return int(labels[pixel[1], pixel[0]]) in point.labels and cover <= JOINT_COVER_RADIUS
    facing = float(normal @ p)
    if facing >= 0.0:
        return False
    reach = 1 if point.record.kind == "corner" else 0
    height, width = labels.shape
    for v in range(max(0, pixel[1] - reach), min(height, pixel[1] + reach + 1)):
        for u in range(max(0, pixel[0] - reach), min(width, pixel[0] + reach + 1)):
            if int(labels[v, u]) not in point.labels:
                continue
            ray = lens.rays((u, v))[0]
            if abs(facing / float(normal @ ray) - depth_mm[v, u] / 1000.0) <= DEPTH_TOLERANCE:
                return True
    return False


_PIXEL_NEIGHBOURS = tuple((u, v) for v in (-1, 0, 1) for u in (-1, 0, 1))  # px, a pixel and its eight neighbours


@dataclass(frozen=True)
class ClothVisibility:
    """The visibility of a cloth in an image.

    Attributes:
        visible: whether each point (n,) is visible.
        places: pixel coordinates of the corners (4, 2); 0 behind the camera.
        depths: depths z of the corners (4,), m; 0 behind the camera.
        visibility: `Visibility` of the corners (4,).
    """

    visible: NDArray[np.bool_]
    places: Array
    depths: Array
    visibility: NDArray[np.uint8]


def measure_cloth_visibility(
    cloth: LabelledCloth,
    qpos: Array,
    T_world_in_cam: Array,
    lens: Intrinsics,
    labels: Image,
    depth_mm: NDArray[np.uint16],
) -> ClothVisibility:
    """Return the visibility of a cloth at MuJoCo's positions `qpos` (nq,), in labels and depths (height, width)."""
    points = cloth.scene.points(qpos) @ T_world_in_cam[:3, :3].T + T_world_in_cam[:3, 3]
    visible = _visible_points(points, cloth, lens, labels, depth_mm)
    numbers = np.array(list(cloth.corner_point_indices.values()))
    corners = points[numbers]
    before = corners[:, 2] >= _MIN_DEPTH
    places, depths = np.zeros((len(corners), 2)), np.zeros(len(corners))
    places[before], depths[before] = lens.project(corners[before]), corners[before, 2]
    height, width = labels.shape
    inside = before & (np.rint(places) >= 0).all(axis=1) & (np.rint(places) < (width, height)).all(axis=1)
    shown = np.where(visible[numbers], Visibility.VISIBLE, Visibility.HIDDEN)
    return ClothVisibility(visible, places, depths, np.where(inside, shown, Visibility.OUTSIDE).astype(np.uint8))


def rendered_cloth_sides(points: Array, corners: NDArray[np.int_], radius: float) -> tuple[Array, Array]:
    """Return the points (n, 3) of the upper and the lower side of a cloth as MuJoCo draws them, m.

    Each point is displaced by `radius`, half the thickness, along the mean unit normal of its triangles (m, 3).
    """
    a, b, c = (points[corners[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    normals = np.zeros_like(points)
    np.add.at(normals, corners.ravel(), np.repeat(across, 3, axis=0))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return points + radius * normals, points - radius * normals


def _visible_points(
    points: Array, cloth: LabelledCloth, lens: Intrinsics, labels: Image, depth_mm: NDArray[np.uint16]
) -> NDArray[np.bool_]:
    """Return whether each point (n, 3) of a cloth, in the camera's frame, m, is visible, as (n,).

    The pixel of a visible point shows the cloth at the depth of a triangle that faces the camera and has this corner.
    At the rim, where half of the pixels show the background, each neighbouring pixel counts too.
    """
    (columns, rows), corners = cloth.scene.grid, grid_triangles(*cloth.scene.grid)
    number = np.arange(len(points))
    rim = np.isin(number % columns, (0, columns - 1)) | np.isin(number // columns, (0, rows - 1))
    visible = np.zeros(len(points), bool)
    for side, facing in zip(
        rendered_cloth_sides(points, corners, cloth.scene.half_thickness), (1.0, -1.0), strict=True
    ):
        a, b, c = (side[corners[:, k]] for k in range(3))
        normals = facing * np.cross(b - a, c - a)
        # Scaled distance of each triangle's plane from the camera, below 0 for a triangle that faces the camera.
        offsets = np.einsum("ij,ij->i", normals, a)
        faces, ends = np.repeat(np.flatnonzero(offsets < 0), 3), corners[offsets < 0].ravel()
        before = side[ends, 2] >= _MIN_DEPTH
        faces, ends = faces[before], ends[before]
        at = np.rint(lens.project(side[ends])).astype(np.int64)
        for beside in _PIXEL_NEIGHBOURS:
            u, v = (at + beside).T
            counts = (u >= 0) & (v >= 0) & (u < labels.shape[1]) & (v < labels.shape[0])
            if any(beside):
                counts &= rim[ends]
            u, v, face = u[counts], v[counts], faces[counts]
            rays = lens.rays(np.column_stack([u, v]))
            slant = np.einsum("ij,ij->i", normals[face], rays)
            apart = np.abs(offsets[face] - depth_mm[v, u] / 1000.0 * slant)
            shown = (labels[v, u] == cloth.label) & (apart <= DEPTH_TOLERANCE * np.abs(slant))
            visible[ends[counts][shown]] = True
    return visible
