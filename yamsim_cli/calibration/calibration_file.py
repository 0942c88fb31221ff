"""The file of a calibration, `calibration.yaml`."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from pydantic import Field

from ..core.config.cameras.camera import Row
from ..core.config.loader import parse_config
from ..core.config.rig import RigConfig
from ..core.errors import ConfigError, UsageError, suggest_similar
from ..core.files.documents.config_base import Config, Quaternion
from ..core.files.documents.yaml_document import dump_yaml
from ..core.files.resources import Locations
from ..core.geometry.camera import CameraModel
from ..core.geometry.se3 import Array, invert_pose, pose, pose_from_quat, rotation_z
from ..photos.overlay.photos import PlacedCamera

CALIBRATION_FILE = "calibration.yaml"  # in the directory of `yamsim calibrate`

Numbers3 = tuple[float, float, float]


class _CameraOnBody(Config):
    """A camera on a base or a flange.

    Attributes:
        name: of its pictures in the episodes.
        position, quat: pose of the camera's OpenCV frame (x right, y down, z forward) on the body, m.
        width, height, K, distortion: as in a camera file, px.
        k1_95: half width of the 95 % interval of the first coefficient of `distortion`, if the fit estimated it; the
            others are then 0.
        position_95_mm, rotation_95_deg: half widths of 95 % intervals along and about the body's axes.
        outline_px: median distance of the rendered outlines to the pictures' edges.
    """

    name: str
    position: Numbers3
    quat: Quaternion
    width: int
    height: int
    K: tuple[Row, Row, Row]
    distortion: tuple[float, ...] = ()
    k1_95: float | None = Field(default=None, ge=0)
    position_95_mm: Numbers3
    rotation_95_deg: Numbers3
    outline_px: float = Field(ge=0)


class CalibratedCamera(_CameraOnBody):
    """A fixed camera, in the base of `Calibration.reference`.

    Attributes:
        focal: `given`, and then moved by the fit within its error, or `estimated` without a prior value.
        focal_95_percent, delay_95_ms: half widths of 95 % intervals. The interval of a given focal length is from its
            file, or as wide as the fit moved the focal length, if that is more.
        delay_ms: pictures show the arms as they were this much before their time stamps.
        frames: pictures that the fit used.
    """

    focal: str = Field(pattern="^(given|estimated)$")
    focal_95_percent: float = Field(ge=0)
    delay_ms: float
    delay_95_ms: float = Field(ge=0)
    frames: int = Field(ge=0)

    @property
    def T_cam_in_base(self) -> Array:
        """Pose (4, 4) of the camera in the reference base."""
        return pose_from_quat(self.position, self.quat)

    @property
    def camera_model(self) -> CameraModel:
        """The camera as a model that projects points."""
        return CameraModel(self.width, self.height, self.K, self.distortion)


class CalibratedWristCamera(_CameraOnBody):
    """A wrist camera, on an arm's flange.

    Attributes:
        arm: name of the arm that carries it.
        pictures: that the fit used.
    """

    arm: str
    pictures: int = Field(ge=0)


class CalibratedArm(Config):
    """An arm of the rig.

    Attributes:
        position, quat: pose of its base in the base of `Calibration.reference`, m.
        joint_offsets_deg: measured minus true joints. That of the first joint is 0: an offset of it looks like a turn
            of the base.
        base_body_turn_deg: turn of the base body about the z axis of the frame `position`, `quat`. It equals the
            measured minus the true first joint, which `joint_offsets_deg` has as 0.
        base_body_turn_95_deg: half width of its 95 % interval; None in files of older versions, which lack the turn.
        joint_offsets_estimated: whether the pictures determine each offset; if not, its interval is mostly that of the
            assumption.
    """

    name: str
    position: Numbers3
    quat: Quaternion
    position_95_mm: Numbers3
    rotation_95_deg: Numbers3
    joint_offsets_deg: tuple[float, ...]
    joint_offsets_95_deg: tuple[float, ...]
    joint_offsets_estimated: tuple[bool, ...]
    base_body_turn_deg: float = 0.0
    base_body_turn_95_deg: float | None = Field(default=None, ge=0)

    @property
    def T_base_in_reference(self) -> Array:
        """Pose (4, 4) of the base in the reference base."""
        return pose_from_quat(self.position, self.quat)

    @property
    def offsets(self) -> Array:
        """Joint offsets (dof,), rad, with the base as in `T_base_in_reference`."""
        return np.radians(self.joint_offsets_deg)

    @property
    def T_base_body_in_reference(self) -> Array:
        """Pose (4, 4) of the base body in the reference base."""
        return self.T_base_in_reference @ pose(rotation=rotation_z(math.radians(self.base_body_turn_deg)))

    @property
    def base_body_offsets(self) -> Array:
        """Joint offsets (dof,), rad, with the base as in `T_base_body_in_reference`. The links stay in their places."""
        return np.radians([self.base_body_turn_deg, *self.joint_offsets_deg[1:]])


class Calibration(Config):
    """Cameras and arms of a station.

    Attributes:
        rig: name of the rig.
        reference: name of the arm in whose base all poses are given: the left or only one.
    """

    rig: str
    reference: str
    cameras: tuple[CalibratedCamera, ...]
    arms: tuple[CalibratedArm, ...]
    wrist_cameras: tuple[CalibratedWristCamera, ...] = ()

    def camera(self, name: str | None, option: str) -> CalibratedCamera:
        """Return a camera, None being the only one. Raise UsageError, which names `option`, if not exactly one fits."""
        self.require_fixed_cameras()
        names = [one.name for one in self.cameras]
        if name is None and len(names) > 1:
            raise UsageError(f"the calibration has several cameras ({', '.join(names)}); name one: {option}")
        for one in self.cameras:
            if name in (None, one.name):
                return one
        raise UsageError(f"the calibration has no camera {name!r}; {suggest_similar(str(name), names)}")

    def require_fixed_cameras(self) -> None:
        """Raise UsageError if the calibration has only wrist cameras."""
        if not self.cameras:
            raise UsageError("the calibration has only wrist cameras; calibrate a fixed camera too")

    def placed_camera(self, camera: CalibratedCamera) -> PlacedCamera:
        """Return the model of a camera with its delay, and the arms' base poses in it with their joint offsets."""
        T_reference_in_cam = invert_pose(camera.T_cam_in_base)
        bases = tuple(T_reference_in_cam @ arm.T_base_body_in_reference for arm in self.arms)
        offsets = tuple(arm.base_body_offsets for arm in self.arms)
        return PlacedCamera(camera.camera_model, bases, offsets, camera.delay_ms / 1000)

    def for_rig(self, rig: RigConfig, option: str) -> Calibration:
        """Return the calibration itself. Raise UsageError if it is of another rig, or of other arms."""
        if self.rig != rig.name:
            raise UsageError(
                f"{option}: the calibration is of rig {self.rig!r}, not {rig.name!r}; give --rig as for "
                "`yamsim calibrate`"
            )
        arms, own = ([arm.name for arm in arms] for arms in (rig.arms, self.arms))
        if arms != own:
            raise UsageError(
                f"{option}: the calibration has the arms {', '.join(own)}; rig {rig.name!r} has {', '.join(arms)}"
            )
        return self


def calibration_text(calibration: Calibration) -> str:
    """Return the YAML of a calibration."""
    return dump_yaml(calibration.model_dump(mode="json"))


def load_calibration(path: Path, locations: Locations) -> Calibration:
    """Read a calibration: a file, or the directory of `yamsim calibrate`. Raise ConfigError if it is not valid."""
    path = path / CALIBRATION_FILE if path.is_dir() else path
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise ConfigError(f"{path} cannot be read: {reason}; give a calibration.yaml of `yamsim calibrate`") from error
    return parse_config(Calibration, text, str(path), locations)


def load_placed_camera(
    path: Path,
    camera: str | None,
    rig: RigConfig,
    locations: Locations,
    *,
    option: str = "--episode-camera",
    remedy: str = "FILE:CAMERA",
) -> tuple[str, PlacedCamera]:
    """Return the name and place of a calibration's camera: that of `path`, written FILE:CAMERA, or `camera`.

    Args:
        option: flag that gives `camera`, for messages.
        remedy: flag or notation with which to choose one of several cameras, for messages.

    Raises:
        ConfigError: the calibration is not valid.
        UsageError: it is of another rig, not exactly one camera fits, or `path` names another camera than `camera`.
    """
    file, _, name = str(path).partition(".yaml:")
    if name and camera not in (None, name):
        raise UsageError(f"--calibration names camera {name!r}, and {option} {camera!r}; leave one out")
    found = load_calibration(Path(f"{file}.yaml") if name else path, locations).for_rig(rig, "--calibration")
    chosen = found.camera(name or camera, remedy)
    return chosen.name, found.placed_camera(chosen)
