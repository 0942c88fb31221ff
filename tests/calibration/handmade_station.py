"""A hand-made calibration of two arms, two fixed cameras and two wrist cameras."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tests.cli.run_cli import yamsim
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.geometry.se3 import Array, pose

RADTAN = (0.05, -0.02, 0.001, 0.002)
RATIONAL = (*RADTAN, 0.01, 0.2, 0.03, 0.004)
K = [[300.0, 0.0, 159.5], [0.0, 310.0, 119.5], [0.0, 0.0, 1.0]]


TOP_TURN, SIDE_TURN = Rotation.from_rotvec([2.9, 0.2, 0.1]), Rotation.from_rotvec([-1.4, 0.3, 0.2])
WRIST_TURN, BASE_TURN = Rotation.from_rotvec([0.1, 0.4, -0.2]), Rotation.from_euler("ZYX", [0.05, 0.0, 0.01])
T_TOP = pose((0.4, 0.1, 1.2), TOP_TURN.as_matrix())
T_SIDE = pose((0.6, -0.5, 0.5), SIDE_TURN.as_matrix())
T_WRIST = pose((0.02, 0.07, 0.03), WRIST_TURN.as_matrix())
# `grasp_site` is 0.1347 m along the flange's z, as in the model of raiden's kinematics. Its y is the flange's x.
T_FLANGE_IN_GRASP = pose((0.0, 0.0, -0.1347), Rotation.from_euler("z", 90, degrees=True).as_matrix())
T_RIGHT = pose((0.01, -0.62, 0.002), BASE_TURN.as_matrix())


def _pose_keys(T: Array) -> dict[str, Any]:
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    return {"position": T[:3, 3].tolist(), "quat": [w, x, y, z]}


def camera_on_body(name: str, T: Array, distortion: tuple[float, ...], width_mm: float = 2.0) -> dict[str, Any]:
    return {
        "name": name,
        **_pose_keys(T),
        "width": 320,
        "height": 240,
        "K": K,
        "distortion": list(distortion),
        "position_95_mm": [width_mm] * 3,
        "rotation_95_deg": [0.1, 0.1, 0.1],
        "outline_px": 0.2,
    }


def fixed_camera(name: str, T: Array, distortion: tuple[float, ...]) -> dict[str, Any]:
    figures = {"focal": "given", "focal_95_percent": 0.5, "delay_ms": 20.0, "delay_95_ms": 5.0, "frames": 40}
    return camera_on_body(name, T, distortion) | figures


def calibrated_arm(name: str, T: Array, width_mm: float) -> dict[str, Any]:
    return {
        "name": name,
        **_pose_keys(T),
        "position_95_mm": [0, width_mm, 0],
        "rotation_95_deg": [0.1, 0, 0],
        "joint_offsets_deg": [0] * 6,
        "joint_offsets_95_deg": [0] * 6,
        "joint_offsets_estimated": [False] * 6,
    }


@dataclasses.dataclass
class Station:
    """A hand-made calibration of the station's two arms in a directory, and the names of its left and right arm."""

    folder: Path
    rig: RigConfig
    left: str
    right: str

    def write(self, base_95_mm: float = 3.0, wrist_95_mm: float = 2.0, **changed: Any) -> None:
        arms = {
            self.left: calibrated_arm(self.left, np.eye(4), 0.0),
            self.right: calibrated_arm(self.right, T_RIGHT, base_95_mm),
        }
        data = {
            "rig": self.rig.name,
            "reference": self.left,
            "cameras": [fixed_camera("top", T_TOP, RADTAN), fixed_camera("side", T_SIDE, ())],
            "arms": [arms[arm.name] for arm in self.rig.arms],
            "wrist_cameras": [
                camera_on_body(f"{side}_eye", T_WRIST, RATIONAL, wrist_95_mm) | {"arm": arm, "pictures": 12}
                for side, arm in (("left", self.left), ("right", self.right))
            ],
        }
        (self.folder / "calibration.yaml").write_text(json.dumps(data | changed))

    @property
    def ros_transforms(self) -> dict[tuple[str, str], Array]:
        """Parent and child frame -> the pose (4, 4) that the files of ROS have to publish."""
        return {
            (f"{self.left}_base", "top_optical_frame"): T_TOP,
            (f"{self.left}_base", "side_optical_frame"): T_SIDE,
            (f"{self.left}_flange", "left_eye_optical_frame"): T_WRIST,
            (f"{self.right}_flange", "right_eye_optical_frame"): T_WRIST,
            (f"{self.left}_base", f"{self.right}_base"): T_RIGHT,
        }

    def export(self, *flags: str, out: str = "out") -> Any:
        return yamsim("export", "calibration", "calibration.yaml", out, "--json", *flags, cwd=self.folder)


def handmade_station(folder: Path, rig: RigConfig) -> Station:
    """Return the station of a rig with two arms; `Station.write` writes its calibration into the folder."""
    left, right = (rig.arms[k].name for k in rig.recording_order)
    return Station(folder, rig, left, right)
