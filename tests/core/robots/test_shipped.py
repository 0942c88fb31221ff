"""Shipped arms and grippers: they fit, and equal the models of recordings."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.core.robots.same_models import figures
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.robots.models import ArmModel, Gripper
from yamsim_cli.core.robots.robot import Robot, assemble_robot
from yamsim_cli.core.scene.assets import load_lock
from yamsim_cli.core.scene.build import build_scene

KEPT = json.loads((Path(__file__).parents[2] / "data" / "robot_models.json").read_text())
WHERE = Locations.from_environment({})


def shipped(model: str, gripper: str) -> Robot:
    return assemble_robot(
        load_config(ArmModel, "robots", model, WHERE), load_config(Gripper, "grippers", gripper, WHERE)
    )


def _pairs() -> list[tuple[str, str]]:
    """Every arm with every gripper that fits it, by either file."""
    arms = [load_config(ArmModel, "robots", name, WHERE) for name in WHERE.config_names("robots")]
    grippers = [load_config(Gripper, "grippers", name, WHERE) for name in WHERE.config_names("grippers")]
    return [
        (arm.name, gripper.name)
        for arm in arms
        for gripper in grippers
        if gripper.name in arm.grippers or arm.name in gripper.arms
    ]


@pytest.mark.parametrize("rig", KEPT)
def test_scenes_are_the_models_that_recordings_were_made_with(
    make_config: Callable[..., RecordConfig], locations: Locations, rig: str
) -> None:
    """The kept figures are older than separate files of arms and grippers."""
    changes = {("rig",): rig, ("boards",): rig in ("single", "russet"), ("wrist",): True}
    found = figures(build_scene(Session(make_config(changes), locations)).model)
    assert [name for name in KEPT[rig] if found[name] != KEPT[rig][name]] == []


@pytest.mark.parametrize(("model", "gripper"), _pairs())
def test_every_pair_that_fits_is_a_model_with_the_stops_of_its_files(model: str, gripper: str) -> None:
    robot = shipped(model, gripper)
    spec = mujoco.MjSpec.from_string(robot.xml)
    joints = {joint.name: tuple(joint.range) for joint in spec.joints}
    for joint in robot.joints:
        assert joints[joint.name] == joint.range
        assert joint.motor_rad_s < joint.reported_rad_s
    if robot.fingers:
        for name, sign in zip(robot.fingers.joints, robot.finger_signs, strict=True):
            assert joints[name] == tuple(sorted(sign * end for end in robot.fingers.range))
    assert {actuator.name for actuator in spec.actuators} == set(robot.drive_names)
    sites = {site.name for site in spec.sites}
    assert {"grasp_site", "pinch_site"} <= sites or robot.fingers is None


@pytest.mark.parametrize(("model", "gripper"), _pairs())
def test_mesh_files_are_those_of_their_sets(model: str, gripper: str) -> None:
    lock, robot = load_lock(WHERE), shipped(model, gripper)
    for mesh in mujoco.MjSpec.from_string(robot.xml).meshes:
        assets, _, file = mesh.file.partition("/")
        assert assets in robot.mesh_sets
        assert file in lock.sets[assets].files


def test_grippers_change_nothing_of_the_links_before_the_flange() -> None:
    crank, linear = (mujoco.MjSpec.from_string(shipped("i2rt_yam", name).xml) for name in ("crank", "linear_4310"))
    for k in range(1, 6):
        one, other = crank.body(f"link_{k}"), linear.body(f"link_{k}")
        for key in ("pos", "quat", "mass", "ipos", "iquat", "inertia", "gravcomp"):
            np.testing.assert_array_equal(getattr(one, key), getattr(other, key), err_msg=f"link_{k} {key}")
