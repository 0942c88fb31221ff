"""Rigs: which arms stand where, with which gripper, board and mount."""

from __future__ import annotations

import itertools
import math
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat, StringConstraints, ValidationInfo, model_validator

from ..geometry.board import Board
from ..geometry.se3 import Array, pose, pose_from_quat, rotation_z
from .base import Config, ConflictError, Name, Quaternion, Vector
from .units import FieldOfView, Heading, OffsetPoint, PlacePoint, Within, as_recorded

# The base mesh's frame in body `arm`. Board and mount positions are given in it. Source: MuJoCo Menagerie i2rt_yam.
T_BASE_MESH_IN_ARM = pose_from_quat((0.0, 0.0, -0.0006), (1.0, 0.0, 0.0, 1.0))


# On a printed mount, in the base mesh's frame. So near to that frame's origin is the arm: less was given in metres.
_OnMount = Annotated[FiniteFloat, Within("mm", -2000, 2000)]
_LEAST_MM = 1.0


def _clear_of_the_arm(value: tuple[float, float, float], info: ValidationInfo) -> tuple[float, float, float]:
    if 0 < math.hypot(*value) < _LEAST_MM and not as_recorded(info):
        meant = ", ".join(f"{1000 * part:g}" for part in value)
        raise ValueError(f"lies {math.hypot(*value):.2g} mm from the base; is it in m? Then give [{meant}]")
    return value


def _thick(value: tuple[float, float], info: ValidationInfo) -> tuple[float, float]:
    low, high = value
    if high - low < _LEAST_MM and not as_recorded(info):
        meant = f"; is it in m? Then give [{1000 * low:g}, {1000 * high:g}]" if high > low else ""
        raise ValueError(f"a mount is at least {_LEAST_MM:g} mm wide, and this is {high - low:.3g}{meant}")
    return value


_BoardPoint = Annotated[tuple[_OnMount, _OnMount, _OnMount], AfterValidator(_clear_of_the_arm)]
_Side = Annotated[tuple[_OnMount, _OnMount], AfterValidator(_thick)]


class BasePose(Config):
    """A base's pose: position in metres, heading in degrees about +z."""

    position: PlacePoint = (0.0, 0.0, 0.0)
    yaw_deg: Heading = 0.0

    @property
    def T(self) -> Array:
        """The pose (4, 4)."""
        return pose(self.position, rotation_z(math.radians(self.yaw_deg)))


class WristCamera(Config):
    """A camera on `link_6`: its position (m) and the axes of its OpenCV frame (x right, y down, z forward) there."""

    position: OffsetPoint
    x_axis: Vector
    y_axis: Vector
    fovy_deg: Annotated[FieldOfView, Field(gt=1, lt=179)]


class BoardConfig(Config):
    """A fiducial board beside an arm's base.

    Attributes:
        marker_length_mm: as printed; measure yours and set it.
        gap_mm: between markers, as printed.
        position_mm, quat: of the `board` frame (origin at the centre, z out of the paper) in the base mesh's frame.
    """

    name: Name
    first_id: int = Field(ge=0)
    columns: int = Field(ge=1, le=50)
    rows: int = Field(ge=1, le=50)
    dictionary: Annotated[str, StringConstraints(pattern=r"^DICT_\w+$")]
    marker_length_mm: Annotated[FiniteFloat, Within("mm", 2, 500)]
    gap_mm: Annotated[FiniteFloat, Within("mm", 0.1, 500)]
    position_mm: _BoardPoint
    quat: Quaternion = (1.0, 0.0, 0.0, 0.0)

    @property
    def board(self) -> Board:
        """Its measures, in metres."""
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
    def T_board_in_arm(self) -> Array:
        """Pose (4, 4) of the `board` frame in body `arm`."""
        return T_BASE_MESH_IN_ARM @ pose_from_quat(np.asarray(self.position_mm) / 1000, self.quat)

    @model_validator(mode="after")
    def _flat(self) -> BoardConfig:
        normal = self.T_board_in_arm[:3, 2]
        if normal[2] < 1 - 1e-6:
            shown = ", ".join(f"{part:.3g}" for part in normal)
            raise ValueError(
                f"board {self.name!r} does not lie flat on its base: its normal is ({shown}), not (0, 0, 1); mend quat"
            )
        return self


class MountConfig(Config):
    """The printed plate that carries a board, in the base mesh's frame.

    Attributes:
        stl: the user's own mesh (millimetres, base mesh's frame); without, a plain plate of the same outline is drawn.
        x_mm, y_mm, z_mm: the outline's extent; `mirror_x` mirrors it, or the mesh, at x = 0.
    """

    name: str
    stl: str | None = None
    mirror_x: bool = False
    x_mm: _Side
    y_mm: _Side
    z_mm: _Side


class ArmConfig(Config):
    """One arm of a rig.

    Attributes:
        name: unique in the rig.
        side: which hand it is; names its wrist camera.
        prefix: put before every name of the arm's in a scene, such as `arm2_`; unique in the rig.
        model, gripper: the MJCF `robot_models/<model>/yam_<gripper>.xml`.
        grasp_offset: height of `grasp_site` over `link_6` along the gripper in metres; None keeps the model's 0.1347.
        base: where the base stands, from its place in the rig.
    """

    name: Name
    side: Literal["left", "right"]
    prefix: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_]*$")] = ""
    model: Literal["i2rt_yam"] = "i2rt_yam"
    gripper: Literal["crank", "linear_4310"] = "crank"
    base: BasePose = BasePose()
    grasp_offset: Annotated[FiniteFloat, Within("m", 0.01, 0.5)] | None = None
    wrist_camera: WristCamera
    board: BoardConfig | None = None
    mount: MountConfig | None = None

    @property
    def wrist_camera_name(self) -> str:
        """The name its wrist camera's images are recorded under."""
        return f"{self.side}_wrist_camera"


class RigConfig(Config):
    """The arms of a station. Source of the figures: see each file in `configs/rigs/`.

    Attributes:
        margin: distance between the places of neighbouring arms along world y, m. The places are centred on the world's
            origin, the first arm the rightmost.
    """

    name: Name
    margin: Annotated[FiniteFloat, Within("m", 0, 3)] = 0.0
    arms: tuple[ArmConfig, ...] = Field(min_length=1, max_length=2)

    @property
    def span(self) -> float:
        """Distance between the places of the outermost arms, m; 0 for a lone one."""
        return (len(self.arms) - 1) * self.margin

    @property
    def recorded(self) -> tuple[int, ...]:
        """Numbers of the arms in the order in which recordings hold them: the left one first."""
        return tuple(sorted(range(len(self.arms)), key=lambda k: self.arms[k].side))

    def place_y(self, arm: int) -> float:
        """Where an arm's place is along world y, m."""
        return (arm - (len(self.arms) - 1) / 2) * self.margin

    def T_base_in_world(self, arm: int) -> Array:
        """Pose (4, 4) of an arm's base."""
        return pose((0.0, self.place_y(arm), 0.0)) @ self.arms[arm].base.T

    @model_validator(mode="after")
    def _distinct(self) -> RigConfig:
        for one, other in itertools.combinations(self.arms, 2):
            for key in ("name", "prefix", "side"):
                if getattr(one, key) == getattr(other, key):
                    raise ValueError(f"two arms have the same {key} {getattr(one, key)!r}; each needs its own")
            if one.board and other.board and (shared := set(one.board.board.ids) & set(other.board.board.ids)):
                raise ValueError(
                    f"boards {one.board.name!r} and {other.board.name!r} share the marker ids "
                    f"{min(shared)}..{max(shared)}; give each board ids of its own"
                )
        if len(self.arms) > 1 and self.margin <= 0:
            raise ConflictError(
                f"margin {self.margin} is not valid: {len(self.arms)} arms need a distance above 0 m", ("margin",)
            )
        return self
