"""raiden's `calibration_results.json`."""

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
from ..calibration_file import Calibration
from .content import FormatFiles, measured_right_base

RESULTS_FILE = "calibration_results.json"
_SOURCE = "yamsim calibrate"


def write_raiden(calibration: Calibration, rig: RigConfig, locations: Locations) -> FormatFiles:
    """Return `calibration_results.json`: fixed cameras in the left base, wrist cameras in their arm's `grasp_site`.

    A single arm is the left one. Wrist cameras are named `left_wrist_camera` and `right_wrist_camera`.
    """
    left_out: list[str] = []
    cameras: dict[str, Any] = {}
    for fixed in calibration.cameras:
        entry = camera_entry(fixed.K, fixed.distortion, (fixed.width, fixed.height), _SOURCE, fixed.frames)
        cameras[fixed.name] = scene_camera(entry, fixed.T_cam_in_base)
    arms = {rig.arms[k].name: (number, rig.arms[k]) for number, k in enumerate(rig.recording_order)}
    for camera in calibration.wrist_cameras:
        number, arm = arms[camera.arm]
        T_grasp_in_flange = _grasp_in_flange(arm)
        if T_grasp_in_flange is None:
            left_out.append(f"raiden: camera {camera.name}: {arm.robot.model} has no grasp_site")
            continue
        T = invert_pose(T_grasp_in_flange) @ pose_from_quat(camera.position, camera.quat)
        entry = camera_entry(camera.K, camera.distortion, (camera.width, camera.height), _SOURCE, camera.pictures)
        cameras[WRIST_CAMERAS[number]] = wrist_camera(WRIST_CAMERAS[number], number, entry, T, _SOURCE)
    data = calibration_document(cameras, "yamsim")
    if len(calibration.arms) > 1:
        T_right, reason = measured_right_base(calibration)
        if T_right is None:
            left_out.append(f"raiden: bimanual_transform: {reason}")
        else:
            data["bimanual_transform"] = bimanual_transform(T_right, computed_from_calibration=True)
    return FormatFiles({RESULTS_FILE: json.dumps(data, indent=2) + "\n"}, tuple(left_out))


def _grasp_in_flange(arm: ArmConfig) -> Array | None:
    kinematics = ArmKinematics(kinematic_model(arm))
    joints = [0.0] * arm.robot.dof
    try:
        return invert_pose(kinematics.T_site_in_base(joints, "tool")) @ kinematics.T_grasp_in_base(joints)
    except KeyError:  # MuJoCo: there is no such site
        return None
