"""raiden's `calibration_results.json`.

Source: TRI-ML/raiden 2353b10, `docs/guide/calibration.md` and `raiden/calibration/runner.py` (keys, five coefficients
of a lens, poses in m with OpenCV's axes). `export.raiden_frames` defines the frame of each pose.
"""

from __future__ import annotations

import json
from typing import Any

from ...core.config.rig import ArmConfig, RigConfig
from ...core.expert.planning.arm_kinematics import ArmKinematics
from ...core.files.resources import Locations
from ...core.geometry.se3 import Array, invert_pose, pose_from_quat
from ...core.scene.arm_model import kinematic_model
from ...export.raiden_frames import (
    WRIST_CAMERAS,
    bimanual_transform,
    calibration_document,
    camera_entry,
    scene_camera,
    wrist_camera,
)
from ..calibration_file import CalibratedCamera, CalibratedWristCamera, Calibration
from .format_files import FormatFiles, measured_right_base, padded_coefficients, wrist_camera_misfit

RESULTS_FILE = "calibration_results.json"
_SOURCE = "yamsim calibrate"
_COEFFICIENTS = 5  # k1 k2 p1 p2 k3, the least that raiden writes


def write_raiden(calibration: Calibration, rig: RigConfig, locations: Locations) -> FormatFiles:
    """Return `calibration_results.json`: fixed cameras in the left base, wrist cameras in their arm's `grasp_site`.

    A single arm is the left one. Wrist cameras are named `left_wrist_camera` and `right_wrist_camera`.
    """
    left_out: list[str] = []
    cameras: dict[str, Any] = {}
    for fixed in calibration.cameras:
        cameras[fixed.name] = scene_camera(_entry(fixed, fixed.frames), fixed.T_cam_in_base)
    arms = {rig.arms[k].name: (number, rig.arms[k]) for number, k in enumerate(rig.recording_order)}
    for camera in calibration.wrist_cameras:
        number, arm = arms[camera.arm]
        name = WRIST_CAMERAS[number]
        reason = f"the file has another camera {name}" if name in cameras else wrist_camera_misfit(camera)
        if reason:
            left_out.append(f"raiden: camera {camera.name}: {reason}")
            continue
        T = invert_pose(_grasp_in_flange(arm)) @ pose_from_quat(camera.position, camera.quat)
        cameras[name] = wrist_camera(name, number, _entry(camera, camera.pictures), T, _SOURCE)
    data = calibration_document(cameras, "yamsim")
    if len(calibration.arms) > 1:
        T_right, reason = measured_right_base(calibration)
        if T_right is None:
            left_out.append(f"raiden: bimanual_transform: {reason}")
        else:
            data["bimanual_transform"] = bimanual_transform(T_right, computed_from_calibration=True)
    if not cameras and "bimanual_transform" not in data:
        return FormatFiles({}, tuple(left_out))
    return FormatFiles({RESULTS_FILE: json.dumps(data, indent=2) + "\n"}, tuple(left_out))


def _entry(camera: CalibratedCamera | CalibratedWristCamera, pictures: int) -> dict[str, Any]:
    distortion = padded_coefficients(camera.distortion, max(_COEFFICIENTS, len(camera.distortion)))
    return camera_entry(camera.K, distortion, (camera.width, camera.height), _SOURCE, pictures)


def _grasp_in_flange(arm: ArmConfig) -> Array:
    """Return the pose (4, 4) of `grasp_site` on the flange, where the site `tool` is, m."""
    kinematics = ArmKinematics(kinematic_model(arm))
    joints = [0.0] * arm.robot.dof
    return invert_pose(kinematics.T_site_in_base(joints, "tool")) @ kinematics.T_grasp_in_base(joints)
