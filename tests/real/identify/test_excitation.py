"""The motion of `yamsim excite`: within limits, without collisions, and informative."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.robots.dynamics import JointDynamics, MeasuredArmDynamics
from yamsim_cli.core.scene.build import build_rig_scene
from yamsim_cli.real.gap.gap_figures import measure_gap
from yamsim_cli.real.identify.excitation import CollisionSpace, Excitation, commands_csv, generate_excitation, log_csv
from yamsim_cli.real.identify.identification import check_logs_usable
from yamsim_cli.real.identify.plant_model import ArmLog, ParametricArm
from yamsim_cli.real.recordings.csv_file import read_csv

WHERE = Locations.from_environment({})
SCENE = load_config(SceneConfig, "scenes", "tabletop", WHERE)


@cache
def _rig(name: str) -> RigConfig:
    return load_config(RigConfig, "rigs", name, WHERE)


@cache
def _excitation(name: str, number: int = 0, seed: int = 0) -> Excitation:
    return generate_excitation(_rig(name), number, SCENE, WHERE, 30.0, seed)


@pytest.mark.parametrize(("name", "number"), [("single", 0), ("bimanual", 1), ("yam_pro+linear_4310", 0)])
def test_a_motion_keeps_to_stops_speeds_and_torques_and_touches_nothing(name: str, number: int) -> None:
    found, arm = _excitation(name, number), _rig(name).arms[number]
    room = CollisionSpace(_rig(name), number, SCENE, WHERE)
    low, high = arm.robot.joint_range.T

    assert (found.commands > low + 0.1).all()
    assert (found.commands < high - 0.1).all()
    speeds = np.abs(np.gradient(found.commands, found.times, axis=0))
    motors = np.array([joint.motor_rad_s for joint in arm.robot.joints])
    assert (speeds < 0.55 * motors).all()
    assert 0 < found.torque <= 0.5
    assert not any(room.is_colliding(row) for row in found.commands[::20])


def test_touching_poses_are_detected() -> None:
    room = CollisionSpace(_rig("single"), 0, SCENE, WHERE)

    assert room.is_colliding(np.array([0.0, 3.2, 0.6, 0.0, 0.0, 0.0]))
    assert not room.is_colliding(np.array(_rig("single").arms[0].robot.start))


def test_every_joint_is_excited_in_every_third_of_it() -> None:
    found = generate_excitation(_rig("single"), 0, SCENE, WHERE, 60.0, 3)
    log = ArmLog("log", found.times, found.commands, found.commands, None)

    for start in (0.0, 20.0, 40.0):
        check_logs_usable([log.slice_time(start, start + 20)], _rig("single").arms[0].robot.joint_names)


def test_a_motion_starts_and_ends_at_rest_in_one_pose_and_follows_from_its_seed() -> None:
    found, again, other = (
        _excitation("single"),
        generate_excitation(_rig("single"), 0, SCENE, WHERE, 30.0, 0),
        _excitation("single", 0, 1),
    )

    assert np.allclose(found.commands[0], found.commands[-1], atol=1e-6)
    assert np.abs(np.diff(found.commands[:3], axis=0)).max() < 1e-4
    assert np.array_equal(found.commands, again.commands)
    assert not np.allclose(found.commands, other.commands)


def test_the_files_hold_commands_and_simulated_readings(tmp_path: Path) -> None:
    rig, found = _rig("bimanual"), _excitation("bimanual", 1)
    (tmp_path / "log.csv").write_bytes(log_csv(rig, 1, found, SCENE, WHERE))

    motion = read_csv(tmp_path / "log.csv", rig)

    place = rig.recording_order.index(1)
    commanded = motion.arms[place].commands
    assert commanded is not None
    assert np.allclose(commanded, found.commands)
    behind = np.abs(motion.arms[place].joints - commanded).max()
    assert 0.001 < behind < 0.5
    lines = commands_csv(rig, 1, found).decode().splitlines()
    assert lines[0].startswith("t,command_left_joint1,")
    assert len(lines) == 1 + len(found.times)
    assert "position" not in lines[0]


@pytest.mark.slow
def test_an_arm_that_is_simulated_by_its_own_revision_has_no_gap(tmp_path: Path) -> None:
    rig, found = _rig("single"), _excitation("single")
    joints = {"joint2": JointDynamics(damping=0.4, offset_rad=0.01, gravity_factor=1.05)}
    dynamics = MeasuredArmDynamics(
        revision="mine", base="i2rt_yam", joints=joints, command_delay_ms=21.3, sensor_delay_ms=3.7, tip_mass_g=50
    )
    mine = rig.model_copy(update={"arms": (rig.arms[0].model_copy(update={"dynamics": dynamics}),)})
    (tmp_path / "log.csv").write_bytes(log_csv(mine, 0, found, SCENE, WHERE))
    motion = read_csv(tmp_path / "log.csv", rig)

    own, plain = (measure_gap(build_rig_scene(each, SCENE, WHERE), motion).error.rms for each in (mine, rig))

    # Rounding of the file's digits.
    assert own < 1e-5
    assert plain > 5e-3


def test_a_plants_values_are_its_models() -> None:
    plant = ParametricArm(_rig("single").arms[0])

    assert np.allclose(plant.model_values.armature, [0.032] * 3 + [0.0018] * 3)
    assert np.allclose(plant.model_values.friction, 0.1)
    assert plant.model_values.delay == 0
