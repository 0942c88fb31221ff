"""Files of other programs with a calibration, read back by their readers."""

from __future__ import annotations

import configparser
import dataclasses
import json
import math
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tests.cli.run_cli import yamsim
from yamsim_cli.core.config.cameras.camera_files import read_camera
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose, pose_from_quat, rotation_from_vector
from yamsim_cli.core.geometry.se3 import quat_from_rotation as quat

RIG = "yam_v1+linear_4310"
RADTAN = (0.05, -0.02, 0.001, 0.002)
RATIONAL = (*RADTAN, 0.01, 0.2, 0.03, 0.004)
K = [[300.0, 0.0, 159.5], [0.0, 310.0, 119.5], [0.0, 0.0, 1.0]]
T_TOP = pose((0.4, 0.1, 1.2), rotation_from_vector([2.9, 0.2, 0.1]))
T_SIDE = pose((0.6, -0.5, 0.5), rotation_from_vector([-1.4, 0.3, 0.2]))
T_WRIST = pose((0.02, 0.07, 0.03), rotation_from_vector([0.1, 0.4, -0.2]))
T_RIGHT = pose((0.01, -0.62, 0.002), rotation_from_vector([0.01, 0.0, 0.05]))
POINT = np.array([0.3, -0.1, 0.2, 1.0])


def _pose_keys(T: Array) -> dict[str, Any]:
    return {"position": T[:3, 3].tolist(), "quat": np.asarray(quat(T[:3, :3])).tolist()}


def _camera(name: str, T: Array, distortion: tuple[float, ...]) -> dict[str, Any]:
    return {
        "name": name,
        **_pose_keys(T),
        "width": 320,
        "height": 240,
        "K": K,
        "distortion": list(distortion),
        "position_95_mm": [2, 2, 2],
        "rotation_95_deg": [0.1, 0.1, 0.1],
        "outline_px": 0.2,
    }


def _fixed(name: str, T: Array, distortion: tuple[float, ...]) -> dict[str, Any]:
    figures = {"focal": "given", "focal_95_percent": 0.5, "delay_ms": 20.0, "delay_95_ms": 5.0, "frames": 40}
    return _camera(name, T, distortion) | figures


def _arm(name: str, T: Array, width_mm: float) -> dict[str, Any]:
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
    """A hand-made calibration of two arms in a directory, and the arms' names."""

    folder: Path
    left: str
    right: str

    def write(self, base_95_mm: float = 3.0, **changed: Any) -> None:
        data = {
            "rig": RIG,
            "reference": self.left,
            "cameras": [_fixed("top", T_TOP, RADTAN), _fixed("side", T_SIDE, ())],
            "arms": [_arm(self.left, np.eye(4), 0.0), _arm(self.right, T_RIGHT, base_95_mm)],
            "wrist_cameras": [
                _camera(f"{side}_wrist_camera", T_WRIST, RATIONAL) | {"arm": arm, "pictures": 12}
                for side, arm in (("left", self.left), ("right", self.right))
            ],
        }
        (self.folder / "calibration.yaml").write_text(yaml.safe_dump(data | changed))

    def export(self, *flags: str, out: str = "out") -> Any:
        return yamsim("export", "calibration", "calibration.yaml", out, "--json", *flags, cwd=self.folder)


@pytest.fixture
def filed(tmp_path: Path, station: RigConfig) -> Station:
    names = [station.arms[k].name for k in station.recording_order]
    return Station(tmp_path, *names)


def _assert_intrinsics(path: Path, distortion: tuple[float, ...]) -> None:
    read = read_camera(path).data
    assert np.reshape(read["K"], (3, 3)) == pytest.approx(np.array(K))
    padded = [*distortion, *[0.0] * (len(read["distortion"]) - len(distortion))]
    assert read["distortion"] == pytest.approx(padded)
    assert (read["width"], read["height"]) == (320, 240)


def _ros_transforms(path: Path) -> dict[tuple[str, str], Array]:
    found = {}
    for line in path.read_text().splitlines():
        if line.startswith("ros2"):
            words = shlex.split(line.removesuffix(" &"))[4:]
            value = dict(zip(words[::2], words[1::2], strict=True))
            x, y, z, qx, qy, qz, qw = (float(value[f"--{key}"]) for key in ("x", "y", "z", "qx", "qy", "qz", "qw"))
            found[value["--frame-id"], value["--child-frame-id"]] = pose_from_quat((x, y, z), (qw, qx, qy, qz))
    return found


def test_all_formats_are_read_back(filed: Station) -> None:
    filed.write()
    run = filed.export()
    assert run.code == 0, run.err
    assert list(run.json["formats"]) == ["ros", "kalibr", "raiden", "inspect_robots"]
    out = filed.folder / "out"

    _assert_intrinsics(out / "ros/top.yaml", RADTAN)
    _assert_intrinsics(out / "ros/left_wrist_camera.yaml", RATIONAL)
    info = yaml.safe_load((out / "ros/left_wrist_camera.yaml").read_text())
    assert (info["distortion_model"], info["distortion_coefficients"]["cols"]) == ("rational_polynomial", 8)
    info = yaml.safe_load((out / "ros/top.yaml").read_text())
    assert (info["distortion_model"], info["distortion_coefficients"]["cols"]) == ("plumb_bob", 5)
    assert np.reshape(info["projection_matrix"]["data"], (3, 4))[:, :3].tolist() == K
    frames = _ros_transforms(out / "ros/static_transforms.sh")
    left, right = f"{filed.left}_base", f"{filed.right}_base"
    assert frames[left, "top_optical_frame"] @ POINT == pytest.approx(T_TOP @ POINT)
    assert frames[f"{filed.right}_flange", "right_wrist_camera_optical_frame"] @ POINT == pytest.approx(T_WRIST @ POINT)
    assert frames[left, right] @ POINT == pytest.approx(T_RIGHT @ POINT)

    chain = out / "kalibr/camchain.yaml"
    _assert_intrinsics(Path(f"{chain}:cam0"), RADTAN)
    _assert_intrinsics(Path(f"{chain}:cam1"), ())
    cams = yaml.safe_load(chain.read_text())
    in_side = np.array(cams["cam1"]["T_cn_cnm1"]) @ invert_pose(T_TOP) @ POINT
    assert in_side == pytest.approx(invert_pose(T_SIDE) @ POINT)
    assert (len(cams), "T_cn_cnm1" in cams["cam0"], cams["cam1"]["distortion_model"]) == (2, False, "none")
    assert sum("a camchain is rigid" in line for line in run.json["left_out"]) == 2

    config = configparser.ConfigParser()
    config.read(out / "inspect_robots/config.ini")
    args = config["embodiment.args"]
    assert [float(value) for value in args["collision_left_base_pos"].split(",")] == [0, 0, 0]
    position = [float(value) for value in args["collision_right_base_pos"].split(",")]
    assert position == pytest.approx(T_RIGHT[:3, 3], abs=1e-6)
    assert float(args["collision_right_base_yaw"]) == pytest.approx(0.05, abs=1e-4)
    assert any(f"right base, {math.degrees(0.01):.2f} degrees" in line for line in run.json["left_out"])


def test_raidens_file_is_read_back(filed: Station) -> None:
    filed.write()
    run = filed.export("--format", "raiden")
    assert run.code == 0, run.err
    path = filed.folder / "out/raiden/calibration_results.json"
    data = json.loads(path.read_text())
    for name, distortion in (("top", RADTAN), ("side", ()), ("right_wrist_camera", RATIONAL)):
        _assert_intrinsics(Path(f"{path}:{name}"), distortion)

    def read(entry: dict[str, Any]) -> Array:
        assert entry["success"]
        return pose(entry["translation_vector"], entry["rotation_matrix"])

    assert read(data["cameras"]["top"]["extrinsics"]) @ POINT == pytest.approx(T_TOP @ POINT)
    left, right = (read(data["cameras"][f"{side}_wrist_camera"]["hand_eye_calibration"]) for side in ("left", "right"))
    # raiden turns the pose of the right camera by 180 degrees about its optical axis.
    assert right @ np.diag([-1.0, -1.0, 1.0, 1.0]) @ POINT == pytest.approx(left @ POINT)
    assert np.linalg.norm(left[:3, 3] - T_WRIST[:3, 3]) > 0.05  # the fingertips are further along than the flange
    right_base = invert_pose(np.array(data["bimanual_transform"]["right_base_to_left_base"]))
    assert right_base @ POINT == pytest.approx(T_RIGHT @ POINT)


def test_what_does_not_fit_is_left_out_and_named(filed: Station) -> None:
    prism = (*RATIONAL, 0.001, 0.0, 0.0, 0.0)
    cameras = [_fixed("top", T_TOP, prism), _fixed("side", T_SIDE, (*RADTAN, 0.01))]
    # The interval before the fit is 58.8 mm; a measured one is below 0.7 times that, 41.2 mm.
    filed.write(base_95_mm=42.0, cameras=cameras, wrist_cameras=[])
    run = filed.export()
    assert run.code == 0, run.err
    assert run.json["formats"] == {
        "ros": ["side.yaml", "static_transforms.sh"],
        "raiden": ["calibration_results.json"],
    }
    lines = run.json["left_out"]
    assert sum("is not measured" in line for line in lines) == 3
    assert sum("thin-prism" in line for line in lines) == 1
    assert sum("radtan has only these" in line for line in lines) == 2
    assert "bimanual_transform" not in json.loads((filed.folder / "out/raiden/calibration_results.json").read_text())
    none = filed.export("--format", "inspect_robots", out="none")
    assert (none.code, "is not measured" in none.message) == (2, True)
    assert not (filed.folder / "none").exists()


def test_wrong_requests_are_refused(filed: Station) -> None:
    filed.write()
    wrong = filed.export("--format", "rso")
    assert (wrong.code, "'ros'" in wrong.message or "ros" in wrong.message.split(";")[-1]) == (2, True)
    (filed.folder / "out").mkdir()
    (filed.folder / "out/notes").write_text("mine")
    existing = filed.export("--format", "kalibr")
    assert (existing.code, "--overwrite" in existing.message) == (2, True)
    assert filed.export("--format", "kalibr", "--overwrite").code == 0
    assert [path.name for path in (filed.folder / "out").iterdir()] == ["kalibr"]
    filed.write(cameras=[_fixed("../top", T_TOP, ())])
    escaping = filed.export(out="escaping")
    assert (escaping.code, "'../top'" in escaping.message) == (2, True)
    filed.write(arms=[_arm("thumb", np.eye(4), 0.0)], reference="thumb")
    stranger = filed.export(out="stranger")
    assert (stranger.code, "'thumb'" in stranger.message) == (2, True)
