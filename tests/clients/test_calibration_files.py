"""Files of `export calibration`, read by the programs that they are for.

`YAMSIM_IMAGE_COMMON`, `YAMSIM_GEOMETRY2`, `YAMSIM_KALIBR` and `YAMSIM_RAIDEN` name checkouts of
ros-perception/image_common, ros2/geometry2, ethz-asl/kalibr and TRI-ML/raiden, without submodules. The programs of ROS
are compiled from them with g++, that of the cameras also with yaml-cpp.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.calibration.handmade_station import (
    RADTAN,
    RATIONAL,
    T_FLANGE_IN_GRASP,
    T_RIGHT,
    T_SIDE,
    T_TOP,
    T_WRIST,
    K,
    handmade_station,
)
from tests.clients.environments import SCRIPTS, Interpreter, checkout
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.geometry.se3 import pose

pytestmark = pytest.mark.client

EXACT = 1e-9  # m and parts of a rotation matrix
# Headers of ROS 2 that `ros_stubs.hpp` replaces.
_STUBBED = (
    "rclcpp/rclcpp.hpp",
    "rclcpp/logging.hpp",
    "sensor_msgs/distortion_models.hpp",
    "sensor_msgs/msg/camera_info.hpp",
    "tf2_ros/static_transform_broadcaster_node.hpp",
)


@pytest.fixture
def exported(tmp_path: Path, station: RigConfig) -> Callable[[str], Path]:
    """Return the folder of a format with the calibration of the hand-made station, whose arms are left and right."""

    def export(form: str) -> Path:
        filed = handmade_station(tmp_path, station)
        filed.write()
        run = filed.export("--format", form)
        assert run.code == 0, run.err
        return tmp_path / "out" / form

    return export


@pytest.fixture
def compiled(tmp_path: Path) -> Callable[..., Path]:
    """Compile C++ sources of ROS with the stubs; skip the test without compiler or library."""

    def make(sources: Sequence[Path], includes: Sequence[Path], header: str = "", library: str = "") -> Path:
        gxx = shutil.which("g++")
        if gxx is None:
            pytest.skip("g++ is not installed")
        if header and _call(gxx, "-x", "c++", "-E", "-include", header, os.devnull).returncode:
            pytest.skip(f"{header} is not installed")
        stubs = tmp_path / "stubs"
        for name in _STUBBED:
            (stubs / name).parent.mkdir(parents=True, exist_ok=True)
            (stubs / name).write_text('#include "ros_stubs.hpp"\n')
        folders = [f"-I{folder}" for folder in (stubs, SCRIPTS, *includes)]
        links = [f"-l{library}"] if library else []
        program = tmp_path / "program"
        done = _call(gxx, "-std=c++17", "-w", *folders, *map(str, sources), "-o", str(program), *links)
        assert done.returncode == 0, done.stderr
        return program

    return make


def _call(*command: str, path: str = "") -> subprocess.CompletedProcess[str]:
    environ = os.environ | {"PATH": os.pathsep.join(filter(None, (path, os.environ["PATH"])))}
    return subprocess.run(command, env=environ, capture_output=True, text=True, timeout=300, check=False)


def test_ros_parses_the_cameras(
    client: Callable[[str], Interpreter], exported: Callable[[str], Path], compiled: Callable[..., Path]
) -> None:
    client("ros-cameras")
    package = checkout("YAMSIM_IMAGE_COMMON") / "camera_calibration_parsers"
    sources = [package / "src/parse_yml.cpp", SCRIPTS / "ros_cameras.cpp"]
    program = compiled(sources, [package / "include"], header="yaml-cpp/yaml.h", library="yaml-cpp")
    lenses = {"top": (*RADTAN, 0.0), "side": (0.0,) * 5, "left_eye": RATIONAL, "right_eye": RATIONAL}
    folder = exported("ros")
    done = _call(str(program), *(str(folder / f"{name}.yaml") for name in lenses))
    assert done.returncode == 0 and not done.stderr, done.stderr
    for name, line in zip(lenses, done.stdout.splitlines(), strict=True):
        read = json.loads(line)
        model = "plumb_bob" if len(lenses[name]) == 5 else "rational_polynomial"
        assert (read["name"], read["model"], read["size"]) == (name, model, [320, 240])
        np.testing.assert_allclose(np.reshape(read["k"], (3, 3)), K, rtol=0, atol=EXACT)
        np.testing.assert_allclose(read["d"], lenses[name], rtol=0, atol=EXACT)
        np.testing.assert_array_equal(np.reshape(read["r"], (3, 3)), np.eye(3))
        np.testing.assert_allclose(np.reshape(read["p"], (3, 4)), np.hstack([K, np.zeros((3, 1))]), rtol=0, atol=EXACT)


def test_ros_publishes_the_poses(
    client: Callable[[str], Interpreter],
    exported: Callable[[str], Path],
    compiled: Callable[..., Path],
    station: RigConfig,
    tmp_path: Path,
) -> None:
    """The exported script runs with a `ros2` that starts the compiled publisher."""
    client("ros-transforms")
    repository = checkout("YAMSIM_GEOMETRY2")
    source = repository / "tf2_ros/src/static_transform_broadcaster_program.cpp"
    program = compiled([source], [repository / "tf2/include"])
    script = tmp_path / "bin" / "ros2"
    script.parent.mkdir()
    script.write_text(
        f'#!/bin/sh\n[ "$1 $2 $3" = "run tf2_ros static_transform_publisher" ] && shift 3 && {program} "$@"'
    )
    script.chmod(0o755)
    done = _call("sh", str(exported("ros") / "static_transforms.sh"), path=str(script.parent))
    assert done.returncode == 0 and not done.stderr, done.stderr
    frames = {}
    for line in done.stdout.splitlines():
        read = json.loads(line)
        turn = Rotation.from_quat([read[f"rotation.{axis}"] for axis in "xyzw"])
        T = pose([read[f"translation.{axis}"] for axis in "xyz"], turn.as_matrix())
        frames[read["frame_id"], read["child_frame_id"]] = T
    expected = handmade_station(tmp_path, station).ros_transforms
    assert frames.keys() == expected.keys()
    for key, T in expected.items():
        np.testing.assert_allclose(frames[key], T, rtol=0, atol=EXACT)


def test_kalibr_reads_the_chain(client: Callable[[str], Interpreter], exported: Callable[[str], Path]) -> None:
    interpreter = client("kalibr")
    camchain = exported("kalibr") / "camchain.yaml"
    top, side = interpreter.run("read_camchain.py", checkout("YAMSIM_KALIBR"), camchain)["cameras"]
    assert (top["topic"], side["topic"]) == ("/top/image_raw", "/side/image_raw")
    for read, lens in ((top, RADTAN), (side, (0.0,) * 4)):
        assert read["projection"] == [K[0][0], K[1][1], K[0][2], K[1][2], 320, 240]
        assert read["lens"] == list(lens)
    np.testing.assert_allclose(side["from_previous"], np.linalg.inv(T_SIDE) @ T_TOP, rtol=0, atol=EXACT)


def test_raidens_server_reads_the_poses(client: Callable[[str], Interpreter], exported: Callable[[str], Path]) -> None:
    interpreter = client("raiden-calibration")
    path = exported("raiden") / "calibration_results.json"
    read = interpreter.run("read_raiden_calibration.py", checkout("YAMSIM_RAIDEN"), path)
    # raiden has already turned the right camera's pose as it turns the pictures.
    in_grasp = T_FLANGE_IN_GRASP @ T_WRIST
    expected = {
        "scene": {"top": T_TOP, "side": T_SIDE},
        "wrist": {"left_wrist_camera": in_grasp, "right_wrist_camera": in_grasp},
        "bases": {"right": T_RIGHT},
    }
    assert {kind: set(of) for kind, of in read.items()} == {kind: set(of) for kind, of in expected.items()}
    for kind, of in expected.items():
        for name, T in of.items():
            np.testing.assert_allclose(read[kind][name], T, rtol=0, atol=EXACT)


def test_inspect_robots_checks_collisions_with_the_bases(
    client: Callable[[str], Interpreter], exported: Callable[[str], Path]
) -> None:
    read = client("inspect-robots-bases").run("read_bases.py", exported("inspect_robots") / "config.ini")
    yaw = Rotation.from_euler("z", 0.05).as_matrix()  # of `T_RIGHT`, whose tilt the file leaves out
    for side, position, rotation in (("left", np.zeros(3), np.eye(3)), ("right", T_RIGHT[:3, 3], yaw)):
        np.testing.assert_allclose(read[side]["position"], position, rtol=0, atol=EXACT)
        np.testing.assert_allclose(read[side]["rotation"], rotation, rtol=0, atol=EXACT)
