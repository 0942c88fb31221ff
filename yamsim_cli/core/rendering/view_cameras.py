"""Cameras that show a whole rig, and titles and labels in their images."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import mujoco
import numpy as np

from ..geometry.camera import Intrinsics, project_points
from ..geometry.se3 import Array, invert_pose, pose
from ..images.image import Image

_MARGIN = 0.12  # fraction of the image's width and height that stays empty around the rig
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True)
class RigView:
    """A viewing direction of a rig.

    Attributes:
        azimuth, elevation: viewing direction of the camera in MuJoCo's convention, degrees.
        fovy_deg: vertical field of view, degrees. With a narrow field the camera is far away, and the arms hide little.
        is_low_view: whether the view shows boards and bases from nearby, instead of the whole rig.
    """

    name: str
    azimuth: float
    elevation: float
    fovy_deg: float = 40.0
    is_low_view: bool = False


# At azimuth 180, the camera looks along -x, at the front of the arms. At negative elevations, it looks down.
RIG_VIEWS = (
    RigView("front", azimuth=155.0, elevation=-28.0),
    RigView("near_top", azimuth=180.0, elevation=-86.0, fovy_deg=12.0),
    RigView("low_close_up", azimuth=125.0, elevation=-14.0, is_low_view=True),
)


@dataclass(frozen=True)
class PlacedCamera:
    """A camera with its pose (4, 4) in `world` in OpenCV's convention, and its intrinsics."""

    T_cam_in_world: Array
    intrinsics: Intrinsics

    def project_point(self, point: Sequence[float] | Array) -> tuple[float, float]:
        """Return the pixel coordinates of a point (3,) in `world`, m."""
        in_cam = (invert_pose(self.T_cam_in_world) @ np.append(point, 1.0))[:3]
        u, v = project_points(self.intrinsics.K, in_cam)[0]
        return float(u), float(v)


def place_camera(view: RigView, points: Array, size: tuple[int, int]) -> PlacedCamera:
    """Place a camera with a view's direction at the least distance from which all `points` are visible.

    Args:
        points: points (n, 3) in `world`, m.
        size: width and height of the image, px.
    """
    azimuth, elevation = math.radians(view.azimuth), math.radians(view.elevation)
    forward = np.array(
        [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    )
    right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    R = np.column_stack([right, np.cross(forward, right), forward])
    intrinsics = Intrinsics.from_fovy(*size, math.radians(view.fovy_deg))
    in_cam = points @ R
    centre = (in_cam.min(axis=0) + in_cam.max(axis=0)) / 2
    # Each point requires a minimum distance of the camera. The largest of these distances is used.
    half = (1 - _MARGIN) * np.array([size[0] / 2 / intrinsics.fx, size[1] / 2 / intrinsics.fy])
    offsets = in_cam - centre
    distance = float((np.abs(offsets[:, :2]) / half - offsets[:, 2:]).max())
    return PlacedCamera(pose(R @ (centre - (0, 0, distance)), R), intrinsics)


def rig_points(model: mujoco.MjModel, data: mujoco.MjData, bodies: Sequence[int]) -> Array:
    """Return the corners (n, 3) in `world`, m, of the bounding boxes of all visible geoms of `bodies`."""
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    points = []
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] in bodies and model.geom_group[geom] <= 2:
            centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
                # A plane is infinite in physics, but is drawn with a finite size.
                centre, half = np.zeros(3), np.array([*model.geom_size[geom, :2], 0.0])
            rotation = data.geom_xmat[geom].reshape(3, 3)
            points.append(data.geom_xpos[geom] + (centre + corners * half) @ rotation.T)
    return np.concatenate(points)


def draw_labels(image: Image, texts: Mapping[str, tuple[float, float]], title: str) -> Image:
    """Return a copy of an image (height, width, 3) with a title, and with each text whose pixel lies inside."""
    labelled = image.copy()
    rows, columns = image.shape[:2]
    scale = max(0.4, rows / 900)
    inside = {text: (u, v) for text, (u, v) in texts.items() if 0 <= u < columns and 0 <= v < rows}
    for text, (u, v) in {**inside, title: (columns * 0.02, rows * 0.05)}.items():
        (width, height), base = cv2.getTextSize(text, _FONT, scale, 1)
        margin = round(6 * scale)
        x = round(min(max(u if text == title else u - width / 2, margin), columns - width - margin))
        y = round(min(max(v, height + margin), rows - base - margin))
        cv2.rectangle(
            labelled,
            (x - margin, y - height - margin),
            (x + width + margin, y + base + margin // 2),
            (245, 245, 245),
            -1,
        )
        cv2.putText(labelled, text, (x, y), _FONT, scale, (25, 25, 25), max(1, round(scale * 1.6)), cv2.LINE_AA)
    return labelled


def resize_area(image: Image, width: int, height: int) -> Image:
    """Return an image resized to `width` x `height` px by area averaging."""
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def montage(images: Sequence[Image]) -> Image:
    """Return images of equal size side by side, separated by white lines of 4 px."""
    line = np.full((images[0].shape[0], 4, 3), 255, np.uint8)
    parts = [part for image in images for part in (image, line)]
    return np.concatenate(parts[:-1], axis=1)
