"""Rigs: which arms stand where, with which gripper."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from ..geometry.se3 import Array, pose, rotation_z
from .base import Config, Name, Positive, Vector


class BasePose(Config):
    """Where an arm's base stands in `world`: position in metres, heading in degrees about +z."""

    position: Vector = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0

    @property
    def T_base_in_world(self) -> Array:
        """The base pose (4, 4)."""
        return pose(self.position, rotation_z(math.radians(self.yaw_deg)))


class WristCamera(Config):
    """A camera on `link_6`: its position (m) and the axes of its OpenCV frame (x right, y down, z forward) there."""

    position: Vector
    x_axis: Vector
    y_axis: Vector
    fovy_deg: float = Field(gt=1, lt=179)


class ArmConfig(Config):
    """One arm of a rig.

    Attributes:
        name: unique in the rig.
        side: which hand it is; names its wrist camera.
        model, gripper: the MJCF `robot_models/<model>/yam_<gripper>.xml`.
        grasp_offset: height of `grasp_site` over `link_6` along the gripper in metres; None keeps the model's 0.1347.
    """

    name: Name
    side: Literal["left", "right"]
    model: Literal["i2rt_yam"] = "i2rt_yam"
    gripper: Literal["crank"] = "crank"
    base: BasePose = BasePose()
    grasp_offset: Positive | None = None
    wrist_camera: WristCamera

    @property
    def wrist_camera_name(self) -> str:
        """The name its wrist camera's images are recorded under."""
        return f"{self.side}_wrist_camera"


class RigConfig(Config):
    """The arms of a station. Source of the figures: see each file in `configs/rigs/`."""

    name: Name
    arms: tuple[ArmConfig, ...] = Field(min_length=1, max_length=1)
