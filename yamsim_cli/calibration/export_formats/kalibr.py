"""Kalibr's camchain of the fixed cameras.

`T_cn_cnm1` transforms points of the previous camera to this one.

Source: ethz-asl/kalibr 1f60227, `kalibr_common/ConfigReader.py`: `CameraParameters`, `CameraChainParameters` and
`AslamCamera`.
"""

from __future__ import annotations

from typing import Any

from ...core.config.rig import RigConfig
from ...core.files.documents.yaml_document import dump_yaml
from ...core.files.resources import Locations
from ...core.geometry.se3 import Array, invert_pose
from ..calibration_file import CalibratedCamera, Calibration
from .format_files import FormatFiles, padded_coefficients

_RADTAN = 4  # coefficients: k1 k2 p1 p2
CAMCHAIN_FILE = "camchain.yaml"


def write_kalibr(calibration: Calibration, rig: RigConfig, locations: Locations) -> FormatFiles:
    """Return `camchain.yaml`: cam0, cam1, ... are the fixed cameras that fit, in order; `rostopic` has their names."""
    left_out = [
        f"kalibr: camera {camera.name}: it moves with {camera.arm}, and a camchain is rigid"
        for camera in calibration.wrist_cameras
    ]
    chain: dict[str, Any] = {}
    T_previous_in_base: Array | None = None
    for camera in calibration.cameras:
        if reason := _misfit(camera):
            left_out.append(f"kalibr: camera {camera.name}: {reason}")
            continue
        entry = _camera_entry(camera)
        if T_previous_in_base is not None:
            entry["T_cn_cnm1"] = (invert_pose(camera.T_cam_in_base) @ T_previous_in_base).tolist()
        T_previous_in_base = camera.T_cam_in_base
        chain[f"cam{len(chain)}"] = entry
    return FormatFiles({CAMCHAIN_FILE: dump_yaml(chain)} if chain else {}, tuple(left_out))


def _misfit(camera: CalibratedCamera) -> str:
    if any(camera.distortion[_RADTAN:]):
        return "its lens has more terms than k1 k2 p1 p2, and radtan has only these"
    if camera.K[0][1]:
        return "its matrix has skew, which a camchain does not have"
    return ""


def _camera_entry(camera: CalibratedCamera) -> dict[str, Any]:
    (fu, _, pu), (_, fv, pv), _ = camera.K
    return {
        "camera_model": "pinhole",
        "intrinsics": [float(value) for value in (fu, fv, pu, pv)],
        "distortion_model": "radtan",  # even without distortion: `AslamCamera` has no geometry with `none`
        "distortion_coeffs": padded_coefficients(camera.distortion, _RADTAN),
        "resolution": [camera.width, camera.height],
        "rostopic": f"/{camera.name}/image_raw",
    }
