"""Rigs: arms with their poses, grippers, boards, mounts and cameras."""

from __future__ import annotations

import itertools
import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    Field,
    FiniteFloat,
    PlainSerializer,
    StringConstraints,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)

from ..files.documents.config_base import (
    Config,
    ConfigReference,
    ConflictError,
    Name,
    Quaternion,
)
from ..files.documents.units import Heading, PlacePoint, QuantityBounds, is_recorded_config
from ..geometry.board import Board
from ..geometry.se3 import Array, pose, pose_from_quat, rotation_z
from ..robots.dynamics import MeasuredArmDynamics
from ..robots.models import ArmModel, Fovy, Gripper, Modes, WristCamera, fovy_for_size
from ..robots.robot import Robot, assemble_robot

_MountCoordinate = Annotated[FiniteFloat, QuantityBounds("mm", -2000, 2000)]  # coordinate of a printed mount
_MIN_EXTENT_MM = 1.0  # mm, least size of a mount and distance of a board from the base; less was probably meant in m


def _require_point_off_base(value: tuple[float, float, float], info: ValidationInfo) -> tuple[float, float, float]:
    if 0 < math.hypot(*value) < _MIN_EXTENT_MM and not is_recorded_config(info):
        meant = ", ".join(f"{1000 * part:g}" for part in value)
        raise ValueError(f"lies {math.hypot(*value):.2g} mm from the base; is it in m? Then give [{meant}]")
    return value


def _require_nonzero_extent(value: tuple[float, float], info: ValidationInfo) -> tuple[float, float]:
    low, high = value
    if high - low < _MIN_EXTENT_MM and not is_recorded_config(info):
        meant = f"; is it in m? Then give [{1000 * low:g}, {1000 * high:g}]" if high > low else ""
        raise ValueError(
            f"a mount must be at least {_MIN_EXTENT_MM:g} mm wide, but this one is {high - low:.3g} mm{meant}"
        )
    return value


_BoardPosition = Annotated[
    tuple[_MountCoordinate, _MountCoordinate, _MountCoordinate], AfterValidator(_require_point_off_base)
]
_MountExtent = Annotated[tuple[_MountCoordinate, _MountCoordinate], AfterValidator(_require_nonzero_extent)]


class BasePose(Config):
    """Pose of an arm's base: position (m) and heading about +z (degrees)."""

    position: PlacePoint = (0.0, 0.0, 0.0)
    yaw_deg: Heading = 0.0

    @property
    def T(self) -> Array:
        """The pose as a matrix (4, 4)."""
        return pose(self.position, rotation_z(math.radians(self.yaw_deg)))


class BoardConfig(Config):
    """A fiducial board beside an arm's base.

    Attributes:
        marker_length_mm: edge of a marker, measured on the print.
        gap_mm: gap between markers, measured on the print.
        position_mm, quat: pose of the board's frame (origin in its centre, z out of the paper) in `ArmModel.base_mesh`.
    """

    name: Name
    first_id: int = Field(ge=0)
    columns: int = Field(ge=1, le=50)
    rows: int = Field(ge=1, le=50)
    dictionary: Annotated[str, StringConstraints(pattern=r"^DICT_\w+$")]
    marker_length_mm: Annotated[FiniteFloat, QuantityBounds("mm", 2, 500)]
    gap_mm: Annotated[FiniteFloat, QuantityBounds("mm", 0.1, 500)]
    position_mm: _BoardPosition
    quat: Quaternion = (1.0, 0.0, 0.0, 0.0)

    @property
    def board_in_metres(self) -> Board:
        """The board with all lengths in m."""
        return Board(
            self.name,
            self.first_id,
            self.columns,
            self.rows,
            self.dictionary,
            self.marker_length_mm / 1000,
            self.gap_mm / 1000,
        )

    @property
    def T_in_base_mesh(self) -> Array:
        """Pose (4, 4) of the board's frame in the frame `ArmModel.base_mesh`."""
        return pose_from_quat(np.asarray(self.position_mm) / 1000, self.quat)


class MountConfig(Config):
    """The printed plate that carries a board, in the frame `ArmModel.base_mesh`.

    Attributes:
        stl: file with the user's mesh (mm, in the same frame); if left out, a plain plate of the given extent is shown.
        mirror_x: whether the plate or the mesh is mirrored at x = 0.
        x_mm, y_mm, z_mm: lower and upper end of the plate along each axis.
    """

    name: str
    stl: str | None = None
    mirror_x: bool = False
    x_mm: _MountExtent
    y_mm: _MountExtent
    z_mm: _MountExtent


# Robots are dumped as their names.
_CONFIGS_DUMPED_AS_NAMES = (
    PlainSerializer(lambda robot: robot.name, return_type=str, when_used="json"),
    WithJsonSchema({"type": "string"}),
)


class ArmConfig(Config):
    """One arm of a rig.

    Attributes:
        name: name of the arm, unique in the rig.
        side: side of the arm. The wrist camera is named after this side.
        prefix: prefix of all names of the arm in a scene, such as `arm2_`; unique in the rig.
        model: a folder of `robot_models/`. A rig's file may instead name a file of identified dynamics, which contains
            the name of the model.
        dynamics: identified dynamics of this arm.
        gripper: a folder of `robot_models/grippers/` that fits the model.
        grasp_offset: distance of the site `grasp_site` from the flange along the gripper, m; default: as in its MJCF.
        base: pose of the base relative to the arm's point on the world y axis, see `RigConfig.margin`.
        wrist_camera: pose and field of view of the wrist camera; the gripper's if left out.
    """

    name: Name
    side: Literal["left", "right"]
    prefix: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_]*$")] = ""
    model: Annotated[ArmModel, ConfigReference("robots"), *_CONFIGS_DUMPED_AS_NAMES]
    gripper: Annotated[Gripper, ConfigReference("grippers"), *_CONFIGS_DUMPED_AS_NAMES]
    dynamics: Annotated[MeasuredArmDynamics | None, ConfigReference("revisions")] = None
    base: BasePose = BasePose()
    grasp_offset: Annotated[FiniteFloat, QuantityBounds("m", 0.01, 0.5)] | None = None
    wrist_camera: WristCamera
    board: BoardConfig | None = None
    mount: MountConfig | None = None

    @property
    def robot(self) -> Robot:
        """The arm with its gripper."""
        return assemble_robot(self.model, self.gripper, self.dynamics)

    @property
    def T_board_in_base(self) -> Array:
        """Pose (4, 4) of the `board` frame in the base frame, for an arm with a board."""
        assert self.board is not None
        return self.robot.T_base_mesh @ self.board.T_in_base_mesh

    @model_validator(mode="before")
    @classmethod
    def _default_wrist_camera(cls, data: Any) -> Any:
        gripper = data.get("gripper") if isinstance(data, dict) else None
        if isinstance(gripper, dict) and data.get("wrist_camera") is None:
            if gripper.get("wrist_camera") is None:
                raise ConflictError(
                    f"the gripper {gripper.get('name')} has no wrist_camera; add one to its gripper.yaml, or to the "
                    "arm in the rig",
                    ("wrist_camera",),
                )
            return {**data, "wrist_camera": gripper["wrist_camera"]}
        return data

    @model_validator(mode="after")
    def _check_arm_and_gripper_fit(self) -> ArmConfig:
        if self.dynamics is not None:
            try:
                self.dynamics.check(self.model)
            except ValueError as error:
                raise ConflictError(str(error), ("dynamics",), ("model",)) from None
        try:
            T_base_mesh = self.robot.T_base_mesh
        except ValueError as error:
            raise ConflictError(str(error), ("gripper",), ("model",)) from None
        if self.board is not None and (T := T_base_mesh @ self.board.T_in_base_mesh)[2, 2] < 1 - 1e-6:
            shown = ", ".join(f"{part:.3g}" for part in T[:3, 2])
            raise ConflictError(
                f"board {self.board.name!r} does not lie flat on its base: its normal is ({shown}), not (0, 0, 1); "
                "correct quat",
                ("board", "quat"),
            )
        return self

    @property
    def wrist_camera_name(self) -> str:
        """Name of the images that the wrist camera records."""
        return self.wrist_camera.name or f"{self.side}_wrist_camera"


class RigCamera(Config):
    """A fixed camera of a station.

    Attributes:
        name: name of the recorded images.
        arm: name of the arm whose base frame is the pose's frame; if left out, that frame is `world`.
        position, quat: pose of the camera's OpenCV frame (x right, y down, z forward), m.
        fovy_deg: vertical field of view.
        modes: image sizes at which the field of view differs from `fovy_deg`.
        housing: name of the visual model `robot_models/cameras/<housing>.xml`, in the camera's frame.
        mesh_sets: the asset sets of the housing's meshes.
    """

    name: Name
    arm: Name | None = None
    position: PlacePoint
    quat: Quaternion
    fovy_deg: Fovy
    modes: Modes = ()
    housing: Name | None = None
    mesh_sets: tuple[Name, ...] = ()

    def fovy(self, size: tuple[int, int]) -> float:
        """Return the vertical field of view of images of a size (width, height in px), degrees."""
        return fovy_for_size(size, self.fovy_deg, self.modes)


class RigConfig(Config):
    """The arms of a station. Each file in `configs/rigs/` states the sources of its figures.

    Attributes:
        margin: distance between neighbouring arms along world y, m. Each arm has a point on the world y axis, to which
            its base pose is relative. The points are centred on the origin; the first arm is the rightmost.
        cameras: fixed cameras of the station. If given, recordings have these and every wrist camera, but no scene
            camera.
    """

    name: Name
    margin: Annotated[FiniteFloat, QuantityBounds("m", 0, 3)] = 0.0
    arms: tuple[ArmConfig, ...] = Field(min_length=1, max_length=2)
    cameras: tuple[RigCamera, ...] = ()

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the station's fixed cameras, then of the wrist cameras, first the left arm's."""
        return (
            *(camera.name for camera in self.cameras),
            *(self.arms[k].wrist_camera_name for k in self.recording_order),
        )

    def T_cam_in_world(self, camera: RigCamera) -> Array:
        """Return the pose (4, 4) in `world` of the OpenCV frame of a fixed camera."""
        T = pose_from_quat(camera.position, camera.quat)
        bases = {arm.name: self.T_base_in_world(k) for k, arm in enumerate(self.arms)}
        return T if camera.arm is None else bases[camera.arm] @ T

    @property
    def arm_span(self) -> float:
        """Distance along world y between the first and the last arm, m: `margin` for two arms, 0 for one."""
        return (len(self.arms) - 1) * self.margin

    @property
    def recording_order(self) -> tuple[int, ...]:
        """Indices of the arms in the order of recordings: the left arm first."""
        return tuple(sorted(range(len(self.arms)), key=lambda k: self.arms[k].side))

    @property
    def drive_count(self) -> int:
        """Number of drives of each arm: one for each joint, and one for the fingers if any."""
        return len(self.arms[0].robot.drive_names)

    def arm_origin_y(self, arm: int) -> float:
        """Return the world y (m) of the point to which the base pose of an arm is relative."""
        return (arm - (len(self.arms) - 1) / 2) * self.margin

    def T_base_in_world(self, arm: int) -> Array:
        """Return the pose (4, 4) in `world` of an arm's base."""
        return pose((0.0, self.arm_origin_y(arm), 0.0)) @ self.arms[arm].base.T

    @model_validator(mode="after")
    def _check_arm_names_and_distance(self) -> RigConfig:
        for one, other in itertools.combinations(self.arms, 2):
            for key in ("name", "prefix", "side"):
                if getattr(one, key) == getattr(other, key):
                    raise ValueError(f"two arms have the same {key} {getattr(one, key)!r}; each needs its own")
            if (
                one.board
                and other.board
                and (shared := set(one.board.board_in_metres.marker_ids) & set(other.board.board_in_metres.marker_ids))
            ):
                raise ValueError(
                    f"boards {one.board.name!r} and {other.board.name!r} share the marker ids "
                    f"{min(shared)}..{max(shared)}; give each board ids of its own"
                )
        kinds = {(arm.robot.dof, arm.robot.fingers is None) for arm in self.arms}
        if len(kinds) > 1:
            listed = ", ".join(
                f"{arm.name} ({arm.model.name} with {arm.gripper.name}) has {arm.robot.dof} joints and "
                f"{'fingers' if arm.robot.fingers else 'no fingers'}"
                for arm in self.arms
            )
            raise ConflictError(
                f"{listed}: the arms of a rig must all have the same number of joints, and all have fingers or none; "
                "choose other models or grippers",
                ("arms",),
            )
        if len(set(self.camera_names)) < len(self.camera_names):
            raise ConflictError(f"two cameras have the same name: {', '.join(self.camera_names)}", ("cameras",))
        for camera in self.cameras:
            if camera.arm is not None and camera.arm not in (names := [arm.name for arm in self.arms]):
                valid = ", ".join(names)
                raise ConflictError(f"camera {camera.name!r}: no arm {camera.arm!r}; valid: {valid}", ("cameras",))
        if len(self.arms) > 1 and self.margin <= 0:
            raise ConflictError(
                f"margin {self.margin} is not valid: {len(self.arms)} arms need a distance above 0 m", ("margin",)
            )
        return self
