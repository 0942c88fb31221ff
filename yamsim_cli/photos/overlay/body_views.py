"""Render which body of an arm a camera sees at each pixel, and how joints move it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel, Intrinsics
from yamsim_cli.core.geometry.se3 import Array, pose

from .rendered_arms import _CAMERA, ArmPicture, ArmRenderer

_VISIBLE_GROUPS = 3  # geom groups 0, 1 and 2 are drawn
_NO_ARM = 0  # label of the background, and body id of MuJoCo's world
_POINT_SEED = 0  # of the sampled surface points


@dataclass(frozen=True)
class BodyPicture:
    """The arms' bodies in an ideal pinhole picture.

    Attributes:
        bodies: (height, width), the visible body's id, 0 for the background.
        depth: (height, width), its z in the camera frame, m.
        fine_bodies: the same as `bodies` with `step` times the rows and columns, of which each `step`-th lies on a
            pixel's centre.
    """

    bodies: NDArray[np.uint8]
    depth: NDArray[np.float32]
    fine_bodies: NDArray[np.uint8]
    step: int


@dataclass(frozen=True)
class JointAxes:
    """The joints of one arm in the camera frame: points `anchors` (dof, 3), m, on unit `axes` (dof, 3)."""

    anchors: Array
    axes: Array


class BodyRenderer(ArmRenderer):
    """Renders the arms' bodies for photos of one camera, at the photos' resolution.

    Attributes:
        arm_of_body: index of the arm (nbody,) to which each body belongs; -1 for none.
        moved_by: whether a joint moves a body, by arm: (dof, nbody).
    """

    def __init__(
        self, rig: RigConfig, scene: SceneConfig, quality: RenderConfig, camera: CameraModel, locations: Locations
    ) -> None:
        super().__init__(rig, scene, quality, camera, locations)
        model = self._model
        numbers = {root: k for k, root in enumerate(self._roots)}
        self.arm_of_body = np.array([numbers.get(int(root), -1) for root in model.body_rootid])
        self._joints = [
            np.array([model.joint(arm.prefix + name).id for name in arm.robot.joint_names]) for arm in rig.arms
        ]
        self.moved_by = [np.array([self._is_below(int(model.jnt_bodyid[j])) for j in ids]) for ids in self._joints]
        self._label_of_geom = np.where(self.arm_of_body >= 0, np.arange(model.nbody), _NO_ARM)[model.geom_bodyid]
        self._label_of_geom = self._label_of_geom.astype(np.uint8)

    def _is_below(self, body: int) -> NDArray[np.bool_]:
        below = np.zeros(self._model.nbody, dtype=bool)
        below[body] = True
        for other in range(body + 1, self._model.nbody):  # MuJoCo numbers parents before their children
            below[other] |= below[self._model.body_parentid[other]]
        return below

    @property
    def intrinsics(self) -> Intrinsics:
        """The camera of `body_picture` and `undistort_photo`, at a focal scale of 1."""
        return self._warp.coarse_intrinsics

    def set_focal_scale(self, scale: float) -> None:
        """Render with a focal length of `scale` times the camera's."""
        half = math.tan(self._warp.fovy / 2) / scale
        self._model.cam_fovy[self._model.camera(_CAMERA).id] = math.degrees(2 * math.atan(half))

    def body_picture(self) -> BodyPicture:
        """Render bodies and depth for the poses of `set_poses`."""
        no_flex = np.zeros(self._model.nflex, np.uint8)
        fine, depth = self._renderer.render_labels_and_depth(self._data, _CAMERA, self._label_of_geom, no_flex)
        warp = self._warp
        return BodyPicture(
            warp.coarse_picture(fine), warp.coarse_picture(depth), warp.cut_to_view(fine), warp.supersample
        )

    def arm_picture(self) -> ArmPicture:
        """Render colours and arms' labels for the poses of `set_poses`, without lens distortion."""
        labels = (self.arm_of_body + 1)[self.body_picture().bodies].astype(np.uint8)
        return ArmPicture(self._warp.coarse_picture(self._renderer.render(self._data, _CAMERA)), labels)

    def joint_axes(self) -> list[JointAxes]:
        """Return each arm's joints for the poses of `set_poses`."""
        return [JointAxes(self._data.xanchor[ids].copy(), self._data.xaxis[ids].copy()) for ids in self._joints]

    def flange_pose(self, arm: int) -> Array:
        """Return the pose (4, 4) of an arm's flange in the camera frame for the poses of `set_poses`."""
        config = self._rig.arms[arm]
        body = self._model.body(config.prefix + config.robot.flange).id
        return pose(self._data.xpos[body], self._data.xmat[body].reshape(3, 3))

    def body_poses(self) -> Array:
        """Return all bodies' poses (nbody, 4, 4) in the camera frame, m."""
        pairs = zip(self._data.xpos, self._data.xmat, strict=True)
        return np.array([pose(position, rotation.reshape(3, 3)) for position, rotation in pairs])

    def surface_points(self, spacing: float) -> list[Array]:
        """Return random points (n, 3) on the visible surface of each body, in its frame, `spacing` m apart."""
        model, rng = self._model, np.random.default_rng(_POINT_SEED)
        points: list[list[Array]] = [[] for _ in range(model.nbody)]
        for geom in range(model.ngeom):
            if model.geom_group[geom] >= _VISIBLE_GROUPS or self._label_of_geom[geom] == _NO_ARM:
                continue
            own = self._geom_points(geom, spacing, rng)
            rotation = np.zeros(9)
            mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
            points[int(model.geom_bodyid[geom])].append(own @ rotation.reshape(3, 3).T + model.geom_pos[geom])
        return [np.concatenate(parts) if parts else np.zeros((0, 3)) for parts in points]

    def _geom_points(self, geom: int, spacing: float, rng: np.random.Generator) -> Array:
        model, mesh = self._model, int(self._model.geom_dataid[geom])
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH or mesh < 0:
            # A primitive: points in its bounding box.
            centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
            sides = 8 * float(half[0] * half[1] + half[1] * half[2] + half[0] * half[2])
            inside: Array = centre + rng.uniform(-1, 1, (max(4, round(sides / spacing**2)), 3)) * half
            return inside
        vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]].astype(np.float64)
        faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        count = max(4, round(float(areas.sum()) / spacing**2))
        chosen = rng.choice(len(faces), count, p=areas / areas.sum())
        u, v = np.sqrt(rng.uniform(size=(count, 1))), rng.uniform(size=(count, 1))
        found: Array = (1 - u) * a[chosen] + u * (1 - v) * b[chosen] + u * v * c[chosen]
        return found
