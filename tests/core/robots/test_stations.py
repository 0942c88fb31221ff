"""The manufacturer's stations: their cameras, and their recordings."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import opencv_from_mujoco
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose, pose_from_quat, rotation_vector
from yamsim_cli.core.scene.build import build_scene
from yamsim_cli.core.scene.compiled import CompiledScene

# From the manufacturer's README of each station (SDK 1.3.6): the upper camera in the left base, and a wrist camera on
# the manufacturer's flange; m and wxyz, rounded to 3 decimals.
_LINEAR = (0, -0.07, 0.077), (-0.976, 0.216, 0, 0)
_CRANK = (0.0017, -0.08, 0.066), (-0.906, 0.423, 0, 0)
_GANTRY = (-0.166, -0.305, 0.954), (0.183, -0.683, 0.683, -0.183)
STATIONS = {
    "yam_station_linear_4310_d405": (_GANTRY, _LINEAR),
    "yam_station_crank_4310_d405": (_GANTRY, _CRANK),
    "yambox_linear_4310_d405_decxin": (((0.027, -0.305, 0.627), (0.265, -0.656, 0.656, -0.265)), _LINEAR),
}
# Half a turn about z from the manufacturer's flange to yamsim's.
_T_FLANGE = pose_from_quat((0, 0, 0), (0, 0, 0, 1))


def _config(rig: str, locations: Locations, **overrides: object) -> RecordConfig:
    given = {(key,): (key, value) for key, value in overrides.items()}
    return load_config(RecordConfig, "record", "default", locations, {("rig",): ("rig", rig), **given})


def _scene(config: RecordConfig, locations: Locations) -> CompiledScene:
    return build_scene(Session(config, locations))


@pytest.mark.parametrize("station", STATIONS)
def test_cameras_look_from_where_the_maker_says(station: str, locations: Locations) -> None:
    config = _config(station, locations)
    assert config.recorded_cameras == ("top", "left", "right")
    scene = _scene(config, locations)
    data = mujoco.MjData(scene.model)
    data.qpos[scene.arms[0].joint_qpos] = (0.3, 1.2, 1.0, -0.4, 0.2, 0.5)
    mujoco.mj_forward(scene.model, data)
    top, wrist = (pose_from_quat(*camera) for camera in STATIONS[station])
    left, right = scene.arms
    _close(invert_pose(left.T_base_in_world) @ _camera(data, "top"), top)
    for arm, name in ((left, "left"), (right, "right")):
        flange = data.body(arm.flange)
        T_flange = pose(flange.xpos, flange.xmat.reshape(3, 3)) @ _T_FLANGE
        _close(invert_pose(T_flange) @ _camera(data, name), wrist)
    np.testing.assert_allclose(
        (invert_pose(left.T_base_in_world) @ right.T_base_in_world)[:3, 3], (0, -0.61, 0), atol=1e-9
    )


def _camera(data: mujoco.MjData, name: str) -> Array:
    view = data.cam(name)
    return pose(view.xpos, opencv_from_mujoco(view.xmat))


def _close(T: Array, expected: Array) -> None:
    """Within 1 mm and 0.1 degrees."""
    assert np.linalg.norm(T[:3, 3] - expected[:3, 3]) < 1e-3
    assert np.linalg.norm(rotation_vector(T[:3, :3].T @ expected[:3, :3])) < math.radians(0.1)


def test_a_size_has_its_field_of_view(locations: Locations) -> None:
    for size, fovy in (((848, 480), 58.0), ((640, 480), 62.8)):
        image = {"size_px": list(size), "jpeg_quality": 85}
        scene = _scene(_config("yam_station_linear_4310_d405", locations, image=image), locations)
        assert {float(scene.model.cam(name).fovy[0]) for name in scene.cameras} == {fovy}


def test_cameras_are_picked_by_name(locations: Locations) -> None:
    config = _config("yam_station_linear_4310_d405", locations, cameras=["right", "scene_camera"])
    assert config.recorded_cameras == ("right", "scene_camera")
    assert [arm.side for arm in config.wrist_arms] == ["right"]
    with pytest.raises(ConfigError, match="has no camera 'topp'; its cameras: scene_camera, top, left, right"):
        _config("yam_station_linear_4310_d405", locations, cameras=["topp"])
