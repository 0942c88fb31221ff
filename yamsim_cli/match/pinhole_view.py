"""The ideal pinhole camera that sees what a real camera sees, without its lens distortion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.geometry.camera import CameraModel, Intrinsics, opencv_from_mujoco
from ..core.geometry.se3 import Array, invert_pose, pose
from ..core.images.image import Image
from ..core.scene.cameras import WORLD_BODY, SceneCamera


@dataclass(frozen=True)
class PinholeView:
    """A camera of the simulation: square pixels, the principal point in the middle, no distortion.

    Attributes:
        camera: the real camera.
        intrinsics: of this view, in the size of the photos. The view is slightly narrower than the photo, so that the
            photo covers it.
        T_cam_in_world: pose (4, 4) in OpenCV's convention.
    """

    camera: CameraModel
    intrinsics: Intrinsics
    T_cam_in_world: Array

    @classmethod
    def of_camera(cls, camera: CameraModel, T_cam_in_world: Array) -> PinholeView:
        """Return the widest view that a camera's photo covers."""
        size = camera.width, camera.height
        K, _ = cv2.getOptimalNewCameraMatrix(
            np.array(camera.K), np.array(camera.distortion), size, 0.0, size, centerPrincipalPoint=True
        )
        focal = max(float(K[0, 0]), float(K[1, 1]))
        middle = (camera.width - 1) / 2, (camera.height - 1) / 2
        return cls(camera, Intrinsics(*size, focal, focal, *middle), T_cam_in_world)

    @property
    def fovy(self) -> float:
        """Vertical field of view, rad."""
        return 2 * math.atan(self.intrinsics.height / 2 / self.intrinsics.fy)

    @property
    def scene_camera(self) -> SceneCamera:
        """The view as a camera of a scene, named `photo`."""
        T = self.T_cam_in_world
        return SceneCamera("photo", WORLD_BODY, pose(T[:3, 3], opencv_from_mujoco(T[:3, :3])), math.degrees(self.fovy))

    def undistort(self, photo: Image, *, nearest: bool = False) -> Image:
        """Return a photo (height, width[, 3]) as this view sees it; `nearest` for labels."""
        distortion, size = np.array(self.camera.distortion), (self.camera.width, self.camera.height)
        maps = cv2.initUndistortRectifyMap(
            np.array(self.camera.K), distortion, np.eye(3), self.intrinsics.K, size, cv2.CV_32FC1
        )
        way = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
        return np.asarray(cv2.remap(photo, *maps, way, borderMode=cv2.BORDER_REPLICATE), np.uint8)

    def project(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return the pixels (n, 2) of points (n, 3) in `world`, m, and which of them are in the image."""
        T = invert_pose(self.T_cam_in_world)
        in_cam = points @ T[:3, :3].T + T[:3, 3]
        ahead = in_cam[:, 2] > 1e-3
        pixels = self.intrinsics.project(np.where(ahead[:, None], in_cam, (0.0, 0.0, 1.0)))
        inside = (pixels >= 0).all(1) & (pixels <= (self.intrinsics.width - 1, self.intrinsics.height - 1)).all(1)
        return pixels.astype(np.float32), ahead & inside
