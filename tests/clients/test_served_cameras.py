"""raiden's policies, unmodified, on a served robot; its cameras and LeRobot's on served pictures.

`YAMSIM_CHIRAL` and `YAMSIM_RAIDEN` name checkouts of TRI-ML's repositories.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.clients.environments import REPOSITORY, Interpreter, checkout
from tests.clients.served_robot import served_robot

pytestmark = pytest.mark.render

STATION = ("--rig", "yam_station_linear_4310_d405", "--size", "160x120", "--quality", "fast")


@pytest.mark.client_heavy
def test_chirals_client_drives_both_arms_and_sees(client: Callable[[str], Interpreter], tmp_path: Path) -> None:
    interpreter = client("chiral")
    with served_robot(tmp_path / "buses", *STATION, "--chiral", "0") as served:
        told = interpreter.run("drive_chiral.py", checkout("YAMSIM_CHIRAL"), served.chiral)
    assert told["metadata"]["action_shape"] == [20]
    names = ["top", "left_wrist_camera", "right_wrist_camera"]
    assert told["metadata"]["cameras"] == names
    assert told["stopped"] == ""
    assert told["off_rad"] < 0.02
    assert told["off_m"] < 0.005
    assert told["age_s"] < 2
    for name in names:
        shape, dtype, contrast = told["cameras"][name]
        assert (shape, dtype) == ([384, 384, 3], "uint8")
        assert contrast > 5
        assert told["moved"][name] > 1


@pytest.mark.client_heavy
def test_raidens_cameras_see(client: Callable[[str], Interpreter], tmp_path: Path) -> None:
    interpreter = client("raiden-cameras")
    with served_robot(tmp_path / "buses", *STATION, "--cameras"):
        told = interpreter.run("raiden_cameras.py", checkout("YAMSIM_RAIDEN"), REPOSITORY, tmp_path / "buses")
    for name, upright in (("left_wrist_camera", True), ("right_wrist_camera", False)):
        one = told[name]
        assert (one["shape"], one["size"]) == ([120, 160, 3], [160, 120])
        assert not one["distorted"] and one["recorded"] == 2
        assert one["centre"] == pytest.approx([79.5, 59.5])
        assert 0 <= one["behind_s"] < 5
        assert (one["straight"] < 1) is upright
        assert (one["turned"] < 1) is not upright


@pytest.mark.client_heavy
def test_lerobots_cameras_see(client: Callable[[str], Interpreter], tmp_path: Path) -> None:
    interpreter = client("lerobot")
    with served_robot(tmp_path / "buses", *STATION, "--cameras"):
        told = interpreter.run("lerobot_cameras.py", REPOSITORY, tmp_path / "buses")
    assert told["shape"] == [120, 160, 3]
    assert told["of_config"] == [120, 160, 30]
    assert told["contrast"] > 5 and told["swapped"] < 1 and told["same"] < 1
    # Each picture was read once: no faster than rendered.
    assert told["a_second"] < 35
    assert told["late"]
    assert "9x9" in told["refused"] and "serve-robot --size" in told["refused"]
    assert not told["connected"]
