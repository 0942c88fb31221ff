"""ROS: a camera_info file of each camera, and commands that publish the poses.

Sources: ros-perception/image_common f6e4ab6, `camera_calibration_parsers/src/parse_yml.cpp` (keys);
`sensor_msgs/distortion_models.hpp` (names of the lens models); ros2/geometry2 04e7636,
`tf2_ros/src/static_transform_broadcaster_program.cpp` (m, quaternion x y z w, pose of the child frame in the parent).
"""

from __future__ import annotations

import shlex

import numpy as np

from ...core.config.rig import RigConfig
from ...core.files.documents.yaml_document import dump_yaml
from ...core.files.resources import Locations
from ...core.geometry.se3 import Array, pose_from_quat, quat_from_rotation
from ..calibration_file import CalibratedCamera, CalibratedWristCamera, Calibration
from .format_files import FormatFiles, measured_right_base, padded_coefficients, second_arm, wrist_camera_misfit

_PLUMB_BOB = 5  # coefficients: k1 k2 p1 p2 k3
_RATIONAL = 8  # coefficients: those, and k4 k5 k6; OpenCV's further ones are thin-prism and tilt terms
TRANSFORMS_FILE = "static_transforms.sh"


def write_ros(calibration: Calibration, rig: RigConfig, locations: Locations) -> FormatFiles:
    """Return `CAMERA.yaml` of each camera, and `static_transforms.sh`.

    The frames are `ARM_base`, `ARM_flange`, and `CAMERA_optical_frame` with OpenCV's axes.
    """
    files: dict[str, str] = {}
    left_out: list[str] = []
    commands: list[str] = []
    base = f"{calibration.reference}_base"
    parents: list[tuple[CalibratedCamera | CalibratedWristCamera, str]] = [
        *((camera, base) for camera in calibration.cameras),
        *((camera, f"{camera.arm}_flange") for camera in calibration.wrist_cameras),
    ]
    for camera, parent in parents:
        if reason := _misfit(camera):
            left_out.append(f"ros: camera {camera.name}: {reason}")
            continue
        files[f"{camera.name}.yaml"] = _camera_info(camera)
        T = pose_from_quat(camera.position, camera.quat)
        commands.append(_static_transform(T, parent, f"{camera.name}_optical_frame"))
    arm = second_arm(calibration)
    if arm is not None:
        T_right, reason = measured_right_base(calibration)
        if T_right is None:
            left_out.append(f"ros: transform to {arm.name}_base: {reason}")
        else:
            commands.append(_static_transform(T_right, base, f"{arm.name}_base"))
    if commands:
        lines = [
            "#!/bin/sh",
            "# Publishes the calibrated poses until it is stopped.",
            # Ends the whole process group: `ros2 run` may not pass signals to its child.
            "trap 'trap - INT TERM; kill 0' INT TERM",
        ]
        files[TRANSFORMS_FILE] = "\n".join([*lines, *(f"{command} &" for command in commands), "wait", ""])
    return FormatFiles(files, tuple(left_out))


def _misfit(camera: CalibratedCamera | CalibratedWristCamera) -> str:
    if any(camera.distortion[_RATIONAL:]):
        return "its lens has thin-prism or tilt terms, which camera_info does not have"
    return wrist_camera_misfit(camera) if isinstance(camera, CalibratedWristCamera) else ""


def _camera_info(camera: CalibratedCamera | CalibratedWristCamera) -> str:
    K = np.array(camera.K, dtype=np.float64)
    rational = any(camera.distortion[_PLUMB_BOB:_RATIONAL])
    coefficients = padded_coefficients(camera.distortion, _RATIONAL if rational else _PLUMB_BOB)
    data = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": camera.name,
        "camera_matrix": _matrix(K),
        "distortion_model": "rational_polynomial" if rational else "plumb_bob",
        "distortion_coefficients": _matrix(np.array([coefficients], dtype=np.float64)),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(np.hstack([K, np.zeros((3, 1))])),
    }
    return dump_yaml(data)


def _matrix(values: Array) -> dict[str, object]:
    rows, columns = values.shape
    return {"rows": rows, "cols": columns, "data": values.ravel().tolist()}


def _static_transform(T: Array, parent: str, child: str) -> str:
    w, *xyz = quat_from_rotation(T[:3, :3])
    values = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), (*T[:3, 3], *xyz, w), strict=True))
    numbers = " ".join(f"--{key} {float(value)!r}" for key, value in values.items())
    frames = f"--frame-id {shlex.quote(parent)} --child-frame-id {shlex.quote(child)}"
    return f"ros2 run tf2_ros static_transform_publisher {numbers} {frames}"
