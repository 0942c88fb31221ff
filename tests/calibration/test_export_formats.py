"""Files of other programs with a calibration, read back by their conventions."""

from __future__ import annotations

import configparser
import json
import math
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from tests.calibration.handmade_station import (
    RADTAN,
    RATIONAL,
    SIDE_TURN,
    T_FLANGE_IN_GRASP,
    T_RIGHT,
    T_SIDE,
    T_TOP,
    T_WRIST,
    TOP_TURN,
    K,
    Station,
    calibrated_arm,
    camera_on_body,
    fixed_camera,
    handmade_station,
)
from yamsim_cli.core.config.cameras.camera_files import read_camera
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.geometry.se3 import pose


@pytest.fixture
def filed(tmp_path: Path, station: RigConfig) -> Station:
    return handmade_station(tmp_path, station)


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
            T = pose([float(value[f"--{axis}"]) for axis in "xyz"], turn.as_matrix())
            frames[value["--frame-id"], value["--child-frame-id"]] = T
    expected = filed.ros_transforms
    assert frames.keys() == expected.keys()
    for key, T in expected.items():
        assert frames[key] == pytest.approx(T, abs=1e-9), key


def test_kalibrs_chain_is_read_back(filed: Station) -> None:
    # The middle camera does not fit: the chain goes from the first to the third.
    cameras = [
        fixed_camera("top", T_TOP, RADTAN),
        fixed_camera("wide", np.eye(4), RATIONAL),
        fixed_camera("side", T_SIDE, ()),
    ]
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
    # Not `none` for the second: Kalibr's `AslamCamera` of such a camera has no geometry.
    lenses = [(cam["distortion_model"], cam["distortion_coeffs"]) for cam in cams.values()]
    assert lenses == [("radtan", list(RADTAN)), ("radtan", [0.0] * 4)]
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

    def read(entry: dict[str, Any]) -> np.ndarray:
        assert entry["success"]
        assert Rotation.from_rotvec(entry["rotation_vector"]).as_matrix() == pytest.approx(
            np.array(entry["rotation_matrix"])
        )
        return pose(entry["translation_vector"], entry["rotation_matrix"])

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
    cameras = [fixed_camera("top", T_TOP, prism), fixed_camera("side", T_SIDE, (*RADTAN, 0.01))]
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
    filed.write(
        rig="yam_v1_linear_4310", reference="arm1", arms=[calibrated_arm("arm1", np.eye(4), 0.0)], wrist_cameras=[]
    )
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
    left = camera_on_body("left_eye", T_WRIST, ())
    without_matrix = {key: value for key, value in fixed_camera("top", T_TOP, ()).items() if key != "K"}
    for code, named, changed in (
        (3, "cameras", {"cameras": [without_matrix]}),
        (3, "rig", {"rig": "unknown_rig"}),
        (2, "'../top'", {"cameras": [fixed_camera("../top", T_TOP, ())]}),
        (2, "several cameras 'top'", {"cameras": [fixed_camera("top", T_TOP, ())] * 2}),
        (2, "thumb", {"arms": [calibrated_arm("thumb", np.eye(4), 0.0)], "reference": "thumb"}),
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
