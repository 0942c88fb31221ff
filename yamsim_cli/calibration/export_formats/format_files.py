"""Shared parts of the writers of calibration files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...core.geometry.se3 import Array
from ..calibration_file import CalibratedArm, CalibratedWristCamera, Calibration
from ..uncertainty import is_base_measured
from ..wrist_fit import is_wrist_camera_measured


@dataclass(frozen=True)
class FormatFiles:
    """Files of one format.

    Attributes:
        files: relative name -> text; empty if the calibration does not fit the format.
        left_out: one line for each thing that the files do not contain, with the reason.
    """

    files: dict[str, str]
    left_out: tuple[str, ...] = ()


def second_arm(calibration: Calibration) -> CalibratedArm | None:
    """Return the right arm; None if there is a single arm."""
    return next((arm for arm in calibration.arms if arm.name != calibration.reference), None)


def measured_right_base(calibration: Calibration) -> tuple[Array | None, str]:
    """Return the pose (4, 4) of the right arm's base in the left one's, m, or None and the reason."""
    arm = second_arm(calibration)
    if arm is None:
        return None, "the calibration has a single arm"
    if not is_base_measured(arm.position_95_mm, arm.rotation_95_deg):
        return None, (
            f"the base of {arm.name} is not measured ({_interval(arm)}): calibrate with a camera that sees both arms"
        )
    return arm.T_base_in_reference, ""


def wrist_camera_misfit(camera: CalibratedWristCamera) -> str:
    """Return why a wrist camera's pose is not written; empty if the pictures measured it."""
    if is_wrist_camera_measured(camera.position_95_mm, camera.rotation_95_deg):
        return ""
    return f"its pose is not measured ({_interval(camera)}): calibrate with more pictures, or in a higher resolution"


def _interval(body: CalibratedArm | CalibratedWristCamera) -> str:
    return f"95 % interval {max(body.position_95_mm):.1f} mm, {max(body.rotation_95_deg):.2f} degrees"


def padded_coefficients(distortion: Sequence[float], count: int) -> list[float]:
    """Return the first `count` lens coefficients in OpenCV's order, with zeros for missing ones."""
    return [float(value) for value in (*distortion, *[0.0] * count)[:count]]
