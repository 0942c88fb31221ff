"""Files of other programs with a calibration, read back by their conventions."""

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
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.cli.run_cli import yamsim
from yamsim_cli.core.config.cameras.camera_files import read_camera
from yamsim_cli.core.config.rig import RigConfig

Array = NDArray[np.float64]

RADTAN = (0.05, -0.02, 0.001, 0.002)
RATIONAL = (*RADTAN, 0.01, 0.2, 0.03, 0.004)
K = [[300.0, 0.0, 159.5], [0.0, 310.0, 119.5], [0.0, 0.0, 1.0]]


def _T(position: Any, rotation: Rotation) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), position
    return T


TOP_TURN, SIDE_TURN = Rotation.from_rotvec([2.9, 0.2, 0.1]), Rotation.from_rotvec([-1.4, 0.3, 0.2])
WRIST_TURN, BASE_TURN = Rotation.from_rotvec([0.1, 0.4, -0.2]), Rotation.from_euler("ZYX", [0.05, 0.0, 0.01])
T_TOP = _T((0.4, 0.1, 1.2), TOP_TURN)
T_SIDE = _T((0.6, -0.5, 0.5), SIDE_TURN)
T_WRIST = _T((0.02, 0.07, 0.03), WRIST_TURN)
# `grasp_site` is 0.1347 m along the flange's z, as in the model of raiden's kinematics. Its y is the flange's x.
T_FLANGE_IN_GRASP = _T((0.0, 0.0, -0.1347), Rotation.from_euler("z", 90, degrees=True))
T_RIGHT = _T((0.01, -0.62, 0.002), BASE_TURN)


def _pose_keys(T: Array) -> dict[str, Any]:
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    return {"position": T[:3, 3].tolist(), "quat": [w, x, y, z]}


def _camera(name: str, T: Array, distortion: tuple[float, ...], width_mm: float = 2.0) -> dict[str, Any]:
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
    """A hand-made calibration of the station's two arms in a directory, and the names of its left and right arm."""

    folder: Path
    rig: RigConfig
    left: str
    right: str

    def write(self, base_95_mm: float = 3.0, wrist_95_mm: float = 2.0, **changed: Any) -> None:
        arms = {self.left: _arm(self.left, np.eye(4), 0.0), self.right: _arm(self.right, T_RIGHT, base_95_mm)}
        data = {
            "rig": self.rig.name,
            "reference": self.left,
            "cameras": [_fixed("top", T_TOP, RADTAN), _fixed("side", T_SIDE, ())],
            "arms": [arms[arm.name] for arm in self.rig.arms],
            "wrist_cameras": [
                _camera(f"{side}_eye", T_WRIST, RATIONAL, wrist_95_mm) | {"arm": arm, "pictures": 12}
                for side, arm in (("left", self.left), ("right", self.right))
            ],
        }
        (self.folder / "calibration.yaml").write_text(json.dumps(data | changed))

    def export(self, *flags: str, out: str = "out") -> Any:
        return yamsim("export", "calibration", "calibration.yaml", out, "--json", *flags, cwd=self.folder)


@pytest.fixture
def filed(tmp_path: Path, station: RigConfig) -> Station:
    left, right = (station.arms[k].name for k in station.recording_order)
    return Station(tmp_path, station, left, right)


def _assert_read_by_import(path: Path, distortion: tuple[float, ...]) -> None:
    read = read_camera(path).data
    assert np.reshape(read["K"], (3, 3)) == pytest.approx(np.array(K))
    padded = [*distortion, *[0.0] * (len(read["distortion"]) - len(distortion))]
    assert read["distortion"] == pytest.approx(padded)
    assert (read["width"], read["height"]) == (320, 240)


def test_ros_files_are_read_back(filed: Station) -> None:
    filed.write()
    run = filed.export("--format", "ros")
    assert (run.code, run.json["left_out"]) == (0, []), run.err
    out = filed.folder / "out/ros"
    for camera, distortion, model, count in (
        ("top", RADTAN, "plumb_bob", 5),
        ("side", (), "plumb_bob", 5),
        ("left_eye", RATIONAL, "rational_polynomial", 8),
    ):
        _assert_read_by_import(out / f"{camera}.yaml", distortion)
        info = yaml.safe_load((out / f"{camera}.yaml").read_text())
        lens = info["distortion_coefficients"]
        assert (info["camera_name"], info["distortion_model"]) == (camera, model)
        assert (lens["rows"], lens["cols"], len(lens["data"])) == (1, count, count)
        assert np.reshape(info["rectification_matrix"]["data"], (3, 3)).tolist() == np.eye(3).tolist()
        assert np.reshape(info["projection_matrix"]["data"], (3, 4)).tolist() == [[*row, 0.0] for row in K]

    frames = {}
    for line in (out / "static_transforms.sh").read_text().splitlines():
        if line.startswith("ros2 run tf2_ros static_transform_publisher"):
            words = shlex.split(line.removesuffix(" &"))[4:]
            value = dict(zip(words[::2], words[1::2], strict=True))
            turn = Rotation.from_quat([float(value[f"--q{axis}"]) for axis in "xyzw"])
            T = _T([float(value[f"--{axis}"]) for axis in "xyz"], turn)
            frames[value["--frame-id"], value["--child-frame-id"]] = T
    expected = {
        (f"{filed.left}_base", "top_optical_frame"): T_TOP,
        (f"{filed.left}_base", "side_optical_frame"): T_SIDE,
        (f"{filed.left}_flange", "left_eye_optical_frame"): T_WRIST,
        (f"{filed.right}_flange", "right_eye_optical_frame"): T_WRIST,
        (f"{filed.left}_base", f"{filed.right}_base"): T_RIGHT,
    }
    assert frames.keys() == expected.keys()
    for key, T in expected.items():
        assert frames[key] == pytest.approx(T, abs=1e-9), key


def test_kalibrs_chain_is_read_back(filed: Station) -> None:
    # The middle camera does not fit: the chain goes from the first to the third.
    cameras = [_fixed("top", T_TOP, RADTAN), _fixed("wide", np.eye(4), RATIONAL), _fixed("side", T_SIDE, ())]
    filed.write(cameras=cameras)
    run = filed.export("--format", "kalibr")
    assert run.code == 0, run.err
    path = filed.folder / "out/kalibr/camchain.yaml"
    _assert_read_by_import(Path(f"{path}:cam0"), RADTAN)
    _assert_read_by_import(Path(f"{path}:cam1"), ())
    cams = yaml.safe_load(path.read_text())
    assert list(cams) == ["cam0", "cam1"]
    assert cams["cam0"]["intrinsics"] == [300.0, 310.0, 159.5, 119.5]
    assert cams["cam0"]["resolution"] == [320, 240]
    assert [(cam["distortion_model"], len(cam["distortion_coeffs"])) for cam in cams.values()] == [
        ("radtan", 4),
        ("none", 0),
    ]
    assert "T_cn_cnm1" not in cams["cam0"]
    point_in_base = np.array([0.3, -0.1, 0.2])
    in_top, in_side = (
        turn.inv().apply(point_in_base - T[:3, 3]) for turn, T in ((TOP_TURN, T_TOP), (SIDE_TURN, T_SIDE))
    )
    assert np.array(cams["cam1"]["T_cn_cnm1"]) @ [*in_top, 1] == pytest.approx([*in_side, 1])
    lines = run.json["left_out"]
    assert [line.split(":")[1].strip() for line in lines] == ["camera left_eye", "camera right_eye", "camera wide"]
    assert ("radtan has only these" in lines[2], "a camchain is rigid" in lines[0]) == (True, True)


def test_raidens_file_is_read_back(filed: Station) -> None:
    filed.write()
    run = filed.export("--format", "raiden")
    assert (run.code, run.json["left_out"]) == (0, []), run.err
    path = filed.folder / "out/raiden/calibration_results.json"
    data = json.loads(path.read_text())
    for name, distortion in (("top", RADTAN), ("side", ()), ("right_wrist_camera", RATIONAL)):
        _assert_read_by_import(Path(f"{path}:{name}"), distortion)
    assert len(data["cameras"]["side"]["intrinsics"]["distortion_coeffs"]) == 5  # as raiden writes it

    def read(entry: dict[str, Any]) -> Array:
        assert entry["success"]
        assert Rotation.from_rotvec(entry["rotation_vector"]).as_matrix() == pytest.approx(
            np.array(entry["rotation_matrix"])
        )
        return _T(entry["translation_vector"], Rotation.from_matrix(entry["rotation_matrix"]))

    assert read(data["cameras"]["top"]["extrinsics"]) == pytest.approx(T_TOP)
    left = read(data["cameras"]["left_wrist_camera"]["hand_eye_calibration"])
    assert left == pytest.approx(T_FLANGE_IN_GRASP @ T_WRIST, abs=1e-9)
    # raiden turns the pose of the right camera by 180 degrees about its optical axis.
    right = read(data["cameras"]["right_wrist_camera"]["hand_eye_calibration"])
    assert right @ np.diag([-1.0, -1.0, 1.0, 1.0]) == pytest.approx(left)
    assert read(data["cameras"]["right_wrist_camera"]["extrinsics"]) == pytest.approx(left)
    base = data["bimanual_transform"]
    assert base["computed_from_calibration"]
    assert np.linalg.inv(base["right_base_to_left_base"]) == pytest.approx(T_RIGHT)


def test_inspect_robots_section_is_read_back(filed: Station) -> None:
    filed.write()
    run = filed.export("--format", "inspect_robots")
    assert run.code == 0, run.err
    config = configparser.ConfigParser()
    config.read(filed.folder / "out/inspect_robots/config.ini")
    args = dict(config["embodiment.args"])
    assert [float(value) for value in args.pop("collision_left_base_pos").split(",")] == [0, 0, 0]
    position = [float(value) for value in args.pop("collision_right_base_pos").split(",")]
    assert position == pytest.approx(T_RIGHT[:3, 3], abs=1e-6)
    assert float(args.pop("collision_left_base_yaw")) == 0
    assert float(args.pop("collision_right_base_yaw")) == pytest.approx(0.05, abs=1e-6)
    assert args == {}
    (line,) = run.json["left_out"]
    assert f"tilt of the right base, {math.degrees(0.01):.2f} degrees" in line


def test_what_does_not_fit_is_left_out_and_named(filed: Station) -> None:
    prism = (*RATIONAL, 0.001, 0.0, 0.0, 0.0)
    cameras = [_fixed("top", T_TOP, prism), _fixed("side", T_SIDE, (*RADTAN, 0.01))]
    # The interval before the fit is 58.8 mm for the base; a measured one is below 0.7 times that, 41.2 mm. For wrist
    # cameras, these are 39.2 and 27.4 mm.
    filed.write(base_95_mm=42.0, wrist_95_mm=28.0, cameras=cameras)
    run = filed.export()
    assert run.code == 0, run.err
    out = filed.folder / "out"
    assert run.json["formats"] == {
        "ros": ["side.yaml", "static_transforms.sh"],
        "raiden": ["calibration_results.json"],
    }
    written = {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}
    assert written == {"ros/side.yaml", "ros/static_transforms.sh", "raiden/calibration_results.json"}
    commands = (out / "ros/static_transforms.sh").read_text()
    assert (commands.count("side_optical_frame"), commands.count("ros2 run")) == (1, 1)
    raiden = json.loads((out / "raiden/calibration_results.json").read_text())
    assert (set(raiden["cameras"]), "bimanual_transform" in raiden) == ({"top", "side"}, False)
    lines = run.json["left_out"]
    assert (
        len([line for line in lines if f"the base of {filed.right} is not measured (95 % interval 42.0 mm" in line])
        == 3
    )
    assert len([line for line in lines if "its pose is not measured (95 % interval 28.0 mm" in line]) == 4
    assert len([line for line in lines if "thin-prism" in line]) == 1
    assert len([line for line in lines if "radtan has only these" in line]) == 2
    assert all(f"left out: {line}" in run.err for line in lines)
    # A format that `--format` names must fit.
    named = filed.export("--format", "ros", "--format", "inspect_robots", out="named")
    assert (named.code, "does not fit inspect_robots: " in named.message) == (2, True)
    assert not (filed.folder / "named").exists()


def test_just_measured_poses_are_written(filed: Station) -> None:
    filed.write(base_95_mm=41.0, wrist_95_mm=27.0)
    run = filed.export("--format", "raiden")
    assert (run.code, run.json["left_out"]) == (0, [])
    raiden = json.loads((filed.folder / "out/raiden/calibration_results.json").read_text())
    assert ("bimanual_transform" in raiden, len(raiden["cameras"])) == (True, 4)


def test_a_single_arm_has_no_second_base(filed: Station) -> None:
    # calibrate writes the name of a rig ROBOT+GRIPPER with an underscore.
    filed.write(rig="yam_v1_linear_4310", reference="arm1", arms=[_arm("arm1", np.eye(4), 0.0)], wrist_cameras=[])
    without = filed.export()
    assert (without.code, "give --rig" in without.message) == (3, True)
    run = filed.export("--rig", "yam_v1+linear_4310")
    assert run.code == 0, run.err
    assert list(run.json["formats"]) == ["ros", "kalibr", "raiden"]
    assert run.json["left_out"] == ["inspect_robots: config.ini: the calibration has a single arm"]


def test_wrong_requests_are_refused(filed: Station) -> None:
    filed.write()
    wrong = filed.export("--format", "rso")
    assert (wrong.code, "'ros'" in wrong.message) == (2, True)
    (filed.folder / "out").mkdir()
    (filed.folder / "out/notes").write_text("mine")
    existing = filed.export("--format", "kalibr")
    assert (existing.code, "--overwrite" in existing.message) == (2, True)
    assert filed.export("--format", "kalibr", "--overwrite").code == 0
    assert [path.name for path in (filed.folder / "out").iterdir()] == ["kalibr"]
    left = _camera("left_eye", T_WRIST, ())
    without_matrix = {key: value for key, value in _fixed("top", T_TOP, ()).items() if key != "K"}
    for code, named, changed in (
        (3, "cameras", {"cameras": [without_matrix]}),
        (3, "rig", {"rig": "unknown_rig"}),
        (2, "'../top'", {"cameras": [_fixed("../top", T_TOP, ())]}),
        (2, "several cameras 'top'", {"cameras": [_fixed("top", T_TOP, ())] * 2}),
        (2, "thumb", {"arms": [_arm("thumb", np.eye(4), 0.0)], "reference": "thumb"}),
        (2, "reference", {"reference": filed.right}),
        (2, "'thumb'", {"wrist_cameras": [left | {"arm": "thumb", "pictures": 12}]}),
    ):
        filed.write(**changed)
        run = filed.export(out="refused")
        assert (run.code, named in run.message) == (code, True), run.message
    for text in ("[1, 2", "name: a rig\n", "\0"):
        (filed.folder / "calibration.yaml").write_text(text)
        run = filed.export(out="refused")
        assert (run.code, "calibration.yaml" in run.message) == (3, True), run.message
    (filed.folder / "calibration.yaml").unlink()
    missing = filed.export(out="refused")
    assert (missing.code, "give a calibration.yaml" in missing.message) == (3, True)
    assert not (filed.folder / "refused").exists()
