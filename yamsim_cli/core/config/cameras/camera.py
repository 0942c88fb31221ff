"""The config of a calibrated camera; `camera_files` reads the file formats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field, field_validator, model_validator

from ...files.documents.config_base import Config
from ...files.documents.yaml_document import Document
from ...geometry.camera import CameraModel
from .camera_files import cameras_in_file, read_camera

Row = tuple[float, float, float]

_COEFFICIENT_COUNTS = (0, 4, 5, 8, 12, 14)  # valid numbers of distortion coefficients in OpenCV's model


class CameraConfig(Config):
    """A calibrated pinhole camera with OpenCV's distortion.

    Attributes:
        K: camera matrix (3, 3), px; pixel centres are at whole numbers.
        distortion: 0, 4, 5, 8, 12 or 14 coefficients in OpenCV's order.
        width, height: size of the calibration images, px.
        focal_sigma: relative standard deviation of the focal length.
    """

    width: int = Field(ge=16, le=16384)
    height: int = Field(ge=16, le=16384)
    K: tuple[Row, Row, Row]
    distortion: tuple[float, ...] = ()
    focal_sigma: float = Field(default=0.003, ge=0, le=0.5)

    @property
    def camera_model(self) -> CameraModel:
        """The same camera as a `CameraModel`, which projects points."""
        return CameraModel(self.width, self.height, self.K, self.distortion, self.focal_sigma)

    @field_validator("K", mode="before")
    @classmethod
    def _three_by_three(cls, value: Any) -> Any:
        if isinstance(value, list) and len(value) == 9 and not any(isinstance(part, list) for part in value):
            value = [value[k : k + 3] for k in (0, 3, 6)]
        is_matrix = isinstance(value, list | tuple) and len(value) == 3
        if not is_matrix or not all(isinstance(row, list | tuple) and len(row) == 3 for row in value):
            raise ValueError("K must have 3 x 3 numbers: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
        return value

    @model_validator(mode="after")
    def _check_plausible(self) -> CameraConfig:
        (fx, skew, cx), (left, fy, cy), last = self.K
        # OpenCV would silently ignore a skew.
        if last != (0.0, 0.0, 1.0) or left != 0.0 or skew != 0.0:
            raise ValueError("K must have the form [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
        if fx <= 0 or fy <= 0:
            raise ValueError(f"the focal lengths {fx:g} and {fy:g} must be above 0 px")
        # These bounds accept a phone's zoom and a fisheye, and refuse a K of another image size or in millimetres.
        longer = max(self.width, self.height)
        if not 0.2 * longer < min(fx, fy) <= max(fx, fy) < 20 * longer:
            raise ValueError(f"K does not fit images of {self.width} x {self.height}: its focal length is {fx:g} px")
        if not (0 <= cx < self.width and 0 <= cy < self.height):
            raise ValueError(
                f"K does not fit images of {self.width} x {self.height}: its principal point is ({cx:g}, {cy:g})"
            )
        across, down = 2 * (cx + 0.5) / self.width, 2 * (cy + 0.5) / self.height
        if abs(across - down) < 0.1 and abs(across + down - 2) > 0.4:
            raise ValueError(
                f"K does not fit images of {self.width} x {self.height}: its principal point ({cx:g}, {cy:g}) is the "
                f"middle of images of about {round(2 * cx)} x {round(2 * cy)}"
            )
        if len(self.distortion) not in _COEFFICIENT_COUNTS:
            raise ValueError(f"distortion has {len(self.distortion)} numbers; OpenCV's model has 0, 4, 5, 8, 12 or 14")
        return self

    @classmethod
    def read_document(cls, path: Path) -> Document:
        """Return one camera of a calibration file of yamsim, OpenCV, ROS, Kalibr or raiden. Raises as `read_camera`."""
        return read_camera(path)

    @classmethod
    def config_paths_in_file(cls, path: Path) -> tuple[Path, ...]:
        """Return `FILE:CAMERA` for each named camera in a file. Raises as `cameras_in_file`."""
        return cameras_in_file(path)
