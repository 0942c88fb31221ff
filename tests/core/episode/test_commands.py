"""Drive commands that follow planned paths."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.attempts import start_of
from yamsim_cli.core.attempt_data import JointPath
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.commands import path_actions
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.compiled import CompiledScene


@pytest.fixture(scope="module")
def scene(config: RecordConfig, locations: Locations) -> CompiledScene:
    return Simulator(Session(config, locations)).scene


def path_of(joints: np.ndarray, torque: float = 0.0, magnet: bool = False) -> JointPath:
    n = len(joints) - 1
    torques = np.full((n, joints.shape[1]), torque)
    return JointPath(joints, torques, np.full(n, 0.02), np.zeros(n), (magnet,) * n, tick=0.032)


def test_at_rest_drives_are_told_their_reference(scene: CompiledScene) -> None:
    place = np.array([0.2, 1.5, 1.2, -1.0, 0.1, 0.3])
    actions = path_actions(scene, [path_of(np.tile(place, (4, 1)), magnet=True)])
    np.testing.assert_allclose(actions.ctrl, np.tile([*place, 0.02], (3, 1)))
    np.testing.assert_allclose(actions.joints, np.tile([*place, 0.02], (3, 1, 1)))
    assert actions.magnet.shape == (3, 1) and actions.magnet.all()


def test_in_motion_commands_lead_and_records_have_the_path(scene: CompiledScene) -> None:
    joints = np.linspace([0.2, 1.5, 1.2, -1.0, 0.1, 0.3], [0.3, 1.6, 1.3, -0.9, 0.2, 0.4], 5)
    plain, loaded = (path_actions(scene, [path_of(joints, torque)]) for torque in (0.0, 2.0))
    middles = (joints[1:] + joints[:-1]) / 2
    lead = scene.first_arm.velocity_gain / scene.first_arm.position_gain * (joints[1] - joints[0]) / 0.032
    np.testing.assert_allclose(plain.ctrl[:, scene.first_arm.arm_ctrl], middles + lead)
    np.testing.assert_allclose(
        loaded.ctrl[:, scene.first_arm.arm_ctrl], middles + lead + 2.0 / scene.first_arm.position_gain
    )
    np.testing.assert_allclose(plain.joints[:, 0, :6], joints[1:])
    np.testing.assert_array_equal(plain.joints, loaded.joints)


def test_commands_are_within_what_drives_can_be_told(scene: CompiledScene) -> None:
    joints = np.tile([0.2, 1.5, 1.2, -1.0, 0.1, 0.3], (3, 1))
    ctrl = path_actions(scene, [path_of(joints, 1e6)]).ctrl[:, scene.first_arm.arm_ctrl]
    np.testing.assert_array_equal(ctrl, np.tile(scene.first_arm.ctrl_range[:, 1], (2, 1)))


def test_an_arm_that_is_told_to_stay_stays(config: RecordConfig, locations: Locations) -> None:
    simulator = Simulator(Session(config, locations))
    scene, start = simulator.scene, start_of(simulator)
    place = start[scene.first_arm.joint_qpos]
    data = mujoco.MjData(scene.model)
    scene.reset(data, start)
    data.ctrl[scene.first_arm.arm_ctrl] = path_actions(scene, [path_of(np.tile(place, (2, 1)))]).ctrl[
        0, scene.first_arm.arm_ctrl
    ]
    scene.step(data, 200)
    np.testing.assert_allclose(data.qpos[scene.first_arm.joint_qpos], place, atol=1e-3)
